"""A server of real size: what a reader learns from it, and how its leaderboards arrive."""

import csv
import re
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from playwright.sync_api import Page

from fixtures.published import published_folder
from reverie_eval.scoring import CORRECT, OUTCOMES
from tests.support.browser import (
    DESKTOP,
    PHONE,
    SIDEWAYS,
    WIDE,
    OpenPage,
    reload_until_ready,
    show_part,
)
from tests.support.demo_site import BOLD, OPEN, ORGANISER, PRIVATE, WALKER, Site
from tests.support.full_site import earlier_rows, full_site
from tests.support.reader import read

METHODS = 3
"""On each split."""
COLUMNS = """tables => tables.map(table => [...table.querySelectorAll("thead th")].map(each => {
    const { left, width } = each.getBoundingClientRect();
    return [left, width];
}))"""


class Full(NamedTuple):
    """A server, and the folder of the published files if it is of them."""

    site: Site
    published: Path | None


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Full]:
    """Run the server, of the published files or, where they are not, of the made-up world."""
    published = published_folder()
    with full_site(tmp_path_factory.mktemp("full"), published, METHODS) as site:
        yield Full(site, published)


def test_a_reader_learns_how_far_the_field_is_and_why_the_leader_fails(
    full: Full, open_page: OpenPage
) -> None:
    """Every step is a link or a form."""
    site = full.site
    learnt = read(open_page(site), site.url, PRIVATE)
    board = site.ask(ORGANISER, "GET", f"/splits/{PRIVATE}/leaderboard").json()
    key = learnt.metric.lower()
    scores = {row["method"]["name"]: row["scores"] for row in board["rows"] if row["rank"]}
    assert learnt.leader == BOLD, "each method is better than the one before"
    assert learnt.best == pytest.approx(100 * scores[BOLD][key], abs=0.005)
    assert learnt.human == (53.66 if full.published is None else 77.84)
    assert learnt.failure in [*OUTCOMES][:CORRECT]
    assert learnt.best_of_2021 == best_of("2021", earlier_rows(full.published))


def best_of(year: str, table: str) -> str:
    """Return the team with the highest RGSPL of a year."""
    rows = [row for row in csv.DictReader(StringIO(table)) if row["date"].endswith(year)]
    return max(rows, key=lambda row: float(row["rgspl"]))["team"]


@pytest.mark.parametrize(
    "path",
    [
        pytest.param("/", id="first page"),
        pytest.param(f"/splits/{OPEN}", id="open split"),
        pytest.param(f"/splits/{OPEN}?columns=all", id="all metrics"),
        pytest.param(f"/splits/{PRIVATE}", id="with rows that are not ranked"),
    ],
)
def test_no_column_moves_while_the_rows_arrive(path: str, full: Full, open_page: OpenPage) -> None:
    page = open_page(full.site, "/guide")
    whole = page.request.get(path).text()
    tables = [*re.finditer(r'<table class="board.*?</thead>(.*?)</table>', whole, re.DOTALL)]
    assert tables
    show_part(page, path, whole)
    final = columns(page)
    for number, table in enumerate(tables):
        begin, end = table.span(1)
        for share in (0, 0.5):
            show_part(page, path, whole[: int(begin + share * (end - begin))])
            assert [each[number] for each in columns(page)] == [each[number] for each in final]


@pytest.mark.parametrize(
    "path",
    [
        pytest.param("/submissions/{walker}/analysis", id="analysis of a method"),
        pytest.param("/episodes/{split}?submission={walker}&other={bold}", id="two methods"),
        pytest.param("/splits/{split}/compare?result={walker}&result={bold}", id="compared"),
    ],
)
def test_no_column_is_out_of_sight(path: str, full: Full, open_page: OpenPage) -> None:
    site = full.site
    ids = {"walker": site.ids[OPEN, WALKER], "bold": site.ids[OPEN, BOLD]}
    page = open_page(site, path.format(split=OPEN, **ids))
    reload_until_ready(page)
    for width, height in (DESKTOP, PHONE):
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate(SIDEWAYS) == []


def columns(page: Page) -> list[Any]:
    """Return where the columns of each leaderboard are, on a large screen and on a phone."""
    found = []
    for width, height in (WIDE, PHONE):
        page.set_viewport_size({"width": width, "height": height})
        found.append(page.locator("table.board").evaluate_all(COLUMNS))
    return found
