"""Whatever scores takes its turn: uploads, and what scores a kept submission again."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any

import httpx
import pytest

from reverie_eval.server.http.runtime import Turns
from reverie_eval.server.scoring.boards import Board
from tests.support.serving import OPEN, OWNER, Serving, runtime_of
from tests.support.visiting import signed_in
from tests.support.waiting import wait_until


class Watched:
    """Counts how often a board scores, and how many do so at once."""

    def __init__(self, turns: Turns) -> None:
        self.calls = self.most = self._now = self._awaited = 0
        self._turns = turns
        self._counting = Lock()

    def around(self, score: Callable[..., Any]) -> Callable[..., Any]:
        """Return what scores, and is counted, when all others wait or one does not."""

        def watched(*given: Any) -> Any:
            with self._counting:
                self.calls += 1
                self._now += 1
                self.most = max(self.most, self._now)
            wait_until(lambda: self._turns.waiting >= self._awaited or self.most > 1)
            try:
                return score(*given)
            finally:
                with self._counting:
                    self._now -= 1
                self._awaited = 0

        return watched

    def all_at_once(self, *requests: Callable[[], httpx.Response]) -> list[int]:
        """Send requests, of which the first that scores is done after the others have come."""
        self._awaited = len(requests) - 1
        with ThreadPoolExecutor(len(requests)) as pool:
            futures = [pool.submit(ask) for ask in requests]
            return [future.result().status_code for future in futures]


@pytest.fixture
def watched(server: Serving, monkeypatch: pytest.MonkeyPatch) -> Watched:
    """Watch a server that scores one file at a time."""
    watched = Watched(runtime_of(server).scoring)
    monkeypatch.setattr(Board, "score", watched.around(Board.score))
    return watched


def sent(server: Serving) -> str:
    return str(server.upload(OWNER, server.distinct()).json()["submission"]["id"])


def test_no_more_score_at_once_than_there_are_processes_for_it(
    server: Serving, watched: Watched
) -> None:
    first, second, third = (sent(server) for _ in range(3))
    visitor = signed_in(server, OWNER)
    replies = watched.all_at_once(
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
    replies = watched.all_at_once(
        *[lambda: server.ask(OWNER, "PATCH", f"/submissions/{submission}", json=publish)] * 5
    )
    assert replies == [200] * 5
    assert watched.calls == 2
