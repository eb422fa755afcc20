"""Limits: whatever is sent, and however slowly, the answer comes, and the server goes on.

Against a server in a process of its own, over plain sockets: nobody else sends such things. It has
room for one upload and for one that waits, so whatever does not give back its place stops all that
come after it.
"""

import asyncio
import codecs
import encodings
import json
import pkgutil
import re
import socket
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock

import httpx
import pytest
import uvicorn
from starlette.types import Message, Receive, Scope, Send

from fixtures.servers import make_folder
from reverie_eval.server import run
from reverie_eval.server.app import create_app
from reverie_eval.server.http import middleware
from reverie_eval.server.http.callers import begin, exchange_of
from reverie_eval.server.http.middleware import MOST_AT_ONCE, BodyLimits
from reverie_eval.server.opening import acting
from reverie_eval.server.run import listen
from reverie_eval.server.settings import load_settings
from tests.support.acting import add_person, add_team, create_token
from tests.support.serving import GOOD, NO_TLS, OPEN, OWNER, Serving, running
from tests.support.waiting import PATIENCE, wait_until

SECONDS = 1
"""That a hasty server gives to a body."""
MEBIBYTE = 1 << 20
SMALL = MEBIBYTE // 4
"""What a request may send that is no upload."""


class Small:
    """A server with room for one upload."""

    def __init__(self, port: int, token: str, organiser: str, log: Path) -> None:
        self.port = port
        self.token = token
        self.organiser = organiser
        """The token of who may read the metrics."""
        self.log = log

    def connect(self) -> socket.socket:
        """Open a connection."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE)

    def head(self, path: str, *headers: str, method: str = "POST") -> bytes:
        """Return a request up to its body."""
        shown = f"Authorization: Bearer {self.token}"
        lines = [f"{method} {path} HTTP/1.1", "Host: server", shown, *headers, "", ""]
        return "\r\n".join(lines).encode()

    def upload(self, *headers: str) -> bytes:
        """Return an upload up to its body."""
        return self.head("/api/v1/splits/val_unseen/submissions?name=x", *headers)

    def logged(self) -> Sequence[Mapping[str, Any]]:
        """Return the lines of its log, of which the last may be on its way."""
        whole, _, _ = self.log.read_text().rpartition("\n")
        return [json.loads(line) for line in whole.splitlines()]

    def hung_up(self, route: str) -> Sequence[Mapping[str, Any]]:
        """Return the lines about requests of a route whose senders were gone before the reply."""
        gone = [line for line in self.logged() if line.get("outcome") == "hung-up"]
        return [line for line in gone if line["route"] == route]

    def uploads_waiting(self) -> int:
        """Return how many uploads wait for their turn."""
        headers = {"Authorization": f"Bearer {self.organiser}"}
        url = f"http://127.0.0.1:{self.port}/metrics"
        metrics = httpx.get(url, headers=headers, timeout=PATIENCE, verify=NO_TLS).text
        (line,) = re.findall(r"^reverie_eval_uploads_waiting (\S+)$", metrics, re.MULTILINE)
        return int(float(line))


@contextmanager
def serving_few(folder: Path, **limits: int) -> Iterator[Small]:
    """Run a server with room for one upload and for one that waits."""
    make_folder(folder)
    with acting(load_settings(folder), "test") as transaction:
        add_team(transaction, "Blue")
        add_person(transaction, "Blue", "Ada")
        add_person(transaction, "Blue", "Olga", "organiser")
        token, organiser = (create_token(transaction, name).token for name in ("Ada", "Olga"))
    limits = {
        "UPLOAD_MEBIBYTES": 1,
        "UNPACKED_MEBIBYTES": 2,
        "REQUESTS_PER_MINUTE": 1_000_000,
        "UPLOADS_AT_ONCE": 1,
        "UPLOADS_WAITING": 1,
        "KIBIBYTES_PER_SECOND": 1,
        **limits,
    }
    variables = {f"REVERIE_EVAL_LIMITS__{name}": str(value) for name, value in limits.items()}
    with running(folder, **variables) as (_, url):
        yield Small(int(url.rpartition(":")[2]), token, organiser, folder / "log")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Small]:
    """Run a server on which no body is too slow."""
    folder = tmp_path_factory.mktemp("small") / "server"
    with serving_few(folder, SECONDS_FOR_BODY=PATIENCE) as small:
        yield small


@pytest.fixture(scope="module")
def hasty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Small]:
    """Run a server on which bodies are soon too slow."""
    folder = tmp_path_factory.mktemp("hasty") / "server"
    with serving_few(folder, SECONDS_FOR_BODY=SECONDS) as hasty:
        yield hasty


def reply_on(connection: socket.socket) -> tuple[int, str]:
    """Return the status and the code of the next reply; of no reply, zero and nothing."""
    received = b""
    while b"\r\n\r\n" not in received:
        piece = connection.recv(1 << 16)
        if not piece:
            return 0, ""
        received += piece
    head, _, body = received.partition(b"\r\n\r\n")
    status = int(head.split(b" ", 2)[1])
    length = int(head.lower().partition(b"content-length: ")[2].split(b"\r\n")[0] or b"0")
    while len(body) < length:
        body += connection.recv(1 << 16)
    is_problem = b"application/problem+json" in head
    return status, json.loads(body)["code"] if is_problem else ""


TOKENS = "/api/v1/tokens"
CHUNK = b"10000\r\n" + b" " * 0x10000 + b"\r\n"
JSON = "Content-Type: application/json"
CONTINUE = "Expect: 100-continue"
FORM = "Content-Type: multipart/form-data"
SLOWNESS = {
    "a body that does not come": (["Content-Length: 100"], b"["),
    "chunks that do not come": (["Transfer-Encoding: chunked"], b"1\r\n[\r\n"),
}
MEANNESS = {
    "a large file": ([f"Content-Length: {2 * MEBIBYTE}"], b" " * 2 * MEBIBYTE, 413, "too-large"),
    "a large file in chunks": (["Transfer-Encoding: chunked"], CHUNK * 32, 413, "too-large"),
    "a lie about the length": (
        ["Content-Length: 99999999999"],
        b" " * (MEBIBYTE + 1),
        413,
        "too-large",
    ),
    "endless nesting": (
        ["Content-Length: 1000000"],
        b"[" * 1_000_000,
        422,
        "submission-rejected",
    ),
    "containers without end": (
        [f"Content-Length: {MEBIBYTE}"],
        b"[" + b"[]," * (MEBIBYTE // 3 - 1) + b"[]]",
        422,
        "submission-rejected",
    ),
    "a form without a boundary": ([FORM, "Content-Length: 2"], b"[]", 400, "malformed-request"),
    "a form that is none": (
        [f"{FORM}; boundary=x", "Content-Length: 2"],
        b"[]",
        400,
        "malformed-request",
    ),
}


@pytest.mark.parametrize(("headers", "body", "status", "code"), MEANNESS.values(), ids=MEANNESS)
def test_whatever_is_uploaded_the_reply_says_why_not(
    headers: list[str], body: bytes, status: int, code: str, small: Small
) -> None:
    with small.connect() as connection:
        connection.sendall(small.upload(*headers) + body)
        assert reply_on(connection) == (status, code)


@pytest.mark.parametrize(("headers", "body"), SLOWNESS.values(), ids=SLOWNESS)
def test_whatever_does_not_come_the_reply_says_so(
    headers: list[str], body: bytes, hasty: Small
) -> None:
    with hasty.connect() as connection:
        connection.sendall(hasty.upload(*headers) + body)
        assert reply_on(connection) == (408, "too-slow")


def codec_of(name: str) -> str:
    """Return what Python decodes a charset by, or its name."""
    try:
        return codecs.lookup(name).name
    except LookupError:
        return name


CODECS = {module.name for module in pkgutil.iter_modules(encodings.__path__)}
CHARSETS = sorted(
    name
    for name in {*encodings.aliases.aliases, *CODECS, "no-such", ""}
    if codec_of(name) not in {"utf-8", "ascii"}
)
URLENCODED = "application/x-www-form-urlencoded; charset={}"
MULTIPART = "multipart/form-data; boundary=x; charset={}"
ONE_FIELD = b'--x\r\nContent-Disposition: form-data; name="token"\r\n\r\nx-\xff\r\n--x--\r\n'


STRANGE_CODECS = ["punycode", "undefined", "idna", "utf_7", "hex_codec"]


@pytest.mark.parametrize(
    ("path", "content_type", "charsets"),
    [
        pytest.param("/sign-in", MULTIPART, CHARSETS, id="each codec"),
        pytest.param("/sign-in", MULTIPART.swapcase(), STRANGE_CODECS, id="upper case"),
        pytest.param("/sign-in", URLENCODED, STRANGE_CODECS, id="without parts"),
        pytest.param(f"/api/v1/splits/{OPEN}/validate", MULTIPART, STRANGE_CODECS, id="an upload"),
    ],
)
def test_a_form_comes_in_utf_8_whatever_codecs_there_are(
    path: str, content_type: str, charsets: Sequence[str], server: Serving
) -> None:
    assert set(STRANGE_CODECS) < set(CHARSETS)

    def status(charset: str) -> int:
        shown = f"Bearer {server.tokens[OWNER]}"
        headers = {"Authorization": shown, "Content-Type": content_type.format(charset)}
        return server.client.post(path, headers=headers, content=ONE_FIELD).status_code

    assert {charset: status(charset) for charset in charsets} == dict.fromkeys(charsets, 400)


@pytest.mark.parametrize("charset", ["utf-8", "UTF-8", '"utf8"', "us-ascii"])
def test_a_form_may_say_that_it_is_in_utf_8(charset: str, server: Serving) -> None:
    headers = {"Content-Type": MULTIPART.format(charset)}
    reply = server.client.post("/sign-in", headers=headers, content=ONE_FIELD)
    assert reply.status_code == 401, "it was read, and holds no token"


@pytest.mark.parametrize(
    ("length", "body", "expected"),
    [
        pytest.param(SMALL + 1, b" " * (SMALL + 1), (413, "too-large"), id="large"),
        pytest.param(SMALL, b" " * SMALL, (400, "malformed-request"), id="just not too large"),
    ],
)
def test_what_is_no_upload_is_short_and_quick(
    length: int, body: bytes, expected: tuple[int, str], small: Small
) -> None:
    with small.connect() as connection:
        connection.sendall(small.head(TOKENS, JSON, f"Content-Length: {length}") + body)
        assert reply_on(connection) == expected


@pytest.mark.parametrize(
    ("length", "status"), [(SMALL // 4 + 1, 413), (SMALL // 4, 401)], ids=["large", "just not"]
)
def test_a_form_without_a_file_is_shorter(length: int, status: int, small: Small) -> None:
    head = small.head("/sign-in", f"Content-Type: {URLENCODED}", f"Content-Length: {length}")
    with small.connect() as connection:
        connection.sendall(head.replace(b"; charset={}", b"") + b"&" * length)
        assert reply_on(connection)[0] == status


def test_what_is_no_upload_is_not_waited_for_either(hasty: Small) -> None:
    with hasty.connect() as connection:
        connection.sendall(hasty.head(TOKENS, JSON, "Content-Length: 100") + b"{")
        assert reply_on(connection) == (408, "too-slow")


def test_headers_without_end_are_cut_short(small: Small) -> None:
    """At 16 KiB; what came after them unread would take the reply away."""
    with small.connect() as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: server\r\n")
        for size in (8000, 8000, 400):
            connection.sendall(b"X-More: " + b"x" * size)
        assert reply_on(connection)[0] == 400


@pytest.mark.parametrize(
    "lines",
    [
        pytest.param([f"GET /{'x' * 16384} HTTP/1.1", "Host: server"], id="a long path"),
        pytest.param(["GET /healthz HTTP/1.1", f"X-More: {'x' * 16384}"], id="a long header"),
        pytest.param(["GET /healthz HTTP/1.1", *["A: b"] * 8192], id="many headers"),
    ],
)
def test_headers_that_are_too_long_are_refused_also_when_they_come_at_once(
    lines: Sequence[str], small: Small
) -> None:
    with small.connect() as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        assert reply_on(connection)[0] == 400


def test_who_is_refused_while_they_send_may_send_on(small: Small) -> None:
    """As proxies do, which ask for a connection's end: they report what breaks as a fault."""
    lines = [
        *("POST /api/v1/splits/val_unseen/submissions?name=x HTTP/1.1", "Host: server"),
        *("Connection: close", f"Content-Length: {4 * MEBIBYTE}", "", ""),
    ]
    with small.connect() as connection:
        connection.sendall("\r\n".join(lines).encode())
        assert connection.recv(1, socket.MSG_PEEK)
        for _ in range(4):
            connection.sendall(bytes(MEBIBYTE))
        assert reply_on(connection) == (401, "not-signed-in")
        assert not connection.recv(1)


