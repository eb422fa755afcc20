"""Work that a server does by itself: what fails or hangs harms nothing else, and is told."""

import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from datetime import timedelta
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any, NamedTuple

import httpx
import pytest
from anyio.from_thread import BlockingPortal
from sqlalchemy import select

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.service import Phase
from reverie_eval.server import app as application
from reverie_eval.server import jobs as runner
from reverie_eval.server.app import add_rooms, create_app, jobs_of
from reverie_eval.server.errors import BusyError
from reverie_eval.server.home import room as home
from reverie_eval.server.jobs import Job, Jobs, one_line
from reverie_eval.server.messages import delivery
from reverie_eval.server.operations import health
from reverie_eval.server.settings import Settings
from reverie_eval.server.store.tables import AuditEntry, Message, StoredSnapshot, Submission
from tests.server.test_notifications import Hook, Mailbox, hook, hook_at, mail_server, mail_to
from tests.support.acting import NOON
from tests.support.ports import free_port
from tests.support.serving import (
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    InProcess,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
)
from tests.support.visiting import said
from tests.support.waiting import PATIENCE, wait_until

__all__ = ["hook"]

CLOSES = NOON + timedelta(hours=1)
DAYS = 30


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at the health of a server whenever somebody asks, and do again at once what failed."""
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    monkeypatch.setattr(runner, "SECONDS_TO_RETRY", 0.05)
    for room in ("boards", "messages"):
        monkeypatch.setattr(f"reverie_eval.server.{room}.room.SOON", 0.05)


@pytest.fixture
def busy_settings(folder: Path, database: str, hook: Hook) -> Settings:
    """Return the settings of a server with something to do for each job, on each database."""
    phase = Phase(name="challenge", closes=CLOSES)
    changes = {
        "webhook": hook_at(hook, events=["phase-end"]),
        "keep_uploads_days": DAYS,
        "public_address": "https://eval.example.org",
    }
    settings = settings_of(folder, database).model_copy(update=changes)
    return adjusted(settings, phases=(phase,))


AtWork = Callable[[Serving], AbstractContextManager[httpx.Client]]


@pytest.fixture
def at_work(portal: BlockingPortal) -> AtWork:
    """Return what lets a server do its jobs, and gives who asks it."""

    @contextmanager
    def at_work(server: Serving) -> Iterator[httpx.Client]:
        app = create_app(server.state, "http://server")
        lifespan = portal.wrap_async_context_manager(app.router.lifespan_context(app))
        with (
            lifespan,
            httpx.Client(transport=InProcess(app, portal), base_url="http://server") as client,
        ):
            yield client

    return at_work


def send(server: Serving, who: str, *, published: bool) -> str:
    """Upload something to the split whose phase will end."""
    reply = server.upload(who, server.distinct(PRIVATE), PRIVATE)
    submission: str = reply.json()["submission"]["id"]
    path = f"/submissions/{submission}"
    if published:
        assert server.ask(who, "PATCH", path, json={"published": True}).status_code == 200
    return submission


def after_the_phase(server: Serving) -> Serving:
    """Return a server with a result that is shown, a file that is not kept, and a phase's end."""
    send(server, OWNER, published=True)
    send(server, OTHER, published=False)
    server.clock.now = CLOSES + timedelta(seconds=1)
    return server


def spoil_row(server: Serving) -> Callable[[], object]:
    """Let nobody read the result that is shown; return what repairs it."""
    shown = select(Submission).where(Submission.published_at.is_not(None))

    def write(report: dict[str, Any]) -> None:
        with server.state.database.writing() as session:
            session.scalars(shown).one().report = report

    with server.state.database.reading() as session:
        report = session.scalars(shown).one().report
    write({})
    return lambda: write(report)


def spoil_upload(server: Serving) -> Callable[[], object]:
    """Put a folder in the place of a file that is to be deleted; return what repairs that."""
    server.clock.turn(days=DAYS)
    with server.state.database.reading() as session:
        hidden = select(Submission.sha256).where(Submission.published_at.is_(None))
        name = session.scalars(hidden).one()
    (file,) = server.state.settings.folder.rglob(f"{name}*")
    moved = file.rename(file.with_name("moved"))
    (file / "within").mkdir(parents=True)

    def repair() -> None:
        (file / "within").rmdir()
        file.rmdir()
        moved.rename(file)

    return repair


