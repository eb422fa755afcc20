"""What holds of every page in a real browser, whoever looks, on whatever screen."""

import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import NamedTuple

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.support.browser import (
    DESKTOP,
    NARROW,
    PHONE,
    WIDE,
    Ear,
    OpenPage,
    Size,
    barriers,
    cost_of,
    exceeded,
    new_context,
    show_part,
)
from tests.support.demo_site import OPEN, ORGANISER, OWNER, PRIVATE, Site
from tests.support.page_routes import EXAMPLES, Example

EMPTY_PAGE = "about:blank"
"""Where the browser is before a page is loaded anew."""
MOVING = "document.getAnimations().map(each => each.constructor.name)"
SCROLLS = "getComputedStyle(document.documentElement).scrollBehavior"
"""What people see who want stillness."""
OF_DASHES = """() => [...document.querySelectorAll("table")].flatMap(table => {
    const rows = [...table.tBodies].flatMap(body => [...body.rows]);
    const most = Math.max(...rows.map(row => row.cells.length));
    const texts = rows.filter(row => row.cells.length === most).map(row =>
        [...row.cells].map(cell => cell.textContent.trim()));
    const empty = [...Array(most).keys()].filter(column =>
        texts.length > 1 && texts.every(row => row[column] === "-"));
    return empty.map(column => `${table.textContent.trim().slice(0, 40)}: ${column}`);
})"""
"""Columns of several rows that hold nothing but dashes."""

every_page = pytest.mark.parametrize("example", EXAMPLES, ids=[each.name for each in EXAMPLES])


class Window(NamedTuple):
    """Where somebody looks at one page after another."""

    page: Page
    ear: Ear

    def empty(self) -> None:
        """Make it as it was when it was opened, besides who looks."""
        width, height = PHONE
        self.page.set_viewport_size({"width": width, "height": height})
        self.page.emulate_media(color_scheme="light")
        self.page.goto(EMPTY_PAGE)
        self.ear.complaints.clear()


@pytest.fixture(scope="module")
def window_of(browser: Browser, site: Site) -> Iterator[Callable[[str | None], Window]]:
    """Return what finds somebody's window: a new one for each page would take longer to load it."""
    contexts = []

    @cache
    def window_of(who: str | None) -> Window:
        context = new_context(browser, site, NARROW, reduced_motion="reduce")
        contexts.append(context)
        if who is not None:
            context.request.post("/sign-in", form={"token": site.tokens[who]})
        ear, page = Ear(site.url, context), context.new_page()
        return Window(page, ear)

    yield window_of
    for context in contexts:
        context.close()


@every_page
def test_a_page_serves_everybody(
    example: Example, site: Site, window_of: Callable[[str | None], Window]
) -> None:
    """Each page is loaded once, which takes longer than all that is checked of it."""
    window = window_of(example.who)
    window.empty()
    page = window.page
    page.goto(example.path(site))
    assert exceeded(cost_of(page)) == []
    assert page.evaluate(OF_DASHES) == []
    assert page.evaluate(MOVING) == []
    assert page.evaluate(SCROLLS) == "auto"
    assert barriers(page) == {}
    assert window.ear.complaints == []


PLACES = """names => Object.fromEntries(names.flatMap(name => {
    const box = document.querySelector(name)?.getBoundingClientRect();
    return box ? [[name, [box.left, box.top, box.width]]] : [];
}))"""
SHARES = (0.3, 0.6, 1)
"""How much of a page the browser has when it first draws it."""


@pytest.mark.parametrize(
    ("path", "parts"),
    [
        pytest.param("/", ["header", "h1", ".lead"], id="first page"),
        pytest.param(
            f"/splits/{OPEN}", ["header", "h1", ".lead", ".filters", ".listed"], id="open"
        ),
        pytest.param(f"/splits/{PRIVATE}", ["h1", ".lead", ".filters", ".listed"], id="private"),
    ],
)
@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
def test_nothing_moves_while_a_page_comes(
    path: str, parts: list[str], size: Size, site: Site, open_page: OpenPage
) -> None:
    """With the viewer's own times in it, which a script adds."""
    page = open_page(site, "/guide", size=size, timezone_id="Asia/Tokyo")
    whole = page.request.get(path).text()
    places: list[dict[str, list[float]]] = []
    for share in SHARES:
        body = whole[: int(share * len(whole))]
        show_part(page, path, body)
        places.append(page.evaluate(PLACES, parts))
    *early, final = places
    assert list(final) == parts
    assert early == [{name: final[name] for name in some} for some in early]
    assert len(early[-1]) > 1


