"""Participants from the sign-in page to the board, in a real browser."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.support.browser import Held, OpenPage, sign_in
from tests.support.demo_site import MARKED, MARKUP, OPEN, OWNER, PRIVATE, SAMPLES, Site, sound

BROKEN = SAMPLES / "broken.json"
PROBLEMS_OF_BROKEN = 23
"""As ``reverie-eval validate`` counts them."""

TRANSFER = """([name, text]) => {
    const transfer = new DataTransfer();
    transfer.items.add(new File([text], name, {type: "application/json"}));
    return transfer;
}"""


FOCUSED = """() => {
    const here = document.activeElement;
    return [(here.labels?.[0] ?? here).textContent, here.type];
}"""
MOST_TABS = 60


@pytest.fixture
def good(tmp_path: Path) -> Path:
    """Write a submission that nobody has sent."""
    file = tmp_path / "good.json"
    file.write_bytes(sound(OPEN, "random 99"))
    return file


def drop(page: Page, file: Path) -> None:
    """Drag a file over the box and let it go."""
    transfer = page.evaluate_handle(TRANSFER, [file.name, file.read_text()])
    for event in ("dragenter", "dragover", "drop"):
        page.locator(".drop").dispatch_event(event, {"dataTransfer": transfer})


def choose(page: Page, file: Path) -> None:
    """Choose a file in the browser's dialogue."""
    page.get_by_label("Result file").set_input_files(file)


def used(site: Site) -> int:
    """Return how many submissions of the year's quota are used."""
    report = site.ask(OWNER, "GET", f"/splits/{OPEN}").json()["quota"]
    (year,) = [window for window in report["windows"] if window["name"] == "year"]
    return int(year["limit"] - year["remaining"])


def check_only(page: Page) -> None:
    page.get_by_role("button", name="Check only").click()


def test_from_a_broken_file_to_the_board(own_site: Site, good: Path, open_page: OpenPage) -> None:
    page = open_page(own_site, "/")
    page.get_by_role("link", name="Sign in").click()
    sign_in(page, own_site.tokens[OWNER])
    page.get_by_role("navigation", name="Main").get_by_role("link", name="Submit").click()
    page.get_by_role("radio", name=OPEN).check()
    before = used(own_site)

    expect(page.get_by_role("button", name="Check only")).to_be_visible()
    drop(page, BROKEN)
    problems = page.get_by_role("region", name="Problems in the file")
    expect(problems.locator("tbody tr")).to_have_count(PROBLEMS_OF_BROKEN)
    expect(problems).to_contain_text("[0].trajectory[2][0]")
    assert used(own_site) == before
    expect(page.get_by_role("button", name="Score")).to_be_disabled()

    drop(page, good)
    expect(problems).to_have_count(0)
    expect(page.get_by_role("main")).to_contain_text("can be scored")
    expect(page.get_by_text("Choose the file again")).to_be_hidden()
    expect(page.get_by_role("button", name="Check again")).to_be_visible()
    expect(page.get_by_role("button", name="Cancel")).to_be_hidden()
    page.get_by_role("radio", name=PRIVATE).check()
    page.get_by_role("button", name=f"Check as {OPEN}").click()
    expect(page.get_by_role("main")).to_contain_text(f"can be scored on {OPEN}")
    expect(page.get_by_role("radio", name=OPEN)).to_be_checked()
    assert used(own_site) == before

    page.get_by_label("Name", exact=False).first.fill("Newcomer")
    page.get_by_role("button", name="Score").click()
    expect(page).to_have_url(re.compile("/submissions/[0-9a-f]{16}"))
    expect(page.get_by_role("heading", level=1)).to_have_text("Newcomer")
    assert used(own_site) == before + 1
    find_on_the_board(page)
    look_at_an_episode(page)
    sign_out(page)


def find_on_the_board(page: Page) -> None:
    page.get_by_role("button", name="Publish", exact=True).click()
    expect(page.get_by_role("status")).to_contain_text("published")
    page.get_by_role("navigation", name="Main").get_by_role("link", name=OPEN).click()
    board = page.get_by_role("region", name="Leaderboard", exact=True)
    expect(board.get_by_role("link", name="Newcomer")).to_be_visible()

    board.get_by_role("link", name=re.compile("^SPL")).click()
    page.wait_for_url("**metric=spl*")  # and its style sheet, which hides another such header
    expect(board.get_by_role("columnheader", name=re.compile("^SPL"))).to_have_attribute(
        "aria-sort", "descending"
    )
    column = [each.inner_text() for each in board.locator("td.primary").all()]
    values = [float(re.split(r"\s", text)[0]) for text in column if text != "-"]
    assert values == sorted(values, reverse=True)

    if not page.get_by_label("Method or team").is_visible():
        page.get_by_text("Filter", exact=True).first.click()
    page.get_by_label("Method or team").fill("newcomer")
    page.get_by_role("button", name="Filter").click()
    expect(board.locator("tbody tr")).to_have_count(1)
    board.get_by_role("link", name="Newcomer").click()


