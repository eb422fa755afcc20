"""A server in a process of its own, people who use it, and a network that fails them."""

import json
import os
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Literal, Self
from urllib.parse import urlsplit

import pytest

from fixtures.servers import make_folder
from reverie_eval.client.logins import login_path
from reverie_eval.schemas.organising import TokenKind
from reverie_eval.schemas.service import Role
from reverie_eval.server.audit.log import AuditLog
from reverie_eval.server.audit.signing import Signer, load_key
from reverie_eval.server.opening import acting
from reverie_eval.server.settings import Settings, load_settings
from reverie_eval.server.store.database import Database
from tests.support.acting import add_person, add_team, create_token
from tests.support.flat_world import Outcome
from tests.support.forking import run_command
from tests.support.serving import running
from tests.support.waiting import PATIENCE

PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY")
UPLOAD = b"POST /api/v1/splits/test/submissions"


@dataclass(frozen=True)
class RealServer:
    """A server that listens, and a way to its database behind its back."""

    url: str
    settings: Settings
    database: Database
    log: Path
    serial: Iterator[int] = field(default_factory=count)

    @property
    def audit_log(self) -> AuditLog:
        """What checks its audit log."""
        key = load_key(self.settings.path(self.settings.signing_key))
        return AuditLog(Signer(key, self.settings.title))

    def newcomer(self, role: Role = "participant") -> str:
        """Add a team with a person in it, and return the person's name."""
        number = next(self.serial)
        name, address = f"Person {number}", f"person{number}@example.org"
        with acting(self.settings, "test") as transaction:
            add_team(transaction, f"Team of {name}")
            add_person(transaction, f"Team of {name}", name, role, address)
        return name

    def mint(
        self, name: str, kind: TokenKind = "access", expires_at: datetime | None = None
    ) -> str:
        """Return a new token of somebody's."""
        with acting(self.settings, "test") as transaction:
            return create_token(transaction, name, kind, expires_at).token


@pytest.fixture
def at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty folder, signed in nowhere; return where logins are kept."""
    for name in ("REVERIE_EVAL_SERVER", "REVERIE_EVAL_TOKEN", *PROXIES):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)
    return login_path()


@pytest.fixture(scope="session")
def real_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RealServer]:
    """Run a server on the demo world."""
    folder = tmp_path_factory.mktemp("real") / "server"
    make_folder(folder)
    with (
        running(folder, REVERIE_EVAL_LIMITS__REQUESTS_PER_MINUTE="1000000") as (_, url),
        closing(Database(load_settings(folder).database_url)) as database,
    ):
        yield RealServer(url, load_settings(folder), database, folder / "log")


def installed(*words: str, variables: Mapping[str, str] | None = None) -> Outcome:
    """Run the installed command as a process of its own."""
    return run_command(*words, folder=Path.cwd(), environment=os.environ | (variables or {}))


class _Listener:
    """Listens at a port of its own, and takes one connection after the other."""

    def __init__(self) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._thread = threading.Thread(target=self._run)
        self.url = f"http://127.0.0.1:{self._listening.getsockname()[1]}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listening.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._listening.close()

    def _run(self) -> None:
        while True:
            try:
                near, _ = self._listening.accept()
            except OSError:
                return
            with near, suppress(OSError):  # who called may have gone
                self._serve(near)

    def _serve(self, near: socket.socket) -> None:
        raise NotImplementedError


Fault = Literal["before", "upload", "reply", "half the reply", "late"] | bytes
"""Where the connection of an upload is cut, or that its reply comes after nobody waits for it any
more; bytes are answered in the server's place."""


class Proxy(_Listener):
    """Brings requests to a server one by one, and fails uploads as planned, one after the other."""

    def __init__(self, server: str, *faults: Fault) -> None:
        super().__init__()
        target = urlsplit(server)
        self._target = target.hostname, target.port
        self._faults = list(faults)
        self.uploads: list[bytes] = []
        """What was sent, as far as it came."""

    def _serve(self, near: socket.socket) -> None:
        head, rest = _head(near)
        is_upload = head.startswith(UPLOAD)
        fault = self._faults.pop(0) if is_upload and self._faults else None
        size = _length(head) // 2 if fault == "upload" else _length(head)
        body = (rest + _exactly(near, size - len(rest)))[:size]
        if is_upload:
            self.uploads.append(head + body)
        if isinstance(fault, bytes):
            near.sendall(fault)
        elif fault != "before":
            self._bring(near, head + body, fault)

    def _bring(self, near: socket.socket, request: bytes, fault: Fault | None) -> None:
        with socket.create_connection(self._target) as far:
            far.sendall(request.replace(b"Connection: keep-alive", b"Connection: close", 1))
            if fault == "upload":
                return
            reply = b"".join(iter(lambda: far.recv(1 << 16), b""))
        if fault == "late":
            near.settimeout(PATIENCE)
            assert near.recv(1) == b"", "whoever waited has gone"
        if fault != "reply":
            near.sendall(reply[: len(reply) // 2] if fault == "half the reply" else reply)


class Script(_Listener):
    """Answers request after request as it was told to, the last answer for ever."""

    def __init__(self, *answers: bytes) -> None:
        super().__init__()
        self._answers = list(answers)
        self.requests: list[bytes] = []

    def _serve(self, near: socket.socket) -> None:
        head, rest = _head(near)
        self.requests.append(head + rest + _exactly(near, _length(head) - len(rest)))
        near.sendall(self._answers.pop(0) if len(self._answers) > 1 else self._answers[0])


def answer(status: str, content: bytes = b"", kind: str = "text/html", *headers: str) -> bytes:
    """Lay out a reply."""
    lines = [f"HTTP/1.1 {status}", f"Content-Type: {kind}", f"Content-Length: {len(content)}"]
    return "\r\n".join([*lines, *headers, "Connection: close", "", ""]).encode() + content


def problem(status: str, code: str, detail: str, *headers: str) -> bytes:
    """Lay out a reply as the server words what it refuses."""
    number, _, title = status.partition(" ")
    document = {"title": title, "status": int(number), "detail": detail, "code": code}
    content = json.dumps(document).encode()
    return answer(status, content, "application/problem+json", *headers)


def _head(near: socket.socket) -> tuple[bytes, bytes]:
    """Read a request's head, and return what came of the body with it."""
    received = b""
    while b"\r\n\r\n" not in received and (piece := near.recv(1 << 16)):
        received += piece
    head, end, rest = received.partition(b"\r\n\r\n")
    return head + end, rest


def _length(head: bytes) -> int:
    return int(head.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0] or 0)


def _exactly(near: socket.socket, size: int) -> bytes:
    received = b""
    while len(received) < size and (piece := near.recv(size - len(received))):
        received += piece
    return received
