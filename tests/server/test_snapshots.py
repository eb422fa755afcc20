"""Snapshots: signed states of a leaderboard, taken by the organiser or when a phase has ended."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import delete, event, select

from reverie_eval.receipts import NotGenuineError, verify, verify_by_history
from reverie_eval.schemas.organising import KeyRevocation, NewSchedule, NewTeam
from reverie_eval.schemas.service import Envelope, KeyReport, Phase, Snapshot
from reverie_eval.server.accounts.people import rename_team
from reverie_eval.server.accounts.tokens import revoke_token
from reverie_eval.server.app import create_app
from reverie_eval.server.audit.transactions import Transactions
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.corrections.snapshots import SnapshotError, Snapshots, snapshot_of
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.intake import retention
from reverie_eval.server.intake.submissions import SubmissionService
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.operations.keys import revoke_key, rotate_key
from reverie_eval.server.settings import Settings
from reverie_eval.server.store.database import UnreadableValueError
from reverie_eval.server.store.tables import AuditEntry, SetSchedule, StoredSnapshot, Submission
from tests.support.acting import NOON, add_team, review
from tests.support.flat_world import Run
from tests.support.serving import (
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
)
from tests.support.signing import altered, snapshot_in
from tests.support.waiting import wait_until

CLOSES = NOON + timedelta(hours=1)
END = CLOSES + timedelta(seconds=1)
TITLE = "CVPR 2027"


def take(server: Serving, split: str = OPEN, title: str = TITLE) -> dict[str, Any]:
    body = {"split": split, "title": title}
    reply = server.ask(ORGANISER, "POST", "/organiser/snapshots", json=body)
    assert reply.status_code == 201
    taken: dict[str, Any] = reply.json()
    return taken


def publish(server: Serving, who: str, split: str = PRIVATE) -> str:
    reply = server.upload(who, server.distinct(split), split)
    submission: str = reply.json()["submission"]["id"]
    path = f"/submissions/{submission}"
    assert server.ask(who, "PATCH", path, json={"published": True}).status_code == 200
    return submission


def envelopes(server: Serving, split: str = PRIVATE) -> list[Envelope]:
    """Return all signed snapshots of a split, as anybody gets them, the earliest first."""
    listed = server.ask(None, "GET", f"/splits/{split}/snapshots").json()
    paths = [f"/splits/{split}/snapshots/{each['number']}" for each in reversed(listed)]
    return [Envelope.model_validate(server.ask(None, "GET", path).json()) for path in paths]


def snapshots(server: Serving, split: str = PRIVATE) -> list[Snapshot]:
    """Return all snapshots of a split, the earliest first."""
    return [snapshot_in(each) for each in envelopes(server, split)]


@pytest.fixture
def closing_settings(folder: Path) -> Settings:
    """Return settings with a phase that ends in an hour, and scores held back until then."""
    phase = Phase(name="challenge", closes=CLOSES)
    return adjusted(settings_of(folder), phases=(phase,), release_scores="phase-end")


# The organiser's.


@pytest.mark.parametrize("path", [f"/api/v1/splits/{OPEN}/snapshots", f"/splits/{OPEN}"])
def test_a_list_of_snapshots_reads_no_leaderboard(path: str, server: Serving) -> None:
    take(server)
    statements: list[str] = []
    event.listen(
        server.state.database.engine,
        "before_cursor_execute",
        lambda *about: statements.append(about[2]),
    )
    reply = server.client.get(path)
    assert TITLE in reply.text
    assert any("FROM snapshot" in each for each in statements)
    assert not any("snapshot.envelope" in each for each in statements)


def test_a_snapshot_stays_as_it_is(server_on: Serving) -> None:
    first = publish(server_on, OWNER, OPEN)
    board = server_on.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()
    text = server_on.ask(None, "GET", f"/splits/{OPEN}/leaderboard.csv").text
    assert take(server_on) == {
        "split": OPEN,
        "number": 1,
        "title": TITLE,
        "as_of": "2026-03-02T12:00:00Z",
    }
    publish(server_on, OTHER, OPEN)
    with server_on.acting() as transaction:
        review(transaction, first, "disqualified")
    (kept,) = snapshots(server_on, OPEN)
    assert kept.leaderboard.model_dump(mode="json") == board
    assert server_on.ask(None, "GET", f"/splits/{OPEN}/snapshots/1.csv").text == text
    (envelope,) = envelopes(server_on, OPEN)
    verify(envelope, server_on.state.signer.public_pem)
    assert take(server_on, title="again")["number"] == 2
    assert len(snapshots(server_on, OPEN)[1].leaderboard.apart) == 1


def test_a_changed_one_is_not_genuine(server: Serving) -> None:
    publish(server, OWNER, OPEN)
    take(server)
    (kept,) = envelopes(server, OPEN)
    with pytest.raises(NotGenuineError):
        verify(altered(kept), server.state.signer.public_pem)


@pytest.mark.parametrize(
    ("path", "status"),
    [
        pytest.param(f"/splits/{OPEN}/snapshots/1", 404, id="none yet"),
        pytest.param("/splits/none/snapshots", 404, id="no such split"),
        pytest.param(f"/splits/{OPEN}/snapshots/first", 400, id="not a number"),
    ],
)
def test_what_is_not_there(path: str, status: int, server: Serving) -> None:
    assert server.ask(None, "GET", path).status_code == status


def test_a_snapshot_that_is_not_there_says_so(server: Serving) -> None:
    take(server)
    with server.state.database.reading() as session:
        assert snapshot_in(snapshot_of(session, OPEN, 1)).title == TITLE
        for split, number in ((OPEN, 2), (PRIVATE, 1)):
            with pytest.raises(NotFoundError) as missing:
                snapshot_of(session, split, number)
            assert str(missing.value) == f"there is no snapshot {number} of {split!r}"


def test_a_snapshot_is_logged_and_numbered_by_split(server: Serving) -> None:
    server.clock.turn(seconds=1)
    taken = [take(server, split, title) for split, title in ((OPEN, "a"), (PRIVATE, "b"))]
    taken.append(take(server, OPEN, "c"))
    assert [each["number"] for each in taken] == [1, 1, 2]
    last = server.ask(ORGANISER, "GET", "/organiser/audit").json()[-1]
    assert (last["actor"], last["action"], last["subject"]) == (ORGANISER, "snapshot taken", OPEN)
    assert last["details"] == {"number": 2, "title": "c", "as_of": "2026-03-02T12:00:01+00:00"}
    with server.state.database.reading() as session:
        rows = session.scalars(select(StoredSnapshot).order_by(StoredSnapshot.id)).all()
    assert [(row.split, row.number, row.title, row.phase) for row in rows] == [
        (OPEN, 1, "a", None),
        (PRIVATE, 1, "b", None),
        (OPEN, 2, "c", None),
    ]
    assert {(row.as_of, row.created_at) for row in rows} == {(server.clock(), server.clock())}


# At the end of a phase.


def due(server: Serving, now: datetime) -> list[tuple[str, str, datetime]]:
    """Return the closings without a snapshot, as a server knows them that has just started."""
    fresh = Snapshots(lambda: server.state.boards, server.state.get(Schedules), "")
    with server.state.database.reading() as session:
        return [(each.split, each.phase, each.at) for each in fresh.due(session, now)]


def test_the_snapshots_of_several_phases_are_due_in_their_order(
    folder: Path, open_server: OpenServer
) -> None:
    settings = settings_of(folder)
    for split, *closings in ((PRIVATE, 2, 1), (OPEN, 1)):
        ends = [NOON + timedelta(hours=each) for each in closings]
        phases = [
            Phase(name=f"{hour}", opens=end - timedelta(minutes=59), closes=end)
            for hour, end in zip(closings, ends, strict=True)
        ]
        phases.append(Phase(name="after", opens=max(ends) + timedelta(minutes=1)))
        settings = adjusted(settings, split, phases=tuple(phases))
    server = open_server(settings)
    server.clock.turn(minutes=1)
    for split in (OPEN, PRIVATE):
        assert server.upload(OWNER, server.distinct(split), split).status_code == 201
    second = END + timedelta(hours=1)
    micro = timedelta(microseconds=1)
    first_two = [(PRIVATE, "1", END), (OPEN, "1", END)]
    assert due(server, END - micro) == []
    assert due(server, END) == due(server, second - micro) == first_two
    assert due(server, second) == [*first_two, (PRIVATE, "2", second)]
    server.clock.now = END
    with server.acting():
        pass  # they are taken first
    assert due(server, second) == [(PRIVATE, "2", second)]
    kept = snapshots(server)[0]
    assert (kept.title, kept.as_of) == ("1", END)
    with server.state.database.reading() as session:
        row = session.scalars(select(StoredSnapshot).order_by(StoredSnapshot.id)).first()
    assert row is not None
    assert (row.split, row.phase, row.created_at) == (PRIVATE, "1", END)


@pytest.mark.parametrize(
    ("received", "changed", "is_due"),
    [
        pytest.param(END - timedelta(seconds=1), None, True, id="received in the last second"),
        pytest.param(END, None, False, id="received after it"),
        pytest.param(NOON, END - timedelta(seconds=1), True, id="changed in the last second"),
        pytest.param(NOON, END, False, id="changed after it"),
    ],
)
def test_a_phase_counts_with_what_was_there_in_its_last_second(
    received: datetime,
    changed: datetime | None,
    folder: Path,
    open_server: OpenServer,
    *,
    is_due: bool,
) -> None:
    phases = (Phase(name="challenge", closes=CLOSES), Phase(name="after", opens=END))
    server = open_server(adjusted(settings_of(folder), phases=phases))
    server.clock.now = received
    server.upload(OWNER, server.distinct(PRIVATE), PRIVATE)
    if changed:  # by a process that takes no snapshots
        server.clock.now = changed
        state = server.state
        with Transactions(state.database, state.audit_log, server.clock).begin("x") as transaction:
            rename_team(transaction, "Red", NewTeam(name="Crimson"))
    assert due(server, END) == ([(PRIVATE, "challenge", END)] if is_due else [])


def test_a_server_looks_no_more_for_what_is_done(
    closing_settings: Settings, open_server: OpenServer
) -> None:
    server = open_server(closing_settings)
    publish(server, OWNER)
    server.clock.now = END
    looked_for = server.state.get(Snapshots)
    with server.state.database.reading() as session:
        assert len(looked_for.due(session, END)) == 1
    looked_for.take_if_due(server.state.transactions)
    with server.state.database.reading() as session:
        assert looked_for.due(session, END) == []
    with server.state.database.writing() as session:
        session.execute(delete(StoredSnapshot))
    with server.state.database.reading() as session:
        assert looked_for.due(session, END) == []
    assert len(due(server, END)) == 1


def test_a_phase_leaves_what_stood_when_it_ended(
    closing_settings: Settings, open_server: OpenServer
) -> None:
    server = open_server(closing_settings)
    early, late = publish(server, OWNER), server.upload(OTHER, server.distinct(PRIVATE), PRIVATE)
    server.clock.now = CLOSES
    server.ask(ORGANISER, "PUT", "/organiser/notice", json={"banner": "one second left"})
    assert snapshots(server) == []
    server.clock.now = END + timedelta(days=3)
    path = f"/submissions/{late.json()['submission']['id']}"
    assert server.ask(OTHER, "PATCH", path, json={"published": True}).status_code == 200
    (kept,) = snapshots(server)
    assert (kept.title, kept.as_of) == ("challenge", END)
    assert [row.submission_id for row in kept.leaderboard.rows] == [early]
    assert kept.leaderboard.rows[0].scores["success"] > 0, "they are released by then"
    assert len(server.ask(None, "GET", f"/splits/{PRIVATE}/leaderboard").json()["rows"]) == 2
    server.clock.turn(days=1)
    publish(server, OWNER, OPEN)
    assert len(snapshots(server)) == 1


def test_one_that_is_taken_before_the_end_holds_scores_back(
    closing_settings: Settings, open_server: OpenServer
) -> None:
    server = open_server(closing_settings)
    publish(server, OWNER)
    take(server, PRIVATE)
    server.clock.now = END
    (kept,) = snapshots(server)
    assert [(row.scores, row.rank) for row in kept.leaderboard.rows] == [({}, None)]


def test_it_is_taken_with_nobody_there(closing_settings: Settings, open_server: OpenServer) -> None:
    server = open_server(closing_settings)
    publish(server, OWNER)

    def look() -> None:
        server.state.get(Snapshots).take_if_due(server.state.transactions)

    server.clock.now = CLOSES
    look()
    assert snapshots(server) == []
    server.clock.now = END
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: look(), range(8)))
    twin = open_server(closing_settings, server.tokens)
    twin.clock.now = END + timedelta(minutes=1)
    twin.state.get(Snapshots).take_if_due(twin.state.transactions)
    assert [each.title for each in snapshots(server)] == ["challenge"]
    with server.state.database.reading() as session:
        taken = AuditEntry.action == "snapshot taken"
        assert session.scalars(select(AuditEntry.actor).where(taken)).all() == ["server"]


def test_a_running_server_takes_it_by_itself(
    closing_settings: Settings, open_server: OpenServer
) -> None:
    server = open_server(closing_settings)
    publish(server, OWNER)
    twin = open_server(closing_settings, server.tokens)
    server.clock.now = twin.clock.now = END

    async def serve() -> None:
        app = create_app(twin.state)
        async with app.router.lifespan_context(app):
            await asyncio.to_thread(wait_until, lambda: snapshots(server))

    asyncio.run(serve())


def test_one_that_is_rolled_back_is_taken_again(
    closing_settings: Settings, open_server: OpenServer
) -> None:
    server = open_server(closing_settings)
    publish(server, OWNER)
    server.clock.now = END
    taken = server.ask(ORGANISER, "POST", "/organiser/teams", json={"name": "Blue"})
    assert taken.status_code == 409
    assert snapshots(server) == []
    server.ask(ORGANISER, "POST", "/organiser/teams", json={"name": "Green"})
    assert len(snapshots(server)) == 1


@pytest.mark.parametrize(
    ("uploads", "set_late", "expected"),
    [
        pytest.param(True, False, ["challenge"], id="a phase that ended"),
        pytest.param(False, False, [], id="nothing was received"),
        pytest.param(True, True, [], id="its end was set after it: the board may have changed"),
    ],
)
def test_which_phases_leave_one(
    uploads: bool,  # noqa: FBT001
    set_late: bool,  # noqa: FBT001
    expected: list[str],
    server: Serving,
) -> None:
    if uploads:
        publish(server, OWNER)
    server.clock.now = END + timedelta(seconds=1) if set_late else CLOSES
    new = NewSchedule(phases=(Phase(name="challenge", closes=CLOSES),), release_scores="at-once")
    with server.acting() as transaction:
        server.state.get(Schedules).set(transaction, PRIVATE, new)
    server.clock.turn(hours=1)
    with server.acting() as transaction:
        add_team(transaction, "Green")
    assert [each.title for each in snapshots(server)] == expected


# With a row that cannot be read.


@pytest.fixture
def ended(folder: Path, database: str, open_server: OpenServer) -> Serving:
    """Return a server on each kind of database, with a phase that has just ended, and the next.

    One of the results that were published in it cannot be read.
    """
    phases = (Phase(name="challenge", closes=CLOSES), Phase(name="after", opens=END))
    server = open_server(adjusted(settings_of(folder, database), phases=phases))
    publish(server, OWNER)
    publish(server, OTHER)
    spoil(server)
    server.clock.now = END
    return server


def spoil(server: Serving) -> dict[str, Any]:
    """Overwrite the report of the result that was published last; return it."""
    with server.state.database.writing() as session:
        last = select(Submission).order_by(Submission.received_at.desc(), Submission.id)
        row = session.scalars(last.limit(1)).one()
        report, row.report = row.report, {}
    return report


def repair(server: Serving) -> None:
    """Give the result that cannot be read the report of the other one."""
    with server.state.database.writing() as session:
        rows = session.scalars(select(Submission).where(Submission.split == PRIVATE)).all()
        report, *_ = [row.report for row in rows if row.report]
        for row in rows:
            row.report = report


def look(server: Serving) -> None:
    """Do what a running server does every minute."""
    server.state.get(Snapshots).take_if_due(server.state.transactions)


def test_a_row_that_cannot_be_read_fails_no_write(ended: Serving, run: Run) -> None:
    with pytest.raises(SnapshotError, match="of test at the end of phase 'challenge' cannot be"):
        look(ended)
    added = ended.ask(ORGANISER, "POST", "/organiser/teams", json={"name": "Green"})
    assert added.status_code == 201
    assert ended.upload(OWNER).status_code == 201
    publish(ended, OWNER, OPEN)
    news = ended.ask(ORGANISER, "POST", "/organiser/news", json={"text": "It is over"})
    assert news.status_code == 201
    with ended.acting() as transaction:
        assert revoke_token(transaction, ended.tokens[OTHER][:11])
    assert snapshots(ended) == []


def test_a_schedule_that_cannot_be_read_fails_no_write_elsewhere(server_on: Serving) -> None:
    damaged = {"phases": [{"closes": "soon"}], "release_scores": "at-once", "paused": False}
    with server_on.state.database.writing() as session:
        session.add(SetSchedule(split=PRIVATE, **damaged, created_at=NOON))
    added = server_on.ask(ORGANISER, "POST", "/organiser/teams", json={"name": "Green"})
    assert added.status_code == 201
    assert server_on.upload(OWNER).status_code == 201
    with server_on.acting() as transaction:
        assert revoke_token(transaction, server_on.tokens[OTHER][:11])
    with pytest.raises(UnreadableValueError):
        look(server_on)


def test_a_write_does_not_try_again_what_has_failed(ended: Serving) -> None:
    statements: list[str] = []
    with ended.acting() as transaction:
        add_team(transaction, "Green")
    event.listen(
        ended.state.database.engine,
        "before_cursor_execute",
        lambda *about: statements.append(about[2]),
    )
    with ended.acting() as transaction:
        add_team(transaction, "Yellow")
    assert not any("FROM submission" in each for each in statements)


def test_uploads_after_the_end_are_not_counted_in_a_late_snapshot(ended: Serving) -> None:
    assert ended.upload(OWNER, ended.distinct(PRIVATE), PRIVATE).status_code == 201
    ended.clock.turn(days=3)
    repair(ended)
    look(ended)
    (kept,) = snapshots(ended)
    assert (kept.as_of, len(kept.leaderboard.rows)) == (END, 2)
    assert [row.submissions for row in kept.leaderboard.rows] == [1, 1]


def disqualify(server: Serving) -> None:
    with server.state.database.reading() as session:
        of_split = select(Submission).where(Submission.split == PRIVATE)
        shown = next(row.id for row in session.scalars(of_split) if row.report)
    with server.acting() as transaction:
        review(transaction, shown, "disqualified")


def tidy(server: Serving) -> None:
    """Delete the file of a submission that nobody published."""
    assert server.upload(OWNER).status_code == 201
    assert len(retention.tidy(server.state, 0)) == 1


def inspect(server: Serving) -> None:
    submission = server.upload(OWNER).json()["submission"]["id"]
    server.state.get(SubmissionService).inspect(submission, ORGANISER)


def rename(server: Serving) -> None:
    with server.acting() as transaction:
        rename_team(transaction, "Red", NewTeam(name="Crimson"))


def reschedule(server: Serving) -> None:
    phases = (Phase(name="challenge", closes=CLOSES), Phase(name="next", opens=END))
    server.clock.turn(seconds=1)
    with server.acting() as transaction:
        new = NewSchedule(phases=phases, release_scores="at-once")
        server.state.get(Schedules).set(transaction, PRIVATE, new)


@pytest.mark.parametrize(
    ("change", "is_missed"),
    [
        pytest.param(lambda server: server.upload(OWNER), False, id="an upload"),
        pytest.param(
            lambda server: [server.upload(who) for who in (OWNER, OTHER)],
            False,
            id="the same file from two teams",
        ),
        pytest.param(tidy, False, id="a file that was deleted"),
        pytest.param(inspect, False, id="values of episodes that somebody read"),
        pytest.param(disqualify, True, id="reviewed"),
        pytest.param(rename, True, id="a team's name"),
        pytest.param(reschedule, True, id="its phases"),
    ],
)
def test_a_changed_leaderboard_leaves_no_snapshot_and_that_is_told(
    change: Callable[[Serving], object], ended: Serving, *, is_missed: bool
) -> None:
    change(ended)
    repair(ended)
    look(ended)
    assert [each.title for each in snapshots(ended)] == ([] if is_missed else ["challenge"])
    with ended.state.database.reading() as session:
        missed = ended.state.get(Snapshots).missed(session, ended.clock())
    assert [each.phase for each in missed] == (["challenge"] if is_missed else [])
    take(ended, PRIVATE)
    with ended.state.database.reading() as session:
        assert ended.state.get(Snapshots).missed(session, ended.clock()) == []


def test_a_command_takes_one(server: Serving, folder: Path, run: Run) -> None:
    publish(server, OWNER)
    ends = {"name": "challenge", "closes": "2026-03-02T12:00:01Z"}
    schedule = {"phases": [ends], "release_scores": "at-once"}
    server.ask(ORGANISER, "PUT", f"/organiser/schedules/{PRIVATE}", json=schedule)
    outcome = run("server", "snapshot", str(folder), PRIVATE, "--title", TITLE)
    assert outcome.out.startswith(f"{PRIVATE}: snapshot 2, {TITLE}, as of 20"), outcome.err
    assert [each.title for each in snapshots(server)] == ["challenge", TITLE]


def test_a_command_goes_on_without_one(server: Serving, folder: Path, run: Run) -> None:
    damaged = publish(server, OWNER)
    spoil(server)
    ends = {"name": "challenge", "closes": "2026-03-02T12:00:01Z"}
    schedule = {"phases": [ends], "release_scores": "at-once"}
    server.ask(ORGANISER, "PUT", f"/organiser/schedules/{PRIVATE}", json=schedule)
    outcome = run("server", "team", "add", str(folder), "Green")
    assert (outcome.status, "Traceback" in outcome.err) == (0, False)
    assert snapshots(server) == []
    faults = [each.what for each in examine(folder) if each.kind == "fault"]
    assert any(damaged in each and "cannot be read" in each for each in faults), faults


# Afterwards.


def test_a_download_is_verified(server: Serving, tmp_path: Path, run: Run) -> None:
    publish(server, OWNER, OPEN)
    take(server)
    key, file = tmp_path / "key.pem", tmp_path / "snapshot.json"
    key.write_text(server.state.signer.public_pem)
    (kept,) = envelopes(server, OPEN)
    file.write_text(kept.model_dump_json(indent=1))
    outcome = run("verify", str(file), "--key", str(key))
    assert (outcome.status, outcome.err) == (0, "")
    assert f"the server's leaderboard of {OPEN} as of " in outcome.out
    assert "  1   57.22  Walker, Blue\n" in outcome.out
    file.write_text(altered(kept).model_dump_json())
    assert run("verify", str(file), "--key", str(key)).status == 1
    wrong = run("verify", str(file), "--key", str(key), "--submission", str(file))
    assert (wrong.status, "--submission is for receipts" in wrong.err) == (2, True)


def test_those_of_a_revoked_key_are_signed_again(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    take(server, title="before")
    server.clock.turn(hours=1)
    take(server, title="after")
    rotate_key(settings_of(folder), "test", "the yearly change")
    after = open_server(settings_of(folder), server.tokens)
    revocation = KeyRevocation(since=NOON + timedelta(minutes=30), reason="stolen")
    with after.acting() as transaction:
        assert revoke_key(transaction, server.state.signer.key_id, revocation) == 1
    keys = [KeyReport.model_validate(key) for key in after.ask(None, "GET", "/keys").json()]
    kept = envelopes(after, OPEN)
    assert [verify_by_history(each, keys).key_id for each in kept] == [key.key_id for key in keys]
    stolen = server.state.signer.sign_again(kept[1])
    with pytest.raises(NotGenuineError, match="but the snapshot is as of"):
        verify_by_history(stolen, keys)
    assert [each.kind for each in examine(folder) if each.check == "snapshots"] == ["ok"]


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        pytest.param(None, "1 snapshot verified", id="none"),
        pytest.param("bytes", "snapshot 1 of val_unseen: the signature does not match", id="bytes"),
        pytest.param("envelope", "snapshot 1 of val_unseen: it was changed", id="no envelope"),
        pytest.param("title", "val_unseen: the snapshot differs from its row", id="its row"),
    ],
)
def test_the_doctor_verifies_them(
    damage: str | None, told: str, server: Serving, folder: Path
) -> None:
    take(server)
    with server.state.database.writing() as session:
        row = session.scalars(select(StoredSnapshot)).one()
        if damage == "bytes":
            changed = altered(Envelope.model_validate(row.envelope))
            row.envelope = changed.model_dump(mode="json")
        if damage == "envelope":
            row.envelope = {"title": TITLE}
        if damage == "title":
            row.title = "another"
    found = [each for each in examine(folder) if each.check == "snapshots"]
    assert any(told in each.what for each in found)
    assert [each.kind for each in found] == (["ok"] if damage is None else ["fault", "ok"])