def test_what_is_no_http_is_told_so(small: Small) -> None:
    with small.connect() as connection:
        connection.sendall(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" * 9)
        assert reply_on(connection)[0] == 400


@pytest.mark.parametrize(
    ("path", "reply"),
    [
        ("/api/v1/splits/val_unseen/submissions?name=x", (400, "malformed-request")),
        ("/sign-in", (400, "")),
    ],
)
def test_a_broken_form_is_not_quoted_in_the_log(
    path: str, reply: tuple[int, str], small: Small
) -> None:
    """Our parser reads a form with a file, the framework's all others."""
    body = b"1999999937 is in no part of the form"
    headers = (f"{FORM}; boundary=1999999937", f"Content-Length: {len(body)}")
    with small.connect() as connection:
        connection.sendall(small.head(path, *headers) + body)
        assert reply_on(connection) == reply
    assert {line["logger"] for line in small.logged()} <= {
        "reverie_eval.server.requests",
        "reverie_eval.server.scoring",
        "uvicorn.error",
    }


def test_nobody_is_believed_about_an_address_unless_a_setting_says_so(small: Small) -> None:
    before = len(refused(small))
    with small.connect() as connection:
        head = small.head("/api/v1/nothing", "X-Forwarded-For: 192.0.2.7", method="GET")
        connection.sendall(
            head.replace(small.token.encode(), b"rv_wrong").replace(b"nothing", b"me")
        )
        assert reply_on(connection) == (401, "not-signed-in")
    wait_until(lambda: len(refused(small)) > before)
    assert {line["address"] for line in refused(small)} == {"127.0.0.1"}


def refused(small: Small) -> Sequence[Mapping[str, Any]]:
    """Return what the log says of requests whose sender's address it names."""
    return [line for line in small.logged() if "address" in line]


def test_a_connection_sends_what_it_has_at_once() -> None:
    """Else a reply's body would wait until the receipt of its head."""
    with (
        listen("127.0.0.1", 0) as listening,
        socket.create_connection(listening.getsockname()),
        listening.accept()[0] as accepted,
    ):
        assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_a_connection_goes_on_after_head(small: Small) -> None:
    url = f"http://127.0.0.1:{small.port}"
    with httpx.Client(base_url=url, timeout=PATIENCE, verify=NO_TLS) as client:
        statuses = [
            client.request(method, path).status_code
            for path in ("/healthz", "/api/v1/openapi.json", "/api/v1/me")
            for method in ("HEAD", "GET")
        ]
    assert statuses == [200, 200, 200, 200, 401, 401]


def test_uploads_wait_for_their_turn_and_too_many_are_sent_away(small: Small) -> None:
    head = small.upload(f"Content-Length: {len(GOOD)}")
    with small.connect() as first, small.connect() as second, small.connect() as third:
        begin_upload(first, small)
        first.sendall(GOOD[:-1])
        second.sendall(head + GOOD)
        wait_until(lambda: small.uploads_waiting() == 1)
        third.sendall(head + GOOD)
        assert reply_on(third) == (503, "busy")
        first.sendall(GOOD[-1:])
        assert {reply_on(first)[0], reply_on(second)[0]} <= {200, 201}


def begin_upload(connection: socket.socket, small: Small) -> None:
    """Send an upload up to its body, and wait until the server holds a place for it."""
    begin_request(connection, small.upload(f"Content-Length: {len(GOOD)}", CONTINUE))


def begin_request(connection: socket.socket, head: bytes) -> None:
    """Send a request up to its body, and wait until the server reads that."""
    connection.sendall(head)
    assert connection.recv(1000).startswith(b"HTTP/1.1 100")


def test_nobody_waits_for_the_slow_longer_than_they_may_take(hasty: Small) -> None:
    head = hasty.upload(f"Content-Length: {len(GOOD)}")
    with hasty.connect() as slow, hasty.connect() as patient:
        begin_upload(slow, hasty)
        slow.sendall(GOOD[:1])
        patient.sendall(head + GOOD)
        assert reply_on(slow) == (408, "too-slow")
        assert reply_on(patient)[0] in {200, 201, 408, 503}

    def status() -> int:
        with hasty.connect() as later:
            later.sendall(head + GOOD)
            return reply_on(later)[0]

    wait_until(lambda: status() in {200, 201})  # a slow machine may need too long for one, too


def test_whoever_hangs_up_leaves_the_place_to_others(small: Small) -> None:
    for _ in range(3):
        with small.connect() as connection:
            begin_upload(connection, small)
            connection.sendall(GOOD[:1])
    with small.connect() as connection:
        connection.sendall(small.upload(f"Content-Length: {len(GOOD)}") + GOOD)
        assert reply_on(connection)[0] in {200, 201}
    wait_until(lambda: len(small.hung_up("/api/v1/splits/{split}/submissions")) == 3)


def test_whoever_hangs_up_before_the_end_of_their_json_gets_no_reply(small: Small) -> None:
    with small.connect() as connection:
        begin_request(connection, small.head(TOKENS, JSON, "Content-Length: 100", CONTINUE))
        connection.sendall(b"{")
    wait_until(lambda: small.hung_up(TOKENS))
    assert [line["status"] for line in small.hung_up(TOKENS)] == [None]


def test_nothing_of_all_that_was_a_fault(small: Small, hasty: Small) -> None:
    lines = [*small.logged(), *hasty.logged()]
    assert [line for line in lines if line["level"] == "error" or "fault" in line] == []
    assert [line for line in lines if line.get("status") == 500] == []


@dataclass(frozen=True)
class Impatient:
    """A server in this process, with little patience, that can tell who is connected to it."""

    server: uvicorn.Server
    port: int

    def connect(self, *, room: int = 1 << 16) -> socket.socket:
        """Open a connection, on which so many bytes may come that nobody reads."""
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, room)
        connection.settimeout(PATIENCE)
        connection.connect(("127.0.0.1", self.port))
        return connection

    def wait_until_closed(self) -> None:
        """Wait until nobody is connected any more."""
        wait_until(lambda: not self.server.server_state.connections)


