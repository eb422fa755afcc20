"""Take a picture of every page: ``python -m tests.support.screenshots DIR [WORD ...]``."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from random import Random
from string import Formatter
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple
from urllib.parse import quote

from playwright.sync_api import Browser

from benchmarks.buildings import plan_picture, scans
from fixtures.published import published_folder, unpack_dataset
from fixtures.servers import make_folder
from reverie_eval.dataset import DatasetFiles
from reverie_eval.dataset._dataset import read_dataset
from reverie_eval.geometry import N_HEADINGS, RoomView, model_building
from reverie_eval.processes import no_progress
from reverie_eval.reporting.answer_svg import answer_picture
from reverie_eval.reporting.answers import AnswerView, seen_in
from reverie_eval.server.opening import acting
from reverie_eval.server.settings import load_settings
from tests.support.browser import (
    UNLIMITED,
    Size,
    browsing,
    chromium_path,
    cost_of,
    demo_site,
    exceeded,
    new_context,
    reload_until_ready,
    sign_in,
)
from tests.support.crowded_site import crowd
from tests.support.demo_site import PEOPLE, Site
from tests.support.full_site import full_site
from tests.support.page_routes import EXAMPLES, Example
from tests.support.reader import read
from tests.support.serving import PRIVATE, populate, running

_ROOMS = 20
_SHEET = """body { display: grid; grid-template-columns: repeat(5, 1fr); gap: 10px; margin: 10px }
figure { margin: 0 } img { width: 100% }"""
Scheme = Literal["light", "dark"]
Medium = Literal["screen", "print"]


class Screen(NamedTuple):
    """What somebody sees a page on."""

    size: Size
    zone: str = "UTC"
    schemes: tuple[Scheme, ...] = ("light", "dark")
    medium: Medium = "screen"


SCREENS = {
    "1440": Screen((1440, 900)),
    "1920": Screen((1920, 1080)),
    "390": Screen((390, 844), "Asia/Tokyo"),  # where one's own time is beside each instant
    "paper": Screen((794, 1123), schemes=("dark",), medium="print"),  # A4, from a dark screen
}
NEED_RESULTS = {
    "board",
    "submission_id",
    "other_id",
    "wordy_id",
    "result_id",
    "private_id",
    "team_id",
}
"""Parts of addresses that lead nowhere on an empty server."""
SHOWN_FULL = ("/splits/{split}", "/episodes", "/play", "/submissions", "/teams", "/team")
"""Pages that look otherwise on a server of real size; so does the first page."""


def main(folder: Path, *only: str) -> int:
    """Write ``<page>.<server>.<screen>.<scheme>.png``, and ``index.html`` that shows all of them.

    ``contact-<server>-<screen>-<scheme>.png`` shows those of a server and a screen.

    Of pages whose name holds one of the words, if there are any. On the server of real size, a
    reader first does what readers want to do there. The word ``drawings`` asks for the plans of all
    published buildings and views of twenty rooms, on ``contact-plans.png`` and ``-views.png``.
    """
    chromium = chromium_path()
    if chromium is None:
        print("there is no Chromium here; install Debian's package chromium", file=sys.stderr)  # noqa: T201
        return 2
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [each for each in EXAMPLES if not only or any(word in each.name for word in only)]
    with TemporaryDirectory() as temporary, browsing(chromium) as browser:
        if not only or "drawings" in only:
            _draw_buildings(browser, folder, Path(temporary) / "dataset")
        if only == ("drawings",):
            return 0
        with demo_site(Path(temporary) / "crowded") as site:
            _take_all(browser, crowd(site), wanted, folder, "crowded")
        with _empty_site(Path(temporary) / "empty") as site:
            bare = [each for each in wanted if not _needs_results(each)]
            _take_all(browser, site, bare, folder, "empty")
        with full_site(Path(temporary) / "full", published_folder()) as site:
            print(read(browser.new_page(), site.url, PRIVATE))  # noqa: T201
            few = [
                each for each in wanted if each.route == "/" or each.route.startswith(SHOWN_FULL)
            ]
            _take_all(browser, site, few, folder, "full")
        _write_index(folder, browser)
    return 0


@contextmanager
def _empty_site(folder: Path) -> Iterator[Site]:
    """Run a server with people who have sent nothing."""
    make_folder(folder)
    with acting(load_settings(folder), "test") as transaction:
        tokens = populate(transaction, PEOPLE)
    with running(folder, **UNLIMITED) as (_, url):
        yield Site(url, folder, tokens, {})


def _needs_results(example: Example) -> bool:
    parts = {name for _, name, _, _ in Formatter().parse(example.route + example.query)}
    return "/snapshots/" in example.route or not parts.isdisjoint(NEED_RESULTS)


def _take_all(
    browser: Browser, site: Site, examples: Sequence[Example], folder: Path, kind: str
) -> None:
    for name, screen in SCREENS.items():
        for who in {each.who: None for each in examples}:
            context = new_context(browser, site, screen.size, timezone_id=screen.zone)
            page = context.new_page()
            if who is not None:
                sign_in(page, site.tokens[who])
            page.emulate_media(media=screen.medium)
            for example in (each for each in examples if each.who == who):
                page.goto(example.path(site))
                reload_until_ready(page)
                for each in exceeded(cost_of(page)):
                    print(f"{example.name} on {kind} at {name}: {each}")  # noqa: T201
                for scheme in screen.schemes:
                    page.emulate_media(color_scheme=scheme)
                    path = folder / f"{example.name}.{kind}.{name}.{scheme}.png"
                    page.screenshot(path=path, full_page=True)
            context.close()


def _draw_buildings(browser: Browser, folder: Path, dataset: Path) -> None:
    """Show what is drawn of the published buildings, if they are here."""
    published = published_folder()
    if published is None:
        print("no published files, so no drawings; name their folder in REVERIE_DATA")  # noqa: T201
        return
    read = read_dataset(DatasetFiles.find(unpack_dataset(published, dataset)), no_progress)
    graph = read.graphs.ground_truth()
    found = [*scans(graph, read.boxes)]
    buildings = {each.name: model_building(each.position, each.edges, each.seen) for each in found}
    plans = {each.name: plan_picture(graph, each, buildings[each.name]).picture() for each in found}
    random = Random(1)
    views = {}
    for number, scan in enumerate(random.sample(found, _ROOMS)):
        row = random.choice([row for row, its in enumerate(scan.objects) if its])
        objects = scan.objects[row]
        # As pages show them: some answers, and what somebody sees who turns around.
        target = random.choice(objects) if number % 2 else None
        view = N_HEADINGS + random.randrange(N_HEADINGS)
        view = view if target is None else int(seen_in(view, [target]).view[0])
        important = [target.object_id] if target else []
        room_view = RoomView(
            buildings[scan.name],
            scan.position,
            row,
            view,
            seen_in(view, objects),
            important=important,
        )
        views[f"{scan.name} {row} {view}"] = answer_picture(
            AnswerView("", objects, target, None, None, "", view, "the stop", "", None, room_view)
        )
    # The larger sheet comes last: after it, Chromium takes no other picture.
    for name, drawn in (("views", views), ("plans", plans)):
        page = browser.new_page(viewport={"width": 2000, "height": 900})
        shown = "".join(
            f'<figure><img src="data:image/svg+xml,{quote(each)}">{title}</figure>'
            for title, each in drawn.items()
        )
        page.set_content(f"<style>{_SHEET}</style>{shown}")
        page.screenshot(path=folder / f"contact-{name}.png", full_page=True)
        page.close()


def _write_index(folder: Path, browser: Browser) -> None:
    """Show all pictures on a page, and those of a server and a screen on a contact sheet."""
    pictures = sorted(each.name for each in folder.glob("*.*.*.*.png"))
    style = "img { width: 15rem; height: 20rem; object-fit: cover; object-position: top }"
    sheets: dict[str, list[str]] = {"index": pictures}
    for each in pictures:
        _, kind, screen, scheme, _ = each.split(".")
        sheets.setdefault(f"contact-{kind}-{screen}-{scheme}", []).append(each)
    page = browser.new_page(viewport={"width": 1600, "height": 900})
    for name, shown in sheets.items():
        links = "".join(f'<a href="{each}"><img src="{each}" title="{each}"></a>' for each in shown)
        sheet = folder / f"{name}.html"
        sheet.write_text(f"<style>{style}</style>{links}", encoding="utf-8")
        if name != "index":
            page.goto(sheet.resolve().as_uri(), wait_until="networkidle")
            page.screenshot(path=sheet.with_suffix(".png"), full_page=True)
            sheet.unlink()
    page.close()


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), *sys.argv[2:]))
