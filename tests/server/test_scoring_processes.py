"""Files are read and scored in processes that no file holds up for long, and no kill for good."""

import os
import re
import resource
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import httpx
import pytest
from sqlalchemy import select

from fixtures.servers import make_folder
from reverie_eval import evaluate
from reverie_eval.errors import SubmissionError
from reverie_eval.ground_truth import Bundle
from reverie_eval.server.errors import BusyError
from reverie_eval.server.operations import scoring_again
from reverie_eval.server.scoring import processes as scoring_processes
from reverie_eval.server.scoring.boards import load_boards
from reverie_eval.server.scoring.contexts import Context, open_file
from reverie_eval.server.scoring.processes import Line, ScoringProcesses, _Process
from reverie_eval.server.settings import load_settings
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Submission
from tests.support.flat_world import Outcome, Run
from tests.support.forking import Beside, Forked, Surroundings
from tests.support.killing import is_running, kill_process, scorers
from tests.support.participants import RealServer
from tests.support.serving import (
    GOOD,
    NO_TLS,
    OPEN,
    OWNER,
    PRIVATE,
    OpenServer,
    Template,
    add_boards,
    running,
    settings_of,
    submission_for,
)
from tests.support.waiting import PATIENCE, wait_until
from tests.support.worlds import with_arrays

MANY = 12
ALLOWED = 2
"""By default, in a day, on the private split."""


@pytest.fixture(autouse=True)
def _processes_are_forked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let processes be copies of the one that all tested servers are copies of."""
    here = Surroundings(Path.cwd(), dict(os.environ), tmp_path / "output", tmp_path / "errors")
    monkeypatch.setattr(scoring_processes, "get_context", lambda _: Beside(here))


@pytest.fixture
def processes(folder: Path) -> Iterator[ScoringProcesses]:
    """Run two processes."""
    settings = settings_of(folder)
    with ScoringProcesses(settings, load_boards(settings), 2) as processes:
        yield processes


def test_a_process_that_scores_imports_neither_pages_nor_the_database() -> None:
    """Each server starts some, and its first check of health waits for them."""
    code = (
        "import sys, reverie_eval.server.scoring.processes\n"
        "print({'alembic', 'fastapi', 'httpx', 'jinja2', 'scipy', 'sqlalchemy'} & {*sys.modules})"
    )
    words = [sys.executable, "-c", code]
    assert subprocess.run(words, check=True, capture_output=True, text=True).stdout == "set()\n"


def test_what_waits_for_a_process_comes_before_what_asks_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As an upload, or a check of health, while a job scores one file after another."""
    line, order, waiting_for = Line[str](), list[str](), list[SimpleQueue[str]]()

    class Noted(SimpleQueue[str]):
        def __init__(self) -> None:
            waiting_for.append(self)

    monkeypatch.setattr(scoring_processes, "SimpleQueue", Noted)
    line.give("process")

    def work(who: str) -> None:
        process = line.take(PATIENCE)
        order.append(who)
        line.give(process)

    with ThreadPoolExecutor(2) as waiting:
        process = line.take(PATIENCE)
        waiting.submit(work, "upload")
        wait_until(lambda: len(waiting_for) == 1)
        waiting.submit(work, "check")
        wait_until(lambda: len(waiting_for) == 2)
        line.give(process)
        work("job")
    assert order == ["upload", "check", "job"]


def test_what_waits_too_long_leaves_the_line() -> None:
    line = Line[str]()
    with pytest.raises(Empty):
        line.take(0)
    line.give("process")
    assert line.take(0) == "process"


def number(_: Context) -> int:
    """Return which process this is."""
    return os.getpid()


def number_of_parent(_: Context) -> int:
    """Return which process this one was forked from."""
    return os.getppid()


def burn(_: Context) -> None:
    """Use the processor for ever."""
    while True:
        pass


def fill(_: Context, mebibytes: int) -> int:
    """Use memory."""
    return len(bytearray(mebibytes << 20))


