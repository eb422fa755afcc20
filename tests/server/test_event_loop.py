"""Nothing slow runs on the event loop: what takes long for one request delays no other."""

import asyncio
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from ipaddress import ip_network
from pathlib import Path
from threading import Event
from types import ModuleType
from typing import NamedTuple

import httpx
import pytest
from starlette import requests
from starlette.exceptions import HTTPException
from starlette.requests import Request

from reverie_eval.server.audit.transactions import utc_now
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.home import guide_page as guide
from reverie_eval.server.http import api, problems, rendering
from reverie_eval.server.http.callers import COOKIE, begin
from reverie_eval.server.http.middleware import BodyLimits
from reverie_eval.server.intake import uploads
from reverie_eval.server.intake.uploads import receive
from reverie_eval.server.settings import Limits
from tests.support.serving import GOOD, OPEN, OWNER, OpenServer, Serving, settings_of
from tests.support.waiting import PATIENCE

PER_MINUTE = 30
FLOODING, ANOTHER = "192.0.2.1", "192.0.2.2"
LATIN = "application/x-www-form-urlencoded; charset=latin-1"


@dataclass
class Standstill:
    """A function that does not go on until it may, and then does what it always did."""

    real: Callable[..., object]
    reached: Event = field(default_factory=Event)
    over: Event = field(default_factory=Event)

    def __call__(self, *given: object, **named: object) -> object:
        """Wait, then go on."""
        self.reached.set()
        self.over.wait(PATIENCE)
        return self.real(*given, **named)


@pytest.fixture
def flooded(folder: Path, open_server: OpenServer, within_a_minute: None) -> Serving:
    """Return a server that refuses whatever else comes from one address."""
    limits = Limits(requests_per_minute=PER_MINUTE)
    changes = {"limits": limits, "trusted_proxies": (ip_network("127.0.0.1"),)}
    server = open_server(settings_of(folder).model_copy(update=changes))
    for _ in range(PER_MINUTE):
        get(server, "/api/v1/splits", FLOODING)
    return server


def get(
    server: Serving, path: str, address: str, headers: Mapping[str, str] | None = None
) -> httpx.Response:
    return server.client.get(path, headers={"X-Forwarded-For": address, **(headers or {})})


@pytest.fixture
def standing_still(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Standstill]]:
    """Return what makes a function stand still; at the end all of them go on."""
    with ExitStack() as end:

        def stand_still(owner: object, name: str) -> Standstill:
            stopped = Standstill(getattr(owner, name))
            monkeypatch.setattr(owner, name, stopped)
            end.callback(stopped.over.set)
            return stopped

        yield stand_still


class Slow(NamedTuple):
    """A request, and the step of its reply that takes long."""

    module: ModuleType
    step: str
    path: str
    status: int
    address: str = ANOTHER
    headers: Mapping[str, str] = {}


SLOW = {
    "a page that refuses": Slow(rendering, "_page", "/episodes", 429, FLOODING),
    "a refusal": Slow(problems, "_document", "/api/v1/me", 429, FLOODING),
    "a charset": Slow(rendering, "_page", "/guide", 400, headers={"Content-Type": LATIN}),
    "a fault": Slow(problems, "log_fault", "/guide/protocols", 500),
    "the description": Slow(api, "get_openapi", "/api/v1/openapi.json", 200),
}


