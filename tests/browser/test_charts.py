"""The charts in a real browser: what is drawn, what of it is in the address, where points lead."""

import re
from urllib.parse import parse_qs, urlsplit

import pytest
from playwright.sync_api import Page, expect

from reverie_eval import CATALOGUE
from tests.support.browser import DESKTOP, PHONE, WIDE, Held, OpenPage, Size, await_chart
from tests.support.demo_site import BOLD, OPEN, OWNER, PRIVATE, Site

BOARD = f"/splits/{OPEN}"
KINDS = ("front", "rest", "reported")


def drawn(page: Page, name: str) -> list[list[list[float]]]:
    """Return the points of each kind in a chart, as their tooltips say, once it is drawn."""
    chart = await_chart(page, name)
    titles = [chart.locator(f".{kind} title").all_text_contents() for kind in KINDS]
    found = [
        [re.findall(r": (-?[0-9.]+)", each.rpartition("\n")[2]) for each in its] for its in titles
    ]
    return [[[float(x), float(y)] for y, x in its] for its in found]


def labels(page: Page, chart: str, name: str) -> tuple[str, list[float]]:
    """Return the title of an axis and the numbers along it."""
    axis = await_chart(page, chart).locator(f".axis-{name}")
    return axis.locator(".title").text_content() or "", [
        *map(float, axis.locator(".tick").all_text_contents())
    ]


def query_of(address: str | None) -> dict[str, str]:
    return {name: values[0] for name, values in parse_qs(urlsplit(address or "").query).items()}


def values(site: Site, *keys: str) -> list[list[float]]:
    """Return what the board's table shows of ranked results, the first rank first."""
    rows = site.ask(OWNER, "GET", f"/splits/{OPEN}/leaderboard").json()["rows"]
    return [
        [float(CATALOGUE[key].display(row["scores"][key])) for key in keys]
        for row in rows
        if row["standing"] == "ranked"
    ]


def test_a_board_draws_what_is_in_its_table(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, BOARD)
    front, rest, reported = drawn(page, "against")
    assert sorted(front + rest) == sorted(values(site, "success", "rgs"))
    assert reported == [[52.51, 34.93]]


def test_a_chosen_axis_is_drawn_and_kept(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"{BOARD}?extra_data=")
    page.get_by_label("Horizontal axis").select_option("spl")
    expect(page.locator("#against")).to_have_attribute(
        "aria-label", re.compile("grounding success against success weighted")
    )
    front, rest, _ = drawn(page, "against")
    assert sorted(front + rest) == sorted(values(site, "spl", "rgs"))
    assert query_of(page.url) == {"x": "spl"}
    main = page.get_by_role("main")
    for name in ("permalink", "LaTeX", "BibTeX", "All metrics"):
        link = main.get_by_role("link", name=name, exact=True).get_attribute("href")
        assert query_of(link)["x"] == "spl", name
    page.get_by_text("Filter", exact=True).first.click()
    page.get_by_label("Method or team").fill("walk")
    page.get_by_role("button", name="Filter").click()
    expect(page.get_by_label("Horizontal axis")).to_have_value("spl")
    main.get_by_role("link", name="Clear").click()
    expect(page.get_by_label("Horizontal axis")).to_have_value("spl")


def test_a_point_leads_to_its_submission(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, BOARD)
    await_chart(page, "against").locator(".front a").first.click()
    page.wait_for_url(re.compile("/submissions/[0-9a-f]{16}"))
    expect(page.get_by_role("heading", level=1)).to_have_text("Walker")


def test_a_chart_never_contradicts_its_selector(site: Site, open_page: OpenPage) -> None:
    """What was asked for first may come last."""
    page = open_page(site, BOARD)
    drawn(page, "against")
    held = Held(page, re.compile(r"/chart\?.*x=spl"))
    page.get_by_label("Horizontal axis").select_option("spl")
    late = held.first()
    page.get_by_label("Horizontal axis").select_option("rgs")
    expect(page.locator("#against")).to_have_attribute("aria-label", re.compile("against remote"))
    late.continue_()
    assert late.request.response() is None, "nobody waits for it any more"
    assert labels(page, "against", "x")[0] == "RGS %"


def test_nothing_is_above_all_there_can_be(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/splits/{PRIVATE}")
    assert max(y for _, y in drawn(page, "against")[0]) == 100
    assert max(labels(page, "against", "y")[1]) == 100
    (top, *_) = page.locator("#against .front circle").evaluate_all(
        "all => all.map(it => it.cy.baseVal.value)"
    )
    assert top == pytest.approx(10)  # the upper end of the axis


def test_only_metrics_that_a_row_has_are_offered(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/splits/{PRIVATE}")
    offered = (
        page.get_by_label("Vertical axis")
        .locator("option")
        .evaluate_all("all => all.map(o => o.value)")
    )
    assert offered == ["path_length", "success", "oracle_success", "spl", "rgs", "rgspl"]


def test_a_chart_without_a_value_says_so(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/splits/{PRIVATE}?y=ndtw")
    expect(page.get_by_text("No result shown has both metrics.")).to_be_visible()
    expect(page.locator("#against")).to_be_hidden()
    expect(page.get_by_label("Vertical axis")).to_have_value("ndtw")
    page.get_by_label("Vertical axis").select_option("spl")
    expect(page.locator("#against")).to_be_visible()


def test_a_chart_that_did_not_arrive(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, "/sign-in", OWNER)
    page.route("**/chart?*", lambda route: route.fulfill(status=204))
    page.goto(BOARD)
    expect(page.get_by_text("The charts could not be loaded.")).to_be_visible()
    expect(page.locator("#against")).to_be_hidden()


COVERED = """chart => {
    const all = [...chart.querySelectorAll(".name, circle")];
    const boxes = all.map(each => [each, each.getBoundingClientRect()]);
    return boxes.filter(([name]) => name.matches(".of-line")).flatMap(([name, its]) => boxes
        .filter(([other, box]) => other !== name && box.left < its.right && its.left < box.right
            && box.top < its.bottom && its.top < box.bottom)
        .map(([other]) => `${name.textContent} and ${other.textContent}`));
}"""


@pytest.mark.parametrize("size", [WIDE, DESKTOP, PHONE], ids=["wide", "desktop", "phone"])
def test_the_name_of_a_line_covers_neither_points_nor_names(
    size: Size, site: Site, open_page: OpenPage
) -> None:
    page = open_page(site, BOARD, size=size)
    chart = await_chart(page, "against")
    expect(chart.locator(".of-line")).to_have_text(["Best reported 34.93"])
    assert chart.evaluate(COVERED) == []


def test_charts_stand_beside_the_table_where_there_is_room(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, BOARD)
    table, charts = page.locator("table.board").first, page.locator("#charts")
    for size, is_beside in ((WIDE, True), (DESKTOP, False), (PHONE, False)):
        page.set_viewport_size({"width": size[0], "height": size[1]})
        left, right = table.bounding_box(), charts.bounding_box()
        assert left
        assert right
        assert (right["x"] >= left["x"] + left["width"]) is is_beside, size
        assert (right["y"] >= left["y"] + left["height"]) is not is_beside, size


def test_the_names_of_methods_are_only_names(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, BOARD)
    titles = await_chart(page, "against").locator("title").all_text_contents()
    assert any(BOLD in each for each in titles)
