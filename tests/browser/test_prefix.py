"""A server below a path of its host, in a real browser: no request leaves the path."""

import re
from dataclasses import replace

from playwright.sync_api import FilePayload, expect

from tests.support.browser import UNLIMITED, OpenPage, await_chart
from tests.support.demo_site import OPEN, OWNER, Site, sound
from tests.support.serving import running

PREFIX = "/reverie"


def test_a_participant_stays_below_the_path(own_site: Site, open_page: OpenPage) -> None:
    variables = {**UNLIMITED, "REVERIE_EVAL_PUBLIC_ADDRESS": f"http://localhost{PREFIX}"}
    with running(own_site.folder, **variables) as (_, url):
        site = replace(own_site, url=f"{url}{PREFIX}")
        page = open_page(site, f"{site.url}/splits/{OPEN}")
        await_chart(page, "against")
        page.get_by_label("Horizontal axis").select_option("spl")
        expect(page).to_have_url(re.compile("x=spl"))
        latex = page.get_by_role("link", name="LaTeX")
        expect(latex).to_have_attribute("href", re.compile(f"{PREFIX}/splits/{OPEN}/latex.*x=spl"))
        page.get_by_role("link", name="Sign in").click()
        page.get_by_label("Token", exact=True).fill(site.tokens[OWNER])
        page.get_by_role("main").get_by_role("button", name="Sign in", exact=True).click()
        page.wait_for_url(f"{site.url}/team")
        page.get_by_role("navigation", name="Main").get_by_role("link", name="Submit").click()
        page.get_by_role("radio", name=OPEN).check()
        content = FilePayload(name="a.json", mimeType="", buffer=sound(OPEN, "random 99"))
        page.get_by_label("Result file").set_input_files(content)
        expect(page.get_by_role("main")).to_contain_text("can be scored")
        page.get_by_label("Name", exact=False).first.fill("Newcomer")
        page.get_by_role("button", name="Score").click()
        page.wait_for_url(re.compile(f"{site.url}/submissions/[0-9a-f]{{16}}"))
        page.goto(f"{site.url}/submit")
        page.get_by_role("radio", name=OPEN).check()
        page.context.clear_cookies()
        page.get_by_label("Result file").set_input_files(content)
        outcome = page.locator("#outcome")
        expect(outcome).to_contain_text("You are signed out, and nothing was scored")
        with page.expect_popup() as opened:
            outcome.get_by_role("link", name="Sign in").click()
        window = opened.value
        window.get_by_label("Token", exact=True).fill(site.tokens[OWNER])
        window.get_by_role("main").get_by_role("button", name="Sign in", exact=True).click()
        window.wait_for_url(f"{site.url}/team")
        page.get_by_role("button", name="Check").click()
        expect(outcome).to_contain_text("can be scored")
        expect(outcome).to_be_in_viewport()
