"""What forms lead to, in a real browser: a page that is a reply keeps nobody out either."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import pytest
from playwright.sync_api import Page, expect

from tests.support.browser import DESKTOP, PHONE, OpenPage, barriers, copied_site
from tests.support.demo_site import ENDLESS, MATE, OPEN, ORGANISER, OWNER, SAMPLES, Site

SEND = "form => HTMLFormElement.prototype.submit.call(form)"
"""Past the scripts, and past what the browser itself would say of a field."""
HEIGHTS = """each => [...each.querySelectorAll("input:not([type=hidden]), select, button, .button")]
    .map(field => field.getBoundingClientRect().height)"""


class Reply(NamedTuple):
    """A page that comes of a form."""

    path: str
    """Where the form is."""
    who: str | None
    fill: Callable[[Page, Site], None]
    heading: str


def upload(page: Page, site: Site) -> None:
    page.get_by_label("Result file").set_input_files(SAMPLES / "broken.json")
    page.locator("form.upload").evaluate(SEND)


def revoke(page: Page, site: Site) -> None:
    page.get_by_role("button", name="Revoke").last.click()


def make_organiser(page: Page, site: Site) -> None:
    form = page.get_by_role("form", name="Add a person")
    form.get_by_label("Name").fill("Zed")
    form.get_by_label("Role").select_option("organiser")
    form.get_by_role("button").click()


def make_team_again(page: Page, site: Site) -> None:
    form = page.get_by_role("form", name="Add a team")
    form.get_by_label("Name").fill("Blue")
    form.get_by_role("button").click()


def make_token(page: Page, site: Site) -> None:
    page.get_by_role("button", name="Create").click()


def flag(page: Page, site: Site) -> None:
    page.get_by_role("radio", name="Flagged").check()
    page.get_by_role("textbox", name="Reason").fill(ENDLESS * 4)
    page.get_by_role("button", name="Publish the review").click()


def pause(page: Page, site: Site) -> None:
    page.get_by_label("Pause submissions").check()
    page.get_by_role("button", name="Preview").click()


def accept(page: Page, site: Site) -> None:
    page.get_by_label("Invitation", exact=True).fill(site.invite(MATE))
    page.get_by_role("button", name="Get my token").click()


def show_a_wrong_invitation(page: Page, site: Site) -> None:
    page.get_by_label("Invitation", exact=True).fill("rv_none")
    page.get_by_role("button", name="Get my token").click()


def rename(page: Page, site: Site) -> None:
    page.get_by_text("Edit the name").click()
    page.get_by_label("Name", exact=True).fill("")
    page.locator("form", has=page.get_by_role("button", name="Save", exact=True)).evaluate(SEND)


REPLIES = {
    "a file with problems": Reply("/submit", OWNER, upload, "Submit"),
    "a question": Reply("/desk/people", ORGANISER, revoke, "Revoke the token"),
    "another question": Reply("/desk/people", ORGANISER, make_organiser, "Make Zed an organiser"),
    "a refusal": Reply("/desk/people", ORGANISER, make_team_again, "People"),
    "a token": Reply("/desk/people", ORGANISER, make_token, "Invitation for Ada"),
    "a review": Reply("/desk/reviews?submission={}", ORGANISER, flag, "Flag this submission?"),
    "a preview": Reply("/desk/notice", ORGANISER, pause, "Everyone will see this"),
    "a welcome": Reply("/sign-in", None, accept, "Welcome, Ben"),
    "no invitation": Reply("/sign-in", None, show_a_wrong_invitation, "Sign in"),
    "no name": Reply("/submissions/{}", OWNER, rename, "Walker"),
}


@pytest.fixture(scope="module")
def used_site(stopped_site: Site, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Run a server whose forms are sent."""
    with copied_site(stopped_site, tmp_path_factory.mktemp("used") / "server") as site:
        yield site


@pytest.mark.parametrize("reply", REPLIES.values(), ids=list(REPLIES))
def test_a_reply_keeps_nobody_out(reply: Reply, used_site: Site, open_page: OpenPage) -> None:
    path = reply.path.format(used_site.ids[OPEN, "Walker"])
    page = open_page(used_site, path, reply.who)
    with page.expect_navigation():  # some replies have the heading and the address of the form
        reply.fill(page, used_site)
    expect(page.get_by_role("heading", level=1)).to_contain_text(reply.heading)
    assert barriers(page) == {}


FORMS = [
    pytest.param(f"/splits/{OPEN}?text=a", None, ".filters form", id="of a board"),
    pytest.param(f"/episodes/{OPEN}", OWNER, "form.chooser", id="of episodes"),
    pytest.param("/desk/audit", ORGANISER, "form.seek", id="of the log"),
]


@pytest.mark.parametrize(("path", "who", "form"), FORMS)
def test_the_fields_of_a_filter_are_of_one_height(
    path: str, who: str | None, form: str, site: Site, open_page: OpenPage
) -> None:
    heights = open_page(site, path, who).locator(form).evaluate(HEIGHTS)
    assert len(heights) > 1
    assert set(heights) == {40}


@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_headings_that_sort_are_large_enough_for_a_finger(
    size: tuple[int, int], site: Site, open_page: OpenPage
) -> None:
    page = open_page(site, f"/splits/{OPEN}?columns=all", None, size)
    boxes = [link.bounding_box() for link in page.locator("thead th a:visible").all()]
    assert boxes
    assert all(box is not None and box["height"] >= 24 for box in boxes)
