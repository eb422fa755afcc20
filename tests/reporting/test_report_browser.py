"""A real browser opens the report: without complaint, on any width and on paper, light and dark."""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import pytest
from playwright.sync_api import Browser, Page

from reverie_eval.reporting.report import report_html
from tests.support.browser import new_page
from tests.support.home_world import OTHER_WALKS, home_log, home_scores

A4 = 688
"""Pixels between the margins."""
NAMES = [
    pytest.param(["val_unseen.mixed1", "val_unseen.mixed2"], id="as files are named"),
    pytest.param([f"experiments-with-{n}-layers-and-no-blank-{n}" for n in "12"], id="long"),
]


@pytest.fixture(scope="module", params=NAMES)
def both(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Write a report on two submissions."""
    mine, theirs = tmp_path_factory.mktemp("mine"), tmp_path_factory.mktemp("theirs")
    scores = (
        home_scores(mine).with_run(home_log(mine, said="to the left " * 40)),
        home_scores(theirs, OTHER_WALKS).with_run(home_log(theirs, OTHER_WALKS)),
    )
    named = zip(request.param, scores, strict=True)
    return report_html({name: each.with_intervals() for name, each in named})


@pytest.fixture
def opened(browser: Browser, both: str, tmp_path: Path) -> Iterator[tuple[Page, list[str]]]:
    """Open the report, and listen to what the browser has to say and to ask for."""
    file = tmp_path / "report.html"
    file.write_text(both)
    heard: list[str] = []
    page = new_page(browser)
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


@pytest.mark.parametrize("width", [320, 375, 390, 1280])
def test_the_page_fits_its_window(width: int, opened: tuple[Page, list[str]]) -> None:
    page, _ = opened
    page.set_viewport_size({"width": width, "height": 800})
    wide = page.evaluate("document.documentElement.scrollWidth")
    assert wide == width


COPY_AGAIN = """
() => [...document.querySelectorAll('use')].map(each => {
  const copy = document.querySelector(each.getAttribute('href')).cloneNode(true)
  copy.removeAttribute('id')
  each.replaceWith(copy)
}).length
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_what_is_drawn_once_looks_the_same_wherever_it_is(
    scheme: Literal["light", "dark"], opened: tuple[Page, list[str]]
) -> None:
    page, _ = opened
    page.emulate_media(color_scheme=scheme)
    drawn = page.screenshot(full_page=True)
    assert page.evaluate(COPY_AGAIN) > 0
    assert page.screenshot(full_page=True) == drawn


IN_SIGHT = """
() => {
  const box = document.querySelector('.comparison'), right = box.getBoundingClientRect().right
  const row = [...box.querySelectorAll('tbody tr')].find(each => each.textContent.includes(' - '))
  return [...row.querySelectorAll('td')].filter(
    each => each.getBoundingClientRect().right <= right
  ).length
}
"""
CUT = """
() => [...document.querySelectorAll('th, td, h1, h2, h3, p, svg:not(svg svg)')]
  .filter(each => each.getBoundingClientRect().right > innerWidth + 1)
  .map(each => each.outerHTML.slice(0, 80))
"""
BREAKS = """
selector => [...document.querySelectorAll(selector)].map(each => {
  const style = getComputedStyle(each)
  return [style.breakInside, style.breakAfter]
})
"""


@pytest.mark.parametrize(("width", "numbers"), [(390, 3), (1280, 6)])
def test_numbers_of_the_comparison_are_in_sight(
    width: int, numbers: int, opened: tuple[Page, list[str]]
) -> None:
    page, _ = opened
    page.set_viewport_size({"width": width, "height": 800})
    assert page.evaluate(IN_SIGHT) >= numbers


def test_nothing_is_cut_on_paper(opened: tuple[Page, list[str]]) -> None:
    page, _ = opened
    page.set_viewport_size({"width": A4, "height": 1000})
    page.emulate_media(media="print")
    assert page.evaluate("document.documentElement.scrollWidth") == A4
    assert page.evaluate(CUT) == []


@pytest.mark.parametrize(
    ("selector", "expected"),
    [
        ("h2, h3", ["avoid", "avoid"]),
        ("h3 + p.small, .map-key, p.over", ["avoid", "avoid"]),
        ("#comparison h3 + p", ["avoid", "avoid"]),
        (".blocks > div, .scroll", ["avoid", "auto"]),
    ],
)
def test_what_belongs_together_is_on_one_page(
    selector: str, expected: list[str], opened: tuple[Page, list[str]]
) -> None:
    page, _ = opened
    page.emulate_media(media="print")
    found = page.evaluate(BREAKS, selector)
    assert found
    assert [each for each in found if each != expected] == []


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
