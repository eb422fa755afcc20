"""Room for uploads: to each team a share, which is free again before the reply is read."""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from anyio.from_thread import BlockingPortal
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from reverie_eval.server.app import create_app, jobs_of
from reverie_eval.server.errors import BusyError
from reverie_eval.server.http.runtime import RuntimeState, Turns
from reverie_eval.server.settings import Limits
from tests.support.serving import (
    GOOD,
    MATE,
    OPEN,
    OTHER,
    OWNER,
    InProcess,
    OpenServer,
    Serving,
    runtime_of,
    settings_of,
)
from tests.support.visiting import signed_in
from tests.support.waiting import PATIENCE

MANY = 30
"""More places than any one team has."""
BLUE, RED, GREEN = 1, 2, 3

Around = Callable[[ASGIApp, Turns], ASGIApp]


@pytest.fixture
def crowded(
    folder: Path, open_server: OpenServer, portal: BlockingPortal
) -> Iterator[Callable[..., tuple[Serving, Turns]]]:
    """Return what opens a server with one place for each team, where nobody waits."""
    clients = []

    def open_crowded(at_once: int, around: Around = lambda app, _: app) -> tuple[Serving, Turns]:
        limits = Limits(uploads_at_once=at_once, uploads_waiting=0)
        opened = open_server(settings_of(folder).model_copy(update={"limits": limits}))
        app = create_app(opened.state, "http://server")
        turns: Turns = app.state.runtime.uploads
        transport = InProcess(around(app, turns), portal)
        clients.append(httpx.Client(transport=transport, base_url="http://server"))
        return replace(opened, client=clients[-1]), turns

    yield open_crowded
    for client in clients:
        client.close()


def letting_another_in(app: ASGIApp, turns: Turns) -> ASGIApp:
    """Return an application that lets in another upload before it sends anything."""

    async def answering(scope: Scope, receive: Receive, send: Send) -> None:
        async def sending(message: Message) -> None:
            async with turns.hold(RED):
                await send(message)

        await app(scope, receive, sending)

    return answering


@pytest.mark.parametrize("path", ["validate", "submissions?name=x"])
def test_a_place_is_free_before_the_reply_is_taken(
    path: str, crowded: Callable[..., tuple[Serving, Turns]]
) -> None:
    server, _ = crowded(1, letting_another_in)
    reply = server.ask(OWNER, "POST", f"/splits/{OPEN}/{path}", content=GOOD)
    assert reply.status_code in {200, 201}


def test_a_team_is_one_whoever_sends_and_how(
    crowded: Callable[..., tuple[Serving, Turns]], portal: BlockingPortal
) -> None:
    server, turns = crowded(4)
    visitor = signed_in(server, OWNER)
    with portal.wrap_async_context_manager(turns.hold(server.person(OWNER).team_id)):
        assert server.upload(OWNER).status_code == 503
        assert server.upload(MATE).status_code == 503
        assert visitor.upload().status_code == 503
        assert server.upload(OTHER).status_code == 201
    assert visitor.upload().status_code == 303


async def held(turns: Turns, whose: int, places: AsyncExitStack) -> int:
    """Return how many places somebody gets without waiting, and let them keep these."""
    for count in range(MANY):
        try:
            await places.enter_async_context(turns.hold(whose))
        except BusyError:
            return count
    pytest.fail("there is no end of places")


async def held_by_five(turns: Turns) -> list[int]:
    async with AsyncExitStack() as places:
        return [await held(turns, whose, places) for whose in range(5)]


@pytest.mark.parametrize(
    ("places", "share", "expected"),
    [
        (1, 1, [1, 0, 0, 0, 0]),
        (3, 1, [1, 1, 1, 0, 0]),
        (7, 1, [1, 1, 1, 1, 1]),
        (8, 2, [2, 2, 2, 2, 0]),
        (11, 2, [2, 2, 2, 2, 2]),
        (32, 8, [8, 8, 8, 8, 0]),
        (2, 5, [2, 0, 0, 0, 0]),
    ],
)
def test_nobody_holds_more_than_their_share(places: int, share: int, expected: list[int]) -> None:
    turns = Turns(places, share, waiting=0, seconds=PATIENCE)

    async def twice() -> list[list[int]]:
        return [await held_by_five(turns), await held_by_five(turns)]

    assert asyncio.run(twice()) == [expected, expected], "all places were given back"


@pytest.mark.parametrize(
    ("at_once", "share"), [(1, 1), (3, 1), (7, 1), (8, 2), (11, 2), (32, 8), (40, 10)]
)
def test_a_team_holds_no_more_than_a_quarter_of_the_uploads_in_memory(
    at_once: int, share: int, folder: Path, open_server: OpenServer
) -> None:
    limits = Limits(uploads_at_once=at_once, uploads_waiting=0)
    server = open_server(settings_of(folder).model_copy(update={"limits": limits}))

    async def one() -> int:
        async with AsyncExitStack() as places:
            return await held(runtime_of(server).uploads, BLUE, places)

    assert asyncio.run(one()) == share


