"""Files that people sent to the organiser: scored, counted and answered as uploads are."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.service.audit import entries
from tests.support.acting import NOON
from tests.support.flat import Outcome, Run
from tests.support.serving import (
    BROKEN,
    GOOD,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    Serving,
    submission_for,
)

TEAM = "Blue"
WHEN = "2026-03-02T12:00:00Z"
"""When tests begin."""


@pytest.fixture
def mailed(tmp_path: Path) -> Path:
    """Return a folder of files that came by e-mail: two sound ones, and one with mistakes."""
    folder = tmp_path / "mail"
    folder.mkdir()
    (folder / "first.json").write_bytes(GOOD)
    (folder / "second.json").write_bytes(BROKEN)
    (folder / "third.json").write_bytes(GOOD + b"\n")
    (folder / "message.txt").write_text("Please score these.")
    return folder


@dataclass(frozen=True)
class Office:
    """A server, and its organiser at the command line."""

    server: Serving
    folder: Path
    run: Run

    def submit(self, place: Path, *more: str, **changed: str) -> Outcome:
        """Submit files of the owner's, with these options changed."""
        given = {"split": OPEN, "team": TEAM, "person": OWNER, "received": WHEN} | changed
        words = [word for name, value in given.items() for word in (f"--{name}", value)]
        return self.run("server", "submit", str(self.folder), str(place), *words, *more)

    def submissions(self) -> list[dict[str, Any]]:
        """Return all submissions of the server."""
        found: list[dict[str, Any]] = self.server.ask(ORGANISER, "GET", "/submissions").json()
        return found


@pytest.fixture
def office(server: Serving, folder: Path, run: Run) -> Office:
    """Return an organiser at the command line."""
    return Office(server, folder, run)


def test_each_file_is_scored_and_answered(office: Office, mailed: Path) -> None:
    outcome = office.submit(mailed, "--publish")
    assert outcome.status == 1, "one was refused"
    replies = outcome.out.split("-" * 72)
    assert [reply.strip().splitlines()[0] for reply in replies] == [f"Dear {TEAM},"] * 3
    first, second, third = replies
    assert f"Your file first.json, received 2026-03-02 12:00:00 UTC, was scored on {OPEN}." in first
    assert "RGSPL" in first
    assert "submissions left on val_unseen: 199" in first
    assert "The signed receipt is attached: first.json.receipt.json" in first
    assert "was not scored, and no submission was used" in second
    assert "[1]" in second
    assert "submissions left on val_unseen: 198" in third
    found = office.submissions()
    assert {(each["team"], each["person"], each["status"]) for each in found} == {
        (TEAM, OWNER, "published")
    }
    assert {each["received_at"] for each in found} == {WHEN}
    assert [each for each in examine(office.folder) if each.kind == "fault"] == []


def test_they_score_what_uploads_score(office: Office, tmp_path: Path) -> None:
    content = submission_for(PRIVATE)
    (tmp_path / "mine.json").write_bytes(content)
    uploaded = office.server.upload(OTHER, content, PRIVATE)
    office.submit(tmp_path / "mine.json", split=PRIVATE)
    (mine,) = [each for each in office.submissions() if each["team"] == TEAM]
    assert uploaded.json()["submission"]["report"] == mine["report"]


def test_the_audit_log_names_the_organiser(office: Office, mailed: Path) -> None:
    office.submit(mailed / "first.json", "--publish")
    with office.server.state.database.reading() as session:
        last = entries(session)[-2:]
        assert list(office.server.state.audit_log.broken_links(session)) == []
    assert [entry.action for entry in last] == ["submitted", "changed"]
    assert all(entry.actor.endswith("(command line)") for entry in last)


def test_again_is_the_same_result(office: Office, mailed: Path) -> None:
    first = office.submit(mailed / "first.json")
    again = office.submit(mailed / "first.json", received="2026-03-02T11:00:00+00:00")
    assert (first.status, again.status) == (0, 0)
    assert "already scored" in again.out
    (only,) = office.submissions()
    assert only["received_at"] == WHEN
    assert len(list(mailed.glob("*.receipt.json"))) == 1


def test_a_pause_does_not_matter_and_a_phase_does(office: Office, mailed: Path) -> None:
    office.server.ask(ORGANISER, "PUT", "/organiser/notice", json={"paused": True})
    assert office.submit(mailed / "first.json").status == 0
    settings = office.folder / "reverie-eval.toml"
    head, split, rest = settings.read_text().partition(f"[splits.{OPEN}]\n")
    phase = 'phases = [{ name = "2026", opens = 2026-03-02T12:00:01Z }]\n'
    settings.write_text(head + split + phase + rest)
    late = office.submit(mailed / "third.json")
    assert (late.status, "accepts no submissions now" in late.out) == (1, True)
    assert office.submit(mailed / "third.json", received="2026-03-02T12:00:01Z").status == 0


@pytest.mark.parametrize(
    ("hours", "status"),
    [
        pytest.param(-30, 0, id="the day before"),
        pytest.param(-20, 1, id="within a day of both"),
        pytest.param(-1, 1, id="an hour before"),
    ],
)
def test_quotas_hold_in_every_window(
    office: Office, tmp_path: Path, hours: int, status: int
) -> None:
    """Two submissions a day are allowed, and two came on the same day by upload."""
    for _ in range(2):
        assert (
            office.server.upload(OWNER, office.server.distinct(PRIVATE), PRIVATE).status_code == 201
        )
    (tmp_path / "mine.json").write_bytes(office.server.distinct(PRIVATE))
    at = (NOON + timedelta(hours=hours)).isoformat()
    outcome = office.submit(tmp_path / "mine.json", split=PRIVATE, received=at)
    assert outcome.status == status
    assert len(office.submissions()) == 3 - status


@pytest.mark.parametrize(
    ("change", "said"),
    [
        pytest.param(
            {"received": "2026-03-02 12:00"}, "is not a time with a time zone", id="naive"
        ),
        pytest.param({"received": "yesterday"}, "is not a time with a time zone", id="no time"),
        pytest.param({"received": "2999-01-01T00:00:00Z"}, "is in the future", id="future"),
        pytest.param({"team": "Red"}, "the team 'Red' has no person", id="another team"),
        pytest.param({"person": "Nobody"}, "the team 'Blue' has no person 'Nobody'", id="nobody"),
        pytest.param({"split": "tset"}, "there is no split 'tset'", id="split"),
    ],
)
def test_a_wrong_call_submits_nothing(
    office: Office, mailed: Path, change: Mapping[str, str], said: str
) -> None:
    outcome = office.submit(mailed / "first.json", **change)
    assert (outcome.status, said in outcome.err) == (2, True), outcome.err
    assert office.submissions() == []
    assert not list(mailed.glob("*.receipt.json"))


def test_a_folder_without_files(office: Office, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    outcome = office.submit(tmp_path / "empty")
    assert (outcome.status, "there is no submission; they end in .json" in outcome.err) == (2, True)
