"""Files that people sent to the organiser: scored, counted and answered as uploads are."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import timedelta
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text

from reverie_eval.reporting.service import METHOD_FLAGS
from reverie_eval.schemas.organising import EmailedFile, EmailedFileReport
from reverie_eval.schemas.service import Method
from reverie_eval.server.audit.log import entries
from reverie_eval.server.errors import MalformedError, NotFoundError, RequestError
from reverie_eval.server.intake.intake import submit_for_sender
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.scoring.boards import Board
from tests.support.acting import NOON
from tests.support.flat_world import Outcome, Run
from tests.support.processes import Laptop
from tests.support.serving import (
    BROKEN,
    GOOD,
    GROUNDING,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    STRICT,
    OpenServer,
    Serving,
    settings_of,
    submission_for,
)
from tests.support.signing import receipt_in
from tests.support.visiting import said, signed_in

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


def test_a_withdrawn_file_that_comes_again_is_answered_and_stays_withdrawn(
    office: Office, mailed: Path
) -> None:
    office.submit(mailed / "first.json", "--publish")
    (known,) = office.submissions()
    path = f"/submissions/{known['id']}"
    assert office.server.ask(OWNER, "PATCH", path, json={"withdrawn": True}).status_code == 200
    again = office.submit(mailed / "first.json", "--publish")
    assert (again.status, "was scored on val_unseen" in again.out) == (0, True)
    assert office.submissions()[0]["status"] == "withdrawn"


def test_publishing_names_an_upload_that_is_damaged(office: Office, mailed: Path) -> None:
    office.submit(mailed / "first.json")
    (upload,) = (office.folder / "uploads").rglob("*.json.gz")
    upload.write_bytes(upload.read_bytes()[:-20])
    told = office.submit(mailed / "first.json", "--publish").err
    sha256 = upload.name.partition(".")[0]
    assert f"the upload {sha256} cannot be read" in told
    assert "run `reverie-eval server doctor`" in told


def test_what_is_logged_meanwhile_is_a_note_without_a_traceback(
    office: Office, mailed: Path
) -> None:
    trigger = "CREATE TRIGGER full BEFORE INSERT ON attempt BEGIN SELECT RAISE(ABORT, 'full'); END"
    with office.server.state.database.writing() as session:
        session.execute(text(trigger))
    alone = replace(office, run=Laptop(mailed, is_real=True).run)
    note, *_ = alone.submit(mailed / "first.json").err.splitlines()
    assert note == "note: upload not recorded: (sqlite3.IntegrityError) full"


def test_each_file_is_scored_and_answered(office: Office, mailed: Path) -> None:
    outcome = office.submit(mailed, "--publish")
    assert outcome.status == 1, "one was refused"
    replies = outcome.out.split("-" * 72)
    assert [reply.strip().splitlines()[0] for reply in replies] == [f"Dear {TEAM},"] * 3
    first, second, third = replies
    assert f"Your file first.json, received 2026-03-02 12:00:00 UTC, was scored on {OPEN}." in first
    assert "RGSPL" in first
    assert "submissions left on val_unseen: 200" in first
    assert "The signed receipt is attached." in first
    assert outcome.err.splitlines() == [
        f"note: attach {mailed / name}.receipt.json" for name in ("first.json", "third.json")
    ]
    assert "was not scored, and no submission was used" in second
    assert "[1]" in second
    assert "submissions left on val_unseen: 200" in third
    found = office.submissions()
    assert {(each["team"], each["person"], each["status"]) for each in found} == {
        (TEAM, OWNER, "published")
    }
    assert {each["received_at"] for each in found} == {WHEN}
    assert [each for each in examine(office.folder) if each.kind == "fault"] == []


def test_a_run_is_described_by_its_card(office: Office, tmp_path: Path) -> None:
    walker = tmp_path / "walker"
    assert office.run("run", "stop", "--split", OPEN, "-o", str(walker)).status == 0
    assert office.submit(walker).status == 0
    (method,) = (each["method"] for each in office.submissions())
    assert (method["name"], method["input_class"]) == ("stop", "geometry")
    assert method["actions_per_episode"] == 1


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
    told = "ignored, because the first upload said otherwise: received at; answer this message"
    assert told in again.out
    assert "not published: answer this message if you want it on the leaderboard" in again.out
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
    assert (outcome.status, "submissions end in .json" in outcome.err) == (2, True)


def test_the_letter_about_a_scored_file(several: Serving) -> None:
    report = emailed(several, GOOD, publish=True)
    submission = report.submission
    assert (submission.status, submission.received_at, submission.person) == (
        *("published", NOON),
        OWNER,
    )
    signature = several.state.board(OPEN).signature
    rules = "ground truth: the synthetic demo world, not REVERIE"
    full = "TL m   SR %  OSR %  SPL %  RGS %  RGSPL %\n9.84  80.95  88.10  72.88"
    grounding, paper = (several.state.board(OPEN, name).signature for name in (GROUNDING, STRICT))
    assert report.reply.startswith(
        "Dear Blue,\n\n"
        "Your file answers.json, received 2026-03-02 12:00:00 UTC, was scored on val_unseen.\n\n"
        f"{full}  65.48    57.22\n\n{signature}\n{rules}\n\n"
        f"On the leaderboard grounding:\nRGS %\n65.48\n\n{grounding}\n{rules}\n\n"
        f"On the leaderboard strict:\n{full}  64.29    56.21\n\n{paper}\n{rules}\n\n"
        f"submission {submission.id} of Blue: Walker, received 2026-03-02 12:00:00 UTC\n"
        "published\n"
        "submissions left on val_unseen: 199\n"
    )
    assert report.reply.endswith(" UTC\n\nThe signed receipts are attached.")
    again = emailed(several, GOOD)
    assert (again.is_repeat, again.submission) == (True, submission)
    assert "\nthis file was already scored; no submission was used\npublished\n" in again.reply


def test_the_letter_says_what_is_left_today_and_the_receipt_what_was_left_then(
    server: Serving,
) -> None:
    server.upload(OWNER, server.distinct(PRIVATE), PRIVATE)
    server.clock.turn(days=3)
    report = emailed(server, server.distinct(PRIVATE), split=PRIVATE)
    receipt = receipt_in(report.submission.receipt)
    assert (
        "submissions left on test: 2\n"
        "  2 of 2 per 24 hours\n"
        "  8 of 10 per 30 days; one more at 2026-04-01 12:00:00 UTC\n"
    ) in report.reply
    assert report.quota.remaining == 2
    assert (receipt.received_at, receipt.quota.remaining) == (NOON, 0)
    assert (receipt.quota.next_at or NOON) - NOON == timedelta(days=1)


def test_the_letter_about_a_file_with_mistakes(server: Serving) -> None:
    with pytest.raises(RequestError) as refused:
        emailed(server, b"[{}]", filename="")
    assert refused.value.reply == (
        "Dear Blue,\n\n"
        "Your file, received 2026-03-02 12:00:00 UTC, was not scored, and no submission was "
        "used.\n\n"
        "submission rejected, 3 problems\n"
        "file: has no prediction for any of the 84 episodes of val_unseen; each needs one\n"
        "[0]: has no instr_id; add it\n"
        "[0]: has no trajectory; add it\n\n"
        "`reverie-eval validate` finds the same problems before you send a file."
    )


def test_the_letter_about_a_closed_split(server: Serving) -> None:
    closed = {"phases": [{"name": "a", "closes": "2026-03-02T11:00:00Z"}]}
    body = {**closed, "release_scores": "at-once"}
    server.ask(ORGANISER, "PUT", f"/organiser/schedules/{OPEN}", json=body).raise_for_status()
    with pytest.raises(RequestError) as refused:
        emailed(server, GOOD)
    assert (refused.value.reply or "").splitlines()[-1] == (
        "val_unseen accepts no submissions now; the last phase closed "
        "2026-03-02T11:00:00+00:00, and this file arrived 2026-03-02T12:00:00.000000+00:00"
    )


def test_a_file_from_the_future_says_what_to_give(server: Serving) -> None:
    later = NOON + timedelta(seconds=1)
    with pytest.raises(MalformedError) as refused:
        emailed(server, GOOD, received_at=later)
    assert str(refused.value) == (
        "the file was received at 2026-03-02 12:00:01 UTC, which is in the future; give the time "
        "at which the e-mail arrived"
    )
    assert refused.value.reply is None
    server.clock.now = later
    assert emailed(server, GOOD, received_at=later).submission.status == "unpublished"


def test_our_own_fault_is_no_letter(server: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise NotFoundError("gone")

    monkeypatch.setattr(Board, "read", fail)
    with pytest.raises(NotFoundError) as refused:
        emailed(server, GOOD)
    assert refused.value.reply is None


# The other doors: the API and the desk.


EVERYTHING: Mapping[str, Any] = {
    **{key: ["false", "true"] for key in METHOD_FLAGS},
    **dict.fromkeys(("paper", "code"), "https://example.org/"),
    "description": "It walks.",
    "publish": "true",
}
"""All that browsers send if every field is filled in: as many fields as a form may have."""


@pytest.mark.parametrize(("content", "status"), [(GOOD, 200), (BROKEN, 422)], ids=["good", "bad"])
def test_every_door_gives_the_same_reply(
    content: bytes, status: int, office: Office, tmp_path: Path
) -> None:
    file = tmp_path / "answers.json"
    file.write_bytes(content)
    office.submit(file, "--publish")  # so that the good one is a repeat at every door
    by_api = sent_to_the_api(office.server, file=("answers.json", content))
    reply = by_api.json()["reply"]
    assert by_api.status_code == status
    at_desk = sent_to_the_desk(office.server, content)
    shown = re.search(r'<code id="reply">(.*?)</code>', at_desk.text, re.DOTALL)
    assert shown is not None
    assert (at_desk.status_code, unescape(shown[1])) == (status, reply)
    assert at_desk.text.count("<tr><td><code>") == len(by_api.json().get("problems", []))
    by_command, is_scored, _ = office.submit(file).out.partition("submissions left")
    assert (by_command.rstrip("\n"), bool(is_scored)) == (
        re.sub(r"ignored, .*\n", "", reply).partition("submissions left")[0].rstrip("\n"),
        status == 200,
    )  # the others describe the method otherwise, which is ignored


def test_the_audit_log_names_the_organiser_who_was_signed_in(server: Serving) -> None:
    scored = sent_to_the_api(server, content=GOOD, publish="true")
    assert scored.status_code == 201, scored.text
    assert scored.json()["submission"]["status"] == "published"
    assert scored.json()["submission"]["received_at"] == WHEN
    assert scored.json()["reply"].startswith(
        "Dear Blue,\n\nYour file, received 2026-03-02 12:00:00 UTC, was scored on val_unseen.\n"
    )
    *_, submitted, published = server.ask(ORGANISER, "GET", "/organiser/audit").json()
    assert (submitted["action"], published["action"]) == ("submitted", "changed")
    assert {submitted["actor"], published["actor"]} == {ORGANISER}
    assert server.ask(OWNER, "GET", "/submissions").json()[0]["person"] == OWNER


WRONG = {
    "a time without a zone": ({"received_at": "2026-03-02T12:00"}, 400, "with its time zone"),
    "a time to come": ({"received_at": "2999-01-01T00:00:00Z"}, 400, "which is in the future"),
    "another split": ({"split": "tset"}, 404, "is no split 'tset'"),
    "a method without a name": ({"name": ""}, 400, "required but missing"),
}


@pytest.mark.parametrize(("change", "status", "told"), WRONG.values(), ids=WRONG)
def test_wrong_fields_are_named_and_nothing_is_submitted(
    change: Mapping[str, str], status: int, told: str, server: Serving
) -> None:
    by_api = sent_to_the_api(server, content=GOOD, **change)
    assert (by_api.status_code, told in by_api.text) == (status, True), by_api.text
    at_desk = sent_to_the_desk(server, GOOD, **change)
    assert (at_desk.status_code, told in unescape(at_desk.text)) == (status, True)
    assert server.ask(ORGANISER, "GET", "/submissions").json() == []


def test_a_file_of_an_organiser_is_no_larger_than_others(
    open_server: OpenServer, folder: Path
) -> None:
    settings = settings_of(folder)
    limits = settings.limits.model_copy(update={"upload_mebibytes": 1})
    server = open_server(settings.model_copy(update={"limits": limits}))
    large = GOOD + b" " * (1 << 20)
    by_api = sent_to_the_api(server, content=large)
    assert (by_api.status_code, by_api.json()["code"]) == (413, "too-large")
    assert sent_to_the_desk(server, large + b" " * (64 << 10)).status_code == 413


def test_the_desk_asks_for_the_sender(server: Serving) -> None:
    nobody = sent_to_the_desk(server, GOOD, person="")
    assert (nobody.status_code, "Choose the person who sent the file." in said(nobody)) == (
        400,
        True,
    )
    assert "Walker" in nobody.text  # what was typed stays


def sent_to_the_api(server: Serving, *, content: bytes | None = None, **more: Any) -> Any:
    """Send a file of the owner's as the organiser, as a body or in a form."""
    files = {"file": more.pop("file")} if "file" in more else None
    given = {"split": OPEN, "team": TEAM, "person": OWNER, "received_at": WHEN, "name": "Walker"}
    fields = {**given, **more}
    place = {"data": fields, "files": files} if files else {"content": content, "params": fields}
    return server.ask(ORGANISER, "POST", "/organiser/submissions", **place)


def sent_to_the_desk(server: Serving, content: bytes, **more: Any) -> Any:
    """Send a file of the owner's with the form of the desk."""
    given = {"split": OPEN, "person": "1", "received_at": WHEN, "name": "Walker"}
    return signed_in(server, ORGANISER).send("/desk/emailed-files", {**given, **more}, file=content)


def emailed(
    server: Serving, content: bytes, filename: str = "answers.json", **changes: Any
) -> EmailedFileReport:
    """Submit a file of the owner's without a request."""
    about = {"split": OPEN, "team": TEAM, "person": OWNER, "received_at": NOON, "publish": False}
    file = EmailedFile.model_validate({**about, **changes})
    method = Method(name="Walker")
    return submit_for_sender(server.state, ORGANISER, file, content, method, filename=filename)
