"""A reader who wants to know how far the field is, and why the leader fails."""

import re
from typing import NamedTuple

from playwright.sync_api import Page, expect

from tests.support.demo_site import OPEN
from tests.support.waiting import SELDOM, wait_until


class Learnt(NamedTuple):
    """What somebody knows after a visit."""

    leader: str
    metric: str
    """What the leader and people are compared by."""
    best: float
    human: float | None
    failure: str
    """How the leader failed in an episode that others solve."""
    best_of_2021: str


def read(page: Page, url: str, history: str) -> Learnt:
    """Visit a server with results, the first page first; every step is a link or a form.

    ``history`` is the split with the rows of earlier years.
    """
    page.goto(url)
    line = page.locator(".standing-line", has_text=history)
    told = re.search(r"best (\w+) ([\d.]+) % \((.*?)\)(?:, human ([\d.]+) %)?,", line.inner_text())
    assert told, line.inner_text()
    metric, best, leader, human = told.groups()
    _see_what_is_hard(page)
    failure = _see_why_the_leader_fails(page)
    _play(page)
    _compare(page)
    far = None if human is None else float(human)
    best_of_2021 = _find(page, history, "2021")
    return Learnt(leader, metric, float(best), far, failure, best_of_2021)


def _see_what_is_hard(page: Page) -> None:
    """Open a split's episodes, and the hardest building."""
    page.get_by_role("link", name="Episodes", exact=True).first.click()
    page.locator(f"a[href$='/episodes/{OPEN}']").first.click()
    _come_again_for(page, "Difficulty")
    page.get_by_role("region", name="Buildings, the hardest first").locator("a").first.click()
    expect(page.get_by_role("heading", name="Where walks end in")).to_be_visible()


def _see_why_the_leader_fails(page: Page) -> str:
    """Open the leader's page, what its result consists of, and a near miss."""
    page.get_by_role("navigation", name="Main").get_by_role("link", name=OPEN).click()
    page.locator("table.board th[scope=row] a.what").first.click()
    page.get_by_role("link", name="Where it succeeds and fails").click()
    _come_again_for(page, "Outcomes")
    page.locator("dl.near a").first.click()
    expect(page.get_by_text(re.compile(r"Solved by \d+ of \d+ methods?"))).to_be_visible()
    return page.locator(".walk-card .outcome").inner_text()


def _come_again_for(page: Page, heading: str) -> None:
    """Reload a page, as it asks for, until the server has computed a part of it."""
    reload = page.get_by_role("link", name="Reload this page")

    def is_there() -> bool:
        if reload.count():
            reload.click()
        return page.get_by_role("heading", name=heading).count() > 0

    wait_until(is_there, SELDOM)


def _play(page: Page) -> None:
    page.get_by_role("link", name="Episodes", exact=True).first.click()
    page.locator(f"a[href$='/play/{OPEN}']").click()
    page.get_by_role("link", name="Begin").click()
    page.locator("#ways a").first.click()
    expect(page.locator("#walked")).to_contain_text("1 step,")
    page.get_by_label("none of them").check()
    page.get_by_role("button", name="Answer").click()
    expect(page.get_by_text(re.compile(r"You against \d+ methods?"))).to_be_visible()


def _compare(page: Page) -> None:
    page.get_by_role("navigation", name="Main").get_by_role("link", name=OPEN).click()
    for tick in (0, 1):
        page.locator("input[name=result]").nth(tick).check()
    page.get_by_role("button", name="Compare two results").click()
    expect(page.locator("svg.interval").first).to_be_visible()


def _find(page: Page, split: str, year: str) -> str:
    """Return the best row of a year, by the filter of a leaderboard."""
    page.get_by_role("navigation", name="Main").get_by_role("link", name=split).click()
    expect(page.locator("#history svg.chart")).to_be_visible()
    page.get_by_text("Filter", exact=True).first.click()
    page.get_by_label("Date from").fill(f"{year}-01-01")
    page.get_by_label("Date until").fill(f"{year}-12-31")
    page.get_by_role("button", name="Filter").click()
    return page.locator("#apart th[scope=row] .what").first.inner_text()