@pytest.fixture
def of_headers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "SECONDS_FOR_HEADERS", 0.3)


@pytest.fixture
def of_slow_senders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(middleware, "SECONDS_OF_GRACE", 0.3)


@pytest.fixture
def of_readers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "SECONDS_FOR_HEADERS", PATIENCE)
    monkeypatch.setattr(run, "SECONDS_FOR_REPLY", 0.3)


@pytest.fixture
def impatient(server: Serving, monkeypatch: pytest.MonkeyPatch) -> Iterator[Impatient]:
    """Serve to sockets in this process; the network takes little that is not read."""
    monkeypatch.setattr(run, "LOGGING", None)  # the logs of this process are pytest's
    listening = listen("127.0.0.1", 0)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 14)
    running = uvicorn.Server(run.configuration(create_app(server.state, "http://server")))
    thread = threading.Thread(target=running.run, kwargs={"sockets": [listening]})
    thread.start()
    yield Impatient(running, listening.getsockname()[1])
    running.should_exit = True
    thread.join()


@pytest.mark.usefixtures("of_headers")
@pytest.mark.parametrize(
    ("sent", "then"),
    [
        pytest.param(b"", b"", id="nothing"),
        pytest.param(b"GET / HTTP/1.1\r\nHost:", b"x", id="headers letter by letter"),
        pytest.param(
            b"POST /api/v1/splits/test/validate HTTP/1.1\r\nHost: x\r\nContent-Length: 999\r\n\r\n",
            b"x",
            id="a body after its reply",
        ),
        pytest.param(
            b"GET /nothing HTTP/1.1\r\nHost: x\r\n\r\nGET ", b"x", id="a second request's headers"
        ),
    ],
)
def test_a_connection_that_sends_no_request_is_closed(
    sent: bytes, then: bytes, impatient: Impatient
) -> None:
    with impatient.connect() as connection:
        connection.sendall(sent)
        connection.settimeout(0.05)
        for _ in range(20 * PATIENCE):
            try:
                if not connection.recv(1 << 16):
                    return
                continue
            except TimeoutError:
                pass
            except ConnectionResetError:
                return
            try:
                connection.sendall(then)
            except (BrokenPipeError, ConnectionResetError):
                return
    pytest.fail("the connection is still open")


