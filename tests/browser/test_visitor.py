"""Somebody who has never heard of the benchmark becomes a row of its leaderboard."""

import re
from pathlib import Path

from playwright.sync_api import FilePayload, Page, expect

from tests.support.browser import OpenPage, copied_site
from tests.support.demo_site import OPEN, ORGANISER, SAMPLES, Site, sound
from tests.support.waiting import SELDOM, wait_until

TEXT_SIZES = """() => [...document.querySelectorAll(".example text")]
    .filter(text => text.checkVisibility())
    .map(text => parseFloat(getComputedStyle(text).fontSize) * text.getScreenCTM().a)"""
LEAST_SIZE = 11
"""Pixels of text in pictures."""
CONTACT = {"REVERIE_EVAL_CONTACT": "lab@example.org"}


def test_from_the_first_page_to_the_leaderboard(
    stopped_site: Site, tmp_path: Path, open_page: OpenPage
) -> None:
    with copied_site(stopped_site, tmp_path / "server", **CONTACT) as site:
        page = open_page(site)
        understand(page)
        play(page)
        ask_for_an_account(page)
        use(page, invitation_by(open_page(site, "/desk", ORGANISER)))
        submit(page)
        publish(page)


def understand(page: Page) -> None:
    expect(page.get_by_role("heading", level=1)).to_contain_text("Find the object")
    main = page.get_by_role("main")
    for name, address in (
        ("Get the data", "https://github.com/YuankaiQi/REVERIE"),
        ("its paper", "https://arxiv.org/abs/1904.10151"),
        ("lab@example.org", "mailto:lab@example.org"),
    ):
        expect(main.get_by_role("link", name=name)).to_have_attribute("href", address)


def play(page: Page) -> None:
    invitation = page.get_by_role("link", name="Be the agent")

    def is_invited() -> bool:
        """Whether the server has computed the example since it started."""
        page.reload()
        return invitation.count() > 0

    wait_until(is_invited, SELDOM)
    assert min(page.evaluate(TEXT_SIZES)) >= LEAST_SIZE
    invitation.click()
    page.get_by_role("link", name="Begin").click()
    page.get_by_role("region", name="Walk").get_by_role("link").first.click()
    expect(page.get_by_role("main")).to_contain_text("1 step,")
    answer = page.get_by_role("region", name="Answer")
    answer.get_by_role("radio").first.check()
    answer.get_by_role("button").click()
    expect(page.get_by_role("heading", name="Scores")).to_be_visible()
    expect(
        page.get_by_role("row", name=re.compile("^Remote grounding success, RGS "))
    ).to_be_visible()


def ask_for_an_account(page: Page) -> None:
    page.get_by_role("navigation", name="Main").get_by_role("link", name="Submit").click()
    page.get_by_role("link", name="Request one").click()
    page.get_by_label("Team", exact=True).fill("Passers-by")
    page.get_by_label("People", exact=True).fill("Dora, dora@example.org")
    page.get_by_label("Institution", exact=True).fill("University")
    page.get_by_role("button", name="Send the request").click()
    expect(page.get_by_role("status")).to_be_visible()


def invitation_by(organiser: Page) -> str:
    """Accept the request with one click, and return the invitation that this gives."""
    organiser.get_by_role("link", name="Answer").click()
    expect(organiser.get_by_role("main")).to_contain_text("Passers-by")
    organiser.get_by_role("button", name="Accept request").click()
    expect(organiser.get_by_role("heading", name="Dora, Passers-by")).to_be_visible()
    return organiser.locator(".secret").inner_text()


def use(page: Page, invitation: str) -> None:
    page.get_by_role("link", name="Sign in").first.click()
    page.get_by_label("Invitation", exact=True).fill(invitation)
    page.get_by_role("button", name="Get my token").click()
    expect(page.locator(".secret")).to_contain_text("rv_")
    page.get_by_role("link", name="I have saved it").click()


def submit(page: Page) -> None:
    page.get_by_role("navigation", name="Main").get_by_role("link", name="Submit").click()
    page.get_by_role("radio", name=OPEN).check()
    file = page.get_by_label("Result file")
    file.set_input_files(SAMPLES / "broken.json")
    expect(page.get_by_role("region", name="Problems in the file")).to_be_visible()
    file.set_input_files(FilePayload(name="a.json", mimeType="", buffer=sound(OPEN, "mixed 70")))
    expect(page.get_by_role("main")).to_contain_text("can be scored")
    page.get_by_label("Name", exact=False).first.fill("Passing through")
    page.get_by_role("button", name="Score").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("Passing through")
    expect(page.get_by_role("main")).to_contain_text("this would be 1st of 8 by RGSPL")


def publish(page: Page) -> None:
    page.get_by_role("button", name="Publish", exact=True).click()
    page.get_by_role("link", name="see it on the leaderboard").click()
    first = page.get_by_role("region", name="Leaderboard", exact=True).locator("tbody tr").first
    expect(first).to_contain_text("Passing through")
    expect(first).to_contain_text("yours")
