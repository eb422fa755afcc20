"""Whether the server is well, and how it ends."""

import asyncio
import json
import re
import signal
import socket
from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from reverie_eval.schemas.service import HealthReport
from reverie_eval.server.app import jobs_of
from reverie_eval.server.audit.signing import Signer
from reverie_eval.server.operations import health
from reverie_eval.server.operations.health import Health
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.uploads import FolderUploads
from tests.support.processes import Laptop, Server
from tests.support.serving import GOOD, OPEN, ORGANISER, PRIVATE, Serving
from tests.support.waiting import PATIENCE, wait_until


def fail(*_: object, **__: object) -> None:
    raise RuntimeError("the target is 1999999937")


def health_of(server: Serving) -> tuple[int, dict[str, Any]]:
    reply = server.client.get("/healthz")
    return reply.status_code, reply.json()


WELL = (200, {"status": "ok", "failed": [], "remedies": {}, "jobs": []})


@pytest.mark.parametrize(
    ("owner", "step", "failed"),
    [
        (Board, "read", [f"scoring of {name}" for name in (PRIVATE, "val_seen", OPEN)]),
        (Board, "score", [f"scoring of {name}" for name in (PRIVATE, "val_seen", OPEN)]),
        (Board, "report", [f"scoring of {name}" for name in (PRIVATE, "val_seen", OPEN)]),
        (Signer, "sign", [f"scoring of {name}" for name in (PRIVATE, "val_seen", OPEN)]),
        (Database, "writing", ["database"]),
        (FolderUploads, "get", ["uploads"]),
    ],
)
def test_health_tries_all_that_an_upload_needs(
    owner: object, step: str, failed: list[str], server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    with monkeypatch.context() as broken:
        broken.setattr(owner, step, fail)
        status, report = health_of(server)
        assert (status, report["status"], report["failed"]) == (503, "unhealthy", failed)
    assert health_of(server) == WELL


def test_health_notices_what_scores_wrongly(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    report = Board.report

    def unrounded(board: Board, *scored: Any) -> Any:
        told = report(board, *scored)
        shifted = {key: value + 1 / 3 for key, value in told.scores.items()}
        return told.model_copy(update={"scores": shifted | {"path_length": 0.0}})

    monkeypatch.setattr(Board, "report", unrounded)
    assert health_of(server)[1]["failed"] == [f"scoring of {PRIVATE}"]


def test_health_writes_into_the_folder_of_uploads_and_leaves_nothing(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    folder = server.state.settings.folder / "uploads"
    assert health_of(server) == WELL
    assert not folder.exists()
    folder.mkdir()
    assert health_of(server) == WELL
    assert list(folder.rglob("*")) == []
    folder.rmdir()
    folder.write_text("no folder")
    assert health_of(server)[1]["failed"] == ["uploads"]


def test_health_is_looked_at_once_for_many_who_ask(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, reads = Board.read, []

    def counting(*given: Any) -> Any:
        reads.append(given)
        return read(*given)

    monkeypatch.setattr(Board, "read", counting)
    monkeypatch.setattr(health, "time", SimpleNamespace(monotonic=lambda: 1000.0))
    assert [health_of(server) for _ in range(5)] == [WELL] * 5
    assert len(reads) == 3


def test_who_asks_meanwhile_waits_for_the_same_result(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    examined = []

    async def examine(checked: Health) -> HealthReport:
        examined.append(checked)
        await asyncio.sleep(0)  # now the others come
        return HealthReport(status="ok")

    async def ask_thrice() -> list[HealthReport]:
        checked = Health(server.state, jobs_of(server.state))
        return await asyncio.gather(*(checked.report() for _ in range(3)))

    monkeypatch.setattr(Health, "_examine", examine)
    first, second, third = asyncio.run(ask_thrice())
    assert first is second is third
    assert len(examined) == 1


def test_health_is_looked_at_again_after_ten_seconds(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    seconds = 1000.0
    monkeypatch.setattr(health, "time", SimpleNamespace(monotonic=lambda: seconds))
    assert health_of(server) == WELL
    monkeypatch.setattr(Board, "score", fail)
    seconds += 9.9
    assert health_of(server) == WELL
    seconds += 0.1
    assert health_of(server)[0] == 503


def test_health_does_not_wait_for_what_hangs(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    assert health_of(server) == WELL  # from now on, what does not hang takes no time
    hanging, seconds = ["database", "uploads"], 0.5
    with server.state.database.writing():  # and everybody else waits
        while (found := _found_within(seconds, server, monkeypatch))["failed"] != hanging:
            seconds *= 2  # on a slow machine, what does not hang takes its time as well
            assert seconds < PATIENCE, found
    late, remedies = f"not done after {seconds:g} seconds", found["remedies"]
    assert remedies["database"].startswith(f"{late}: the machine, the database or the store is too")
    assert remedies["uploads"] == f"not checked, because 'database' was {late}"


def _found_within(
    seconds: float, server: Serving, monkeypatch: pytest.MonkeyPatch
) -> Mapping[str, Any]:
    monkeypatch.setattr(health, "SECONDS_TO_ANSWER", seconds)
    return health_of(server)[1]


def test_health_leaves_no_trace(server: Serving) -> None:
    before = server.ask(ORGANISER, "GET", "/organiser/audit").json()
    assert health_of(server) == WELL
    assert server.ask(ORGANISER, "GET", "/organiser/audit").json() == before
    assert server.ask(ORGANISER, "GET", "/submissions").json() == []


class Running(NamedTuple):
    """A server of its own process."""

    server: Server
    port: int
    token: str


@pytest.fixture(params=["1", "2"], ids=["one process", "two workers"])
def running(laptop: Laptop, request: pytest.FixtureRequest) -> Iterator[Running]:
    """Run the demo server."""
    with laptop.serving("--workers", request.param) as server:
        token = re.search(r"rv_[\w-]{43}", server.said)
        assert token is not None
        yield Running(server, int(server.url.rpartition(":")[2]), token[0])
        log = server.log.read_text()
        assert [line for line in log.splitlines() if json.loads(line)["level"] == "error"] == []
        assert token[0] not in log


def test_an_upload_on_its_way_is_answered_before_the_end(
    running: Running,
) -> None:
    server, port, token = running
    process = server.process
    head = (
        f"POST /api/v1/splits/{OPEN}/submissions?name=x HTTP/1.1\r\nHost: server\r\n"
        f"Authorization: Bearer {token}\r\nContent-Length: {len(GOOD)}\r\n"
        "Expect: 100-continue\r\n\r\n"
    )
    with (
        socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as upload,
        socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as idle,
    ):
        upload.sendall(head.encode())
        assert upload.recv(1000).startswith(b"HTTP/1.1 100")  # it is being read
        process.send_signal(signal.SIGTERM)
        assert idle.recv(1) == b""
        wait_until(lambda: refuses(port))  # one worker may stop listening before the other
        assert process.poll() is None
        upload.sendall(GOOD)
        reply = b"".join(iter(lambda: upload.recv(1 << 16), b""))
    assert reply.startswith(b"HTTP/1.1 201")
    assert b'"receipt"' in reply
    assert process.wait(PATIENCE) == 0


def refuses(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=PATIENCE).close()
    except ConnectionRefusedError:
        return True
    return False


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_told_to_stop_it_stops(number: int, running: Running) -> None:
    process = running.server.process
    process.send_signal(number)
    assert process.wait(PATIENCE) == 0
