"""Take a picture of every page with the demo data: ``python -m tests.support.screenshots DIR``."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

from playwright.sync_api import Browser

from tests.support.browser import (
    DESKTOP,
    PHONE,
    WIDE,
    Size,
    browsing,
    chromium_path,
    demo_site,
    new_context,
    sign_in,
)
from tests.support.demo_site import Site
from tests.support.page_routes import EXAMPLES, Example

Scheme = Literal["light", "dark"]


class Screen(NamedTuple):
    """Where somebody sits before a page."""

    size: Size
    zone: str = "UTC"
    under: str = "/"
    """Pages that look another way there."""


SCREENS = {
    "desktop": Screen(DESKTOP),
    "phone": Screen(PHONE, zone="Asia/Tokyo"),  # where one's own time is beside each instant
    "wide": Screen(WIDE, under="/boards/"),
}
SCHEMES: tuple[Scheme, ...] = ("light", "dark")


def main(folder: Path, *only: str) -> int:
    """Write ``<page>.<screen>.<scheme>.png`` for pages whose name holds one of the words."""
    chromium = chromium_path()
    if chromium is None:
        print("there is no Chromium here; install Debian's package chromium", file=sys.stderr)  # noqa: T201
        return 2
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [each for each in EXAMPLES if not only or any(word in each.name for word in only)]
    with (
        TemporaryDirectory() as temporary,
        demo_site(Path(temporary) / "server") as site,
        browsing(chromium) as browser,
    ):
        for name, screen in SCREENS.items():
            for example in wanted:
                if example.route.startswith(screen.under):
                    _take(browser, site, example, screen, folder / f"{example.name}.{name}")
    return 0


def _take(browser: Browser, site: Site, example: Example, screen: Screen, to: Path) -> None:
    context = new_context(browser, site, screen.size, timezone_id=screen.zone)
    page = context.new_page()
    if example.who is not None:
        sign_in(page, site.tokens[example.who])
    for scheme in SCHEMES:
        page.emulate_media(color_scheme=scheme)
        page.goto(example.path(site), wait_until="networkidle")
        page.screenshot(path=f"{to}.{scheme}.png", full_page=True)
    context.close()


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), *sys.argv[2:]))
