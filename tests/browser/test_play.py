"""A person walks episodes in a real browser, with the keyboard alone and with a pointer."""

import json
import math
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from random import Random

import numpy as np
from playwright.sync_api import Browser, Locator, Page, expect

import reverie_eval as rv
from reverie_eval.analysis import VisibleObject
from reverie_eval.geometry import Picture, RoomView, Sightings, model_building
from reverie_eval.ground_truth import read_episode_ids
from reverie_eval.reporting.answer_svg import (
    ANSWER_STYLE,
    ObjectLink,
    WayLink,
    ahead_svg,
    panorama_svg,
)
from reverie_eval.reporting.answers import Span, seen_in
from tests.support.browser import PHONE, Held, OpenPage, new_page
from tests.support.demo_site import OPEN, OWNER, SAMPLES, Site

KEPT = f"reverie-eval walks {OPEN}"
"""By which name a browser keeps walks."""


def press(page: Page, key: str, part: str, text: str) -> None:
    """Press a key, and wait until a part of the page says something."""
    page.keyboard.press(key)
    expect(page.locator(part)).to_contain_text(text)


def test_walks_are_kept_with_their_times_and_can_be_downloaded(
    site: Site, open_page: OpenPage, tmp_path: Path
) -> None:
    page = open_page(site, f"/play/{OPEN}?n=2")
    for number in (1, 2):
        page.get_by_role("link", name="Begin" if number == 1 else "Next episode").press("Enter")
        walk_and_stop(page)
        expect(page.get_by_role("heading", name="Scores")).to_be_visible()
    expect(page.locator("#kept")).to_contain_text("2 walks are kept in this browser.")
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Download").click()
    waiting.value.save_as(tmp_path / "walks.json")
    records = json.loads((tmp_path / "walks.json").read_bytes())
    assert [(record["actions"], record["seconds"] > 0) for record in records] == [(3, True)] * 2
    assert {len(record["trajectory"]) for record in records} == {3}
    page.goto(f"/play/{OPEN}?n=3")
    expect(page.locator(".sampled")).to_contain_text("✓ walked")
    expect(page.get_by_text("A leaderboard needs the whole split")).to_be_visible()
    with page.expect_download() as waiting:
        page.get_by_role("button", name="List of episodes").click()
    waiting.value.save_as(tmp_path / "walks.txt")
    listed = read_episode_ids(tmp_path / "walks.txt")
    assert listed == [record["instr_id"] for record in records]
    rv.evaluate(tmp_path / "walks.json", split=OPEN, subset=listed)
    page.get_by_role("button", name="Forget").click()
    expect(page.locator(".sampled")).not_to_contain_text("✓ walked")