def limit_more(_: Context) -> None:
    """Do what an administrator may have done: limit the process for good."""
    for kind, most in ((resource.RLIMIT_CPU, 3_600), (resource.RLIMIT_AS, 8 << 30)):
        resource.setrlimit(kind, (most, most))


def fail(_: Context, error: Exception) -> None:
    """Raise an error."""
    raise error


def refuse_to_be_pickled(_: Context) -> object:
    """Return what cannot be sent to another process."""
    return lambda: None


def test_a_server_replies_the_same_wherever_it_scores(
    folder: Path, open_server: OpenServer
) -> None:
    server = open_server(workers=2)
    expected = evaluate(GOOD, split=OPEN).to_report().scores
    uploaded = server.upload(OWNER)
    assert uploaded.status_code == 201
    submission = uploaded.json()["submission"]
    assert submission["report"]["scores"] == expected
    path = f"/submissions/{submission['id']}"
    published = server.ask(OWNER, "PATCH", path, json={"published": True}).json()
    assert published["report"]["intervals"]
    episodes = server.ask(OWNER, "GET", f"{path}/episodes")
    private = server.upload(OWNER, submission_for(PRIVATE), PRIVATE)
    here = open_server(settings_of(folder), server.tokens)
    assert here.ask(OWNER, "GET", path).json()["report"] == published["report"]
    assert here.ask(OWNER, "GET", f"{path}/episodes").text == episodes.text
    assert here.upload(OWNER, submission_for(PRIVATE), PRIVATE).json()["is_repeat"]
    assert private.json()["submission"]["report"]["scores"]
    assert server.client.get("/healthz").json()["failed"] == []


def test_a_file_that_takes_too_long_is_refused_and_the_next_one_is_not(
    processes: ScoringProcesses, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_processes, "SECONDS", 0)
    with pytest.raises(SubmissionError, match="more than 0 seconds of processor time"):
        processes.run(burn)
    assert is_running(processes.run(number))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells how large a process is")
def test_a_file_that_needs_too_much_memory_is_refused_and_the_next_one_is_not(
    processes: ScoringProcesses, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_processes, "MEBIBYTES", 64)
    with processes.hold() as runner:
        before = runner.run(number)
        with pytest.raises(SubmissionError, match="more than 64 MiB of memory"):
            runner.run(fill, 65)
        assert runner.run(fill, 16) == 16 << 20
        assert runner.run(number) == before


def test_the_limits_of_the_system_may_be_lower(
    processes: ScoringProcesses, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_processes, "SECONDS", 10_000)
    monkeypatch.setattr(scoring_processes, "MEBIBYTES", 1 << 20)
    with processes.hold() as runner:
        runner.run(limit_more)
        assert runner.run(fill, 1) == 1 << 20


def test_a_process_that_is_killed_while_it_waits_is_not_missed(
    processes: ScoringProcesses,
) -> None:
    with processes.hold() as first, processes.hold() as second:
        dead = {first.run(number), second.run(number)}
    for process in dead:
        kill_process(process)
    with processes.hold() as first, processes.hold() as second:
        assert not {first.run(number), second.run(number)} & dead


def is_zombie(process: int) -> bool:
    """Whether a process has ended and nobody has asked how."""
    return "State:\tZ" in Path(f"/proc/{process}/status").read_text()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of processes in files")
def test_it_is_not_missed_even_before_anybody_is_told_of_its_end(
    processes: ScoringProcesses, monkeypatch: pytest.MonkeyPatch
) -> None:
    with processes.hold() as first, processes.hold() as second:
        dead = {first.run(number), second.run(number)}
        fork_server = first.run(number_of_parent)
    stop = _Process.stop

    def be_told_and_stop(process: _Process) -> None:
        os.kill(fork_server, signal.SIGCONT)
        stop(process)

    monkeypatch.setattr(_Process, "stop", be_told_and_stop)
    os.kill(fork_server, signal.SIGSTOP)
    try:
        for process in dead:
            os.kill(process, signal.SIGKILL)
        wait_until(lambda: all(map(is_zombie, dead)))
        assert processes.run(number) not in dead
    finally:
        os.kill(fork_server, signal.SIGCONT)