def spoil_webhook(server: Serving) -> Callable[[], object]:
    """Let the webhook refuse a message; return what lets it accept the next."""
    kept = server.state.settings.webhook
    assert kept is not None
    told = {"channel": "webhook", "event": "phase-end", "text": "x", "path": "/", "error": ""}
    port = kept.url.port
    object.__setattr__(kept, "url", kept.url.build(scheme="http", host="127.0.0.1", port=1))
    now = server.clock()
    with server.state.database.writing() as session:
        session.add(Message(**told, created_at=now, due_at=now, attempts=0))

    def repair() -> None:
        url = kept.url.build(scheme="http", host="127.0.0.1", port=port or 0)
        object.__setattr__(kept, "url", url)
        server.clock.turn(hours=7)

    return repair


class Fault(NamedTuple):
    """Something that lets a job fail."""

    plant: Callable[[Serving], Callable[[], object]]
    """Does it, and returns what repairs it."""
    failing: str
    """The job that fails, whose backlog grows."""
    kind: str
    """What the backlog consists of."""
    error: str
    """How its error begins."""


FAULTS = [
    pytest.param(
        Fault(
            spoil_row,
            "snapshots",
            "due",
            "SnapshotError: the snapshot of test at the end of phase 'challenge' cannot be taken",
        ),
        id="a row that cannot be read",
    ),
    pytest.param(
        Fault(spoil_upload, "tidying", "files", "IsADirectoryError"), id="a file that stays"
    ),
    pytest.param(
        Fault(
            spoil_webhook,
            "webhook",
            "waiting",
            "DeliveryError: 2 messages could not be sent yet (webhook.url)",
        ),
        id="a webhook that is dead",
    ),
]


def reports(client: httpx.Client) -> dict[str, dict[str, Any]]:
    return {job["name"]: job for job in client.get("/healthz").json()["jobs"]}


def values(server: Serving, client: httpx.Client) -> dict[str, float]:
    """Return the metrics of jobs."""
    headers = {"Authorization": f"Bearer {server.tokens[ORGANISER]}"}
    lines = client.get("/metrics", headers=headers).text.splitlines()
    told = [line.rpartition(" ") for line in lines if line.startswith("reverie_eval_job_")]
    return {name: float(value) for name, _, value in told}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_job_that_fails_is_named_everywhere_and_stops_no_other(
    fault: Fault, busy_settings: Settings, open_server: OpenServer, at_work: AtWork
) -> None:
    server = after_the_phase(open_server(busy_settings))
    plant, failing, kind, error = fault
    repair = plant(server)
    with at_work(server) as client:
        # It has failed again, and every other job has ended.
        wait_until(lambda: all(job["runs"] for job in reports(client).values()))
        wait_until(lambda: reports(client)[failing]["failures"] > 1)
        reply = client.get("/healthz")
        assert reply.status_code == 503
        others = [name for name in reply.json()["failed"] if not name.startswith("job ")]
        assert sorted(reply.json()["failed"]) == sorted([f"job {failing}", *others])
        ready, needed = client.get("/readyz"), [name for name in others if name != "leaderboards"]
        assert (ready.status_code, ready.json()["failed"]) == (503 if needed else 200, needed)
        jobs = reports(client)
        assert {name for name, job in jobs.items() if job["error"]} == {failing}
        assert jobs[failing]["error"].startswith(error)
        assert jobs[failing]["last_success_at"] is None
        assert jobs[failing]["backlog"][kind] > 0
        told = values(server, client)
        for name, job in jobs.items():
            of_job = f'{{name="{name}"}}'
            assert told[f"reverie_eval_job_failing{of_job}"] == (name == failing)
            is_known = f"reverie_eval_job_last_success_timestamp_seconds{of_job}" in told
            assert is_known == (job["last_success_at"] is not None)
        desk = said(desk_of(server, client))
        assert error.partition("'")[0].rstrip() in desk
        assert f"job {failing}" in desk.partition("Failing:")[2]
        repair()
        wait_until(lambda: client.get("/healthz").json()["status"] == "ok")
        assert reports(client)[failing]["backlog"][kind] == 0


def desk_of(server: Serving, client: httpx.Client) -> httpx.Response:
    client.post("/sign-in", data={"token": server.tokens[ORGANISER]}, headers=SAME_SITE)
    return client.get("/desk")


