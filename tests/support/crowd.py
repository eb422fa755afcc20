"""Everybody who is at a server besides those who upload: readers, idle and slow connections."""

import asyncio
import gzip
import http.client
import json
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import pytest

from fixtures.published import published_folder
from tests.support.amounts import is_evidence
from tests.support.serving import GOOD, OPEN
from tests.support.waiting import PATIENCE

PAUSE = 0.05
"""Seconds between two requests of a reader."""
DRIP = 1 << 14
"""Bytes that a slow sender sends at a time."""
SIZE = 1_400_000
"""Bytes of a file for REVERIE's val_unseen, with its 3,521 episodes."""


class Reply(NamedTuple):
    """What came back for a request."""

    status: int
    seconds: float
    body: bytes


def ask(
    connection: http.client.HTTPConnection,
    method: str,
    path: str,
    body: bytes | None = None,
    token: str = "",
) -> Reply:
    """Send a request and wait for all of the reply."""
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    began = time.monotonic()
    connection.request(method, path, body, {"Content-Type": "application/json", **headers})
    reply = connection.getresponse()
    content = reply.read()
    return Reply(reply.status, time.monotonic() - began, content)


def connect(url: str, address: str = "127.0.0.1") -> http.client.HTTPConnection:
    """Return a connection to a server, from an address of this machine."""
    netloc = urlsplit(url).netloc
    return http.client.HTTPConnection(netloc, timeout=PATIENCE, source_address=(address, 0))


def large(request: pytest.FixtureRequest) -> tuple[str, bytes]:
    """Return the path of a bundle of the open split, and a large submission to it.

    They are the published ones, if these are there and not only the suite is run.
    """
    published = published_folder() if is_evidence() else None
    if published is None:
        return f"bundles/{OPEN}.npz", long_submission()
    bundles: Path = request.getfixturevalue("published_bundles")
    file = published / "reference" / "submissions" / f"{OPEN}.mixed1.json.gz"
    return str(bundles / f"{OPEN}.npz"), gzip.decompress(file.read_bytes())


def long_submission() -> bytes:
    """Return a submission to the demo world that is as large as one to REVERIE."""
    records = json.loads(GOOD)
    laps = SIZE // len(json.dumps([record["trajectory"] for record in records]))
    for record in records:
        record["trajectory"] *= laps
    return json.dumps(records).encode()


def peak_megabytes(process: int) -> float:
    """Return the most memory that a process has had."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(re.findall(r"VmHWM:\s+(\d+) kB", status)[0]) / 1000


@contextmanager
def reading(url: str, paths: Sequence[str]) -> Iterator[Mapping[str, Sequence[Reply]]]:
    """Read these pages again and again, each by a reader of its own; give the replies by path."""
    replies: dict[str, list[Reply]] = {path: [] for path in paths}

    def read(path: str, is_over: threading.Event) -> None:
        connection = connect(url)
        while not is_over.wait(PAUSE):
            replies[path].append(ask(connection, "GET", path)._replace(body=b""))
        connection.close()

    with _until_the_end([(read, path) for path in paths]):
        yield replies


@contextmanager
def sending_slowly(
    url: str, path: str, body: bytes, tokens: Sequence[str], seconds: float
) -> Iterator[Sequence[int]]:
    """Upload a file for each of these tokens, slowly, so that it takes at least so many seconds.

    Gives the statuses of the replies.
    """
    statuses: list[int] = []
    pause = seconds * DRIP / len(body)

    def send(token: str, is_over: threading.Event) -> None:
        while not is_over.is_set():
            connection = connect(url)
            connection.putrequest("POST", path)
            connection.putheader("Authorization", f"Bearer {token}")
            connection.putheader("Content-Type", "application/json")
            connection.putheader("Content-Length", str(len(body)))
            connection.endheaders()
            for begin in range(0, len(body), DRIP):
                connection.send(body[begin : begin + DRIP])
                is_over.wait(pause)
            statuses.append(connection.getresponse().status)
            connection.close()

    with _until_the_end([(send, token) for token in tokens]):
        yield statuses


@contextmanager
def idling(url: str, connections: int) -> Iterator[None]:
    """Hold this many connections on which nothing is sent; one that is closed is opened again."""
    address = urlsplit(url)
    ready = threading.Barrier(2)

    async def idle(is_over: asyncio.Event) -> None:
        while not is_over.is_set():
            reader, writer = await asyncio.open_connection(address.hostname, address.port)
            try:
                await reader.read()
            finally:
                writer.close()
                with suppress(ConnectionError):
                    await writer.wait_closed()

    async def hold(is_over: threading.Event) -> None:
        over = asyncio.Event()
        tasks = [asyncio.create_task(idle(over)) for _ in range(connections)]
        await asyncio.sleep(0)
        ready.wait(PATIENCE)
        await asyncio.to_thread(is_over.wait)
        over.set()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def run(_: str, is_over: threading.Event) -> None:
        asyncio.run(hold(is_over))

    with _until_the_end([(run, "")]):
        ready.wait(PATIENCE)
        yield


@contextmanager
def _until_the_end(
    tasks: Sequence[tuple[Callable[[str, threading.Event], None], str]],
) -> Iterator[None]:
    """Run tasks in threads of their own, and tell them when it is over; their errors are ours."""
    is_over = threading.Event()
    with ThreadPoolExecutor(len(tasks)) as pool:
        running = [pool.submit(task, subject, is_over) for task, subject in tasks]
        try:
            yield
        finally:
            is_over.set()
        for each in running:
            each.result()