def test_a_process_that_is_killed_while_it_works_asks_to_try_again(
    processes: ScoringProcesses,
) -> None:
    with processes.hold() as runner, ThreadPoolExecutor(1) as other:
        process = runner.run(number)
        burning = other.submit(runner.run, burn)
        kill_process(process)
        with pytest.raises(BusyError):
            burning.result(PATIENCE)
        assert runner.run(number) != process


def test_a_server_without_room_for_processes_asks_to_wait_until_there_is(folder: Path) -> None:
    settings = settings_of(folder)
    one = ScoringProcesses(settings, load_boards(settings), 1)
    with ExitStack() as running:
        with no_more_files():
            running.enter_context(one)
            for _ in range(2):
                with pytest.raises(BusyError, match="no room"):
                    one.run(number)
        process = one.run(number)
        with no_more_files():
            kill_process(process)
            for _ in range(2):
                with pytest.raises(BusyError, match="no room"):
                    one.run(number)
        assert is_running(one.run(number))


@contextmanager
def no_more_files() -> Iterator[None]:
    """Let this process open no file, so that it has no connection to a new process.

    The standard streams are open; what else is closed meanwhile, as garbage may be, leaves no room.
    """
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_a_process_that_is_ended_leaves_no_core_file_with_the_answers(
    processes: ScoringProcesses,
) -> None:
    assert processes.run(size_of_core_files) == (0, 0)


def size_of_core_files(_: Context) -> tuple[int, int]:
    """Return the limits of core files."""
    return resource.getrlimit(resource.RLIMIT_CORE)


def test_what_was_opened_by_a_process_that_was_killed_is_not_taken_for_an_empty_file(
    processes: ScoringProcesses,
) -> None:
    with processes.hold() as runner:
        runner.run(open_file, GOOD, len(GOOD))
        kill_process(runner.run(number))
        with pytest.raises(BusyError):
            runner.run(number)
        with pytest.raises(BusyError):
            runner.run(content_size)


def content_size(context: Context) -> int:
    """Return the size of the opened file."""
    return len(context.content)


def test_an_error_is_raised_as_it_was(processes: ScoringProcesses) -> None:
    with pytest.raises(ZeroDivisionError, match="nothing") as raised:
        processes.run(fail, ZeroDivisionError("nothing"))
    assert "in fail" in "".join(raised.value.__notes__), "where it was raised"
    with pytest.raises(RuntimeError, match=r"^a function cannot be sent: "):
        processes.run(refuse_to_be_pickled)
    assert is_running(processes.run(number))


def test_processes_end_with_the_context_whatever_they_do(folder: Path) -> None:
    settings = settings_of(folder)
    with (
        ScoringProcesses(settings, load_boards(settings), 2) as processes,
        ThreadPoolExecutor(1) as other,
    ):
        with processes.hold() as first, processes.hold() as second:
            all_of_them = {first.run(number), second.run(number)}
        burning = other.submit(processes.run, burn)
        processes.__exit__()
        with suppress(BusyError, OSError):
            burning.result(PATIENCE)
    wait_until(lambda: not any(is_running(process) for process in all_of_them))


