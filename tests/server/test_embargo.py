"""Scores that are held back until a phase ends: nobody sees them before, and everybody after."""

import json
from datetime import timedelta
from pathlib import Path

import pytest
from pydantic import ValidationError

from reverie_eval.receipts import verify
from reverie_eval.schemas.organising import EmailedFile
from reverie_eval.schemas.service import Envelope, Method, Phase
from reverie_eval.server.boards.reviews import any_submission
from reverie_eval.server.boards.schedules import Schedules, View
from reverie_eval.server.intake.intake import submit_for_sender
from reverie_eval.server.intake.submissions import publication
from reverie_eval.server.settings import Split
from reverie_eval.server.state import Reading
from tests.support.acting import NOON
from tests.support.serving import (
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
    submission_for,
)
from tests.support.signing import payloads_in, receipt_in
from tests.support.visiting import said, signed_in

CLOSES = NOON + timedelta(days=1)
PHASES = (
    Phase(name="first", closes=CLOSES),
    Phase(name="second", opens=CLOSES + timedelta(days=9), closes=CLOSES + timedelta(days=19)),
)
SENTENCE = "Scores are published when the phase ends on 2026-03-03 12:00 UTC."


@pytest.fixture
def held(folder: Path, open_server: OpenServer) -> Serving:
    """Return a server that holds scores back."""
    return open_server(adjusted(settings_of(folder), phases=PHASES, release_scores="phase-end"))


def submit(server: Serving) -> str:
    """Submit to the private split and publish it; return its id."""
    reply = server.upload(OWNER, submission_for(PRIVATE), PRIVATE)
    assert reply.status_code == 201
    submission: str = reply.json()["submission"]["id"]
    published = {"published": True}
    assert server.ask(OWNER, "PATCH", f"/submissions/{submission}", json=published).is_success
    return submission


def everything(server: Serving, submission: str) -> dict[str, str]:
    """Return whatever is told of a submission, by who asks for what."""
    api = [
        (who, f"/api/v1{path}")
        for who in (OWNER, ORGANISER)
        for path in (
            "/submissions",
            f"/submissions/{submission}",
            f"/submissions/{submission}/receipt",
            "/organiser/audit" if who == ORGANISER else "/me",
            "/organiser/attempts" if who == ORGANISER else "/me",
        )
    ]
    board = [
        f"/splits/{PRIVATE}{path}" for path in ("", "/chart", "/latex", "/bibtex", "/feed.atom")
    ]
    public = [
        *(f"/api/v1/splits/{PRIVATE}/leaderboard{kind}" for kind in ("", ".csv")),
        *board,
        f"/submissions/{submission}",
    ]
    pages = [f"/submissions/{submission}", "/team", f"/splits/{PRIVATE}"]
    told = {}
    for who, path in api:
        headers = {"Authorization": f"Bearer {server.tokens[who]}"}
        told[f"{who} {path}"] = unwrapped(server.client.get(path, headers=headers).text)
    for path in public:
        told[path] = server.client.get(path).text
    for who in (OWNER, OTHER, ORGANISER):
        visitor = signed_in(server, who)
        desk = [f"/desk/reviews?submission={submission}", "/desk"] if who == ORGANISER else []
        told |= {f"{who} page {path}": visitor.get(path).text for path in (*pages, *desk)}
    again = server.upload(OWNER, submission_for(PRIVATE), PRIVATE)
    return told | {"the same file": unwrapped(again.text)}


def unwrapped(text: str) -> str:
    """Return a reply, and what is signed in it as plain text besides."""
    return "\n".join([text, *payloads_in(text)])


def secrets_of(server: Serving) -> set[str]:
    """Return how the scores are written that nobody may see."""
    board = server.state.boards[PRIVATE]
    reading = board.read(submission_for(PRIVATE))
    scores = board.report(board.score(reading), reading).scores
    told = [scores[key] for key in ("success", "oracle_success", "spl") if scores[key]]
    assert told
    return {f"{100 * value:.2f}" for value in told} | {json.dumps(value) for value in told}


def test_nobody_sees_a_score_before_the_phase_ends_and_everybody_after(
    held: Serving,
) -> None:
    submission, secrets = submit(held), secrets_of(held)

    def telling() -> set[str]:
        told = everything(held, submission)
        return {name for name, text in told.items() if any(each in text for each in secrets)}

    assert telling() == set()
    held.clock.now = CLOSES
    assert telling() == set(), "the last second of the phase is a part of it"
    held.clock.turn(seconds=1)
    assert {
        f"Ada /api/v1/submissions/{submission}/receipt",
        f"/api/v1/splits/{PRIVATE}/leaderboard",
        f"/splits/{PRIVATE}",
        f"Ada page /submissions/{submission}",
        "the same file",
    } <= telling()


def test_it_is_said_when_scores_are_published(held: Serving) -> None:
    submission = submit(held)
    told = held.ask(OWNER, "GET", f"/submissions/{submission}").json()
    assert told["scores_held_until"] == "2026-03-03T12:00:00Z"
    assert told["report"]["scores"] == receipt_in(told["receipt"]).scores == {}
    for who in (OWNER, ORGANISER):
        assert SENTENCE in said(signed_in(held, who).get(f"/submissions/{submission}"))
    assert SENTENCE in said(held.client.get(f"/submissions/{submission}"))
    board = said(held.client.get(f"/splits/{PRIVATE}"))
    assert "1 result here has no scores yet" in board
    assert "when the phase ends on 2026-03-03 12:00 UTC" in board


