"""Submissions: the server scores as the laptop does, keeps what it accepts, and answers repeats."""

import gzip
import hashlib
import io
import json
import re
import subprocess
import sys
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest
from sqlalchemy import select

from reverie_eval import CATALOGUE, SubmissionError, evaluate, validate
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.schemas.organising import NewNotice
from reverie_eval.schemas.service import Phase
from reverie_eval.server.audit.log import entries
from reverie_eval.server.boards.reviews import lift_review
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.intake.submissions import publication, result_on, submission_of
from reverie_eval.server.messages.notices import post_notice
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import Webhook
from reverie_eval.server.state import Reading
from reverie_eval.server.store.tables import Message
from tests.conftest import SAMPLES
from tests.support.acting import NOON, review
from tests.support.flat_world import Run
from tests.support.serving import (
    BROKEN,
    GOOD,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    broken_private,
    settings_of,
    submission_for,
)
from tests.support.signing import receipt_in

SECRET_BUNDLE = DEMO_BUNDLES / "private" / f"{PRIVATE}.npz"
HOUR = timedelta(hours=1)
HEADLINE = ["path_length", "success", "oracle_success", "spl", "rgs", "rgspl"]


def zipped(content: bytes) -> bytes:
    archive = io.BytesIO()
    with ZipFile(archive, "w") as file:
        file.writestr("submit.json", content)
    return archive.getvalue()


def on_the_command_line(file: Path, *options: str) -> str:
    command = [sys.executable, "-m", "reverie_eval_cli", str(file), *options]
    return subprocess.check_output(command, text=True)


def accepted(server: Serving, content: bytes, split: str = OPEN, **said: str) -> dict[str, Any]:
    reply = server.upload(OWNER, content, split, **said)
    assert reply.status_code == 201, reply.text
    submission: dict[str, Any] = reply.json()["submission"]
    return submission


@pytest.mark.parametrize("sample", ["good", "mediocre", "drawn"])
def test_on_an_open_split_the_server_says_what_the_laptop_says(
    server: Serving, sample: str, tmp_path: Path
) -> None:
    file = SAMPLES / f"{sample}.json"
    submission = accepted(server, file.read_bytes())
    printed = on_the_command_line(file, "--split", OPEN, "--format", "json")
    in_python = evaluate(file, split=OPEN).to_report().model_dump(mode="json")
    assert submission["report"] == json.loads(printed) == in_python
    table = tmp_path / "episodes.csv"
    on_the_command_line(file, "--split", OPEN, "--episodes", str(table))
    kept = server.ask(OWNER, "GET", f"/submissions/{submission['id']}/episodes")
    assert kept.content == table.read_bytes()


@pytest.mark.parametrize("agent", ["random", "shortest", "stop"])
def test_on_a_private_split_it_says_the_headline_of_it_rounded(
    server: Serving, agent: str, tmp_path: Path
) -> None:
    file = tmp_path / "submit.json"
    file.write_bytes(submission_for(PRIVATE, agent))
    report = accepted(server, file.read_bytes(), PRIVATE)["report"]
    options = "--split", PRIVATE, "--ground-truth", str(SECRET_BUNDLE), "--format", "json"
    printed = json.loads(on_the_command_line(file, *options))
    exact = evaluate(file, split=PRIVATE, ground_truth=SECRET_BUNDLE)
    assert printed == exact.to_report().model_dump(mode="json")
    assert list(report["scores"]) == HEADLINE
    assert {key: f"{report['scores'][key]:.9f}" for key in HEADLINE} == {
        key: f"{round(exact[key], 2 if key == 'path_length' else 4):.9f}" for key in HEADLINE
    }
    as_printed = {key: CATALOGUE[key].display(exact[key]) for key in HEADLINE}
    assert {key: CATALOGUE[key].display(report["scores"][key]) for key in HEADLINE} == as_printed
    checked = validate(file, split=PRIVATE, ground_truth=SECRET_BUNDLE)
    assert report["notes"] == checked.notes  # without using the solution
    assert {**printed, "scores": 0, "notes": 0} == {**report, "scores": 0, "notes": 0}


@pytest.mark.parametrize(
    ("pack", "sent_as"),
    [
        pytest.param(bytes, "application/json", id="plain"),
        pytest.param(gzip.compress, "application/gzip", id="gzip"),
        pytest.param(zipped, "application/zip", id="zip"),
        pytest.param(zipped, "application/json", id="zip that is called JSON"),
        pytest.param(gzip.compress, None, id="gzip that is called nothing"),
    ],
)
def test_a_file_is_the_same_however_it_is_packed(
    server: Serving, pack: Callable[[bytes], bytes], sent_as: str | None
) -> None:
    first = accepted(server, GOOD)
    headers = {"Content-Type": sent_as} if sent_as else {}
    path, said = f"/splits/{OPEN}/submissions", {"name": "Walker"}
    again = server.ask(OWNER, "POST", path, content=pack(GOOD), params=said, headers=headers)
    assert (again.status_code, again.json()["is_repeat"]) == (200, True)
    assert again.json()["submission"] == first
    assert server.ask(OWNER, "GET", f"/submissions/{first['id']}/file").content == GOOD


