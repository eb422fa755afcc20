"""Several worker processes of one server: together they keep to what one would keep to."""

import json
import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import Mock, patch

import httpx
import pytest
from limits import RateLimitItemPerMinute
from limits.strategies import FixedWindowRateLimiter
from prometheus_client.parser import text_string_to_metric_families
from sqlalchemy import select

from fixtures.servers import make_folder
from reverie_eval.server.http.workers import FileCounts, Workers
from reverie_eval.server.operations import run
from reverie_eval.server.operations.run import run_server
from reverie_eval.server.settings import load_settings
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Submission
from tests.support.forking import Forked, Surroundings
from tests.support.participants import RealServer, private_submission
from tests.support.serving import (
    GOOD,
    NO_TLS,
    OPEN,
    PRIVATE,
    Template,
    replace_answers,
    running,
)
from tests.support.waiting import PATIENCE, wait_until

MANY = 24
ALLOWED = 2
"""By default, in a day, on the private split."""
WINDOW = 60
ATTEMPTS = 5
"""To send a few requests within a window."""
"""Seconds in which requests are counted together."""


@dataclass(frozen=True)
class Crew:
    """A server of two worker processes."""

    real: RealServer
    process: Forked | subprocess.Popen[str]

    def logged(self) -> Sequence[Mapping[str, object]]:
        """Return the lines of its log, of which the last may be on its way."""
        whole, _, _ = self.real.log.read_text().rpartition("\n")
        return [json.loads(line) for line in whole.splitlines()]

    def replaced(self) -> Sequence[Mapping[str, object]]:
        """Return what the log says of workers that died."""
        return [line for line in self.logged() if line["event"] == "worker process replaced"]

    def workers(self) -> set[int]:
        """Return the processes that answer requests."""
        events = " ".join(str(line["event"]) for line in self.logged())
        started = {
            int(number) for number in re.findall(r"Started server process \[(\d+)\]", events)
        }
        return started - {int(str(line["dead"])) for line in self.replaced()}

    def get(self, path: str, token: str = "") -> httpx.Response:
        """Ask over a connection of its own."""
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        return httpx.get(f"{self.real.url}{path}", headers=headers, timeout=PATIENCE, verify=NO_TLS)

    def upload(self, token: str, split: str, content: bytes) -> httpx.Response:
        """Upload over a connection of its own."""
        return httpx.post(
            f"{self.real.url}/api/v1/splits/{split}/submissions?name=Walker",
            headers={"Authorization": f"Bearer {token}"},
            content=content,
            timeout=PATIENCE,
            verify=NO_TLS,
        )

    @contextmanager
    def only(self, worker: int) -> Iterator[None]:
        """Let one worker answer, and stop the other one meanwhile."""
        (other,) = self.workers() - {worker}
        os.kill(other, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(other, signal.SIGCONT)

    def requests_counted(self, organiser: str) -> float:
        """Return how often the metrics say that the list of splits was asked for."""
        text = self.get("/metrics", organiser).text
        return sum(
            sample.value
            for family in text_string_to_metric_families(text)
            for sample in family.samples
            if sample.name == "reverie_eval_requests_total"
            and sample.labels["route"] == "/api/v1/splits"
        )


@contextmanager
def serving(folder: Path, database: str, **limits: str) -> Iterator[Crew]:
    """Run two workers on a folder and a database."""
    variables = {f"REVERIE_EVAL_LIMITS__{name}": value for name, value in limits.items()}
    settings = load_settings(folder).model_copy(update={"database": database})
    with (
        running(folder, 2, REVERIE_EVAL_DATABASE=database, **variables) as (process, url),
        closing(Database(settings.database_url)) as opened,
    ):
        yield Crew(RealServer(url, settings, opened, folder / "log"), process)


@contextmanager
def started(folder: Path) -> Iterator[Crew]:
    """Run two workers that are not forked: each imports everything, as they do for users."""
    words = (sys.executable, "-m", "reverie_eval_cli", "serve", folder, "--workers=2", "--port=0")
    settings, log = load_settings(folder), folder / "log"
    with (
        log.open("w") as errors,
        subprocess.Popen(words, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
        closing(Database(settings.database_url)) as opened,
    ):
        assert process.stdout is not None
        try:
            first, second = process.stdout.readline(), process.stdout.readline()
            found = re.search(r"listening at (\S+),", first + second)
            assert found, log.read_text()
            yield Crew(RealServer(found[1], settings, opened, log), process)
        finally:
            process.terminate()


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def crew(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Crew]:
    """Run two workers on each kind of database."""
    folder = tmp_path_factory.mktemp("crew") / "server"
    make_folder(folder)
    database = "sqlite:///server.db"
    if request.param == "postgresql":
        template: Template = request.getfixturevalue("postgresql_template")
        database = request.getfixturevalue("postgresql")(template.ready)
    with serving(folder, database, REQUESTS_PER_MINUTE="1000000") as crew:
        yield crew


def at_once(crew: Crew, token: str, split: str, files: Sequence[bytes]) -> Sequence[httpx.Response]:
    with ThreadPoolExecutor(len(files)) as pool:
        return list(pool.map(lambda content: crew.upload(token, split, content), files))


def test_of_many_files_as_many_are_scored_as_the_quota_allows(crew: Crew) -> None:
    name = crew.real.newcomer()
    content = private_submission()
    files = [content + b" " * number for number in range(MANY)]
    replies = at_once(crew, crew.real.mint(name), PRIVATE, files)
    statuses = Counter(reply.status_code for reply in replies)
    assert statuses == {201: ALLOWED, 429: MANY - ALLOWED}
    with crew.real.database.reading() as session:
        rows = session.scalars(select(Submission)).all()
        assert sum(row.person.name == name for row in rows) == ALLOWED
        assert not list(crew.real.audit_log.broken_links(session))


def test_metrics_are_those_of_all_workers(crew: Crew) -> None:
    expect_counts_of_all(crew)


def test_so_they_are_of_workers_that_are_not_forked(folder: Path) -> None:
    with started(folder) as crew:
        expect_counts_of_all(crew)
    assert crew.process.poll() == 0


def expect_counts_of_all(crew: Crew) -> None:
    organiser = crew.real.mint(crew.real.newcomer("organiser"))
    before = crew.requests_counted(organiser)
    first, second = crew.workers()
    for worker, requests in ((first, 3), (second, 4)):
        with crew.only(worker):
            for _ in range(requests):
                assert crew.get("/api/v1/splits").status_code == 200
    # A request is counted after its reply.
    wait_until(lambda: crew.requests_counted(organiser) == before + 7)
    for worker in (first, second):
        with crew.only(worker):
            assert crew.requests_counted(organiser) == before + 7


def test_a_worker_that_is_killed_loses_nothing_and_is_replaced(crew: Crew) -> None:
    organiser = crew.real.mint(crew.real.newcomer("organiser"))
    token = crew.real.mint(crew.real.newcomer())
    files = [GOOD + b" " * number for number in range(MANY)]
    victim, killed = min(crew.workers()), len(crew.replaced())

    def send(number: int) -> httpx.Response | None:
        if number == MANY // 3:
            os.kill(victim, signal.SIGKILL)
        try:
            return crew.upload(token, OPEN, files[number])
        except httpx.TransportError:
            return None

    counted = crew.requests_counted(organiser)
    with ThreadPoolExecutor(4) as pool:
        replies = list(pool.map(send, range(MANY)))
    acknowledged = {
        number: reply.json()["submission"]["receipt"]
        for number, reply in enumerate(replies)
        if reply is not None and reply.status_code == 201
    }
    assert acknowledged
    wait_until(lambda: len(crew.replaced()) == killed + 1 and len(crew.workers()) == 2)
    again = at_once(crew, token, OPEN, files)
    assert {reply.status_code for reply in again} <= {200, 201}
    assert (
        acknowledged.items()
        <= {
            number: reply.json()["submission"]["receipt"] for number, reply in enumerate(again)
        }.items()
    )
    assert crew.replaced()[-1]["dead"] == victim
    assert crew.requests_counted(organiser) == counted
    with crew.only(max(crew.workers() - {victim})):
        assert crew.get("/healthz").json() == {"status": "ok", "failed": []}


def test_a_worker_that_finds_another_bundle_does_not_start(folder: Path) -> None:
    with serving(folder, "sqlite:///server.db") as crew:
        replace_answers(folder, OPEN)
        victim, other = crew.workers()
        os.kill(victim, signal.SIGKILL)
        wait_until(lambda: any("a bundle has changed" in str(e["event"]) for e in crew.logged()))
        assert crew.get("/healthz").json() == {"status": "ok", "failed": []}
        assert crew.workers() == {other}


def test_workers_end_with_a_supervisor_that_is_killed(folder: Path) -> None:
    with serving(folder, "sqlite:///server.db") as crew:
        workers = crew.workers()
        crew.process.kill()
        wait_until(lambda: not any(is_running(worker) for worker in workers))


def is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def _serve_other_rules(folder: Path) -> None:
    with patch.object(run, "rules_of", return_value={}):
        run_server(load_settings(folder), "127.0.0.1", 0, workers=2)


def test_a_server_whose_workers_cannot_start_ends_and_says_why(folder: Path) -> None:
    errors = folder / "errors"
    surroundings = Surroundings(folder, dict(os.environ), folder / "output", errors)
    process = Forked(_serve_other_rules, surroundings, folder)
    assert process.wait(PATIENCE) == 1
    said = errors.read_text()
    assert "a worker process did not start; the log has the reason" in said
    log = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
    reasons = [line["event"] for line in log if line["level"] == "error"]
    assert len(reasons) == 2
    assert all("a bundle has changed since the server started" in each for each in reasons)


def _write_what_workers_find(folder: Path) -> None:
    def look(_config: object, _listening: object, counts: Path, _announce: object) -> Mock:
        with closing(sqlite3.connect(counts / "requests.sqlite")) as database:
            for query in ("PRAGMA journal_mode", "SELECT number FROM counted"):
                sys.stdout.write(f"{database.execute(query).fetchall()}\n")
        return Mock()

    with patch.object(run, "Supervisor", look):
        run_server(load_settings(folder), "127.0.0.1", 0, workers=2)


def test_workers_find_the_file_in_which_they_count(folder: Path) -> None:
    """Two that made it at the same moment found it locked, and the server did not start."""
    output, errors = folder / "output", folder / "errors"
    surroundings = Surroundings(folder, dict(os.environ), output, errors)
    assert Forked(_write_what_workers_find, surroundings, folder).wait(PATIENCE) == 0
    assert output.read_text() == "[('wal',)]\n[]\n"


def test_the_rate_limit_is_that_of_all_workers(folder: Path) -> None:
    with serving(folder, "sqlite:///server.db", REQUESTS_PER_MINUTE="6") as crew:
        first, second = crew.workers()
        for _ in range(ATTEMPTS):
            began, statuses = time.monotonic(), []
            for worker in (first, second):
                with crew.only(worker):
                    statuses += [crew.get("/api/v1/splits").status_code for _ in range(4)]
            if time.monotonic() - began < WINDOW:  # or they were counted apart: once more
                break
            time.sleep(WINDOW)
        else:
            pytest.fail("eight requests take longer than a minute")
    assert statuses == [200] * 6 + [429] * 2


@pytest.fixture
def counts(tmp_path: Path) -> tuple[FixedWindowRateLimiter, FixedWindowRateLimiter]:
    """Return how two workers count."""
    both = [Workers(2, tmp_path).counts() for _ in range(2)]
    return FixedWindowRateLimiter(both[0]), FixedWindowRateLimiter(both[1])


def test_a_window_begins_with_the_first_request_and_ends_after_a_minute(
    counts: tuple[FixedWindowRateLimiter, FixedWindowRateLimiter],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 1000.0
    monkeypatch.setattr(time, "time", lambda: now)
    (one, other), limit = counts, RateLimitItemPerMinute(3)
    assert one.test(limit, "token", "a")
    assert [one.hit(limit, "token", "a"), other.hit(limit, "token", "a")] == [True, True]
    assert other.get_window_stats(limit, "token", "a") == (1060.0, 1)
    now = 1059.9
    assert other.hit(limit, "token", "a")
    assert not one.test(limit, "token", "a")
    assert not one.hit(limit, "token", "a")
    assert one.hit(limit, "token", "b")
    now = 1060.0
    assert one.test(limit, "token", "a")
    assert other.hit(limit, "token", "a")
    assert one.get_window_stats(limit, "token", "a") == (1120.0, 2)


def test_what_was_counted_is_forgotten_after_its_window(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1000.0
    monkeypatch.setattr(time, "time", lambda: now)
    counts = FileCounts(tmp_path / "requests")
    for number in range(50):
        counts.incr(f"address {number}", WINDOW)
    now = 1060.0
    counts.incr("address 50", WINDOW)
    assert counts.reset() == 1


@pytest.mark.parametrize(
    ("workers", "total", "share"),
    [(1, 32, 32), (2, 32, 16), (3, 32, 10), (8, 4, 1), (2, 1, 1), (2, 0, 0)],
)
def test_what_is_divided_is_at_least_one_if_there_is_any(
    workers: int, total: int, share: int
) -> None:
    assert Workers(workers).share(total) == share
