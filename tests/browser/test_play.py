"""A person walks episodes in a real browser, with the keyboard alone."""

import json
from pathlib import Path

from playwright.sync_api import Page, expect

import reverie_eval as rv
from reverie_eval.ground_truth import read_episode_ids
from tests.support.browser import OpenPage
from tests.support.demo_site import OPEN, OWNER, SAMPLES, Site


def follow(page: Page, text: str) -> None:
    """Follow a link whose text contains this, with the keyboard alone."""
    for _ in range(60):
        page.keyboard.press("Tab")
        if text in page.evaluate("document.activeElement.closest('a')?.textContent ?? ''"):
            page.keyboard.press("Enter")
            page.wait_for_load_state()
            return
    raise AssertionError(text)


def test_walks_are_kept_with_their_times_and_can_be_downloaded(
    site: Site, open_page: OpenPage, tmp_path: Path
) -> None:
    page = open_page(site, f"/play/{OPEN}?n=2")
    for _ in range(2):
        follow(page, "Begin" if "/play/val_unseen?" in page.url else "Next episode")
        expect(page.get_by_role("heading", name="Walk", exact=True)).to_be_visible()
        follow(page, "walk ")
        expect(page.locator("[data-play=walking]")).to_contain_text("1 step,")
        follow(page, "stop here without an answer")
        expect(page.get_by_role("heading", name="Scores")).to_be_visible()
    expect(page.locator("[data-play=scored]")).to_contain_text("2 walks are kept in this browser.")
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Download").click()
    waiting.value.save_as(tmp_path / "walks.json")
    records = json.loads((tmp_path / "walks.json").read_bytes())
    assert [(record["actions"], record["seconds"] > 0) for record in records] == [(2, True)] * 2
    assert {len(record["trajectory"]) for record in records} == {2}
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


def test_walks_through_all_episodes_can_be_submitted(own_site: Site, open_page: OpenPage) -> None:
    page = open_page(own_site, f"/play/{OPEN}", OWNER)
    walks = {
        record["instr_id"]: {**record, "seconds": 4.2, "actions": 3}
        for record in json.loads((SAMPLES / "good.json").read_bytes())
    }
    page.evaluate(
        "([name, walks]) => localStorage.setItem(name, JSON.stringify(walks))",
        [f"reverie-eval walks {OPEN}", walks],
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