@pytest.mark.usefixtures("of_slow_senders")
def test_who_sends_slowly_is_told_so(impatient: Impatient, server: Serving) -> None:
    """Long before all of it would have to be there."""
    shown = f"Authorization: Bearer {server.tokens[OWNER]}"
    path = f"/api/v1/splits/{OPEN}/validate"
    head = f"POST {path} HTTP/1.1\r\nHost: x\r\n{shown}\r\nContent-Length: {len(GOOD)}\r\n\r\n"
    with impatient.connect() as connection:
        connection.sendall(head.encode() + GOOD[:1000])
        received = b""
        while b"no submission was used" not in received.lower():
            piece = connection.recv(1 << 16)
            assert piece, received
            received += piece
    assert received.startswith(b"HTTP/1.1 408")
    assert b"sent too slowly: 1,000 bytes in" in received
    assert b"16 KiB a second" in received


def test_who_sends_fast_enough_is_waited_for() -> None:
    allowance = middleware.Allowance(0, seconds=60, kibibytes_per_second=2, began=100)
    assert [allowance.next_until(received) for received in (0, 2048, 20480, 1 << 20)] == [
        110,
        111,
        120,
        160,
    ]


def unread(impatient: Impatient, head: bytes) -> bytes:
    """Ask for something, wait until nobody is connected, and return what had come until then."""
    with impatient.connect(room=1 << 12) as connection:
        connection.sendall(head + b"Host: server\r\n\r\n")
        assert connection.recv(12) == b"HTTP/1.1 200"
        impatient.wait_until_closed()
        received = b""
        with suppress(ConnectionResetError):
            while piece := connection.recv(1 << 16):
                received += piece
    return received


