"""A year of the leaderboard by commands alone, and the hand-over at its end."""

import csv
import io
from collections import Counter
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

import pytest

from tests.support.flat_world import Outcome
from tests.support.serving import PRIVATE
from tests.support.year import TEAMS, Year, at, begin_year, check, check_site, hand_over, live


class Commands:
    """The organiser at a terminal."""

    def __init__(self, year: Year) -> None:
        self.steps: Counter[str] = Counter()
        self._year = year

    def import_history(self, file: Path, source: str, told: str) -> None:
        """Add the results of an earlier leaderboard, and read how many were added."""
        words = [str(file), "--split", PRIVATE, "--source", source]
        assert told in self._run("import", "import", *words).out

    def accept_requests(self) -> Mapping[str, str]:
        """Accept all requests to join; return the invitation of each team's person."""
        _, *rows = self._run("join", "request", "list").out.splitlines()
        numbers = [row.split()[0] for row in rows]
        assert len(numbers) == len(TEAMS)
        accepted = self._run("join", "request", "accept", *numbers).out
        return {row["team"]: row["invitation"] for row in csv.DictReader(io.StringIO(accepted))}

    def open_phase(self, name: str, opens: datetime, closes: datetime | None) -> None:
        """Accept submissions to the private split in a period."""
        words = ["--opens", opens.isoformat()]
        words += ["--closes", closes.isoformat()] if closes else []
        self._run("phases", "phase", "set", PRIVATE, name, *words)

    def close_phases(self) -> None:
        """Accept no submissions to the private split from now on."""
        self._run("phases", "phase", "close", PRIVATE)

    def grant(self, team: str, number: int, reason: str) -> None:
        """Grant a team extra submissions."""
        self._run("grant", "grant", team, PRIVATE, str(number), "--reason", reason)

    def disqualify(self, submission_id: str, reason: str) -> None:
        """Disqualify a submission."""
        assert submission_id in self._run("review", "submissions", "--split", PRIVATE).out
        self._run("review", "review", "add", submission_id, "disqualified", "--reason", reason)

    def correct(self, bundle: Path, reason: str) -> None:
        """Score everything again with another ground truth."""
        words = [PRIVATE, "--bundle", str(bundle)]
        self._run("correct", "rescore", *words, "--dry-run")
        self._run("correct", "rescore", *words, "--reason", reason)
        self._year.restart()

    def delete_person(self, team: str, name: str) -> None:
        """Delete a person's name and address."""
        self._run("delete", "person", "delete", name, "--team", team, "--yes")

    def _run(self, task: str, *words: str) -> Outcome:
        """Run a command on the folder, which comes after the command's own words."""
        self.steps[task] += 1
        n = 2 if words[0] in {"request", "phase", "review", "person"} else 1
        return self._year.laptop.run("server", *words[:n], "lab", *words[n:])


@pytest.mark.slow
def test_a_year_by_commands(tmp_path: Path) -> None:
    with begin_year(tmp_path) as year:
        organiser = Commands(year)
        live(year, organiser)
        year.move_to(at(12, 20))
        successor = hand_over(year)
        check_site(year)
        check(year, successor)
        assert year.refused == {409: 2, 422: 10, 429: 6}
        assert organiser.steps == {
            "import": 1,
            "join": 2,
            "phases": 3,
            "grant": 1,
            "review": 2,
            "correct": 2,
            "rotate the key": 1,
            "delete": 1,
        }
