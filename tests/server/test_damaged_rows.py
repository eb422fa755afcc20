"""A stored row that cannot be read: only what shows that row fails, and it is said."""

import sqlite3
from collections.abc import Mapping
from contextlib import closing

import pytest
from sqlalchemy import text

from reverie_eval.server.operations import health
from tests.support.acting import review
from tests.support.entries import entered, named, report_result
from tests.support.server_data import faults
from tests.support.serving import GROUNDING, OPEN, ORGANISER, OTHER, PRIVATE, CopyServer, Serving
from tests.support.visiting import said, signed_in

CANNOT = f"The {OPEN} leaderboard cannot be shown: a result on it cannot be read."
READ_FOR_ALL = (
    "/",
    "/episodes",
    "/feed.atom",
    "/guide/rules",
    "/submit",
    "/api/v1/splits",
    "/api/v1/news",
    "/desk",
    "/desk/phases",
    "/desk/quotas",
    "/desk/corrections",
    "/desk/snapshots",
    "/metrics",
    f"/api/v1/splits/{OPEN}",
    f"/api/v1/splits/{OPEN}/snapshots",
    f"/splits/{PRIVATE}",
    f"/splits/{PRIVATE}/feed.atom",
    f"/splits/{PRIVATE}/chart",
    f"/api/v1/splits/{PRIVATE}/leaderboard",
    f"/api/v1/splits/{PRIVATE}/leaderboard.csv",
)
"""What shows several leaderboards, or another one than the damaged."""
OF_ORGANISERS = {"/desk"}
"""What may fail, for them alone: the overview has the time of the last upload to each split."""
OF_THE_BOARD = (
    f"/splits/{OPEN}",
    f"/splits/{OPEN}/chart",
    f"/splits/{OPEN}/latex",
    f"/api/v1/splits/{OPEN}/leaderboard",
    f"/api/v1/splits/{OPEN}/leaderboard.csv",
)
DAMAGES = {
    "no JSON": "submission SET report = '{'",
    "a report without scores": "submission SET report = '{\"x\": 1}'",
    "a report that is a list": "submission SET report = '[]'",
    "a score that is a text": "submission SET report = json_set(report, '$.scores.rgspl', 'high')",
    "a report that is not UTF-8": "submission SET report = CAST(x'7bff7d' AS TEXT)",
    "a method without a name": "submission SET method = '{}'",
    "a method whose name is a number": "submission SET method = '{\"name\": 5}'",
    "a method that is not UTF-8": "submission SET method = CAST(x'ff' AS TEXT)",
    "no time of publication": "submission SET published_at = 'once'",
    "no time of arrival": "submission SET received_at = 'once'",
    "a number as a time": "submission SET anonymous_until = 7",
    "a reported result without JSON": "reported_result SET scores = '{'",
    "a reported score that is a text": 'reported_result SET scores = \'{"rgspl": "high"}\'',
    "a reported method without a name": "reported_result SET method = '{}'",
    "a source that is not UTF-8": "reported_result SET source = CAST(x'ff' AS TEXT)",
}
"""By what becomes of a value."""
ON_POSTGRESQL = {
    "a report without scores": "submission SET report = '{\"x\": 1}'",
    "a report that is a list": "submission SET report = '[]'",
    "a method without a name": "submission SET method = '{}'",
    "a time after all years": "submission SET anonymous_until = 'infinity'",
    "a reported score that is a text": 'reported_result SET scores = \'{"rgspl": "high"}\'',
}
"""PostgreSQL refuses the others itself."""


@pytest.fixture(scope="module")
def published(shared: Serving) -> Serving:
    """Publish results on two splits, and take a snapshot of each."""
    return publish(shared)


def publish(server: Serving) -> Serving:
    walker = entered(server, shows_episodes=True)
    entered(server, split=PRIVATE, who=OTHER, **named("Runner"))
    report_result(server, "FAST", rgspl=0.25)
    with server.acting(ORGANISER) as transaction:
        review(transaction, walker, "verified")
    for split in (OPEN, PRIVATE):
        new = {"split": split, "title": "The first month"}
        assert server.ask(ORGANISER, "POST", "/organiser/snapshots", json=new).is_success
    return server