SAME_SITE = {"Origin": "http://server"}


def test_a_job_that_begins_to_fail_is_told_though_nobody_asks(
    busy_settings: Settings, open_server: OpenServer, hook: Hook, at_work: AtWork
) -> None:
    webhook = hook_at(hook, events=["unhealthy"])
    server = after_the_phase(open_server(busy_settings.model_copy(update={"webhook": webhook})))
    spoil_row(server)
    with at_work(server):
        wait_until(hook.requests.copy)
    ((_, body),) = hook.requests
    assert json.loads(body)["event"] == "unhealthy"
    assert json.loads(body)["text"].startswith("job snapshots failed: ")


def test_two_servers_on_one_database_do_each_job_once(
    busy_settings: Settings, open_server: OpenServer, hook: Hook, at_work: AtWork
) -> None:
    first = after_the_phase(open_server(busy_settings))
    second = open_server(busy_settings, first.tokens)
    first.clock.turn(days=DAYS)
    second.clock.now = first.clock.now
    with first.state.database.writing() as session:
        session.add_all(
            Message(
                channel="webhook",
                event="phase-end",
                text=f"{number}",
                path="/",
                error="",
                attempts=0,
                created_at=first.clock.now,
                due_at=first.clock.now,
            )
            for number in range(20)
        )
    with ExitStack() as stack:
        clients = [stack.enter_context(at_work(server)) for server in (first, second)]
        for client in clients:
            wait_until(lambda client=client: is_done(client))  # type: ignore[misc]
    texts = [body for _, body in hook.requests]
    assert len(texts) == len(set(texts)) == 20
    with first.state.database.reading() as session:
        assert session.scalars(select(StoredSnapshot.title)).all() == ["challenge"]
        acted = select(AuditEntry.action).where(AuditEntry.actor == "server")
        assert sorted(session.scalars(acted)) == ["snapshot taken", "upload deleted"]


def is_done(client: httpx.Client) -> bool:
    """Whether all jobs have run, and nothing is left to do."""
    jobs = reports(client).values()
    return all(job["runs"] and not any(job["backlog"].values()) for job in jobs)


def test_a_mail_server_that_is_dead_is_told_by_webhook(
    folder: Path, hook: Hook, open_server: OpenServer, at_work: AtWork
) -> None:
    port = free_port()
    channels = {"mail": mail_to(port), "webhook": hook_at(hook)}
    server = open_server(settings_of(folder).model_copy(update=channels))
    assert server.upload(OWNER).status_code == 201
    with at_work(server) as client:
        wait_until(lambda: sorted(hook.events()) == ["submission", "unhealthy"])
        assert client.get("/healthz").json()["failed"] == ["job mail"]
        assert client.get("/readyz").status_code == 200
        assert reports(client)["mail"]["backlog"]["waiting"] == 2
        assert "(mail.host, mail.port)" in reports(client)["mail"]["error"]
        assert f"{port}" not in reports(client)["mail"]["error"]
        box = Mailbox()
        with mail_server(box, port):
            server.clock.turn(hours=7)
            wait_until(lambda: client.get("/healthz").json()["status"] == "ok")
        assert len(box.mails) == 1


