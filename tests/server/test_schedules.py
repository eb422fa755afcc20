"""Phases, pauses and the release of scores, changed while the server runs."""

import json
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest

from reverie_eval.schemas.organising import NewSchedule
from reverie_eval.schemas.service import Method, Phase, Schedule, first_overlap
from reverie_eval.server.boards.schedules import Schedules, Timetable, close, with_phase
from reverie_eval.server.errors import ConflictError, NotFoundError, NotOpenError
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.operations.checks import check_folder
from reverie_eval.server.store.tables import SetSchedule
from tests.support.acting import NOON
from tests.support.flat_world import Run
from tests.support.serving import (
    GOOD,
    OPEN,
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

SPLITS = ("test", "val_seen", "val_unseen")
METHOD = Method(name="Walker")
MOMENT, SECOND, HOUR = timedelta.resolution, timedelta(seconds=1), timedelta(hours=1)
ENDED = {"name": "first", "closes": "2026-03-02T11:00:00Z"}
RUNNING = {"name": "second", "opens": "2026-03-02T11:30:00Z", "closes": "2026-03-02T13:00:00Z"}


def put(server: Serving, split: str = OPEN, **schedule: Any) -> httpx.Response:
    return server.ask(ORGANISER, "PUT", f"/organiser/schedules/{split}", json=schedule)


def shown(server: Serving, split: str = OPEN) -> dict[str, Any]:
    told: dict[str, Any] = server.ask(None, "GET", f"/splits/{split}").json()
    return told


# In effect.


def test_what_the_desk_sets_applies_at_once_and_until_it_is_taken_back(server_on: Serving) -> None:
    put(server_on, phases=[ENDED], release_scores="at-once")
    assert [(each["name"], each["is_open"]) for each in shown(server_on)["phases"]] == [
        ("first", False)
    ]
    refused = server_on.upload(OWNER)
    assert (refused.status_code, refused.json()["code"]) == (409, "not-open")
    put(server_on, phases=[ENDED, RUNNING], release_scores="at-once")
    assert server_on.upload(OWNER).status_code == 201
    report = put(server_on).json()
    assert report["desk"] is None
    assert report["in_effect"] == report["settings"]
    assert [each["name"] for each in shown(server_on)["phases"]] == ["always"]


def test_other_workers_and_a_restart_follow(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    twin = open_server(settings_of(folder), server.tokens)
    assert twin.upload(OWNER).status_code == 201
    put(server, phases=[ENDED], release_scores="at-once", paused=True)
    assert twin.upload(OTHER).status_code == 409
    assert shown(open_server(settings_of(folder), server.tokens))["paused"] is True


def test_a_pause_is_one_split_s(server: Serving) -> None:
    put(server, paused=True)
    refused = server.upload(OWNER)
    assert refused.json()["detail"] == f"the organiser has paused submissions to {OPEN}"
    assert server.upload(OWNER, submission_for(PRIVATE), PRIVATE).status_code == 201
    assert server.ask(OWNER, "POST", f"/splits/{OPEN}/validate", content=GOOD).status_code == 200
    assert [each["name"] for each in shown(server)["phases"]] == ["always"]
    put(server, paused=False)
    assert server.upload(OWNER).status_code == 201


def test_an_upload_follows_what_applied_when_it_arrived(server: Serving) -> None:
    arrived = server.clock()
    server.clock.turn(seconds=1)
    put(server, phases=[ENDED], release_scores="at-once", paused=True)
    server.clock.turn(seconds=1)

    def submit(at: datetime, person: str) -> str:
        accepted = server.state.get(Intake).submit(
            server.person(person), OPEN, GOOD, METHOD, key=None, arrived=at
        )
        return accepted.submission.status

    assert submit(arrived, OWNER) == "unpublished"
    with pytest.raises(NotOpenError, match="paused"):
        submit(server.clock(), OTHER)


@pytest.mark.parametrize("at", [0, 2, 400_000, 999_999], ids="microsecond {}".format)
def test_what_arrives_when_a_phase_is_closed_is_too_late(at: int) -> None:
    now = NOON + at * MOMENT
    (closed,) = close(Timetable(Schedule(phases=(Phase(name="a"),)), ()), now).phases or ()
    moments = [now - MOMENT, now, now + MOMENT, NOON + SECOND - MOMENT]
    assert [closed.is_open(each) for each in moments] == [True, False, False, False]


def test_an_upload_in_the_second_in_which_its_phase_is_closed(
    folder: Path, open_server: OpenServer
) -> None:
    phases = (Phase(name="a", closes=NOON + HOUR),)
    server = open_server(adjusted(settings_of(folder), phases=phases, release_scores="phase-end"))
    server.clock.turn(microseconds=300_000)
    sent = server.upload(OWNER, submission_for(PRIVATE), PRIVATE).json()["submission"]
    assert sent["report"]["scores"] == {}
    server.clock.turn(microseconds=1)
    with server.acting() as transaction:
        assert server.state.get(Schedules).change(transaction, PRIVATE, close).shown == 1
    refused = server.upload(OTHER, submission_for(PRIVATE), PRIVATE)
    assert "closed 2026-03-02T12:00:00.300000+00:00" in refused.json()["detail"]
    path = f"/submissions/{sent['id']}"
    assert server.ask(OWNER, "GET", path).json()["report"]["scores"] != {}
    with server.acting():  # takes the snapshots that are due
        pass
    (snapshot,) = server.client.get(f"/api/v1/splits/{PRIVATE}/snapshots").json()
    assert snapshot["title"] == "a"


@pytest.mark.parametrize(
    ("schedule", "split", "status", "why"),
    [
        pytest.param({"paused": True}, "none", 404, "no split 'none'", id="no such split"),
        pytest.param({"phases": [ENDED]}, PRIVATE, 400, "together, or neither", id="half"),
        pytest.param({"phases": [], "release_scores": "at-once"}, PRIVATE, 400, "add a", id="none"),
        pytest.param(
            {"phases": [{"name": "a", "closes": "soon"}], "release_scores": "at-once"},
            PRIVATE,
            400,
            "a time with its time zone",
            id="not a time",
        ),
        pytest.param(
            {"phases": [{"name": "a"}], "release_scores": "phase-end"},
            PRIVATE,
            409,
            "only if every phase has `closes`, and 'a' has none; change it at /desk/phases or with "
            "`reverie-eval server phase set`",
            id="held back for ever",
        ),
        pytest.param(
            {"phases": [{"name": "a b"}, RUNNING], "release_scores": "at-once"},
            PRIVATE,
            409,
            "the phases 'a b' (always open) and 'second' (from 2026-03-02T11:30:00Z until "
            "2026-03-02T13:00:00Z) overlap; 'a b' must close before 'second' opens; change it at "
            "/desk/phases or with `reverie-eval server phase set`",
            id="overlap",
        ),
        pytest.param(
            {
                "phases": [RUNNING, {**RUNNING, "name": "third", "closes": "2026-03-03"}],
                "release_scores": "phase-end",
            },
            PRIVATE,
            409,
            "'second' must close before 'third' opens",
            id="overlap from the start",
        ),
        pytest.param(
            {"phases": [RUNNING], "release_scores": "phase-end"},
            OPEN,
            409,
            "solution is public",
            id="public solution held back",
        ),
    ],
)
def test_what_cannot_apply_is_refused(
    schedule: dict[str, Any], split: str, status: int, why: str, server: Serving
) -> None:
    reply = put(server, split, **schedule)
    assert reply.status_code == status
    assert why in json.dumps(reply.json(), ensure_ascii=False)
    assert server.ask(ORGANISER, "GET", "/organiser/schedules").json()[0]["desk"] is None


@pytest.mark.parametrize(
    ("given", "opens", "closes"),
    [
        pytest.param("2027-06-01", "2027-06-01T00:00:00Z", "2027-06-01T23:59:59Z", id="a day"),
        pytest.param(
            "2027-06-01T12:00:00-12:00", *2 * ["2027-06-02T00:00:00Z"], id="anywhere on earth"
        ),
    ],
)
def test_a_day_alone_counts_whole(given: str, opens: str, closes: str) -> None:
    first = Phase.model_validate({"name": "a", "opens": given})
    last = Phase.model_validate({"name": "a", "closes": given})
    told = first.model_dump(mode="json")["opens"], last.model_dump(mode="json")["closes"]
    assert told == (opens, closes)


def test_what_is_set_is_reported_and_logged(server: Serving) -> None:
    always = {
        "phases": [{"name": "always", "opens": None, "closes": None}],
        "release_scores": "at-once",
        "paused": False,
    }
    ended = {**ENDED, "opens": None}
    desk: dict[str, Any] = {"phases": [ended], "release_scores": "at-once", "paused": True}
    server.clock.turn(seconds=1)
    assert put(server, **desk).json() == {
        "split": OPEN,
        "settings": always,
        "desk": desk,
        "in_effect": desk,
        "set_at": "2026-03-02T12:00:01Z",
    }
    last = server.ask(ORGANISER, "GET", "/organiser/audit").json()[-1]
    assert (last["actor"], last["action"], last["subject"]) == (ORGANISER, "schedule set", OPEN)
    assert last["details"] == desk
    paused = {"phases": None, "release_scores": None, "paused": True}
    put(server, PRIVATE, **paused)
    nothing = {"desk": None, "set_at": None}
    found = server.ask(ORGANISER, "GET", "/organiser/schedules").json()
    assert {each["split"]: each for each in found} == {
        PRIVATE: {
            "split": PRIVATE,
            "settings": always,
            "desk": paused,
            "in_effect": {**always, "paused": True},
            "set_at": "2026-03-02T12:00:01Z",
        },
        "val_seen": {"split": "val_seen", "settings": always, "in_effect": always, **nothing},
        OPEN: {
            "split": OPEN,
            "settings": always,
            "desk": desk,
            "in_effect": desk,
            "set_at": "2026-03-02T12:00:01Z",
        },
    }


def test_a_transaction_sees_what_it_has_set(server: Serving) -> None:
    schedules = server.state.get(Schedules)
    with server.acting() as transaction:
        assert not schedules.of_split(transaction.session, OPEN).latest.paused
        schedules.set(transaction, OPEN, NewSchedule(paused=True))
        assert schedules.of_split(transaction.session, OPEN).latest.paused
        in_effect = schedules.in_effect(transaction.session)
        assert {name: each.paused for name, each in in_effect.items()} == {
            name: name == OPEN for name in SPLITS
        }
        with pytest.raises(NotFoundError) as missing:
            schedules.of_split(transaction.session, "none")
    told = "there is no split 'none' here; choose one of: test, val_seen, val_unseen"
    assert str(missing.value) == told


def test_which_schedule_applied_at_a_moment() -> None:
    rows = [
        SetSchedule(split=OPEN, paused=paused, created_at=NOON + hours * HOUR)
        for hours, paused in ((0, True), (1, False), (2, True))
    ]
    timetable = Timetable(Schedule(phases=(Phase(name="a"),)), rows)
    moments = [NOON - SECOND, NOON, NOON + HOUR - SECOND, NOON + HOUR, NOON + 9 * HOUR]
    assert [timetable.at(each).paused for each in moments] == [False, True, True, False, True]


def asked_for(new: NewSchedule, *_: object) -> NewSchedule:
    return new


def test_what_a_schedule_would_show_is_counted(folder: Path, open_server: OpenServer) -> None:
    first = Phase(name="a", closes=NOON + HOUR)
    settings = adjusted(settings_of(folder), phases=(first,), release_scores="phase-end")
    server = open_server(settings)
    for _ in range(2):
        server.upload(OWNER, server.distinct(PRIVATE), PRIVATE)
    server.upload(OWNER)
    now = NOON + HOUR / 2
    with server.state.database.reading() as session:
        for release, expected in (("at-once", 2), ("phase-end", 0)):
            asked = NewSchedule.model_validate({"phases": [first], "release_scores": release})
            change = partial(asked_for, asked)
            effect = server.state.get(Schedules).if_changed(session, PRIVATE, change, now)
            assert (effect.after.release_scores, effect.shown) == (release, expected)


PHASES = (
    Phase(name="over", closes=NOON - HOUR),
    Phase(name="open", opens=NOON - HOUR + SECOND, closes=NOON + HOUR - SECOND),
    Phase(name="to come", opens=NOON + HOUR),
)


@pytest.mark.parametrize(
    ("first", "second", "is_overlap"),
    [
        pytest.param((None, NOON), (NOON + SECOND, None), False, id="the next second"),
        pytest.param((None, NOON), (NOON, None), True, id="in its last second"),
        pytest.param((None, NOON), (NOON + SECOND / 2, None), True, id="within its last second"),
        pytest.param((None, NOON + SECOND / 2), (NOON + SECOND, None), False, id="a part of one"),
        pytest.param((None, None), (NOON, NOON + HOUR), True, id="behind one that is always open"),
        pytest.param((NOON, None), (NOON + HOUR, None), True, id="two without an end"),
        pytest.param((None, NOON), (None, NOON + HOUR), True, id="two without a start"),
        pytest.param((NOON, NOON + HOUR), (NOON, NOON + HOUR), True, id="the same twice"),
        pytest.param((NOON, NOON + 9 * HOUR), (NOON + HOUR, NOON + 2 * HOUR), True, id="within"),
    ],
)
def test_which_phases_overlap(first: Any, second: Any, *, is_overlap: bool) -> None:
    phases = [
        Phase(name=name, opens=opens, closes=closes)
        for name, (opens, closes) in (("first", first), ("second", second))
    ]
    for order in (phases, phases[::-1]):
        pair = first_overlap(order)
        assert (pair is not None) is is_overlap
        # A file could belong to both, or to neither, in the first moment of the second one.
        begin = phases[1].opens or NOON
        assert all(phase.is_open(begin) for phase in phases) is is_overlap


def test_an_overlap_is_found_among_many_phases() -> None:
    hours = [(8, 9), (0, 1), (2, 5), (6, 7), (4, 5)]
    phases = [
        Phase(name=f"{begin}", opens=NOON + begin * HOUR, closes=NOON + end * HOUR)
        for begin, end in hours
    ]
    pair = first_overlap(phases)
    assert pair is not None
    assert [phase.name for phase in pair] == ["2", "4"]
    assert first_overlap(phases[:-1]) is None


@pytest.mark.parametrize(
    ("names", "paused", "paused_server", "expected"),
    [
        pytest.param(["over", "open", "to come"], False, False, "open", id="a phase is open"),
        pytest.param(["over", "open", "to come"], True, False, "paused", id="the split is paused"),
        pytest.param(["over", "open", "to come"], False, True, "paused", id="all are paused"),
        pytest.param(["over", "to come"], False, False, "not open yet", id="between phases"),
        pytest.param(["to come"], True, True, "not open yet", id="paused before a phase"),
        pytest.param(["over"], False, False, "closed", id="all phases are over"),
        pytest.param(["over"], True, True, "closed", id="paused after all phases"),
    ],
)
def test_whether_a_split_accepts_submissions(
    names: list[str], expected: str, *, paused: bool, paused_server: bool
) -> None:
    phases = tuple(phase for phase in PHASES if phase.name in names)
    schedule = Schedule(phases=phases, paused=paused)
    assert schedule.status(NOON, paused_server=paused_server) == expected


@pytest.mark.parametrize(
    ("opens", "closes", "expected"),
    [
        pytest.param(NOON, None, "open", id="its first moment"),
        pytest.param(NOON + timedelta(microseconds=1), None, "not open yet", id="just before it"),
        pytest.param(None, NOON, "open", id="its last second"),
        pytest.param(None, NOON - timedelta(seconds=1), "closed", id="just after it"),
    ],
)
def test_the_status_of_a_phase(
    opens: datetime | None, closes: datetime | None, expected: str
) -> None:
    phase = Phase(name="a", opens=opens, closes=closes)
    assert phase.status(NOON, is_paused=False) == expected


def test_to_close_ends_the_open_phases_at_this_moment() -> None:
    schedule = Schedule(phases=PHASES, release_scores="phase-end", paused=True)
    over, running, coming = PHASES
    end = close(Timetable(schedule, ()), NOON + SECOND / 2)
    assert end.model_dump() == {
        "phases": (
            over.model_dump(),
            {**running.model_dump(), "closes": NOON + SECOND / 2 - MOMENT},
            coming.model_dump(),
        ),
        "release_scores": "phase-end",
        "paused": True,
    }
    new = Phase(name="new", opens=NOON, closes=NOON + HOUR)
    (shortest,) = close(Timetable(Schedule(phases=(new,)), ()), NOON).phases or ()
    assert shortest.closes == NOON + MOMENT, "it has to open before it closes"
    with pytest.raises(ConflictError) as refused:
        close(Timetable(Schedule(phases=(over, coming)), ()), NOON)
    assert str(refused.value) == "no phase is open"


@pytest.mark.parametrize(
    ("name", "opens", "closes", "release", "expected"),
    [
        pytest.param(
            "b",
            "2026-01-01",
            None,
            None,
            [("a", None, NOON), ("b", "2026-01-01", None)],
            id="added",
        ),
        pytest.param(
            "a", "2026-01-01", None, "at-once", [("a", "2026-01-01", NOON)], id="its start"
        ),
        pytest.param("a", None, "2027-01-01", None, [("a", None, "2027-01-01")], id="its end"),
    ],
)
def test_a_phase_is_added_or_changed(
    name: str, opens: str | None, closes: str | None, release: Any, expected: list[Any]
) -> None:
    phases = (Phase(name="a", closes=NOON),)
    schedule = Schedule(phases=phases, release_scores="phase-end", paused=True)
    fields = with_phase(schedule, name, opens, closes, release)
    keys = ("name", "opens", "closes")
    assert [tuple(map(phase.get, keys)) for phase in fields["phases"]] == expected
    assert (fields["release_scores"], fields["paused"]) == (release or "phase-end", True)
    assert fields.keys() == {"phases", "release_scores", "paused"}


# Scores held back.


def held(closes: datetime | None) -> dict[str, Any]:
    """Return a schedule that holds scores back until a time, or not at all."""
    phases = (Phase(name="a", closes=closes or NOON + 9 * HOUR),)
    return {"phases": phases, "release_scores": "phase-end" if closes else "at-once"}


@pytest.mark.parametrize(
    ("settings", "changes", "at", "expected"),
    [
        pytest.param(None, [], 1, None, id="never held back"),
        pytest.param(2, [], 1, 2, id="held back"),
        pytest.param(2, [], 2, 2, id="in the last second"),
        pytest.param(2, [], 3, None, id="after the end"),
        pytest.param(2, [(1, 4)], 3, 4, id="extended before the end"),
        pytest.param(2, [(3, 5)], 4, None, id="extended after the end: shown before"),
        pytest.param(2, [(2, 5)], 4, 5, id="extended in the last second"),
        pytest.param(None, [(1, 5)], 2, None, id="held back after it was shown"),
        pytest.param(5, [(1, None)], 2, None, id="released at once"),
        pytest.param(5, [(1, None), (2, 6)], 3, None, id="released, and held back again"),
        pytest.param(5, [(1, None), (2, 6)], 1, None, id="what comes later does not count yet"),
        pytest.param(2, [(-1, 4)], 3, 4, id="changed before it came"),
    ],
)
def test_scores_that_were_shown_stay_visible(
    settings: int | None, changes: list[tuple[int, int | None]], at: int, expected: int | None
) -> None:
    """Hours after a submission came, of schedules that hold scores back until an hour."""

    def hour(number: int | None) -> datetime | None:
        return None if number is None else NOON + number * HOUR

    rows = [
        SetSchedule(split=PRIVATE, paused=False, created_at=NOON + when * HOUR, **held(hour(until)))
        for when, until in changes
    ]
    timetable = Timetable(Schedule(**held(hour(settings))), rows)
    assert timetable.held_until(NOON, NOON, NOON + at * HOUR) == hour(expected)


@pytest.mark.parametrize(
    ("scored", "settings", "changes", "at", "expected"),
    [
        pytest.param(2, None, [(1, 5)], 3, 5, id="after scores are held back"),
        pytest.param(1, None, [(1, 5)], 3, 5, id="when they begin to be held back"),
        pytest.param(0, None, [(1, 5)], 3, None, id="before that: shown"),
        pytest.param(3, 2, [], 3, None, id="after the end of its phase"),
        pytest.param(2, 2, [], 2, 2, id="in the last second of its phase"),
        pytest.param(3, 5, [(1, None)], 4, None, id="after its phase was released"),
        pytest.param(3, 5, [(1, None), (2, 6)], 4, 6, id="released and held back again by then"),
    ],
)
def test_scores_are_shown_no_earlier_than_a_file_is_scored(
    scored: int, settings: int | None, changes: list[tuple[int, int | None]], at: int, expected: Any
) -> None:
    """A file of noon that is scored hours later, when other schedules may apply."""
    times = [(when, None if until is None else NOON + until * HOUR) for when, until in changes]
    rows = [
        SetSchedule(split=PRIVATE, paused=False, created_at=NOON + when * HOUR, **held(until))
        for when, until in times
    ]
    first = held(None if settings is None else NOON + settings * HOUR)
    timetable = Timetable(Schedule(**first), rows)
    until = timetable.held_until(NOON, NOON + scored * HOUR, NOON + at * HOUR)
    assert until == (None if expected is None else NOON + expected * HOUR)


def test_a_leaderboard_follows_the_phase_in_effect(folder: Path, open_server: OpenServer) -> None:
    phase = Phase(name="a", closes=NOON + HOUR)
    settings = adjusted(settings_of(folder), phases=(phase,), release_scores="phase-end")
    server = open_server(settings)
    submission = server.upload(OWNER, submission_for(PRIVATE), PRIVATE).json()["submission"]["id"]
    server.ask(OWNER, "PATCH", f"/submissions/{submission}", json={"published": True})

    def scores() -> bool:
        board = server.ask(None, "GET", f"/splits/{PRIVATE}/leaderboard").json()
        own = server.ask(OWNER, "GET", f"/submissions/{submission}").json()
        assert bool(board["rows"][0]["scores"]) is bool(own["report"]["scores"])
        return bool(own["report"]["scores"])

    assert not scores()
    later = [{"name": "a", "closes": "2026-03-02T15:00:00Z"}]
    server.clock.turn(minutes=59)
    put(server, PRIVATE, phases=later, release_scores="phase-end")
    server.clock.turn(hours=2)
    assert not scores()
    with server.state.database.reading() as session:
        asked = NewSchedule(phases=(phase,), release_scores="at-once")
        schedules, change = server.state.get(Schedules), partial(asked_for, asked)
        effect = schedules.if_changed(session, PRIVATE, change, server.clock())
    assert effect.shown == 1
    put(server, PRIVATE, phases=later, release_scores="at-once")
    assert scores()
    server.clock.turn(minutes=1)
    put(server, PRIVATE, phases=later, release_scores="phase-end")
    assert scores()


# Commands.


def test_commands_open_extend_close_and_reset(server: Serving, folder: Path, run: Run) -> None:
    def phase(*words: str) -> str:
        outcome = run("server", "phase", words[0], str(folder), PRIVATE, *words[1:])
        assert outcome.status == 0, outcome.err
        return outcome.out

    told = phase("set", "always", "--closes", "2999-06-01", "--release-scores", "phase-end")
    assert told == ("test: always until 2999-06-01T23:59:59Z, scores shown when the phase ends\n")
    told = phase("set", "CVPR 2999", "--opens", "2999-07-01", "--closes", "2999-07-02")
    assert "always until 2999-06-01T23:59:59Z, CVPR 2999 from 2999-07-01T00:00:00Z" in told
    assert phase("pause").endswith(", scores shown when the phase ends, paused\n")
    diff = run("server", "phase", "show", str(folder)).out
    assert [line.split()[0] for line in diff.splitlines()] == ["of", "all", *SPLITS]
    assert shown(server, PRIVATE)["paused"]
    told = phase("close")
    assert "paused" in told
    assert "2999-06-01" not in told
    phase("resume")
    assert phase("reset") == "test: always\n"
    assert shown(server, PRIVATE)["phases"][0]["closes"] is None


def test_a_wrong_time_is_refused_in_a_line(server: Serving, folder: Path, run: Run) -> None:
    words = ["server", "phase", "set", str(folder), OPEN]
    wrong = run(*words, "always", "--closes", "tomorrow")
    assert wrong.status == 2
    assert "'--closes': 'tomorrow' is not a day or a time with a time zone" in wrong.err
    assert run(*words[:-1], "none", "a").status == 2
    assert shown(server)["phases"][0]["closes"] is None


def test_a_phase_beside_the_one_that_is_always_open_is_refused(
    server: Serving, folder: Path, run: Run
) -> None:
    words = ["server", "phase", "set", str(folder), PRIVATE]
    challenge = [*words, "challenge", "--opens", "2999-06-01", "--closes", "2999-07-01"]
    refused = run(*challenge)
    assert refused.status == 2
    assert "'always' (always open) and 'challenge' (from 2999-06-01T00:00:00Z" in refused.err
    assert [each["name"] for each in shown(server, PRIVATE)["phases"]] == ["always"]
    assert run(*words, "always", "--closes", "2999-05-31").status == 0
    assert run(*challenge).status == 0


def test_a_check_notes_what_the_desk_has_set(server: Serving, folder: Path) -> None:
    def found() -> list[tuple[str, str]]:
        return [(each.kind, each.what) for each in check_folder(folder) if each.check == "phases"]

    assert found() == []
    put(server, PRIVATE, phases=[RUNNING], release_scores="phase-end")
    ((kind, what),) = found()
    assert kind == "note"
    assert f"reverie-eval server phase show {folder}" in what
    settings = (folder / "reverie-eval.toml").read_text()
    head, split, rest = settings.partition(f"[splits.{PRIVATE}]\n")
    opened = rest.replace('visibility = "private"', 'visibility = "open"')
    (folder / "reverie-eval.toml").write_text(head + split + opened)
    ((kind, what),) = found()
    assert kind == "fault"
    assert f"reverie-eval server phase reset {folder} {PRIVATE}" in what