def test_json_lines_are_read_at_every_door(server: Serving, run: Run, tmp_path: Path) -> None:
    content = b"\n".join(json.dumps(record).encode() for record in json.loads(GOOD))
    path = f"/splits/{OPEN}/validate"
    assert server.ask(OWNER, "POST", path, content=content).status_code == 200
    expected = evaluate(GOOD, split=OPEN).to_report().model_dump(mode="json")
    assert accepted(server, content)["report"] == expected
    file = tmp_path / "lines.jsonl"
    file.write_bytes(content)
    assert run("validate", str(file), "--split", OPEN).status == 0
    scored = run(str(tmp_path), "--split", OPEN, "--format", "json").out  # found in a folder
    assert json.loads(scored) == {str(file): expected}


REPEATS: list[tuple[dict[str, str], list[str]]] = [
    ({"name": "Walker"}, []),
    ({"name": "Walker", "paper": "https://example.org/paper"}, []),
    ({"name": "Runner"}, ["name"]),
    ({"name": "Walker", "extra_data": "true", "code": "https://b.org/"}, ["code", "extra_data"]),
    ({"name": "Walker", "ensemble": "false"}, ["ensemble"]),
]


@pytest.mark.parametrize(("method", "ignored"), REPEATS)
def test_a_repeat_says_what_it_ignores(
    server: Serving, method: dict[str, str], ignored: list[str]
) -> None:
    first = server.upload(OWNER, GOOD, paper="https://example.org/paper").json()
    assert (first["is_repeat"], first["ignored"]) == (False, [])
    path = f"/splits/{OPEN}/submissions"
    again = server.ask(OWNER, "POST", path, content=GOOD, params=method).json()
    assert (again["is_repeat"], again["ignored"]) == (True, ignored)
    assert again["submission"] == first["submission"]


@pytest.mark.parametrize("pack", [bytes, gzip.compress, zipped], ids=["plain", "gzip", "zip"])
def test_a_form_says_the_same_as_the_query(server: Serving, pack: Callable[[bytes], bytes]) -> None:
    said = {"name": "Walker", "description": "walks", "extra_data": "true", "paper": ""}
    files = {"file": ("submit.json", pack(GOOD))}
    sent = server.ask(OWNER, "POST", f"/splits/{OPEN}/submissions", data=said, files=files)
    assert sent.status_code == 201, sent.text
    submission = sent.json()["submission"]
    assert submission["method"]["description"] == "walks"
    assert submission["method"]["extra_data"] is True
    assert submission["method"]["paper"] is None
    again = server.upload(OWNER, GOOD)
    assert again.json()["submission"] == submission


@pytest.mark.parametrize(
    ("split", "content"),
    [
        pytest.param(OPEN, BROKEN, id="open"),
        pytest.param(PRIVATE, broken_private(), id="private"),
        pytest.param(OPEN, submission_for(PRIVATE), id="another split's"),
        pytest.param(OPEN, b"[", id="no JSON"),
        pytest.param(OPEN, gzip.compress(gzip.compress(GOOD)), id="gzipped twice"),
        pytest.param(OPEN, gzip.compress(zipped(GOOD)), id="gzipped zip"),
        pytest.param(OPEN, zipped(GOOD)[:-30], id="damaged"),
    ],
)
def test_a_broken_file_gets_all_problems_at_once_as_at_home(
    server: Serving, split: str, content: bytes
) -> None:
    public = DEMO_BUNDLES / f"{split}{'.public' if split == PRIVATE else ''}.npz"
    with pytest.raises(SubmissionError) as rejected:
        validate(content, split=split, ground_truth=public)
    at_home = [
        {"code": each.code, "where": each.where, "message": each.message}
        | ({"split": each.split} if each.split else {})
        for each in rejected.value.problems
    ]
    for path in ("submissions", "validate"):
        reply = server.ask(
            OWNER, "POST", f"/splits/{split}/{path}", content=content, params={"name": "Walker"}
        )
        assert (reply.status_code, reply.json()["code"]) == (422, "submission-rejected")
        assert reply.json()["problems"] == at_home