def damage(server: Serving, change: str) -> None:
    """Change stored values of one split."""
    statement = f"UPDATE {change} WHERE split = '{OPEN}'"
    if server.state.database.is_sqlite:
        server.state.database.close()
        path = server.state.settings.folder / "server.db"
        with closing(sqlite3.connect(path)) as file, file:
            assert file.execute(statement).rowcount == 1
    else:
        with server.state.database.writing() as session:
            session.execute(text(statement))


def refused(server: Serving, *paths: str) -> Mapping[str, tuple[int, str]]:
    """Return status and code of each reply that is not a success, to an organiser's browser."""
    visitor = signed_in(server, ORGANISER)
    replies = {path: visitor.get(path) for path in paths}
    return {
        path: (reply.status_code, "damaged" if "server restore" in reply.text else reply.text)
        for path, reply in replies.items()
        if not reply.is_success
    }


def check_that_only_its_board_fails(server: Serving) -> None:
    assert refused(server, *READ_FOR_ALL).keys() <= OF_ORGANISERS
    assert refused(server, *OF_THE_BOARD) == dict.fromkeys(OF_THE_BOARD, (503, "damaged"))
    home = said(server.client.get("/"))
    assert home.count(CANNOT) == 1
    assert "Runner Red" in home  # on the other leaderboard
    feed = server.client.get("/feed.atom").text
    assert f"<subtitle>Without results on {OPEN}, which cannot be read</subtitle>" in feed
    assert "Runner" in feed
    assert "Walker" not in home + feed
    failed = server.client.get("/healthz").json()
    assert failed["failed"] == ["leaderboards"]
    assert "server doctor" in failed["remedies"]["leaderboards"]
    assert server.client.get("/readyz").status_code == 200  # the others can be used


@pytest.mark.parametrize("change", DAMAGES.values(), ids=DAMAGES)
def test_a_row_that_cannot_be_read_fails_on_its_own_leaderboard_only(
    change: str, published: Serving, copy_server: CopyServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    server = copy_server(published)
    damage(server, change)
    check_that_only_its_board_fails(server)
    assert server.client.get(f"/splits/{PRIVATE}/boards/{GROUNDING}").status_code == 200
    server.state.database.close()
    assert faults(server.state.settings.folder)


@pytest.mark.parametrize("kind_of_database", ["postgresql"])
@pytest.mark.parametrize("change", ON_POSTGRESQL.values(), ids=ON_POSTGRESQL)
def test_it_is_the_same_on_postgresql(
    change: str, server_on: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    damage(publish(server_on), change)
    check_that_only_its_board_fails(server_on)
    settings = server_on.state.settings
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", settings.database)
    assert faults(settings.folder)


ENVELOPES = {
    "no JSON": "'{'",
    "another shape": "'{}'",
    "a list": "'[]'",
    "not UTF-8": "CAST(x'ff' AS TEXT)",
}


@pytest.mark.parametrize("envelope", ENVELOPES.values(), ids=ENVELOPES)
def test_a_snapshot_that_cannot_be_read_fails_alone(
    envelope: str, published: Serving, copy_server: CopyServer
) -> None:
    server = copy_server(published)
    damage(server, f"snapshot SET envelope = {envelope}")
    paths = [f"/splits/{OPEN}/snapshots/1", f"/api/v1/splits/{OPEN}/snapshots/1.csv"]
    assert refused(server, *paths) == dict.fromkeys(paths, (503, "damaged"))
    api = f"/api/v1/splits/{OPEN}/snapshots/1"
    told = server.client.get(api)
    assert told.status_code == 200 or told.json()["code"] == "damaged"  # it is not opened there
    others = [*READ_FOR_ALL, *OF_THE_BOARD, f"/api/v1/splits/{PRIVATE}/snapshots/1"]
    assert refused(server, *others) == {}
    server.state.database.close()
    assert faults(server.state.settings.folder)