@dataclass(frozen=True)
class Crew:
    """A real server with two processes that score, and a token of a participant."""

    real: RealServer
    process: Forked | subprocess.Popen[str]
    token: str

    def upload(self, content: bytes, split: str = OPEN) -> httpx.Response:
        """Upload over a connection of its own."""
        return httpx.post(
            f"{self.real.url}/api/v1/splits/{split}/submissions?name=Walker",
            headers={"Authorization": f"Bearer {self.token}"},
            content=content,
            timeout=PATIENCE,
            verify=NO_TLS,
        )

    def health(self) -> Mapping[str, Any]:
        """Return what the server says of its health."""
        reply = httpx.get(f"{self.real.url}/healthz", timeout=PATIENCE, verify=NO_TLS)
        report: Mapping[str, Any] = reply.json()
        return report

    def is_warm(self) -> bool:
        """Whether the server has computed what takes long the first time."""
        return any(job["name"] == "warm-up" and job["runs"] for job in self.health()["jobs"])

    def scorers(self) -> set[int]:
        """Return the processes that score."""
        return scorers(self.real.log)


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def crew(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Crew]:
    """Run a server on each kind of database."""
    folder = tmp_path_factory.mktemp("crew") / "server"
    make_folder(folder)
    database = "sqlite:///server.db"
    if request.param == "postgresql":
        template: Template = request.getfixturevalue("postgresql_template")
        database = request.getfixturevalue("postgresql")(template.ready)
    settings = load_settings(folder).model_copy(update={"database": database})
    limits = {"REVERIE_EVAL_LIMITS__REQUESTS_PER_MINUTE": "1000000"}
    with (
        running(folder, 2, REVERIE_EVAL_DATABASE=database, **limits) as (process, url),
        closing(Database(settings.database_url)) as opened,
    ):
        real = RealServer(url, settings, opened, folder / "log")
        yield Crew(real, process, real.mint(real.newcomer()))


def test_of_many_files_as_many_are_scored_as_the_quota_allows(crew: Crew) -> None:
    content = submission_for(PRIVATE)
    files = [content + b" " * number for number in range(MANY)]
    with ThreadPoolExecutor(MANY) as pool:
        replies = list(pool.map(lambda file: crew.upload(file, PRIVATE), files))
    statuses = Counter(reply.status_code for reply in replies)
    assert statuses == {201: ALLOWED, 429: MANY - ALLOWED}
    with crew.real.database.reading() as session:
        assert len(session.scalars(select(Submission)).all()) == ALLOWED
        assert not list(crew.real.audit_log.broken_links(session))


def test_a_process_that_is_killed_loses_nothing_and_is_replaced(crew: Crew) -> None:
    files = [GOOD + b" " * number for number in range(MANY)]
    wait_until(crew.is_warm)
    victims = crew.scorers()

    def send(number: int) -> httpx.Response:
        if number == MANY // 3:
            for victim in victims:
                os.kill(victim, signal.SIGKILL)
        return crew.upload(files[number])

    with ThreadPoolExecutor(4) as pool:
        replies = list(pool.map(send, range(MANY)))
    assert {reply.status_code for reply in replies} <= {201, 503}
    assert {reply.headers.get("retry-after") for reply in replies} <= {None, "10"}
    again = [crew.upload(file) for file in files]
    for before, after in zip(replies, again, strict=True):
        if before.status_code == 201:
            assert after.status_code == 200
            assert after.json()["submission"] == before.json()["submission"]
        else:
            assert after.status_code == 201
    assert len(crew.scorers()) == 2
    assert not crew.scorers() & victims
    wait_until(lambda: not crew.health()["failed"])


def test_processes_end_with_a_server_that_is_killed(folder: Path) -> None:
    settings = load_settings(folder)
    with running(folder, 2) as (process, url), closing(Database(settings.database_url)) as opened:
        crew = Crew(RealServer(url, settings, opened, folder / "log"), process, "")
        wait_until(lambda: len(crew.scorers()) == 2)
        process.kill()
        wait_until(lambda: not any(is_running(scorer) for scorer in crew.scorers()))


