"""A year at the desk, in a real browser; commands only for what the desk does not do."""

import csv
import re
from collections import Counter
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from tests.support.browser import new_page
from tests.support.serving import PRIVATE
from tests.support.year import Year, begin_year, check, live


class Desk:
    """The organiser before a browser; fields that are filled in do not count as clicks."""

    def __init__(self, year: Year, page: Page) -> None:
        self.steps: Counter[str] = Counter()
        self._year, self._page = year, page
        self._task = ""

    def import_history(self, file: Path, source: str, told: str) -> None:
        """Add the results of an earlier leaderboard."""
        self._begin("import", "Reported results")
        self._press(self._main.get_by_role("link", name="Import"))
        self._page.get_by_label("Split", exact=True).select_option(PRIVATE)
        self._page.get_by_label("Source", exact=True).fill(source)
        self._page.get_by_role("textbox", name="Results").fill(file.read_text())
        self._press_button("Show what would be added")
        added = re.search(r"(\d+) added", told)
        assert added
        expect(self._page.get_by_role("heading", level=1)).to_contain_text(f"Add {added[1]} result")
        self._press_button("Import")

    def accept_requests(self) -> Mapping[str, str]:
        """Accept all requests to join; return the invitation of each team's person."""
        self._begin("join", "Requests")
        self._press(self._main.get_by_role("link", name="Tick all"))
        self._press_button("Accept the ticked ones")
        with self._page.expect_download() as download:
            self._press(self._main.get_by_role("link", name="invitations.csv"))
        with download.value.path().open() as file:
            invitations = {row["team"]: row["invitation"] for row in csv.DictReader(file)}
        self._press(self._main.get_by_role("link", name="I have copied them"))
        return invitations

    def close_phases(self) -> None:
        """Accept no submissions to the private split from now on."""
        self._begin("phases", "Phases")
        self._press(self._main.get_by_role("link", name=PRIVATE, exact=True))
        self._press_button("Close now")
        self._press_button("Change")

    def open_phase(self, name: str, opens: datetime, closes: datetime | None) -> None:
        """Accept submissions to the private split in a period."""
        self._begin("phases", "Phases")
        self._press(self._main.get_by_role("link", name=PRIVATE, exact=True))
        form = self._page.get_by_role("group", name=re.compile("^Phase ")).last
        form.get_by_label("Name", exact=True).fill(name)
        form.get_by_label("Opens", exact=True).fill(opens.isoformat())
        form.get_by_label("Closes", exact=True).fill(closes.isoformat() if closes else "")
        self._press_button("Preview")
        self._press_button("Change")

    def grant(self, team: str, number: int, reason: str) -> None:
        """Grant a team extra submissions."""
        self._begin("grant", "Quotas")
        self._page.get_by_label("Team", exact=True).select_option(team)
        self._page.get_by_label("Split", exact=True).select_option(PRIVATE)
        self._page.get_by_label("Extra submissions", exact=True).fill(str(number))
        self._page.get_by_label("Last day", exact=True).fill("2027-12-31")
        self._page.get_by_label("Reason", exact=True).fill(reason)
        self._press_button("Grant")

    def disqualify(self, submission_id: str, reason: str) -> None:
        """Disqualify a submission."""
        self._begin("review", "Reviews")
        self._page.get_by_label("Find by id", exact=True).fill(submission_id)
        self._press_button("Find")
        self._press(self._page.get_by_label("Disqualified"))
        self._page.get_by_label("Reason", exact=True).fill(reason)
        self._press_button("Publish the review")
        self._press_button("Disqualify")

    def correct(self, bundle: Path, reason: str) -> None:
        """Score everything again with another ground truth, which only a command can."""
        words = ("lab", PRIVATE, "--bundle", str(bundle), "--reason", reason)
        self._year.laptop.run("server", "rescore", *words)
        self._year.restart()

    def delete_person(self, team: str, name: str) -> None:
        """Delete a person's name and address."""
        self._begin("delete", "People")
        row = self._page.get_by_role("row").filter(has=self._page.get_by_text(team, exact=True))
        self._press(row.get_by_role("link", name=name, exact=True).first)
        self._press_button("Delete this person")
        self._press(self._page.locator("main button.risky"))

    @property
    def _main(self) -> Locator:
        return self._page.get_by_role("main")

    def _begin(self, task: str, part: str) -> None:
        """Open a part of the desk; sign in if the last session has ended."""
        self._task = task
        self._page.goto(f"{self._year.url}/desk")
        if "/sign-in" in self._page.url:
            self._page.get_by_label("Token", exact=True).fill(self._year.organiser_token)
            self._press(self._main.get_by_role("button", name="Sign in").first)
        menu = self._page.get_by_role("navigation", name="Desk")
        self._press(menu.get_by_role("link", name=part, exact=True))

    def _press_button(self, name: str) -> None:
        self._press(self._main.get_by_role("button", name=name, exact=True))

    def _press(self, target: Locator) -> None:
        target.click()
        self._page.wait_for_load_state()
        expect(self._page.get_by_role("alert")).to_have_count(0)
        self.steps[self._task] += 1


@pytest.mark.slow
def test_a_year_at_the_desk(tmp_path: Path, browser: Browser) -> None:
    with begin_year(tmp_path) as year:
        page = new_page(browser)
        organiser = Desk(year, page)
        live(year, organiser)
        page.close()
        check(year, year.folder)
        assert organiser.steps == {
            "import": 5,
            "join": 6,
            "phases": 13,
            "grant": 3,
            "review": 6,
            "rotate the key": 1,
            "delete": 5,
        }