def test_a_walk_is_kept_before_the_next_one_begins(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/play/{OPEN}/1")
    held = Held(page, "**/play.js*")
    page.locator("#object-none").check()
    page.locator("#answer button").click(no_wait_after=True)
    script = held.first()
    expect(page.get_by_role("link", name="Next episode")).to_have_count(0)
    script.continue_()
    expect(page.get_by_role("link", name="Next episode")).to_be_visible()
    expect(page.locator("#kept")).to_contain_text("1 walk is kept in this browser.")


def test_a_walk_that_is_faster_than_its_script_is_kept(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/play/{OPEN}")
    Held(page, "**/walking.js*")
    page.get_by_role("link", name="Begin").click()
    page.locator("#ways a").first.click()
    expect(page.locator("#walked")).to_contain_text("1 step,")
    page.locator("#object-none").check()
    page.locator("#answer button").click()
    expect(page.locator("#kept")).to_contain_text("1 walk is kept in this browser.")
    kept = page.evaluate("name => JSON.parse(localStorage.getItem(name))", KEPT)
    assert [walk["actions"] for walk in kept.values()] == [2]


def test_a_late_reply_shows_no_place_that_one_has_left(site: Site, open_page: OpenPage) -> None:
    start = f"/play/{OPEN}/1"
    page = open_page(site, start)
    page.evaluate("window.isSame = true")
    turns = Held(page, re.compile("[?&]facing="))
    page.keyboard.press("ArrowLeft")
    turn = turns.first()
    page.keyboard.press("1")
    expect(page.locator("#walked")).to_contain_text("1 step,")
    turn.abort()
    page.go_back()
    expect(page.locator("#walked")).to_contain_text("at the start")
    steps = Held(page, re.compile("[?&]walk="))
    page.keyboard.press("1")
    step = steps.first()
    page.go_back()
    step.continue_()
    page.evaluate("fetch(location).then(reply => reply.text())")  # which comes after it
    expect(page.locator("#walked")).to_contain_text("at the start")
    assert page.url == f"{site.url}{start}"
    assert page.evaluate("window.isSame")


def walk_and_stop(page: Page) -> None:
    """Walk two steps and stop, by the keyboard alone; the page itself never changes."""
    expect(page.locator("#panorama")).to_be_focused()
    page.evaluate("window.isSame = true")
    ways = page.locator("#ways li").count()
    faced = {page.locator("#facing").inner_text()}
    for _ in range(ways - 1):
        page.keyboard.press("ArrowLeft")
        faced.add(page.locator("#facing").inner_text())
    assert len(faced) == ways, "arrow keys turn to each way once"
    press(page, "Enter", "#walked", "1 step,")
    press(page, "1", "#walked", "2 steps,")
    assert page.evaluate("window.isSame")
    expect(page.locator("#panorama")).to_be_focused()
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    press(page, "ArrowUp", "#facing", "Chosen: none of them.")
    page.keyboard.press("Enter")


def test_an_object_is_chosen_first_and_then_confirmed(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/play/{OPEN}/1")
    objects = page.locator("[data-object]")
    ids = [each.get_attribute("data-object") for each in objects.all()]
    for link, object_id in zip(objects.all(), ids, strict=True):
        click_until_chosen(page, link, f"#object-{object_id}")
    chosen = ids[-1]
    button = page.locator("#answer button")
    expect(button).to_contain_text(page.locator(f"[for=object-{chosen}]").inner_text().strip())
    expect(page.locator("#panorama")).to_be_focused()
    page.keyboard.press("Enter")  # which would walk if nothing were chosen
    expect(page.locator("#walked")).to_contain_text("at the start")
    button.click()
    page.wait_for_url(re.compile(f"answer={chosen}$"))
    expect(page.locator("code")).to_contain_text(f'"predObjId":{chosen}')


def test_parts_keep_their_distance_on_a_phone(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/play/{OPEN}/1", size=PHONE)
    above = page.locator(".candidates").bounding_box()
    below = page.locator("#walk").bounding_box()
    assert above is not None
    assert below is not None
    assert below["y"] - above["y"] - above["height"] > 24


def test_one_turns_in_place_and_points_in_the_view(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/play/{OPEN}/1")
    page.evaluate("window.isSame = true")
    view = page.get_by_text("The view ahead, heading")
    seen: dict[str, str] = {}
    for _ in range(12):
        for link in page.locator("#ahead [data-object]").all():
            seen[str(link.get_attribute("data-object"))] = page.url
        before = view.text_content()
        page.get_by_role("link", name="Turn right").click()
        expect(view).not_to_have_text(str(before))
    around = page.locator("#panorama [data-object]").all()
    assert seen.keys() <= {str(link.get_attribute("data-object")) for link in around}
    assert len(seen) > len(around) / 2, "most objects are in a level view"
    object_id = next(iter(seen))
    page.goto(seen[object_id])
    page.evaluate("window.isSame = true")
    link = page.locator(f"#ahead [data-object='{object_id}']")
    click_until_chosen(page, link, f"#object-{object_id}")
    before = view.text_content()
    page.get_by_role("link", name="Turn left").click()
    expect(view).not_to_have_text(str(before))
    expect(page.locator(f"#panorama .chosen[data-object='{object_id}']")).to_have_count(1)
    assert page.evaluate("window.isSame")


def click_until_chosen(page: Page, link: Locator, radio: str) -> None:
    """Click the middle of an object in the picture, again if a smaller one lies over it."""
    link.evaluate("link => link.ownerSVGElement.scrollIntoView({ block: 'center' })")
    x, y = link.evaluate(MIDDLE)
    for _ in range(5):
        page.mouse.click(x, y)
        if page.locator(radio).is_checked():
            return
    raise AssertionError(radio)


MIDDLE = """link => {
    const { left, right } = link.ownerSVGElement.getBoundingClientRect();
    for (const rect of link.querySelectorAll("rect")) {
        const box = rect.getBoundingClientRect();
        const [from, to] = [Math.max(box.left, left), Math.min(box.right, right)];
        if (from < to) return [(from + to) / 2, box.top + box.height / 2];
    }
}"""
"""The middle of the part of a box that the picture shows."""
HITS = """pictures => pictures.map(picture => {
    document.body.innerHTML = picture;
    const { left, right, top, bottom } = document.querySelector("svg").getBoundingClientRect();
    const toPage = shape => {
        const origin = shape.ownerSVGElement.getBoundingClientRect();
        return { origin, scale: origin.width / shape.ownerSVGElement.viewBox.baseVal.width };
    };
    const shapes = [...document.querySelectorAll("a :is(rect, circle, polygon)")].map(shape => {
        const link = shape.closest("a"), box = shape.getBoundingClientRect();
        const isWay = shape.tagName === "circle", radius = box.width / 2;
        const area = isWay ? Math.PI * radius ** 2 : box.width * box.height;
        const { scale, origin } = toPage(shape);
        const fills = (x, y) => shape.isPointInFill(
            new DOMPoint((x - origin.left) / scale, (y - origin.top) / scale));
        const beside = more => [[more, 0], [-more, 0], [0, more], [0, -more]];
        const has = (x, y, more = 0) => shape.tagName === "polygon"
            ? beside(more)[more < 0 ? "every" : "some"](([dx, dy]) => fills(x + dx, y + dy))
            : isWay ? Math.hypot(x - box.left - radius, y - box.top - radius) < radius + more
            : x > box.left - more && x < box.right + more
                && y > box.top - more && y < box.bottom + more;
        return { link, box, area, has };
    }).sort((one, other) => one.area - other.area);
    const wrong = [], part = [0.07, 0.5, 0.93];
    let points = 0;
    for (const { link, box, has } of shapes) {
        const [from, to] = [Math.max(box.left, left + 1), Math.min(box.right, right - 1)];
        const [first, last] = [Math.max(box.top, top + 1), Math.min(box.bottom, bottom - 1)];
        for (const across of part) for (const down of part) {
            const x = from + across * (to - from), y = first + down * (last - first);
            const isOnLine = shapes.some((shape) => shape.has(x, y, -2) !== shape.has(x, y, 2));
            if (from >= to || isOnLine || !has(x, y)) continue;
            points += 1;
            const hit = document.elementFromPoint(x, y)?.closest("a");
            const all = document.elementsFromPoint(x, y).map((each) => each.closest("a"));
            const [{ area }, ...others] = shapes.filter((shape) => shape.has(x, y));
            const isLarger = others.some((other) => other.link === hit && other.area > 1.01 * area);
            if (!all.includes(link) || isLarger) wrong.push(link.outerHTML);
        }
    }
    return { points, wrong };
})"""
"""What a pointer hits at nine points of each box and circle, against the smallest one there."""


def test_the_smallest_box_is_hit_in_every_view(browser: Browser) -> None:
    random = Random(3)
    pictures = [made_up_picture(random, is_ahead=number % 2 == 0) for number in range(200)]
    page = new_page(browser, viewport={"width": 1200, "height": 900})
    sheet = files("reverie_eval.server.http").joinpath("static/style.css").read_text()
    page.set_content(f"<style>{sheet}{ANSWER_STYLE}</style>")
    found = page.evaluate(HITS, pictures)
    page.close()
    assert sum(each["points"] for each in found) > 12_000
    assert [each["wrong"] for each in found if each["wrong"]] == []


def made_up_picture(random: Random, *, is_ahead: bool) -> str:
    """Draw up to 30 objects, large and small ones that cover each other, and up to 8 ways."""
    objects = []
    for number in range(random.randint(1, 30)):
        width, height = (math.exp(random.uniform(1, 4)) for _ in range(2))
        low = random.uniform(-60, 60 - height)
        span = Span(random.uniform(0, 360), -width / 2, width / 2, low, low + height)
        objects.append(ObjectLink(number, span, "desk", f"desk {number}", f"#{number}"))
    ways = [
        WayLink(
            number * 45 + random.uniform(0, 20),
            random.uniform(-20, 20),
            random.uniform(1, 8),
            f"way {number}",
            f"#way-{number}",
        )
        for number in range(random.randint(1, 8))
    ]
    if not is_ahead:
        return panorama_svg(objects, ways, random.uniform(0, 360), Picture(12))
    sizes = [(math.exp(random.uniform(2, 5.5)), math.exp(random.uniform(2, 5.5))) for _ in objects]
    view = 12 + random.randrange(12)
    seen = []
    for link, (width, height) in zip(objects, sizes, strict=True):
        box = [random.uniform(0, 640 - width), random.uniform(0, 480 - height), width, height]
        # Some have no box in the view but in the one below, as a drawn room shows them.
        views = np.array([random.choice((view, view, view - 12))])
        seen.append(VisibleObject(link.object_id, link.name, views, np.array([box])))
    return ahead_svg([*zip(objects, seen, strict=True)], ways, view, room_view(view, seen))


def room_view(view: int, seen: Sequence[VisibleObject]) -> RoomView:
    """Return a picture of what is seen where there are no rooms."""
    nothing = np.zeros(0, int)
    none = Sightings(nothing, nothing, np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2)), ())
    building = model_building(np.zeros((1, 3)), np.zeros((0, 2), int), none)
    return RoomView(building, np.zeros((1, 3)), 0, view, seen_in(view, seen))


def test_walks_through_all_episodes_can_be_submitted(own_site: Site, open_page: OpenPage) -> None:
    page = open_page(own_site, f"/play/{OPEN}", OWNER)
    walks = {
        record["instr_id"]: {**record, "seconds": 4.2, "actions": 3}
        for record in json.loads((SAMPLES / "good.json").read_bytes())
    }
    page.evaluate(
        "([name, walks]) => localStorage.setItem(name, JSON.stringify(walks))",
        [KEPT, walks],
    )
    page.reload()
    expect(page.get_by_text("A leaderboard needs the whole split")).to_be_hidden()
    page.get_by_role("link", name="Submit your walks").click()
    expect(page.locator("#outcome")).to_contain_text("can be scored on val_unseen")
    expect(page.get_by_label("Human")).to_have_value("true")
    page.get_by_label("Name").fill("Our students")
    page.get_by_role("button", name="Score", exact=True).click()
    expect(page.get_by_role("heading", name="Our students")).to_be_visible()
    expect(page.get_by_text("People walked the episodes").first).to_be_visible()
    submission = page.url.partition("?")[0].rpartition("/")[2]
    sent = own_site.ask(OWNER, "GET", f"/submissions/{submission}/file").json()
    assert {key for record in sent for key in record} == {"instr_id", "trajectory", "predObjId"}