def test_so_do_those_that_users_start(folder: Path) -> None:
    """Servers of other tests are forked from a process of the tests."""
    words = (sys.executable, "-m", "reverie_eval_cli", "serve", folder, "--workers=2", "--port=0")
    settings, log = load_settings(folder), folder / "log"
    with (
        log.open("w") as errors,
        subprocess.Popen(words, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
        closing(Database(settings.database_url)) as opened,
    ):
        try:
            assert process.stdout is not None
            first, second = process.stdout.readline(), process.stdout.readline()
            found = re.search(r"listening at (\S+),", first + second)
            assert found, log.read_text()
            real = RealServer(found[1], settings, opened, log)
            crew = Crew(real, process, real.mint(real.newcomer()))
            assert crew.upload(GOOD).status_code == 201
            scorers = crew.scorers()
            assert scorers
        finally:
            process.terminate()
    assert process.returncode == 0
    wait_until(lambda: not any(is_running(scorer) for scorer in scorers))


def test_they_load_the_ground_truth_of_a_correction(
    folder: Path, open_server: OpenServer, run: Run
) -> None:
    server = open_server(workers=2)
    before = server.upload(OWNER).json()["submission"]
    bundle = Bundle.load(folder / "bundles" / f"{OPEN}.npz")
    new = folder / "new.npz"
    with_arrays(bundle, task_target=bundle.arrays["task_target"] + 1).save(new)
    done = run(
        *("server", "rescore", str(folder), OPEN, "--bundle", str(new)),
        *("--reason", "The answers were wrong.", "--jobs", "1"),
    )
    assert done.status == 0, done.err
    path = f"/submissions/{before['id']}"
    now = server.ask(OWNER, "GET", path).json()
    again = server.upload(OWNER, server.distinct())
    assert again.status_code == 201, again.text
    again = again.json()["submission"]
    assert again["report"]["scores"] == now["report"]["scores"] != before["report"]["scores"]
    assert again["report"]["fingerprint"] == Bundle.load(new).header.fingerprint
    assert server.client.get("/healthz").json()["failed"] == []


def die(*_: object) -> None:
    """Be killed, as a system without memory does it."""
    os.kill(os.getpid(), signal.SIGKILL)


def burn_whatever_is_given(*_: object) -> None:
    """Use the processor for ever."""
    while True:
        pass


@pytest.fixture
def rescoring(
    folder: Path, open_server: OpenServer, run: Run, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Outcome]:
    """Score two submissions again in one or two processes, by a function of the test."""
    server = open_server()
    for _ in range(2):
        assert server.upload(OWNER, server.distinct()).status_code == 201
    bundle = Bundle.load(folder / "bundles" / f"{OPEN}.npz")
    new = folder / "new.npz"
    with_arrays(bundle, task_target=bundle.arrays["task_target"] + 1).save(new)
    monkeypatch.setattr(scoring_processes, "SECONDS", 0)
    monkeypatch.setattr(scoring_again, "FOR_ONE", 1)  # so that two are enough for two processes

    def again(work: Callable[..., None], jobs: str = "2") -> Outcome:
        monkeypatch.setattr(scoring_again, "rescore_one", work)
        words = ("--bundle", str(new), "--dry-run", "--jobs", jobs)
        return run("server", "rescore", str(folder), OPEN, *words)

    return again


def test_scoring_again_starts_its_processes_once(
    folder: Path, open_server: OpenServer, run: Run, caplog: pytest.LogCaptureFixture
) -> None:
    assert open_server().upload(OWNER).status_code == 201
    add_boards(folder, OPEN)
    with caplog.at_level("INFO", "reverie_eval.server.scoring"):
        done = run("server", "rescore", str(folder), OPEN, "--reason", "two more", "--jobs", "1")
    assert (done.status, done.out.count("Walker")) == (0, 3), done.err
    assert caplog.messages.count("scoring process started") == 1


def test_scoring_again_says_that_a_process_was_killed(
    rescoring: Callable[..., Outcome],
) -> None:
    done = rescoring(die)
    assert done.status == 2
    assert "a process that scored was killed, perhaps for lack of memory" in done.err
    assert "fewer --jobs" in done.err


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_scoring_again_says_which_files_take_too_long(
    jobs: str, rescoring: Callable[..., Outcome]
) -> None:
    done = rescoring(burn_whatever_is_given, jobs)
    assert done.status == 1
    assert done.out.count("more than 0 seconds of processor time") == 2
    assert "2 submissions cannot be scored again" in done.err
