"""What uploads came to: noted after they were dealt with, and never in their way."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import timedelta

import pytest
from sqlalchemy import text
from sqlalchemy.exc import OperationalError

from reverie_eval.errors import Problem, SubmissionError
from reverie_eval.schemas.organising import NewMerge
from reverie_eval.schemas.people import Rejection
from reverie_eval.server.accounts.joining import reject_request
from reverie_eval.server.accounts.people import merge_teams
from reverie_eval.server.accounts.personal_data import delete_person
from reverie_eval.server.errors import MalformedError, NotFoundError
from reverie_eval.server.intake import attempts
from reverie_eval.server.intake.attempts import list_attempts
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.operations.room import (
    SplitCounts,
    Totals,
    counts_of_splits,
    last_day,
    totals,
)
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.store.paging import Page
from reverie_eval.server.store.tables import Attempt
from tests.support.acting import NOON, ask_to_join
from tests.support.serving import (
    BROKEN,
    GOOD,
    MATE,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    Serving,
    packed,
)


def noted(server: Serving) -> Sequence[tuple[str, int, int]]:
    """Return outcome, problems and size of every upload, the latest first."""
    rows = server.ask(ORGANISER, "GET", "/organiser/attempts").json()
    return [(row["outcome"], row["problems"], row["size"]) for row in rows]


def spend(server: Serving) -> None:
    for _ in range(3):
        server.upload(OWNER, server.distinct(PRIVATE), PRIVATE)


def pause(server: Serving) -> None:
    server.ask(ORGANISER, "PUT", "/organiser/notice", json={"paused": True})
    server.upload(OWNER)


def reuse_key(server: Serving) -> None:
    server.upload(OWNER, key="k")
    server.upload(OWNER, server.distinct(), key="k")


@pytest.mark.parametrize(
    ("upload", "outcome"),
    [
        pytest.param(lambda server: server.upload(OWNER), "scored", id="scored"),
        pytest.param(
            lambda server: [server.upload(OWNER), server.upload(OWNER)], "repeat", id="a repeat"
        ),
        pytest.param(
            lambda server: server.upload(OWNER, BROKEN), "submission-rejected", id="a broken file"
        ),
        pytest.param(
            lambda server: server.upload(OWNER, packed(GOOD)[:50]),
            "submission-rejected",
            id="a broken archive",
        ),
        pytest.param(spend, "quota-spent", id="nothing left"),
        pytest.param(pause, "not-open", id="paused"),
        pytest.param(reuse_key, "conflict", id="a key of another file"),
    ],
)
def test_every_upload_is_noted_with_what_it_came_to(
    upload: Callable[[Serving], object], outcome: str, server: Serving
) -> None:
    upload(server)
    assert noted(server)[0][0] == outcome


def test_what_is_noted(server_on: Serving) -> None:
    server_on.upload(OWNER, packed(GOOD))
    (row,) = server_on.ask(ORGANISER, "GET", "/organiser/attempts").json()
    assert row.pop("milliseconds") >= 0
    assert row == {
        "id": 1,
        "at": "2026-03-02T12:00:00Z",
        "person": OWNER,
        "team": "Blue",
        "split": OPEN,
        "outcome": "scored",
        "problems": 0,
        "size": len(GOOD),
    }


def test_problems_are_counted(server: Serving) -> None:
    problems = server.upload(OWNER, BROKEN).json()["problems"]
    assert len(problems) > 1
    assert noted(server) == [("submission-rejected", len(problems), len(BROKEN))]


def test_a_check_is_no_upload_and_neither_is_one_to_nowhere(server: Serving) -> None:
    server.ask(OWNER, "POST", f"/splits/{OPEN}/validate", content=GOOD)
    server.upload(OWNER, split="nowhere")
    assert noted(server) == []


def test_our_own_faults_are_noted_too(server: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError

    monkeypatch.setattr(Board, "score", fail)
    assert server.upload(OWNER).status_code == 500
    assert noted(server)[0][0] == "internal"


def test_what_cannot_be_noted_fails_no_upload(
    server: Serving, caplog: pytest.LogCaptureFixture
) -> None:
    trigger = (
        "CREATE TRIGGER full BEFORE INSERT ON attempt BEGIN SELECT RAISE(ABORT, 'it is full'); END"
    )
    with server.state.database.writing() as session:
        session.execute(text(trigger))
    assert server.upload(OWNER).status_code == 201
    assert server.upload(OWNER, BROKEN).status_code == 422
    assert noted(server) == []
    assert caplog.messages.count("upload not recorded") == 2
    assert len(server.ask(OWNER, "GET", "/submissions").json()) == 1


def test_a_submission_that_cannot_be_stored_is_noted_as_such(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OperationalError("", {}, Exception("database or disk is full"))

    with monkeypatch.context() as patch:
        patch.setattr(Intake, "_worded", fail)  # the last that is done before the commit
        assert server.upload(OWNER).status_code >= 500
    assert [outcome for outcome, *_ in noted(server)] == ["internal"]
    assert server.ask(OWNER, "GET", "/submissions").json() == []


def test_what_is_older_than_ninety_days_is_forgotten(server: Serving) -> None:
    server.upload(OWNER)
    server.clock.turn(days=90)
    server.upload(OWNER)
    assert len(noted(server)) == 2
    server.clock.turn(seconds=1)
    server.upload(OWNER)
    assert len(noted(server)) == 2


def test_there_are_never_more_than_so_many(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(attempts, "MOST_KEPT", 3)
    for _ in range(5):
        server.upload(OWNER, BROKEN)
    rows = server.ask(ORGANISER, "GET", "/organiser/attempts").json()
    assert [row["id"] for row in rows] == [5, 4, 3]


def test_they_are_read_page_by_page(server: Serving) -> None:
    for _ in range(4):
        server.upload(OWNER, BROKEN)
    query = {"limit": 2, "cursor": 4}
    rows = server.ask(ORGANISER, "GET", "/organiser/attempts", params=query).json()
    assert [row["id"] for row in rows] == [3, 2]


def test_a_day_in_hours(server: Serving) -> None:
    person = server.person(OWNER)

    def attempt(hours_ago: float, outcome: str, milliseconds: int) -> Attempt:
        return Attempt(
            at=NOON - timedelta(hours=hours_ago),
            person_id=person.id,
            split=OPEN,
            outcome=outcome,
            problems=0,
            size=1,
            milliseconds=milliseconds,
        )

    with server.state.database.writing() as session:
        session.add_all(
            [
                attempt(23.01, "scored", 1000),  # in the 13th hour of yesterday's noon: too old
                attempt(23, "scored", 10),
                attempt(1, "repeat", 20),
                attempt(0.75, "quota-spent", 60),
                attempt(0, "scored", 30),
            ]
        )
    with server.state.database.reading() as session:
        day = last_day(session, NOON + timedelta(minutes=30))
    counts = [(hour.scored, hour.repeats, hour.refused) for hour in day.hours]
    assert counts == [(1, 0, 0), *[(0, 0, 0)] * 21, (0, 1, 1), (1, 0, 0)]
    assert (day.uploads, day.refused, day.busiest) == (4, 1, 2)
    assert (day.median_milliseconds, day.slowest_milliseconds) == (25, 60)


def test_a_day_without_uploads(server: Serving) -> None:
    now = NOON + timedelta(minutes=59, seconds=59, microseconds=9)
    with server.state.database.reading() as session:
        day = last_day(session, now)
    assert [hour.begins for hour in day.hours] == [
        NOON - timedelta(hours=ago) for ago in range(23, -1, -1)
    ]
    assert (day.uploads, day.refused, day.busiest) == (0, 0, 0)
    assert (day.median_milliseconds, day.slowest_milliseconds) == (None, None)


def test_totals_leave_out_who_is_no_longer_there(server: Serving) -> None:
    def counted() -> Totals:
        with server.state.database.reading() as session:
            return totals(session, server.clock())

    empty = Totals(
        teams=3, people=4, upload_bytes=0, open_requests=0, same_files=0, same_file_on=None
    )
    assert counted() == empty
    server.upload(OWNER, GOOD)
    server.upload(OTHER, GOOD)
    ask_to_join(server.state.transactions, "Green")
    full = replace(
        empty, upload_bytes=2 * len(GOOD), open_requests=1, same_files=1, same_file_on=OPEN
    )
    assert counted() == full
    with server.acting() as transaction:
        delete_person(transaction, server.person(MATE).id)
        merge_teams(transaction, NewMerge(team="Red", into="Blue"))
        reject_request(transaction, 1, Rejection(reason="full"))
    assert counted() == replace(full, teams=2, people=3, open_requests=0)


def test_how_long_an_upload_took(server: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([7.0, 7.2506])
    monkeypatch.setattr(time, "perf_counter", lambda: next(times))
    with attempts.recording(server.state, server.person(OWNER), OPEN, 5):
        server.clock.turn(seconds=1)
    monkeypatch.undo()
    with server.state.database.reading() as session:
        (report,) = list_attempts(session, Page()).rows
    assert report.model_dump() == {
        "id": 1,
        "at": NOON + timedelta(seconds=1),
        "person": OWNER,
        "team": "Blue",
        "split": OPEN,
        "outcome": "scored",
        "problems": 0,
        "size": 5,
        "milliseconds": 251,
    }


@pytest.mark.parametrize(
    ("error", "outcome", "problems"),
    [
        pytest.param(
            SubmissionError([Problem("c", "w", "m")] * 2), "submission-rejected", 2, id="2"
        ),
        pytest.param(MalformedError("x"), "malformed-request", 0, id="malformed"),
        pytest.param(NotFoundError("x"), "internal", 0, id="no outcome of uploads"),
        pytest.param(RuntimeError("x"), "internal", 0, id="a fault"),
    ],
)
def test_what_an_upload_that_failed_came_to(
    error: Exception, outcome: str, problems: int, server: Serving
) -> None:
    person = server.person(OWNER)
    with pytest.raises(type(error)), attempts.recording(server.state, person, OPEN, 5):
        raise error
    assert noted(server) == [(outcome, problems, 5)]


def test_submissions_of_each_split_are_counted_with_the_latest(server_on: Serving) -> None:
    def upload(split: str, hour: int) -> str:
        server_on.clock.now = NOON + timedelta(hours=hour)
        reply = server_on.upload(OWNER, server_on.distinct(split), split).json()
        return f"/submissions/{reply['submission']['id']}"

    upload(OPEN, 0)
    other = upload(OPEN, 2)
    path = upload(PRIVATE, 1)
    assert server_on.ask(OWNER, "PATCH", path, json={"published": True}).status_code == 200
    with server_on.state.database.reading() as session:
        assert counts_of_splits(session) == {
            OPEN: SplitCounts(2, 0, NOON + timedelta(hours=2)),
            PRIVATE: SplitCounts(1, 1, NOON + timedelta(hours=1)),
        }
    assert server_on.ask(OWNER, "PATCH", other, json={"published": True}).status_code == 200
    with server_on.state.database.reading() as session:
        published = {split: counts.published for split, counts in counts_of_splits(session).items()}
    assert published == {OPEN: 1, PRIVATE: 1}