@pytest.mark.usefixtures("of_readers")
def test_a_reply_that_nobody_takes_is_given_up(impatient: Impatient, server: Serving) -> None:
    whole = server.client.get("/api/v1/openapi.json").content
    assert len(unread(impatient, b"GET /api/v1/openapi.json HTTP/1.1\r\n")) < len(whole)


@pytest.mark.usefixtures("of_readers")
def test_a_file_that_nobody_takes_is_given_up(impatient: Impatient, server: Serving) -> None:
    content = GOOD + b" " * 2 * MEBIBYTE
    submission = server.upload(OWNER, content).json()["submission"]["id"]
    shown = f"Authorization: Bearer {server.tokens[OWNER]}"
    path = f"/api/v1/submissions/{submission}/file"
    came = unread(impatient, f"GET {path} HTTP/1.1\r\n{shown}\r\n".encode())
    assert len(came) < len(content)


def test_nothing_more_is_awaited_of_a_request_that_is_being_answered() -> None:
    scope: Scope = {"type": "http", "headers": []}

    async def hang_up() -> Message:
        await asyncio.sleep(0.01)
        return {"type": "http.disconnect"}

    async def app(scope: Scope, receive: Receive, _: Send) -> None:
        exchange_of(scope).status = 200
        assert (await receive())["type"] == "http.disconnect"

    begin(scope)
    asyncio.run(BodyLimits(app, seconds=0, kibibytes_per_second=1)(scope, hang_up, AsyncMock()))


def test_a_crowd_of_slow_connections_with_one_token_is_small(tmp_path: Path) -> None:
    room = {"UPLOADS_AT_ONCE": 4 * MOST_AT_ONCE, "SECONDS_FOR_BODY": PATIENCE}
    with serving_few(tmp_path / "server", **room) as server, ExitStack() as stack:
        slow = [stack.enter_context(server.connect()) for _ in range(MOST_AT_ONCE)]
        for connection in slow:
            connection.sendall(server.upload(f"Content-Length: {MEBIBYTE}") + b" " * SMALL)

        def ask(token: str) -> httpx.Response:
            url = f"http://127.0.0.1:{server.port}/api/v1/me"
            headers = {"Authorization": f"Bearer {token}"}
            return httpx.get(url, headers=headers, timeout=PATIENCE, verify=NO_TLS)

        wait_until(lambda: ask(server.token).status_code == 503)
        refusal = ask(server.token)
        assert (refusal.json()["code"], refusal.headers["Retry-After"]) == ("busy", "10")
        assert ask(server.organiser).status_code == 200
        slow[0].close()
        wait_until(lambda: ask(server.token).status_code == 200)
