"""The small scripts in a real browser: the viewer's own time, and buttons that copy."""

from datetime import datetime
from zoneinfo import ZoneInfo

import pytest
from playwright.sync_api import expect

from tests.support.browser import PHONE, Held, OpenPage
from tests.support.demo_site import MATE, ORGANISER, OWNER, Site

TOKYO = "Asia/Tokyo"
IS_WHOLE = "each => each.getClientRects().length === 1"


@pytest.mark.parametrize(
    ("path", "who"),
    [("/team", OWNER), ("/desk/attempts", ORGANISER), ("/desk", ORGANISER)],
)
def test_the_viewer_s_own_time_is_beside_every_instant(
    path: str, who: str, site: Site, open_page: OpenPage
) -> None:
    page = open_page(site, path, who, PHONE, timezone_id=TOKYO)
    instants = page.locator("main time[datetime*='T']")
    expect(instants).not_to_have_count(0)
    for each in instants.all():
        told = each.get_attribute("datetime") or ""
        local = datetime.fromisoformat(told).astimezone(ZoneInfo(TOKYO))
        own = each.locator("xpath=following-sibling::*[1]")
        expect(own).to_have_text(f"({local:%Y-%m-%d %H:%M} your time)")
        assert each.evaluate(IS_WHOLE), told
        assert own.evaluate(IS_WHOLE), told


def test_in_utc_there_is_nothing_to_add(site: Site, open_page: OpenPage) -> None:
    page = open_page(site, "/team", OWNER, timezone_id="UTC")
    expect(page.locator("main time").first).to_be_visible()
    expect(page.locator(".own")).to_have_count(0)


def test_a_token_is_copied_with_a_button(own_site: Site, open_page: OpenPage) -> None:
    invitation = own_site.invite(MATE)
    page = open_page(own_site, "/sign-in", permissions=["clipboard-read", "clipboard-write"])
    page.get_by_label("Invitation", exact=True).fill(invitation)
    page.get_by_role("button", name="Get my token").click()
    page.get_by_role("button", name="Copy").click()
    expect(page.get_by_role("status").last).to_have_text("Copied.")
    token = page.locator("#secret").inner_text()
    assert token.startswith("rv_")
    assert page.evaluate("navigator.clipboard.readText()") == token


def test_a_button_is_seen_when_it_can_copy(own_site: Site, open_page: OpenPage) -> None:
    invitation = own_site.invite(MATE)
    page = open_page(own_site, "/sign-in", permissions=["clipboard-write"])
    held = Held(page, "**/copy.js*")
    page.get_by_label("Invitation", exact=True).fill(invitation)
    page.get_by_role("button", name="Get my token").click()
    script = held.first()
    expect(page.get_by_role("button", name="Copy")).to_have_count(0)
    script.continue_()
    page.get_by_role("button", name="Copy").click()
    expect(page.get_by_role("status").last).to_have_text("Copied.")


def test_where_there_is_no_clipboard_it_is_marked(own_site: Site, open_page: OpenPage) -> None:
    invitation = own_site.invite(MATE)
    page = open_page(own_site, "/sign-in")
    page.get_by_label("Invitation", exact=True).fill(invitation)
    page.get_by_role("button", name="Get my token").click()
    page.evaluate("() => { navigator.clipboard.writeText = () => Promise.reject(new Error()); }")
    page.get_by_role("button", name="Copy").click()
    expect(page.get_by_role("status").last).to_have_text("Selected: copy it with the keyboard.")
    assert (
        page.evaluate("getSelection().toString()").strip() == page.locator("#secret").inner_text()
    )