def test_a_receipt_without_scores_is_genuine_and_so_is_the_later_one(held: Serving) -> None:
    submission, receipts = submit(held), []
    for _ in range(2):
        told = held.ask(OWNER, "GET", f"/submissions/{submission}/receipt").json()
        receipts.append(Envelope.model_validate(told))
        held.clock.now = CLOSES + timedelta(seconds=1)
    for receipt in receipts:
        verify(receipt, held.state.signer.public_pem)
    first, later = map(receipt_in, receipts)
    assert first.scores == {}
    assert later.scores["success"] > 0
    assert first == later.model_copy(update={"scores": {}})


def test_what_was_released_or_is_of_a_split_that_is_gone_keeps_its_scores(held: Serving) -> None:
    submission = submit(held)
    with held.state.database.reading() as session:
        row = any_submission(session, submission)
        timetables, signer = held.state.get(Schedules).read(session), held.state.signer
        view = View(timetables, signer, CLOSES)
        assert view.score_report(row).scores == {}
        after = View(timetables, signer, CLOSES + timedelta(seconds=1))
        assert after.score_report(row).scores["success"] > 0
        row.split = "gone"
        assert view.held_until(row) is None


def test_everyone_sees_a_result_without_scores_and_earlier_ones(held: Serving) -> None:
    submission = submit(held)
    with held.state.database.writing() as session:
        row = any_submission(session, submission)
        about = {"report": row.report, "receipt": row.receipt, "reason": "corrected"}
        row.earlier = [{**about, "replaced_at": f"{NOON:%FT%TZ}"}]
    seen = []
    for now in (CLOSES, CLOSES + timedelta(seconds=1)):
        with held.state.database.reading() as session:
            view = View.of(Reading(held.state, session, now))
            shown = publication(session, submission, view)
        seen.append((shown.scores_held_until, bool(shown.report.scores), len(shown.earlier)))
    assert seen == [(CLOSES, False, 0), (None, True, 1)]
    told = held.ask(OWNER, "PATCH", f"/submissions/{submission}", json={}).json()
    assert (told["report"]["scores"], told["earlier"]) == ({}, [])


def test_a_later_phase_holds_back_its_own_submissions_alone(held: Serving) -> None:
    submit(held)
    held.clock.now = CLOSES + timedelta(days=10)
    held.upload(OWNER, submission_for(PRIVATE) + b" ", PRIVATE)
    told = held.ask(OWNER, "GET", "/submissions").json()
    assert [bool(each["report"]["scores"]) for each in told] == [False, True]


def test_a_file_that_came_by_e_mail_is_held_back_by_the_phase_of_its_date(server: Serving) -> None:
    """It came when scores were shown at once, and is scored when they are held back."""
    path = f"/organiser/schedules/{PRIVATE}"
    uploaded = submit(server)
    server.clock.turn(hours=1)
    challenge = {"name": "challenge", "opens": f"{NOON:%F}", "closes": f"{CLOSES:%FT%TZ}"}
    body = {"phases": [challenge], "release_scores": "phase-end"}
    server.ask(ORGANISER, "PUT", path, json=body).raise_for_status()
    server.clock.turn(hours=1)
    organiser = server.person(ORGANISER)
    file = EmailedFile(
        split=PRIVATE, team="Blue", person=OWNER, received_at=NOON + timedelta(minutes=9)
    )
    content = server.distinct(PRIVATE)
    method = Method(name="Walker")
    told = submit_for_sender(server.state, organiser, file, content, method, filename="a.json")
    emailed = told.submission.id
    assert told.submission.scores_held_until == CLOSES
    assert "RGSPL" not in told.reply
    shown = {
        each["id"]: bool(each["report"]["scores"])
        for each in server.ask(OWNER, "GET", "/submissions").json()
    }
    assert shown == {uploaded: True, emailed: False}, "scores that were shown stay visible"
    server.ask(OWNER, "PATCH", f"/submissions/{emailed}", json={"published": True})
    board = server.ask(None, "GET", f"/splits/{PRIVATE}/leaderboard").json()
    ranked = {each["submission_id"]: bool(each["scores"]) for each in board["rows"]}
    assert ranked == shown
    server.clock.now = CLOSES + timedelta(seconds=1)
    assert server.ask(OWNER, "GET", f"/submissions/{emailed}").json()["report"]["scores"]


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        pytest.param({"visibility": "open"}, "open split cannot be held back", id="open"),
        pytest.param(
            {"phases": [{"name": "always"}]},
            "only if every phase has `closes`, and 'always' has none",
            id="no end",
        ),
    ],
)
def test_scores_cannot_be_held_back_for_ever_or_of_open_answers(
    changes: dict[str, object], why: str
) -> None:
    split = {
        "bundle": "test.npz",
        "release_scores": "phase-end",
        "phases": [{"name": "first", "closes": CLOSES}],
    }
    assert Split.model_validate(split)
    with pytest.raises(ValidationError, match=why):
        Split.model_validate(split | changes)
