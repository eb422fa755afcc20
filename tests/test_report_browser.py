"""A real browser opens the report: without complaint, on any width, in light and dark."""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import pytest
from playwright.sync_api import Browser, Page

from reverie_eval.reporting.report import report_html
from tests.home import OTHER_WALKS, home_scores


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Write a report on two submissions."""
    mine, theirs = tmp_path_factory.mktemp("mine"), tmp_path_factory.mktemp("theirs")
    other = home_scores(theirs, OTHER_WALKS)
    return report_html({"mine": home_scores(mine).with_intervals(), "theirs": other})


@pytest.fixture
def opened(browser: Browser, both: str, tmp_path: Path) -> Iterator[tuple[Page, list[str]]]:
    """Open the report, and listen to what the browser has to say and to ask for."""
    file = tmp_path / "report.html"
    file.write_text(both)
    heard: list[str] = []
    page = browser.new_page()
    page.on("console", lambda message: heard.append(message.text))
    page.on("pageerror", lambda error: heard.append(str(error)))
    page.on("request", lambda request: heard.append(request.url))
    page.goto(file.as_uri())
    heard.remove(file.as_uri())
    yield page, heard
    page.close()


def test_a_browser_has_no_complaint_and_asks_for_nothing(opened: tuple[Page, list[str]]) -> None:
    _, heard = opened
    assert heard == []


@pytest.mark.parametrize("width", [320, 375, 1280])
def test_the_page_fits_its_window(width: int, opened: tuple[Page, list[str]]) -> None:
    page, _ = opened
    page.set_viewport_size({"width": width, "height": 800})
    wide = page.evaluate("document.documentElement.scrollWidth")
    assert wide == width


@pytest.mark.parametrize(
    ("scheme", "ground", "map_ground"),
    [
        ("light", "rgb(255, 255, 255)", "rgb(247, 248, 250)"),
        ("dark", "rgb(20, 23, 27)", "rgb(28, 33, 40)"),
    ],
)
def test_light_and_dark(
    scheme: Literal["light", "dark"], ground: str, map_ground: str, opened: tuple[Page, list[str]]
) -> None:
    page, _ = opened
    page.emulate_media(color_scheme=scheme)
    style = "(name, key) => getComputedStyle(document.querySelector(name))[key]"
    page_style = f"({style})('body', 'backgroundColor')"
    map_style = f"({style})('.episode-map .ground', 'fill')"
    assert page.evaluate(page_style) == ground
    assert page.evaluate(map_style) == map_ground
