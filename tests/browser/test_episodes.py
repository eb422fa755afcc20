"""What a script adds to an episode's page: walking the trajectory, picking a storey, arrow keys."""

import re
from datetime import timedelta
from itertools import pairwise

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.support.acting import NOON
from tests.support.browser import DESKTOP, NARROW, OpenPage
from tests.support.demo_site import OPEN, OWNER, Site

WALKER, DRAWER = "Walker", "Box drawer"
STEP_MILLISECONDS = 800
"""From one step to the next when a walk is played."""


@pytest.fixture
def path(site: Site) -> str:
    """Return where two walks of several steps are on one map."""
    ids = (site.ids[OPEN, WALKER], site.ids[OPEN, DRAWER])
    return f"/episodes/{OPEN}/1196_0_0?submission={ids[0]}&other={ids[1]}"


def steps_shown(page: Page) -> list[int]:
    """Return at which step each walk is."""
    current = page.locator(".steps [aria-current=step]")
    return [int(row.get_attribute("data-step") or -1) for row in current.all()]


def place(walker: Locator) -> tuple[float, float]:
    box = walker.bounding_box()
    assert box is not None
    return (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def test_walking_step_by_step(site: Site, path: str, open_page: OpenPage) -> None:
    page = open_page(site, path, OWNER, reduced_motion="reduce")
    lasts = [table.locator("tr[data-step]").count() - 1 for table in page.locator(".steps").all()]
    last = max(lasts)
    assert last > 1
    assert steps_shown(page) == lasts
    page.get_by_label("Step", exact=True).fill("0")
    assert steps_shown(page) == [0, 0]
    expect(page.get_by_role("status")).to_contain_text(f"Step 0 of {last}")
    expect(page.get_by_role("status")).to_contain_text(
        re.compile(r"0\.0 m walked, \d+\.\d m to the")
    )
    assert page.locator(".leg:not(.ahead)").count() == 0
    assert page.locator(".answers svg:visible").count() == 0
    expect(page.get_by_role("img", name="Step 0, facing")).to_have_count(2)
    for view in page.locator(".answers img").all():
        expect(view).to_have_js_property("naturalHeight", 150)  # of an image that has no size
    walker, places = page.locator(".walker.route-1"), []
    places.append(place(walker))
    for step in range(1, lasts[0] + 1):
        page.get_by_role("button", name="One step forward").click()
        assert steps_shown(page)[0] == step
        places.append(place(walker))
    assert all(one != other for one, other in pairwise(places))
    assert page.locator(".leg.ahead[data-route='1']").count() == 0
    expect(page.get_by_role("heading", name="Answer: Walker")).to_be_visible()
    page.get_by_role("button", name="One step back").click()
    assert place(walker) == places[-2]
    shown = steps_shown(page)
    page.reload()
    assert steps_shown(page) == shown  # the link leads to the step


def test_playing_to_the_end(site: Site, path: str, open_page: OpenPage) -> None:
    """A person who wants no motion sees the steps without gliding between them."""
    page = open_page(site, "/", OWNER, reduced_motion="reduce")
    page.clock.install(time=NOON)
    page.goto(path)
    page.clock.pause_at(NOON + timedelta(hours=1))
    duration = "getComputedStyle(document.querySelector('.walker')).transitionDuration"
    assert page.evaluate(duration) == "0s"
    page.get_by_role("button", name="Play").press("Enter")
    button, status = page.locator("[data-do=play]"), page.get_by_role("status")
    last = int(page.get_by_label("Step", exact=True).get_attribute("max") or 0)
    for step in range(last):
        expect(status).to_contain_text(f"Step {step} of {last}:")
        expect(button).to_have_text("Pause")
        page.clock.run_for(STEP_MILLISECONDS)
    expect(status).to_contain_text(f"Step {last} of {last}:")
    expect(button).to_have_text("Play")


def test_picking_a_level(site: Site, path: str, open_page: OpenPage) -> None:
    page = open_page(site, path, OWNER)

    def faint() -> set[str | None]:
        return {
            each.get_attribute("data-levels") for each in page.locator("svg [opacity='0.15']").all()
        }

    def plans() -> set[str | None]:
        rooms = page.locator("svg [data-levels]:has(> .room)").all()
        return {
            each.get_attribute("data-levels")
            for each in rooms
            if each.locator(".room").is_visible()
        }

    assert len(plans()) == 1  # of the start
    page.get_by_label("Level").select_option("1")
    assert (faint(), plans()) == ({"2"}, {"1"})
    page.get_by_label("Level").select_option("2")
    assert (faint(), plans()) == ({"1"}, {"2"})
    page.get_by_label("Level").select_option("all")
    assert page.locator("svg [data-levels][opacity]").count() == 0
    page.get_by_label("Level").select_option("")
    assert page.locator("svg [data-levels][opacity='0.35']").count() > 0


def test_arrow_keys_lead_on_where_they_mean_nothing_else(
    site: Site, path: str, open_page: OpenPage
) -> None:
    page = open_page(site, path, OWNER)
    onward = page.get_by_role("link", name="Next").get_attribute("href")
    expect(page.get_by_text("Keys: ← and → open the previous and the next episode")).to_be_visible()
    page.get_by_label("Step", exact=True).press("ArrowLeft")
    expect(page).to_have_url(re.compile(re.escape(path)))
    last = steps_shown(page)[0]
    page.get_by_role("button", name="One step back").press("ArrowLeft")
    assert steps_shown(page)[0] == last - 1
    page.get_by_role("button", name="Show").press("ArrowRight")
    expect(page).to_have_url(re.compile(re.escape(path)))
    page.get_by_role("heading", level=1).click()
    page.keyboard.press("ArrowRight")
    page.wait_for_url(f"{site.url}{onward}")  # and for the script that hears the keys
    page.keyboard.press("ArrowLeft")
    page.wait_for_url(f"{site.url}{path}")


def test_a_row_points_at_its_place(site: Site, path: str, open_page: OpenPage) -> None:
    page = open_page(site, path, OWNER)
    ring = page.locator("svg .pointer")
    expect(ring).to_be_hidden()
    page.locator(".steps tr[data-step='0']").first.hover()
    expect(ring).to_be_visible()
    start, pointed = page.locator("svg .start").first, place(ring)
    assert place(start) == pytest.approx(pointed, abs=1.0)


def test_the_map_stays_in_sight_beside_the_steps(
    site: Site, path: str, open_page: OpenPage
) -> None:
    page = open_page(site, path, OWNER, DESKTOP)
    drawn = page.locator("svg.walkable")
    expect(drawn).to_be_in_viewport(ratio=1)
    page.locator(".steps tr").last.scroll_into_view_if_needed()
    assert page.evaluate("scrollY") > 0
    expect(drawn).to_be_in_viewport(ratio=1)


@pytest.mark.parametrize("has_scripts", [True, False])
def test_without_scripts_nothing_is_offered_that_needs_them(
    has_scripts: bool,  # noqa: FBT001
    site: Site,
    open_page: OpenPage,
) -> None:
    page = open_page(
        site, f"/episodes/{OPEN}/1196_0_0", java_script_enabled=has_scripts, size=NARROW
    )
    tools = page.locator(".map-tools")
    expect(tools).to_be_visible(visible=has_scripts)
    expect(page.locator(".keys")).to_be_visible(visible=has_scripts)
    expect(page.get_by_role("img", name="What is visible from viewpoint")).to_be_visible()
    expect(page.get_by_role("link", name="Next")).to_be_visible()
    assert page.locator("svg .annotated").count() > 0
