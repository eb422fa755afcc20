"""Whatever scores takes its turn: uploads, and what scores a kept submission again."""

from asyncio import Semaphore
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Condition
from typing import Any

import httpx
import pytest

from reverie_eval.server.http.runtime import Admission
from reverie_eval.server.service.boards import Board
from tests.support.serving import OPEN, OWNER, OpenServer, Serving
from tests.support.visiting import signed_in
from tests.support.waiting import PATIENCE


class Watched:
    """Counts how often a board scores, and how many do so at once."""

    def __init__(self) -> None:
        self.calls = self.most = self._now = self._waiting = self._awaited = 0
        self._changed = Condition()

    def around(self, score: Callable[..., Any]) -> Callable[..., Any]:
        """Return what scores, and is counted, when all others wait or one does not."""

        def watched(*given: Any) -> Any:
            with self._changed:
                self.calls += 1
                self._now += 1
                self.most = max(self.most, self._now)
                self._changed.notify_all()
                assert self._changed.wait_for(self._is_settled, PATIENCE)
            try:
                return score(*given)
            finally:
                with self._changed:
                    self._now -= 1

        return watched

    def before(self, gate: Callable[[Admission], Semaphore]) -> Callable[[Admission], Semaphore]:
        """Return what is asked for a turn, and counts who has to wait for it."""

        def watched(admission: Admission) -> Semaphore:
            with self._changed:
                self._waiting += gate(admission).locked()
                self._changed.notify_all()
            return gate(admission)

        return watched

    def all_at_once(self, *requests: Callable[[], httpx.Response]) -> list[int]:
        """Send requests, of which the first that scores is done after the others have come."""
        self._waiting, self._awaited = 0, len(requests) - 1
        with ThreadPoolExecutor(len(requests)) as pool:
            futures = [pool.submit(ask) for ask in requests]
            return [future.result().status_code for future in futures]

    def _is_settled(self) -> bool:
        return self._waiting >= self._awaited or self.most > 1


@pytest.fixture
def server(open_server: OpenServer, monkeypatch: pytest.MonkeyPatch) -> Serving:
    """Return a server on a machine with one processor."""
    monkeypatch.setattr("reverie_eval.server.http.runtime._SCORED_AT_ONCE", 1)
    return open_server()


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    watched = Watched()
    monkeypatch.setattr(Board, "score", watched.around(Board.score))
    monkeypatch.setattr(Admission, "score", watched.before(Admission.score))
    return watched


def sent(server: Serving) -> str:
    return str(server.upload(OWNER, server.distinct()).json()["submission"]["id"])


def test_no_more_are_scored_at_once_than_there_are_processors(
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
