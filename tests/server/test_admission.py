"""Room for uploads: to each team a share, which is free again before the reply is read."""

import asyncio
import os
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from anyio.from_thread import BlockingPortal
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from reverie_eval.server.app import create_app
from reverie_eval.server.errors import BusyError
from reverie_eval.server.http.runtime import Admission, RuntimeState
from reverie_eval.server.http.workers import Workers
from reverie_eval.server.jobs.work import jobs_of
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
    settings_of,
)
from tests.support.visiting import signed_in
from tests.support.waiting import PATIENCE

MANY = 30
"""More places than any one team has."""
BLUE, RED, GREEN = 1, 2, 3

Around = Callable[[ASGIApp, Admission], ASGIApp]


@pytest.fixture
def crowded(
    folder: Path, open_server: OpenServer, portal: BlockingPortal
) -> Iterator[Callable[..., tuple[Serving, Admission]]]:
    """Return what opens a server with one place for each team, where nobody waits."""
    clients = []

    def open_crowded(
        at_once: int, around: Around = lambda app, _: app
    ) -> tuple[Serving, Admission]:
        limits = Limits(uploads_at_once=at_once, uploads_waiting=0)
        opened = open_server(settings_of(folder).model_copy(update={"limits": limits}))
        app = create_app(opened.state, "http://server")
        admission: Admission = app.state.runtime.admission
        transport = InProcess(around(app, admission), portal)
        clients.append(httpx.Client(transport=transport, base_url="http://server"))
        return replace(opened, client=clients[-1]), admission

    yield open_crowded
    for client in clients:
        client.close()


def letting_another_in(app: ASGIApp, admission: Admission) -> ASGIApp:
    """Return an application that lets in another upload before it sends anything."""

    async def answering(scope: Scope, receive: Receive, send: Send) -> None:
        async def sending(message: Message) -> None:
            async with admission.hold(RED):
                await send(message)

        await app(scope, receive, sending)

    return answering


@pytest.mark.parametrize("path", ["validate", "submissions?name=x"])
def test_a_place_is_free_before_the_reply_is_taken(
    path: str, crowded: Callable[..., tuple[Serving, Admission]]
) -> None:
    server, _ = crowded(1, letting_another_in)
    reply = server.ask(OWNER, "POST", f"/splits/{OPEN}/{path}", content=GOOD)
    assert reply.status_code in {200, 201}


def test_a_team_is_one_whoever_sends_and_how(
    crowded: Callable[..., tuple[Serving, Admission]], portal: BlockingPortal
) -> None:
    server, admission = crowded(4)
    visitor = signed_in(server, OWNER)
    with portal.wrap_async_context_manager(admission.hold(server.person(OWNER).team_id)):
        assert server.upload(OWNER).status_code == 503
        assert server.upload(MATE).status_code == 503
        assert visitor.upload().status_code == 503
        assert server.upload(OTHER).status_code == 201
    assert visitor.upload().status_code == 303


async def held(admission: Admission, team: int, places: AsyncExitStack) -> int:
    """Return how many uploads of a team are let in without waiting, and let them stay."""
    for count in range(MANY):
        try:
            await places.enter_async_context(admission.hold(team))
        except BusyError:
            return count
    pytest.fail("there is no end of places")


async def held_by_five(admission: Admission) -> list[int]:
    async with AsyncExitStack() as places:
        return [await held(admission, team, places) for team in range(5)]


@pytest.mark.parametrize(
    ("at_once", "expected"),
    [
        (1, [1, 0, 0, 0, 0]),
        (3, [1, 1, 1, 0, 0]),
        (7, [1, 1, 1, 1, 1]),
        (8, [2, 2, 2, 2, 0]),
        (11, [2, 2, 2, 2, 2]),
        (32, [8, 8, 8, 8, 0]),
    ],
)
def test_one_team_holds_no_more_than_a_quarter_of_the_places(
    at_once: int, expected: list[int]
) -> None:
    admission = Admission(at_once, waiting=0, seconds=PATIENCE)

    async def twice() -> list[list[int]]:
        return [await held_by_five(admission), await held_by_five(admission)]

    assert asyncio.run(twice()) == [expected, expected], "all places were given back"


