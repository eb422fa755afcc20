"""Failures of ours: whatever breaks on the way, nothing is spent, and sending again is safe."""

import errno
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from sqlalchemy import event, select

from reverie_eval.server.audit.log import AuditLog, entries
from reverie_eval.server.audit.signing import Signer
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.intake import intake, quotas
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.uploads import FolderUploads
from tests.support.serving import OPEN, ORGANISER, OTHER, OWNER, PRIVATE, Serving, submission_for


def upload(server: Serving) -> Any:
    return server.upload(OWNER, submission_for(PRIVATE), PRIVATE, key="mine")


def kept(server: Serving) -> tuple[int, int]:
    """Return how many submissions there are, and how many the audit log knows of."""
    with server.state.database.reading() as session:
        assert not list(server.state.audit_log.broken_links(session))
        recorded = [entry for entry in entries(session) if entry.action == "submitted"]
        return len(session.scalars(select(Submission)).all()), len(recorded)


def left(server: Serving) -> int:
    quota = server.ask(OWNER, "GET", f"/splits/{PRIVATE}").json()["quota"]
    remaining: int = quota["remaining"]
    return remaining


@pytest.mark.parametrize(
    ("owner", "step"),
    [
        pytest.param(Board, "read", id="reading"),
        pytest.param(Board, "score", id="scoring"),
        pytest.param(Board, "report", id="rounding"),
        pytest.param(FolderUploads, "staged", id="keeping the file"),
        pytest.param(quotas, "usage_of", id="counting the quota"),
        pytest.param(Signer, "sign", id="signing"),
        pytest.param(AuditLog, "append", id="the audit log"),
        pytest.param(View, "report", id="wording the reply"),
    ],
)
def test_a_failing_step_leaves_nothing(
    server_on: Serving, owner: object, step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("the secret is 1999999937")

    with monkeypatch.context() as broken:
        broken.setattr(owner, step, fail)
        reply = upload(server_on)
        assert (reply.status_code, reply.json()["code"]) == (500, "internal")
        assert "1999999937" not in reply.text
    assert kept(server_on) == (0, 0)
    assert left(server_on) == 2
    assert upload(server_on).status_code == 201
    assert kept(server_on) == (1, 1)
    assert left(server_on) == 1


def test_a_disk_without_room_for_the_file_leaves_nothing(
    server_on: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "/srv/secret/path")

    with monkeypatch.context() as full:
        full.setattr(FolderUploads, "staged", fail)
        reply = upload(server_on)
    assert (reply.status_code, reply.json()["code"]) == (507, "storage-full")
    assert "/srv" not in reply.text
    assert kept(server_on) == (0, 0)
    assert upload(server_on).status_code == 201


def test_a_database_without_room_leaves_nothing(server: Serving) -> None:
    def allow_no_further_page(connection: Any) -> None:
        connection.exec_driver_sql("PRAGMA max_page_count = 1")  # or as many as there are

    engine = server.state.database.engine
    event.listen(engine, "begin", allow_no_further_page)
    try:
        replies = [server.upload(OWNER, server.distinct()) for _ in range(20)]
    finally:
        event.remove(engine, "begin", allow_no_further_page)
    refused = [reply.json()["code"] for reply in replies if reply.status_code == 507]
    accepted = sum(reply.status_code == 201 for reply in replies)
    assert refused == ["storage-full"] * (20 - accepted)
    assert accepted < 20
    assert kept(server) == (accepted, accepted)


def test_a_commit_that_fails_leaves_nothing(server_on: Serving) -> None:
    def fail(_: object) -> None:
        raise RuntimeError("the disk is full")

    engine = server_on.state.database.engine
    event.listen(engine, "commit", fail)
    try:
        assert upload(server_on).status_code == 500
    finally:
        event.remove(engine, "commit", fail)
    assert kept(server_on) == (0, 0)
    assert left(server_on) == 2
    assert upload(server_on).status_code == 201


@pytest.fixture
def losing_replies(server_on: Serving) -> Iterator[Callable[[], None]]:
    """Return what makes every commit work and then fail, as on a connection that breaks."""
    dialect = server_on.state.database.engine.dialect
    commit = type(dialect).do_commit

    def commit_and_fail(connection: Any) -> None:
        commit(dialect, connection)
        raise ConnectionError("nobody heard that it worked")

    yield lambda: setattr(dialect, "do_commit", commit_and_fail)
    if "do_commit" in vars(dialect):
        del dialect.do_commit


def test_a_commit_that_nobody_hears_of_counts_once(
    server_on: Serving, losing_replies: Callable[[], None]
) -> None:
    losing_replies()
    failed = upload(server_on)
    assert failed.status_code == 500
    assert "no file is counted twice" in failed.json()["detail"]
    del server_on.state.database.engine.dialect.do_commit
    again = upload(server_on)
    assert (again.status_code, again.json()["is_repeat"]) == (200, True)
    assert kept(server_on) == (1, 1)
    assert left(server_on) == 1


def test_a_reply_that_fails_after_the_commit_counts_once(
    server_on: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    submit = intake.Intake.submit

    def submit_and_fail(*given: Any, **named: Any) -> None:
        submit(*given, **named)
        raise RuntimeError("after the commit")

    with monkeypatch.context() as broken:
        broken.setattr(intake.Intake, "submit", submit_and_fail)
        assert upload(server_on).status_code == 500
    again = upload(server_on)
    assert (again.status_code, again.json()["is_repeat"]) == (200, True)
    assert kept(server_on) == (1, 1)


def test_an_upload_whose_turn_never_comes_is_no_deadlock(server: Serving) -> None:
    """What a failed writer held is free again."""
    with pytest.raises(RuntimeError, match="mine"), server.state.database.writing():
        raise RuntimeError("mine")
    assert upload(server).status_code == 201


def test_a_clock_that_was_a_year_ahead_spoils_nothing(server_on: Serving) -> None:
    ahead = server_on.upload(OWNER, server_on.distinct()).json()["submission"]["id"]
    server_on.clock.turn(days=400)
    of_then = server_on.upload(OTHER, server_on.distinct()).json()["submission"]["id"]
    for who, submission_id in ((OWNER, ahead), (OTHER, of_then)):
        server_on.ask(who, "PATCH", f"/submissions/{submission_id}", json={"published": True})
    taken = {"split": OPEN, "title": "then"}
    assert server_on.ask(ORGANISER, "POST", "/organiser/snapshots", json=taken).status_code == 201
    server_on.clock.turn(days=-400)
    assert server_on.upload(OWNER, server_on.distinct()).status_code == 201
    rows = server_on.ask(OWNER, "GET", f"/splits/{OPEN}/leaderboard").json()["rows"]
    assert {row["submission_id"] for row in rows} >= {ahead, of_then}
    for path in ("/", f"/splits/{OPEN}", "/healthz"):
        assert server_on.client.get(path).status_code == 200, path
    with server_on.state.database.reading() as session:
        assert not list(server_on.state.audit_log.broken_links(session))
