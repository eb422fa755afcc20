"""When an upload counts: as soon as all of it has arrived, however long the server takes."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from datetime import datetime, timedelta
from pathlib import Path

import httpx
import pytest
from anyio.from_thread import BlockingPortal

from reverie_eval.schemas.organising import NewNotice
from reverie_eval.schemas.service import Phase
from reverie_eval.server.http.runtime import Turns
from reverie_eval.server.messages.notices import post_notice
from tests.support.acting import NOON
from tests.support.serving import (
    MATE,
    OPEN,
    OTHER,
    OWNER,
    OpenServer,
    Serving,
    adjusted,
    runtime_of,
    settings_of,
)
from tests.support.signing import receipt_in
from tests.support.visiting import signed_in
from tests.support.waiting import wait_until

CLOSES = NOON + timedelta(seconds=1)
Upload = Callable[[Serving], httpx.Response]
UPLOADS: dict[str, Upload] = {
    "the API": lambda server: server.upload(OWNER),
    "a page": lambda server: signed_in(server, OWNER).upload(),
}
ACCEPTED = {201, 303}


@pytest.fixture
def closing(folder: Path, open_server: OpenServer) -> Serving:
    """Return a server with a phase that closes in a second."""
    phases = (Phase(name="first", closes=CLOSES),)
    return open_server(adjusted(settings_of(folder), OPEN, phases=phases))


@pytest.fixture
def in_line_for_scoring(
    portal: BlockingPortal,
) -> Callable[[Serving], AbstractContextManager[Turns]]:
    """Return what lets nobody score for a while; gives the turns, which tell who waits."""

    @contextmanager
    def nobody_scores(server: Serving) -> Iterator[Turns]:
        turns = runtime_of(server).scoring
        with ExitStack() as held:
            for number in range(server.state.scoring.number):
                held.enter_context(portal.wrap_async_context_manager(turns.hold(1000 + number)))
            yield turns

    return nobody_scores


def received_at(server: Serving) -> list[datetime]:
    """Return when the receipts say that submissions came."""
    found = server.ask(OWNER, "GET", "/submissions").json()
    return [receipt_in(each["receipt"]).received_at for each in found]


@pytest.mark.parametrize("upload", UPLOADS.values(), ids=UPLOADS)
def test_who_has_arrived_in_time_is_in_time_however_long_the_queue(
    upload: Upload,
    closing: Serving,
    in_line_for_scoring: Callable[[Serving], AbstractContextManager[Turns]],
) -> None:
    with ThreadPoolExecutor(1) as pool:
        with in_line_for_scoring(closing) as turns:
            reply = pool.submit(upload, closing)
            wait_until(lambda: turns.waiting)
            closing.clock.turn(hours=1)
        assert reply.result().status_code in ACCEPTED
    assert received_at(closing) == [NOON]


@pytest.mark.parametrize("upload", UPLOADS.values(), ids=UPLOADS)
def test_a_pause_does_not_refuse_what_had_arrived(
    upload: Upload,
    server: Serving,
    in_line_for_scoring: Callable[[Serving], AbstractContextManager[Turns]],
) -> None:
    with ThreadPoolExecutor(1) as pool:
        with in_line_for_scoring(server) as turns:
            reply = pool.submit(upload, server)
            wait_until(lambda: turns.waiting)
            server.clock.turn(seconds=1)
            with server.acting() as transaction:
                post_notice(transaction, NewNotice(banner="", paused=True))
        assert reply.result().status_code in ACCEPTED
    assert server.upload(OTHER).json()["code"] == "not-open"


def test_a_pause_that_is_over_still_refuses_what_arrived_during_it(
    server: Serving,
    in_line_for_scoring: Callable[[Serving], AbstractContextManager[Turns]],
) -> None:
    def post(*, paused: bool) -> None:
        server.clock.turn(seconds=1)
        with server.acting() as transaction:
            post_notice(transaction, NewNotice(banner="", paused=paused))

    post(paused=True)
    with ThreadPoolExecutor(1) as pool:
        with in_line_for_scoring(server) as turns:
            reply = pool.submit(server.upload, OWNER)
            wait_until(lambda: turns.waiting)
            post(paused=False)
        assert reply.result().json()["code"] == "not-open"


@pytest.mark.parametrize("upload", UPLOADS.values(), ids=UPLOADS)
def test_what_waits_unread_loses_no_time(
    upload: Upload, closing: Serving, portal: BlockingPortal
) -> None:
    unread = runtime_of(closing).uploads
    with ThreadPoolExecutor(1) as pool:
        with ExitStack() as places:
            for number in range(closing.state.settings.limits.uploads_at_once):
                place = portal.wrap_async_context_manager(unread.hold(1000 + number))
                places.enter_context(place)
            reply = pool.submit(upload, closing)
            wait_until(lambda: unread.waiting == 1)
            closing.clock.turn(hours=1)
        assert reply.result().status_code in ACCEPTED
    assert received_at(closing) == [NOON]


def test_thirty_uploads_that_wait_for_one_slot_are_all_in_time(
    closing: Serving,
    in_line_for_scoring: Callable[[Serving], AbstractContextManager[Turns]],
) -> None:
    people = (OWNER, MATE, OTHER)
    replies: list[Future[httpx.Response]] = []
    with ThreadPoolExecutor(30) as pool:
        with in_line_for_scoring(closing) as turns:
            for number in range(30):
                content = closing.distinct()
                replies.append(pool.submit(closing.upload, people[number % 3], content))
            unread = runtime_of(closing).uploads
            wait_until(lambda: turns.waiting + unread.waiting == 30)
            closing.clock.turn(hours=1)
        assert [reply.result().status_code for reply in replies] == [201] * 30


def test_who_arrives_late_is_late(closing: Serving) -> None:
    closing.clock.turn(seconds=2)
    assert closing.upload(OWNER).json()["code"] == "not-open"
