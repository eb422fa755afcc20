"""Whatever scores takes its turn: uploads, and what scores a kept submission again."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any

import httpx
import pytest

from reverie_eval.server.service.boards import Board
from tests.support.serving import OPEN, OWNER, OpenServer, Serving
from tests.support.visiting import signed_in


class Watched:
    """Counts how often a board scores, and how many do so at once."""

    def __init__(self) -> None:
        self.calls = self.most = self._now = 0
        self._lock = Lock()

    def around(self, score: Callable[..., Any]) -> Callable[..., Any]:
        """Return what scores slowly and is counted."""

        def watched(*given: Any) -> Any:
            with self._lock:
                self.calls += 1
                self._now += 1
                self.most = max(self.most, self._now)
            time.sleep(0.05)  # long enough for whoever does not wait to come in
            try:
                return score(*given)
            finally:
                with self._lock:
                    self._now -= 1

        return watched


@pytest.fixture
def server(open_server: OpenServer, monkeypatch: pytest.MonkeyPatch) -> Serving:
    """Return a server on a machine with one processor."""
    monkeypatch.setattr("reverie_eval.server.http.admission._SCORED_AT_ONCE", 1)
    return open_server()


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    watched = Watched()
    monkeypatch.setattr(Board, "score", watched.around(Board.score))
    return watched


def sent(server: Serving) -> str:
    return str(server.upload(OWNER, server.distinct()).json()["submission"]["id"])


def all_at_once(*requests: Callable[[], httpx.Response]) -> list[int]:
    with ThreadPoolExecutor(len(requests)) as pool:
        return [future.result().status_code for future in [pool.submit(ask) for ask in requests]]


def test_no_more_are_scored_at_once_than_there_are_processors(
    server: Serving, watched: Watched
) -> None:
    first, second, third = (sent(server) for _ in range(3))
    visitor = signed_in(server, OWNER)
    replies = all_at_once(
        lambda: server.upload(OWNER, server.distinct()),
        lambda: server.ask(OWNER, "PATCH", f"/submissions/{first}", json={"published": True}),
        lambda: visitor.send(f"/submissions/{second}", {"published": "true"}),
        lambda: server.ask(OWNER, "GET", f"/submissions/{third}/episodes"),
        lambda: visitor.get(f"/episodes/{OPEN}?submission={first}"),
    )
    assert replies == [201, 200, 303, 200, 200]
    assert watched.most == 1
    assert watched.calls >= 3 + len(replies)


def test_intervals_are_drawn_once_however_often_one_publishes(
    server: Serving, watched: Watched
) -> None:
    submission = sent(server)
    publish = {"published": True}
    replies = all_at_once(
        *[lambda: server.ask(OWNER, "PATCH", f"/submissions/{submission}", json=publish)] * 5
    )
    assert replies == [200] * 5
    assert watched.calls == 2
