"""An OpenAI-compatible endpoint on a thread of its own, which misbehaves when it is told to."""

import json
import re
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

USAGE = {
    "prompt_tokens": 100,
    "prompt_tokens_details": {"cached_tokens": 60},
    "completion_tokens": 20,
    "completion_tokens_details": {"reasoning_tokens": 5},
}


@dataclass(frozen=True)
class Behaviour:
    """What an endpoint does with a request."""

    document: Any
    """The body of the reply, sent as JSON; text and bytes are sent as they are."""
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)
    is_cut: bool = False
    """Whether the connection ends within the reply."""
    is_slow: bool = False
    """Whether nothing is sent until the client is gone."""
    unless: str = ""
    """A field of the request without which it behaves well."""


def saying(text: str | None, end: str = "stop", **changes: Any) -> Behaviour:
    """Reply with a text of the model."""
    message = {"role": "assistant", "content": text, **changes.pop("message", {})}
    choice = {"index": 0, "message": message, "finish_reason": end}
    document = {"model": "words-1", "choices": [choice], "usage": USAGE, **changes}
    return Behaviour({name: value for name, value in document.items() if value is not None})


def failing(status: int, message: str = "no", code: str = "", **headers: str) -> Behaviour:
    """Reply with an error."""
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return Behaviour({"error": {"message": message, "code": code}}, status, named)


def text_of(message: Mapping[str, Any]) -> str:
    """Return the text of a message, which may have pictures, too."""
    content = message["content"]
    return str(content if isinstance(content, str) else content[0]["text"])


def well_behaved(request: Mapping[str, Any]) -> Behaviour:
    """Answer with object 5 where it is visible, or go to the place that was heard of last."""
    texts = [text_of(message) for message in request["messages"]]
    text = next(each for each in reversed(texts) if "You are at place" in each)
    if "object 5:" in text:
        return saying('{"thought": "It is here.", "action": "answer", "object": 5}')
    places = [int(number) for number in re.findall(r"- place (\d+)", text)]
    if not places:
        return saying('{"thought": "Enough.", "action": "stop"}')
    return saying(json.dumps({"thought": "On.", "action": "go", "place": max(places)}))


class Endpoint:
    """What was asked of a server, and what it is going to do."""

    def __init__(self, url: str, key: str) -> None:
        self.url = url
        self._key = key
        self.script: deque[Behaviour] = deque()
        """How the endpoint treats the next requests, one after the other; then it behaves well."""
        self.good: Callable[[Mapping[str, Any]], Behaviour] = well_behaved
        self.requests: list[Mapping[str, Any]] = []
        self.sent = 0
        """Replies of the model that were sent completely."""
        self.closing = threading.Event()

    def take(self, request: Mapping[str, Any], key: str) -> Behaviour:
        """Decide what to do with a request."""
        self.requests.append(request)
        if self._key and key != f"Bearer {self._key}":
            return failing(401, f"Incorrect API key provided: {key.removeprefix('Bearer ')}")
        if self.script and self.script[0].unless not in {"", *request}:
            return self.good(request)
        return self.script.popleft() if self.script else self.good(request)


@contextmanager
def endpoint(key: str = "") -> Iterator[Endpoint]:
    """Serve an endpoint."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version, wbufsize = "HTTP/1.1", -1  # a reply is one packet

        def do_POST(self) -> None:
            content = self.rfile.read(int(self.headers["Content-Length"]))
            request = json.loads(content)
            does = serving.take(request, self.headers.get("Authorization", ""))
            if does.is_slow:
                serving.closing.wait()
                return
            body = does.document
            if not isinstance(body, bytes):
                body = (body if isinstance(body, str) else json.dumps(body)).encode()
            self.send_response(does.status)
            for name, value in {**does.headers, "Content-Length": str(len(body))}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body[: len(body) // 2] if does.is_cut else body)
            self.close_connection |= does.is_cut
            serving.sent += does.status == 200 and not does.is_cut

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    serving = Endpoint(f"http://127.0.0.1:{server.server_port}/v1", key)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield serving
    finally:
        serving.closing.set()
        server.shutdown()
        thread.join()
        server.server_close()