def test_two_results_are_compared_and_neither_one_nor_three(
    site: Site, open_page: OpenPage
) -> None:
    page = open_page(site, f"/splits/{OPEN}")
    compare = page.get_by_role("button", name="Compare two results")
    ticks = page.get_by_role("checkbox")
    expect(compare).to_be_disabled()
    ticks.nth(0).check()
    expect(compare).to_be_disabled()
    ticks.nth(1).check()
    expect(ticks.nth(2)).to_be_disabled()
    compare.click()
    expect(page.get_by_role("heading", level=1)).to_have_text("Walker and Box drawer")


HEIGHTS = "rows => rows.map(row => row.getBoundingClientRect().height)"
OVER_NUMBERS = """names => names.filter(name => [...name.querySelectorAll("*")].some(each =>
    each.getBoundingClientRect().right > name.getBoundingClientRect().right))"""
TWO_LINES = 66
"""Pixels of a row on a phone, at most."""


def test_rows_of_a_leaderboard_have_two_lines_on_a_phone(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/splits/{OPEN}", size=PHONE)
    board = page.get_by_role("region", name="Leaderboard", exact=True)
    heights = board.locator("tbody tr").evaluate_all(HEIGHTS)
    assert len(heights) == 8
    assert max(heights) < TWO_LINES
    assert board.locator("tbody th .marks").evaluate_all(OVER_NUMBERS) == []


def test_what_a_board_is_sorted_by_is_in_sight_on_the_narrowest_phone(
    site: Site, open_page: OpenPage
) -> None:
    page = open_page(site, f"/splits/{OPEN}", size=NARROW)
    value = page.locator("td.first").first.bounding_box()
    assert value is not None
    assert value["x"] + value["width"] <= NARROW[0]


def test_the_tabs_of_the_desk_take_few_lines_on_a_phone(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, "/desk", ORGANISER, PHONE)
    tabs = page.get_by_role("navigation", name="Desk").get_by_role("link")
    assert tabs.count() > 10
    assert len({place["y"] for each in tabs.all() if (place := each.bounding_box())}) <= 5


def test_the_last_of_three_leaderboards_fills_its_row(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, "/", size=DESKTOP)
    widths = [each.bounding_box() for each in page.locator(".leaders > section").all()]
    first, second, third = [box["width"] for box in widths if box]
    assert first == second
    assert third > 2 * first


def test_a_row_on_a_phone_leaves_out_metrics_that_a_result_has_not(
    site: Site, open_page: OpenPage
) -> None:
    page = open_page(site, "/team", OWNER, PHONE)
    missing = page.locator("td[data-label]", has_text=re.compile("^-$"))
    assert missing.count() > 0
    assert not any(each.is_visible() for each in missing.all())
    page.set_viewport_size({"width": WIDE[0], "height": WIDE[1]})
    assert all(each.is_visible() for each in missing.all())


A4 = (794, 1123)
HIDDEN = """() => [...document.querySelectorAll(".scroll")].filter(each =>
    getComputedStyle(each).overflow !== "visible" ||
    each.scrollWidth > document.documentElement.clientWidth).length"""
LIGHT = "rgb(255, 255, 255)"


@pytest.mark.parametrize(
    "path",
    [f"/splits/{OPEN}", "/team", f"/episodes/{OPEN}/1196_0_0?submission=shortest", "/guide/rules"],
)
def test_a_printed_page_is_light_and_whole(path: str, site: Site, open_page: OpenPage) -> None:
    page = open_page(site, path, OWNER, A4, color_scheme="dark")
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == LIGHT
    assert page.locator("nav:visible, form:visible").count() == 0
    assert page.locator(".scroll").count() > 0
    assert page.evaluate(HIDDEN) == 0
    assert page.evaluate("document.documentElement.scrollWidth") <= A4[0]


def test_on_paper_the_marks_of_a_method_follow_its_team(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/splits/{OPEN}", size=A4)
    page.emulate_media(media="print")
    name = page.locator(".one-line", has_text="not declared").first
    team, marks = (name.locator(part).first.bounding_box() for part in (".of", ".badge"))
    assert team is not None
    assert marks is not None
    assert marks["y"] < team["y"] + team["height"]
