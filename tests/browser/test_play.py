"""A person walks episodes in a real browser, with the keyboard alone."""

import json
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

import reverie_eval as rv
from tests.support.browser import OpenPage
from tests.support.demo_site import OPEN, Site


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
    with pytest.raises(rv.SubmissionError) as refused:
        rv.validate(tmp_path / "walks.json", split=OPEN)
    assert {problem.code for problem in refused.value.problems} == {"missing-episode"}
    page.goto(f"/play/{OPEN}?n=3")
    expect(page.locator(".sampled")).to_contain_text("✓ walked")
    page.get_by_role("button", name="Forget").click()
    expect(page.locator(".sampled")).not_to_contain_text("✓ walked")