@pytest.fixture
def hanging(folder: Path, hook: Hook, open_server: OpenServer) -> Iterator[Serving]:
    """Return a server whose mail server accepts connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        channels = {"mail": mail_to(listening.getsockname()[1]), "webhook": hook_at(hook)}
        yield open_server(settings_of(folder).model_copy(update=channels))


def test_a_mail_server_that_hangs_delays_no_other_job(
    hanging: Serving, hook: Hook, at_work: AtWork, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = hanging
    monkeypatch.setattr(runner, "SECONDS_TO_STOP", 0.1)
    monkeypatch.setattr(delivery, "SECONDS_TO_SEND", PATIENCE)  # until the test has ended
    assert server.upload(OWNER).status_code == 201
    with at_work(server) as client:
        wait_until(lambda: hook.events() == ["submission"])
        wait_until(lambda: reports(client)["warm-up"]["runs"])
        assert reports(client)["mail"]["runs"] == 0
        assert client.get("/healthz").status_code == 200
        later = SimpleNamespace(monotonic=lambda: time.monotonic() + runner.SECONDS_TO_RUN)
        monkeypatch.setattr(runner, "time", later)
        assert "job mail" in client.get("/healthz").json()["failed"]
        assert reports(client)["mail"]["is_overdue"]


# The first visitor.


def test_nobody_waits_for_what_a_server_computes_when_it_starts(
    server: Serving, at_work: AtWork, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, gate = Event(), Event()

    def hang(_: object) -> None:
        begun.set()
        assert gate.wait(PATIENCE)

    monkeypatch.setattr(home, "warm_up", hang)
    with at_work(server) as client:
        assert begun.wait(PATIENCE)
        first = client.get("/")
        assert first.status_code == 200
        assert "leaderboards" in said(first)
        assert 'class="example"' not in first.text
        assert "Random" not in first.text
        gate.set()
        wait_until(lambda: reports(client)["warm-up"]["runs"])
        assert 'class="example"' in client.get("/").text
        assert "Random" in client.get("/").text


def test_a_server_computes_what_its_first_page_shows(
    server: Serving, at_work: AtWork, monkeypatch: pytest.MonkeyPatch
) -> None:
    with at_work(server) as client:
        wait_until(lambda: reports(client)["warm-up"]["runs"])
        monkeypatch.delattr("reverie_eval.server.explore.episodes.run_agent")
        monkeypatch.delattr("reverie_eval.server.explore.room.BuildingPicture")
        assert 'class="example"' in client.get("/").text


def test_a_server_knows_its_routes_before_the_first_request(
    server: Serving, at_work: AtWork, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "add_rooms", add_rooms)  # tests share routes otherwise
    with at_work(server) as client, monkeypatch.context() as broken:
        broken.delattr("fastapi.routing.get_dependant")
        assert client.get("/guide").status_code == 200


# Any job.


def test_a_job_runs_at_once_and_again_even_if_it_fails(server: Serving) -> None:
    done, calls = Event(), iter(range(1000))

    def work() -> None:
        if next(calls) == 0:
            raise OSError("the disk is full")
        done.set()

    jobs = Jobs([Job("test", work, 0.01)], server.state.database, server.clock)
    assert jobs.reports() == []  # not started
    with jobs.running():
        assert done.wait(PATIENCE)
        wait_until(lambda: jobs.reports()[0].last_success_at)
    (report,) = jobs.reports()
    assert (report.failures, report.error, jobs.failing()) == (1, "", [])


def test_a_job_that_the_end_of_its_server_cuts_off_is_no_fault(
    server: Serving, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(runner, "SECONDS_TO_STOP", 0)
    begun, is_cut_off = Event(), Event()
    told: list[str] = []

    def work() -> None:
        begun.set()
        is_cut_off.wait(PATIENCE)
        raise BusyError(1, "the process that was reading the file was stopped")

    jobs = Jobs([Job("long", work, None)], server.state.database, server.clock, told.append)
    with jobs.running():
        begun.wait(PATIENCE)
    is_cut_off.set()
    wait_until(lambda: jobs.reports()[0].runs == 1)
    assert (caplog.messages, told) == ([], [])


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ReverieEvalError("the key\nwas replaced"), "ReverieEvalError: the key was replaced"),
        (OSError(13, "Permission denied", "/srv/secret"), "PermissionError: Permission denied"),
        (ValueError("the answer is 42"), "ValueError"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid"), "UnicodeDecodeError"),
    ],
    ids=lambda each: type(each).__name__ if isinstance(each, Exception) else "",
)
def test_an_error_is_told_without_what_it_may_quote(error: Exception, line: str) -> None:
    assert one_line(error) == line


def test_a_backlog_that_cannot_be_counted_is_left_out(server: Serving) -> None:
    def count(*_: object) -> dict[str, int]:
        raise ValueError

    jobs = Jobs([Job("test", lambda: None, 9, count)], server.state.database, server.clock)
    with jobs.running():
        assert jobs.reports()[0].backlog == {}


def test_a_scoring_process_that_is_killed_while_a_server_warms_up_is_no_fault(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes = iter([BusyError(10), None])

    def warm_up(_: object) -> None:
        if (error := next(outcomes)) is not None:
            raise error

    monkeypatch.setattr(home, "warm_up", warm_up)
    (job,) = (job for job in jobs_of(server.state).jobs if job.name == "warm-up")
    job.work()
    assert next(outcomes, "warm") == "warm"