def test_each_of_two_workers_has_half_of_the_places(folder: Path, open_server: OpenServer) -> None:
    limits = Limits(uploads_at_once=32, uploads_waiting=0)
    server = open_server(settings_of(folder).model_copy(update={"limits": limits}))
    jobs = jobs_of(server.state, lambda: None)
    admission = RuntimeState.of(server.state, jobs, Workers(2)).admission
    assert asyncio.run(held_by_five(admission)) == [4, 4, 4, 4, 0]


@pytest.mark.parametrize("at_once", [1, 1000])
def test_no_more_are_scored_at_once_than_there_are_cores(at_once: int) -> None:
    admission = Admission(at_once, waiting=0, seconds=PATIENCE)

    async def scored_at_once() -> int:
        async with AsyncExitStack() as turns:
            for count in range(at_once + 1):
                if admission.score().locked():
                    return count
                await turns.enter_async_context(admission.score())
        pytest.fail("more are scored than are let in")

    assert asyncio.run(scored_at_once()) == min(at_once, os.cpu_count() or 1)


def test_who_has_their_share_waits_and_nobody_else() -> None:
    admission = Admission(at_once=8, waiting=1, seconds=PATIENCE)

    async def upload(team: int) -> None:
        async with admission.hold(team):
            pass

    async def scenario() -> None:
        async with admission.hold(BLUE), admission.hold(BLUE):
            third = asyncio.create_task(upload(BLUE))
            await asyncio.sleep(0)
            assert admission.waiting == 1
            with pytest.raises(BusyError):
                await upload(BLUE)
            await upload(RED)
            assert not third.done()
        await third
        assert admission.waiting == 0

    asyncio.run(scenario())


def test_a_full_queue_is_full_for_every_team() -> None:
    admission = Admission(at_once=1, waiting=1, seconds=PATIENCE)

    async def upload(team: int) -> None:
        async with admission.hold(team):
            pass

    async def scenario() -> None:
        async with admission.hold(BLUE):
            second, third = (asyncio.create_task(upload(team)) for team in (RED, GREEN))
            await asyncio.sleep(0)
            assert admission.waiting == 1
            assert third.done()
            assert isinstance(third.exception(), BusyError)
        await second

    asyncio.run(scenario())


def test_one_team_fills_no_more_than_a_quarter_of_the_queue() -> None:
    admission = Admission(at_once=4, waiting=8, seconds=PATIENCE)

    async def upload(team: int) -> None:
        async with admission.hold(team):
            pass

    async def scenario() -> None:
        async with admission.hold(BLUE), admission.hold(RED):
            queued = [asyncio.create_task(upload(BLUE)) for _ in range(2)]
            await asyncio.sleep(0)
            with pytest.raises(BusyError):
                await upload(BLUE)
            queued.append(asyncio.create_task(upload(RED)))
            await asyncio.sleep(0)
            assert admission.waiting == 3
        await asyncio.gather(*queued)

    asyncio.run(scenario())


def test_whose_turn_never_comes_leaves_their_place_to_others() -> None:
    admission = Admission(at_once=4, waiting=9, seconds=0.01)

    async def scenario() -> None:
        async with admission.hold(BLUE):
            with pytest.raises(BusyError):
                async with admission.hold(BLUE):
                    pytest.fail("there was a place")
        async with AsyncExitStack() as places:
            for team in (BLUE, RED, 3, 4):
                await places.enter_async_context(admission.hold(team))
            with pytest.raises(BusyError):
                await places.enter_async_context(admission.hold(5))
        async with admission.hold(5):
            assert admission.waiting == 0

    asyncio.run(scenario())