def test_validating_says_what_the_laptop_says(server: Serving) -> None:
    file = SAMPLES / "drawn.json"
    reply = server.ask(OWNER, "POST", f"/splits/{OPEN}/validate", content=file.read_bytes())
    public = DEMO_BUNDLES / f"{PRIVATE}.public.npz"
    assert reply.json()["notes"]
    assert reply.json()["valid"] is True
    sent = submission_for(PRIVATE, "stop")
    private = server.ask(OWNER, "POST", f"/splits/{PRIVATE}/validate", content=sent)
    at_home = validate(sent, split=PRIVATE, ground_truth=public)
    assert private.json()["notes"] == list(at_home.notes)


def test_who_arrives_in_time_is_in_time_however_long_scoring_takes(
    open_server: OpenServer, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closing = Phase(name="spring", closes=NOON + timedelta(minutes=1))
    server = open_server(adjusted(settings_of(folder), OPEN, phases=(closing,)))
    score = Board.score

    def score_slowly(board: Board, reading: Any) -> Any:
        server.clock.turn(hours=1)
        notice = {"banner": "", "paused": True}
        server.ask(ORGANISER, "PUT", "/organiser/notice", json=notice).raise_for_status()
        return score(board, reading)

    monkeypatch.setattr(Board, "score", score_slowly)
    submission = accepted(server, GOOD)
    assert submission["received_at"] == f"{NOON:%FT%TZ}"
    assert receipt_in(submission["receipt"]).received_at == NOON
    assert server.upload(OWNER, server.distinct()).json()["code"] == "not-open"


def test_an_accepted_file_is_logged_and_announced(open_server: OpenServer, folder: Path) -> None:
    hook = Webhook.model_validate({"url": "https://example.org", "events": ["submission"]})
    server = open_server(settings_of(folder).model_copy(update={"webhook": hook}))
    number = accepted(server, GOOD)["id"]
    assert re.fullmatch("[0-9a-f]{16}", number)
    with server.state.database.reading() as session:
        *_, logged = entries(session)
        told = session.scalars(select(Message)).one()
    digest = hashlib.sha256(GOOD).hexdigest()
    assert (logged.action, logged.subject) == ("submitted", number)
    method = {"name": "Walker"}
    assert logged.details == {"split": OPEN, "sha256": digest, "method": method}
    assert (told.event, told.path) == ("submission", f"/submissions/{number}")
    assert told.text == f"Blue ({OWNER}) submitted Walker to {OPEN}"


@pytest.mark.parametrize(
    ("phases", "paused", "banner", "detail"),
    [
        pytest.param([], True, "", "the organiser has paused submissions", id="a pause"),
        pytest.param(
            [], True, "Soon.", "the organiser has paused submissions: Soon.", id="a pause and why"
        ),
        pytest.param(
            [("a", NOON - 2 * HOUR, NOON - HOUR)],
            False,
            "Soon.",
            "val_unseen accepts no submissions now; the last phase closed "
            "2026-03-02T11:00:00+00:00, and this file arrived 2026-03-02T12:00:00.000000+00:00",
            id="over",
        ),
        pytest.param(
            [("a", NOON + 2 * HOUR, None), ("b", NOON + HOUR, None)],
            False,
            "",
            "val_unseen accepts no submissions now; the next phase opens 2026-03-02T13:00:00+00:00",
            id="before two",
        ),
    ],
)
def test_a_closed_split_says_why(
    phases: list[tuple[str, datetime, datetime | None]],
    banner: str,
    detail: str,
    open_server: OpenServer,
    folder: Path,
    *,
    paused: bool,
) -> None:
    given = [Phase(name=name, opens=opens, closes=closes) for name, opens, closes in phases]
    settings = settings_of(folder)
    server = open_server(adjusted(settings, OPEN, phases=given or settings.splits[OPEN].phases))
    with server.acting() as transaction:
        post_notice(transaction, NewNotice(banner=banner, paused=paused))
    reply = server.upload(OWNER)
    assert (reply.status_code, reply.json()["detail"]) == (409, detail)


def test_a_change_of_nothing_is_none(server: Serving) -> None:
    submission = accepted(server, GOOD)
    reply = server.ask(OWNER, "PATCH", f"/submissions/{submission['id']}", json={})
    assert reply.json() == submission
    with server.state.database.reading() as session:
        assert "changed" not in {entry.action for entry in entries(session)}


@pytest.mark.parametrize(
    ("route", "content", "headers", "status"),
    [
        pytest.param("submissions", BROKEN, {}, 422, id="rejected"),
        pytest.param("validate", BROKEN, {}, 422, id="checked and rejected"),
        pytest.param("validate", GOOD, {}, 200, id="checked"),
        pytest.param("submissions", GOOD, {"Idempotency-Key": ""}, 400, id="malformed"),
        pytest.param("submissions", b" " + GOOD, {"Idempotency-Key": "a"}, 409, id="conflict"),
        pytest.param("submissions", GOOD, {}, 200, id="repeat"),
    ],
)
def test_every_reply_to_a_file_says_what_is_left(
    server: Serving, route: str, content: bytes, headers: dict[str, str], status: int
) -> None:
    server.upload(OWNER, key="a")
    path = f"/splits/{OPEN}/{route}?name=Walker"
    reply = server.ask(OWNER, "POST", path, content=content, headers=headers)
    quota = reply.json()["quota"]
    assert (reply.status_code, quota["remaining"]) == (status, 199)
    day = quota["windows"][0]
    assert (day["remaining"], day["resets_at"]) == (199, "2026-03-03T12:00:00Z")


def test_a_split_that_is_none_has_no_quota(server: Serving) -> None:
    reply = server.upload(OWNER, split="none")
    assert (reply.status_code, reply.json()["quota"]) == (404, None)


def test_what_is_refused_of_a_stored_submission_says_why(
    open_server: OpenServer, folder: Path
) -> None:
    settings = settings_of(folder).model_copy(update={"required_metadata": ("code", "paper")})
    server = open_server(settings)
    links = {"code": "https://example.org/code", "paper": "https://example.org/paper"}
    mine, private = (
        accepted(server, server.distinct(split), split, **links)["id"] for split in (OPEN, PRIVATE)
    )
    theirs = "0123456789abcdef"

    def refused(submission: str, who: str = OWNER, **change: object) -> tuple[int, str]:
        reply = server.ask(who, "PATCH", f"/submissions/{submission}", json=change)
        return reply.status_code, reply.json()["detail"]

    def missing(submission: str) -> tuple[int, str]:
        return 404, f"your team has no submission {submission!r}"

    assert refused(theirs, published=True) == missing(theirs)
    assert refused(mine, OTHER, published=True) == missing(mine)
    assert refused(private, shows_episodes=True) == (
        409,
        "episodes of private splits are never shown to anyone",
    )
    assert refused(mine, method={"code": None, "paper": None}) == (
        400,
        "required information about the method is missing: code, paper",
    )
    assert refused(mine, method={"navigation_only": True}) == (
        409,
        "whether a submission is navigation only follows from its file, and cannot be changed",
    )
    reply = server.ask(OWNER, "GET", f"/submissions/{private}/episodes")
    assert reply.json()["detail"] == "per-episode values of private splits are never released"
    with server.acting() as transaction:
        disqualified = review(transaction, private, "disqualified")
    told = (
        "the organiser has disqualified this submission; until the review is lifted, it cannot be "
        "unpublished or withdrawn"
    )
    assert refused(private, withdrawn=True) == refused(private, published=False) == (409, told)
    with server.acting() as transaction:
        lift_review(transaction, disqualified.id)
    server.ask(OWNER, "PATCH", f"/submissions/{private}", json={"withdrawn": True})
    assert refused(private, published=True) == (
        409,
        "a withdrawn submission cannot be published; restore it first",
    )
    assert server.ask(OWNER, "GET", f"/submissions/{mine}").json()["status"] == "unpublished"


def test_what_has_no_result_or_is_not_published_says_so(server: Serving) -> None:
    submission = server.upload(OWNER).json()["submission"]["id"]
    with server.state.database.reading() as session:
        view = View.of(Reading(server.state, session, NOON))
        own = submission_of(session, server.person(OWNER), submission, view)
        with pytest.raises(NotFoundError) as none_here:
            result_on("strict", own)
        with pytest.raises(NotFoundError) as not_published:
            publication(session, submission, view)
    assert str(none_here.value) == (
        f"{submission} has no result on a leaderboard 'strict'; it has results on: none"
    )
    told = "nothing is published here; sign in if it is a submission of your team"
    assert str(not_published.value) == told


def test_times_of_publishing_and_withdrawing_are_those_of_the_first_time(server: Serving) -> None:
    path = f"/submissions/{server.upload(OWNER).json()['submission']['id']}"

    def times(**change: object) -> tuple[str | None, str | None]:
        server.clock.turn(hours=1)
        seen = server.ask(OWNER, "PATCH", path, json=change).json()
        return seen["published_at"], seen["withdrawn_at"]

    one, three, seven = (f"2026-03-02T{12 + hours}:00:00Z" for hours in (1, 3, 7))
    assert times(published=True) == times(published=True) == (one, None)
    assert times(withdrawn=True) == times(withdrawn=True) == (one, three)
    assert times(withdrawn=False) == (one, None)
    assert times(published=False) == (None, None)
    assert times(published=True) == (seven, None)