@pytest.mark.parametrize(("processes", "share"), [(2, 1), (3, 2), (8, 7)])
def test_a_team_leaves_a_process_that_scores_to_all_others(
    processes: int, share: int, server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server.state.scoring, "number", processes)
    monkeypatch.setattr(server.state.scoring, "turns", 2 * processes)
    turns = RuntimeState.of(server.state, jobs_of(server.state)).scoring

    async def scenario() -> int:
        async with AsyncExitStack() as places:
            for _ in range(share):
                await places.enter_async_context(turns.hold(BLUE))
            fourth = asyncio.create_task(turns.hold(BLUE).__aenter__())
            await asyncio.sleep(0)
            count = await held(turns, RED, places)
            assert not fourth.done()
            fourth.cancel()
        return count

    monkeypatch.setattr(turns, "_most_waiting", 1)
    assert asyncio.run(scenario()) == share


def test_who_has_their_share_waits_and_nobody_else() -> None:
    turns = Turns(8, 2, waiting=1, seconds=PATIENCE)

    async def scenario() -> None:
        async with turns.hold(BLUE), turns.hold(BLUE):
            third = asyncio.create_task(once(turns, BLUE))
            await asyncio.sleep(0)
            assert turns.waiting == 1
            with pytest.raises(BusyError):
                await once(turns, BLUE)
            await once(turns, RED)
            assert not third.done()
        await third
        assert turns.waiting == 0

    asyncio.run(scenario())


async def once(turns: Turns, whose: int) -> None:
    async with turns.hold(whose):
        pass


def test_a_full_queue_is_full_for_everyone() -> None:
    turns = Turns(1, 1, waiting=1, seconds=PATIENCE)

    async def scenario() -> None:
        async with turns.hold(BLUE):
            second, third = (asyncio.create_task(once(turns, whose)) for whose in (RED, GREEN))
            await asyncio.sleep(0)
            assert turns.waiting == 1
            assert third.done()
            assert isinstance(third.exception(), BusyError)
        await second

    asyncio.run(scenario())


def test_one_fills_no_more_than_a_quarter_of_the_queue() -> None:
    turns = Turns(4, 1, waiting=8, seconds=PATIENCE)

    async def scenario() -> None:
        async with turns.hold(BLUE), turns.hold(RED):
            queued = [asyncio.create_task(once(turns, BLUE)) for _ in range(2)]
            await asyncio.sleep(0)
            with pytest.raises(BusyError):
                await once(turns, BLUE)
            queued.append(asyncio.create_task(once(turns, RED)))
            await asyncio.sleep(0)
            assert turns.waiting == 3
        await asyncio.gather(*queued)

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("asked", "served"),
    [
        pytest.param([BLUE, BLUE, BLUE, RED], [RED, BLUE, BLUE, BLUE], id="who holds none"),
        pytest.param([RED, GREEN], [RED, GREEN], id="who came first"),
        pytest.param([GREEN, RED, GREEN], [GREEN, RED, GREEN], id="each in turn"),
    ],
)
def test_who_holds_fewest_is_next_then_who_came_first(asked: list[int], served: list[int]) -> None:
    turns, order = Turns(2, 2, waiting=100, seconds=PATIENCE), list[int]()

    async def note(whose: int) -> None:
        async with turns.hold(whose):
            order.append(whose)

    async def scenario() -> None:
        async with turns.hold(BLUE):
            async with turns.hold(BLUE if BLUE in asked else 4):
                queued = [asyncio.create_task(note(whose)) for whose in asked]
                await asyncio.sleep(0)
            await asyncio.gather(*queued)

    asyncio.run(scenario())
    assert order == served


def test_whose_turn_never_comes_leaves_their_place_to_others() -> None:
    turns = Turns(4, 1, waiting=9, seconds=0.01)

    async def scenario() -> None:
        async with turns.hold(BLUE):
            with pytest.raises(BusyError):
                async with turns.hold(BLUE):
                    pytest.fail("there was a place")
        async with AsyncExitStack() as places:
            for whose in (BLUE, RED, 3, 4):
                await places.enter_async_context(turns.hold(whose))
            with pytest.raises(BusyError):
                await places.enter_async_context(turns.hold(5))
        async with turns.hold(5):
            assert turns.waiting == 0

    asyncio.run(scenario())


def test_who_gives_up_in_the_moment_of_their_turn_passes_it_on() -> None:
    turns = Turns(1, 1, waiting=9, seconds=PATIENCE)

    async def scenario() -> None:
        async with turns.hold(BLUE):
            second, third = (asyncio.create_task(once(turns, whose)) for whose in (RED, GREEN))
            await asyncio.sleep(0)
        second.cancel()  # its place was handed out, but it has not run since
        await third
        with pytest.raises(asyncio.CancelledError):
            await second
        await once(turns, BLUE)

    asyncio.run(scenario())
