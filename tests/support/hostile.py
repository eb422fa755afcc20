"""A team that means harm: files that take long to read, and connections that never end.

It works from a process and an address of its own, so that it takes nothing from those who measure
what others notice.
"""

import asyncio
import gzip
import json
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from types import MappingProxyType
from typing import NamedTuple
from urllib.parse import urlsplit

from tests.support.crowd import ask, connect
from tests.support.forking import PROCESSES

CONNECTIONS = 4
"""On which files are sent at once."""
BEAT = 1.0
"""Seconds between two bytes of a connection that never ends."""
_EMPTY = gzip.compress(b"", mtime=0)


def _values(number: int) -> bytes:
    return gzip.compress(b"[" + b"[]," * (number - 2) + b"[]]")


def _keys(number: int) -> bytes:
    return gzip.compress(json.dumps([{f"k{key}": 0 for key in range(number)}]).encode())


def _problems(number: int) -> bytes:
    return gzip.compress(json.dumps([{"instr_id": f"x{each}"} for each in range(number)]).encode())


def _digits(number: int) -> bytes:
    return gzip.compress(b"[" + b",".join([b"9" * 4000] * number) + b"]")


FILES: Mapping[str, tuple[Callable[[int], bytes], int]] = MappingProxyType(
    {
        "values": (_values, 4_900_000),
        "keys of a record": (_keys, 1_000_000),
        "problems": (_problems, 10_000),
        "integers of 4,000 digits": (_digits, 10_000),
        "empty gzip members": (lambda number: _EMPTY * number, 9_999),
        "empty gzip members, too many": (lambda number: _EMPTY * number, 1_500_000),
    }
)
"""What makes the worst files, and of how many pieces."""


class Sender(NamedTuple):
    """Who sends, and where to."""

    url: str
    path: str
    token: str
    address: str
    """The sender's address, on this machine."""


@contextmanager
def sending(sender: Sender, content: bytes) -> Iterator[Counter[int]]:
    """Send a file again and again, as often as a team may; give the statuses at the end."""
    with _beside(_send, sender, content) as statuses:
        yield statuses


@contextmanager
def dripping(sender: Sender, connections: int) -> Iterator[Counter[int]]:
    """Hold this many uploads that hardly go on; one that is refused begins again."""
    with _beside(_drip, sender, connections) as statuses:
        yield statuses


@contextmanager
def _beside(work: Callable[..., None], *given: object) -> Iterator[Counter[int]]:
    here, there = PROCESSES.Pipe()
    process = PROCESSES.Process(target=work, args=(there, *given))
    process.start()
    there.close()
    statuses = Counter[int]()
    try:
        here.recv()  # it has begun
        yield statuses
        here.send("it is over")
        statuses.update(here.recv())
    finally:
        process.kill()
        process.join()
        here.close()


def _send(connection: Connection, sender: Sender, content: bytes) -> None:
    is_over = threading.Event()

    def send(_: int) -> list[int]:
        statuses = []
        server = connect(sender.url, sender.address)
        while not is_over.is_set():
            reply = ask(server, "POST", sender.path, content, sender.token)
            statuses.append(reply.status)
            if reply.status in {429, 503}:
                is_over.wait(1)
        return statuses

    with ThreadPoolExecutor(CONNECTIONS) as pool:
        sent = [pool.submit(send, number) for number in range(CONNECTIONS)]
        connection.send("it has begun")
        connection.recv()
        is_over.set()
        connection.send(Counter(status for each in sent for status in each.result()))


def _drip(connection: Connection, sender: Sender, connections: int) -> None:
    connection.send(asyncio.run(_drip_all(connection, sender, connections)))


async def _drip_all(connection: Connection, sender: Sender, connections: int) -> Counter[int]:
    server, statuses = urlsplit(sender.url), Counter[int]()
    head = (
        f"POST {sender.path} HTTP/1.1\r\nHost: {server.netloc}\r\n"
        f"Authorization: Bearer {sender.token}\r\nContent-Type: application/json\r\n"
        "Content-Length: 1000000\r\n\r\n"
    )

    async def drip() -> None:
        while True:
            with suppress(OSError):
                reader, writer = await asyncio.open_connection(
                    server.hostname, server.port, local_addr=(sender.address, 0)
                )
                writer.write(head.encode())
                reply = asyncio.ensure_future(reader.readline())
                while not reply.done():
                    writer.write(b" ")
                    await asyncio.wait([reply], timeout=BEAT)
                if line := reply.result():
                    statuses[int(line.split()[1])] += 1
                writer.close()
            await asyncio.sleep(BEAT)

    tasks = [asyncio.create_task(drip()) for _ in range(connections)]
    await asyncio.sleep(BEAT)
    connection.send("it has begun")
    await asyncio.to_thread(connection.recv)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    return statuses