@pytest.mark.parametrize("slow", SLOW.values(), ids=SLOW)
def test_others_are_answered_while_one_reply_is_made(
    slow: Slow,
    flooded: Serving,
    standing_still: Callable[..., Standstill],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if slow.status == 500:
        monkeypatch.setattr(guide, "_task", None)
    stopped = standing_still(slow.module, slow.step)
    order: list[object] = []
    with ThreadPoolExecutor(1) as other:
        late = other.submit(get, flooded, slow.path, slow.address, slow.headers)
        late.add_done_callback(lambda done: order.append(done.result().status_code))
        assert stopped.reached.wait(PATIENCE)
        for _ in range(20):
            assert flooded.client.get("/static/style.css").status_code == 200
            order.append("another")
        stopped.over.set()
    assert order == ["another"] * 20 + [slow.status]


@pytest.mark.parametrize("path", ["/episodes", "/api/v1/me"], ids=["a page", "the API"])
def test_a_refusal_does_not_ask_the_database(
    path: str, flooded: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(flooded.state.database), "reading", None)
    reply = get(flooded, path, FLOODING, {"Cookie": f"{COOKIE}=anybody.s"})
    assert reply.status_code == 429
    assert "too many requests" in reply.text.lower()


def test_others_are_answered_while_a_form_is_parsed(
    server: Serving, standing_still: Callable[..., Standstill]
) -> None:
    stopped = standing_still(uploads, "parse_form")
    with ThreadPoolExecutor(1) as other:
        files = {"file": ("answers.json", GOOD)}
        late = other.submit(server.ask, OWNER, "POST", f"/splits/{OPEN}/validate", files=files)
        assert stopped.reached.wait(PATIENCE)
        for _ in range(20):
            assert server.client.get("/static/style.css").status_code == 200
        assert not late.done()
        stopped.over.set()
    assert late.result().status_code == 200


CONTENT_TYPE = b"multipart/form-data; boundary=x"
HEAD = b'--x\r\nContent-Disposition: form-data; name="file"; filename="f"\r\n\r\n'
FILLINGS = {
    "boundaries with something behind them": b"\r\n--xX",
    "all but a boundary": b"\r\n--",
    "ends of lines": b"\r\n",
    "fields": b'\r\n--x\r\nContent-Disposition: form-data; name="a"\r\n\r\n',
    "fields without a name": b"\r\n--x\r\n\r\n",
    "lines before a field": b'\r\n--x\r\nContent-Disposition: form-data; name="a"' + b"\r\na:" * 99,
}


def calls_to_parse(content: bytes) -> int:
    """Return how many calls it takes to parse a form with a file."""
    messages = [{"type": "http.request", "body": HEAD + content + b"\r\n--x--\r\n"}]
    calls = 0

    def count(*_: object) -> None:
        nonlocal calls
        calls += 1

    async def app(scope: object, receive_body: object, _: object) -> None:
        with suppress(MalformedError, HTTPException):
            await receive(Request(scope, receive_body), Limits(), utc_now)  # type: ignore[arg-type]

    async def body() -> Mapping[str, object]:
        return messages.pop()

    scope = {"type": "http", "method": "POST", "path": "/", "app": None}
    scope["headers"] = [(b"content-type", CONTENT_TYPE)]  # type: ignore[assignment]
    begin(scope)
    threading.setprofile(count)
    sys.setprofile(count)
    try:
        asyncio.run(BodyLimits(app, PATIENCE, 1)(scope, body, None))  # type: ignore[arg-type]
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return calls


@pytest.mark.parametrize("filling", FILLINGS.values(), ids=FILLINGS)
def test_no_byte_of_a_form_costs_more_than_another(filling: bytes) -> None:
    size = 2 << 20
    plain = calls_to_parse(b"x" * size)
    assert calls_to_parse(filling * (size // len(filling))) < 3 * plain


def test_cookies_that_are_not_ours_are_not_parsed(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python may need seconds for a quoted one, in a time that grows with its length squared."""
    own = server.client.post("/sign-in", data={"token": server.tokens[OWNER]}).cookies[COOKIE]
    server.client.cookies.clear()
    parse, parsed = requests.cookie_parser, set[str]()

    def listening(header: str) -> dict[str, str]:
        parsed.add(header)
        return parse(header)

    monkeypatch.setattr(requests, "cookie_parser", listening)
    hostile = '"' + 60_000 * "\\" + '"'
    for cookies in (f"a={hostile}; {COOKIE}={own}", f"{COOKIE}={own};{COOKIE}={hostile}"):
        reply = server.client.get("/team", headers={"Cookie": cookies})
        assert reply.status_code == 200
    assert parsed == {f"{COOKIE}={own}"}
