"""Take a picture of every page with the demo world: ``python -m tests.screenshots FOLDER``."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from playwright.sync_api import Browser

from tests.browser import (
    DESKTOP,
    PHONE,
    Size,
    browsing,
    chromium_path,
    demo_site,
    new_context,
    sign_in,
)
from tests.demo_site import Site
from tests.page_routes import EXAMPLES, Example

Scheme = Literal["light", "dark"]
SCREENS = {"desktop": DESKTOP, "phone": PHONE}
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
        for screen, size in SCREENS.items():
            for example in wanted:
                _take(browser, site, example, size, folder / f"{example.name}.{screen}")
    return 0


def _take(browser: Browser, site: Site, example: Example, size: Size, to: Path) -> None:
    context = new_context(browser, site, size)
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