def look_at_an_episode(page: Page) -> None:
    page.get_by_role("link", name="Browse episodes").click()
    page.locator(f"table a[href^='/episodes/{OPEN}/']").first.click()
    expect(page).to_have_url(re.compile(f"/episodes/{OPEN}/"))
    expect(page.locator("main svg[role=img]").first).to_be_visible()
    first = page.url
    page.get_by_role("link", name="Next").first.click()
    expect(page).not_to_have_url(first)


def sign_out(page: Page) -> None:
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_role("link", name="Sign in")).to_be_visible()
    page.goto("/submit")
    expect(page).to_have_url(re.compile("/sign-in"))


def test_a_file_is_checked_that_was_chosen_before_the_script_came(
    site: Site, good: Path, open_page: OpenPage
) -> None:
    page = open_page(site, "/team", OWNER)
    held = Held(page, "**/submit.js*")
    page.goto(f"/submit?split={OPEN}", wait_until="commit")
    script = held.first()
    choose(page, good)
    script.continue_()
    expect(page.locator("#outcome")).to_contain_text("can be scored")


def test_the_same_upload_without_scripts(own_site: Site, good: Path, open_page: OpenPage) -> None:
    page = open_page(own_site, "/submit", OWNER, java_script_enabled=False)
    before = used(own_site)
    page.get_by_role("radio", name=OPEN).check()
    check_only(page)
    expect(page.get_by_role("alert")).to_contain_text("Choose a file first.")
    choose(page, BROKEN)
    check_only(page)
    expect(page.locator(".problems tbody tr")).to_have_count(PROBLEMS_OF_BROKEN)

    choose(page, good)
    check_only(page)
    expect(page.get_by_role("main")).to_contain_text("can be scored")
    assert used(own_site) == before

    choose(page, good)
    page.get_by_label("Name", exact=False).first.fill("Newcomer")
    page.get_by_role("button", name="Score").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("Newcomer")
    assert used(own_site) == before + 1
    find_on_the_board(page)
    look_at_an_episode(page)
    sign_out(page)


def press_until(page: Page, label: str, kind: str = "") -> None:
    """Go from field to field until one with this name, and of this type, has the focus."""
    for _ in range(MOST_TABS):
        page.keyboard.press("Tab")
        found, its_kind = page.evaluate(FOCUSED)
        if found.strip().startswith(label) and kind in (its_kind or ""):
            return
    raise AssertionError(f"nobody comes to {label!r} with the Tab key")


def test_with_the_keyboard_alone(own_site: Site, good: Path, open_page: OpenPage) -> None:
    page = open_page(own_site, "/")
    press_until(page, "Skip")
    press_until(page, "Sign in")
    page.keyboard.press("Enter")
    page.wait_for_url("**/sign-in**")
    press_until(page, "Token")
    page.keyboard.type(own_site.tokens[OWNER])
    page.keyboard.press("Enter")
    page.wait_for_url("**/team")
    press_until(page, "Submit")
    page.keyboard.press("Enter")
    page.wait_for_url("**/submit")
    press_until(page, "test", "radio")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowDown")
    expect(page.get_by_role("radio", name=OPEN)).to_be_checked()
    press_until(page, "Result file")
    choose(page, good)  # the dialogue that opens here is the desktop's, not the page's
    expect(page.get_by_role("main")).to_contain_text("can be scored")
    press_until(page, "Name")
    page.keyboard.type("Typed")
    press_until(page, "Score")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", level=1)).to_have_text("Typed")


def test_a_team_with_markup_for_a_name_is_only_a_name(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, f"/splits/{OPEN}")
    expect(page.get_by_role("main")).to_contain_text(MARKUP)
    page = open_page(site, "/team", MARKED)
    expect(page.get_by_role("heading", level=1)).to_contain_text(MARKUP)
    expect(page.locator("header")).to_contain_text(MARKUP)
