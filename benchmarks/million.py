"""How much slower a server is with a million submissions than with ten thousand.

``python benchmarks/million.py [SUBMISSIONS]`` makes a server on SQLite and one on PostgreSQL, both
of the demo world, and writes that many submissions straight into their databases, which takes half
an hour or more for a million. Ten thousand of them are published. Then it starts each server and
asks, as one reader does, for the leaderboard and for lists of submissions, and uploads files. At
the end, ``server check``, ``backup`` and ``doctor`` run as commands, whose peak memory is printed.
Only the leaderboard's first page has a bar: for the time that the processors spend on a request, in
the server and in PostgreSQL, as the time until the reply depends on what else the machine does.
"""

import http.client
import itertools
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.bars import Figure, judge
from fixtures.many_submissions import SAMPLE, SPLIT, fill
from fixtures.servers import make_folder
from reverie_eval.schemas.organising import NewPerson, NewToken
from reverie_eval.server.operations.checks import acting
from reverie_eval.server.operations.folder import upgrade_folder
from reverie_eval.server.service.people import add_person
from reverie_eval.server.service.tokens import create_token
from reverie_eval.server.settings import SETTINGS_FILE, load_settings
from reverie_eval.server.state import ServerState
from tests.support.crowd import ask, connect
from tests.support.serving import make_database, running, running_postgresql

SUBMISSIONS = 1_000_000
PUBLISHED = 10_000
FILES_OF_TEAM = 500
REQUESTS = 30
BARS = {"sqlite": 100.0, "postgresql": 50.0}
"""Milliseconds for the first page of the leaderboard."""

BOARD = f"/boards/{SPLIT}"
LIST = "/api/v1/submissions"
UPLOAD = f"/api/v1/splits/{SPLIT}/submissions?name=Walker"
COMMAND = Path(sys.executable).with_name("reverie-eval")
QUOTAS = {
    f"REVERIE_EVAL_SPLITS__{SPLIT}__QUOTA__{name}": "100000" for name in ("day", "month", "year")
}
"""Of the uploads; the teams have none left otherwise."""


def main() -> int:
    """Print all figures; return 1 if a leaderboard misses its bar."""
    submissions = int(sys.argv[1]) if len(sys.argv) > 1 else SUBMISSIONS
    os.environ |= QUOTAS
    figures: list[Figure] = []
    for kind, bar in BARS.items():
        with ExitStack() as stack:
            folder = Path(stack.enter_context(TemporaryDirectory())) / "server"
            make_folder(folder)
            postmaster = None
            if kind == "postgresql":
                postgresql = stack.enter_context(running_postgresql())
                use_database(folder, make_database(postgresql, "million"))
                postmaster = postgresql.get_pid()
            state = ServerState.open(load_settings(folder))
            teams = max(2, submissions // FILES_OF_TEAM)
            fill(state, submissions, min(submissions, PUBLISHED), teams)
            state.database.close()
            print(f"{kind}, {submissions:,} submissions")
            figures.append((f"{kind}: first page, ms", measure(folder, postmaster), bar))
    return judge(figures)


def use_database(folder: Path, url: str) -> None:
    """Let a server use another database, which is empty."""
    file = folder / SETTINGS_FILE
    file.write_text(file.read_text().replace("sqlite:///server.db", url))
    upgrade_folder(folder)


def measure(folder: Path, postmaster: int | None) -> float:
    """Print what a server needs; return the processors' milliseconds for its leaderboard."""
    with acting(load_settings(folder), "benchmark") as transaction:
        new = NewPerson(team="Team 1 of the University", name="Organiser", role="organiser")
        add_person(transaction, new)
        organiser = create_token(transaction, NewToken(person="Organiser", kind="access")).token
        member = create_token(transaction, NewToken(person="P 0", kind="access")).token
    with running(folder, REVERIE_EVAL_LIMITS__REQUESTS_PER_MINUTE="1000000") as (process, url):
        connection = connect(url)
        print(f"    leaderboard, first of all: {milliseconds(connection, BOARD):.0f} ms")
        before = processor_milliseconds(process.pid, postmaster)
        print_times("leaderboard", connection, itertools.repeat((BOARD, "")))
        page = (processor_milliseconds(process.pid, postmaster) - before) / REQUESTS
        print(f"    leaderboard: {page:.1f} ms of the processors")
        upload(connection, member, 0)
        print(f"    leaderboard, after an upload: {milliseconds(connection, BOARD):.0f} ms")
        print_times("a team's submissions", connection, itertools.repeat((LIST, member)))
        print_times("all submissions", connection, itertools.repeat((LIST, organiser)))
        print_times("the sixth page of all", connection, pages(connection, organiser))
        quota = f"/api/v1/splits/{SPLIT}"
        print_times("quota", connection, itertools.repeat((quota, member)))
        times = [upload(connection, member, number) for number in range(1, REQUESTS)]
        print(f"    upload: {spread(times)}")
    for command in ("check", "backup", "doctor"):
        print_command(command, folder)
    return page


def processor_milliseconds(server: int, postmaster: int | None) -> float:
    """Return what processors have spent on a server and the processes of PostgreSQL so far."""
    processes = [server]
    if postmaster is not None:
        children = Path(f"/proc/{postmaster}/task/{postmaster}/children").read_text()
        processes += map(int, children.split())
    ticks = 0
    for process in processes:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])  # user and system time
    return 1000 * ticks / os.sysconf("SC_CLK_TCK")


def milliseconds(connection: http.client.HTTPConnection, path: str, token: str = "") -> float:
    """Return how long a reply took."""
    reply = ask(connection, "GET", path, token=token)
    if reply.status != http.client.OK:
        raise RuntimeError(f"status {reply.status} for {path}")
    return 1000 * reply.seconds


def print_times(
    name: str, connection: http.client.HTTPConnection, requests: Iterator[tuple[str, str]]
) -> None:
    """Print how long replies take."""
    times = [
        milliseconds(connection, path, token)
        for path, token in itertools.islice(requests, REQUESTS)
    ]
    print(f"    {name}: {spread(times)}")


def spread(times: Sequence[float]) -> str:
    """Say how long replies take."""
    return f"fastest {min(times):.1f} ms, median {statistics.median(times):.1f} ms"


def pages(connection: http.client.HTTPConnection, token: str) -> Iterator[tuple[str, str]]:
    """Yield the address of a page deep in the list of all submissions, again and again."""
    path = LIST
    for _ in range(5):
        last = json.loads(ask(connection, "GET", path, token=token).body)[-1]["id"]
        path = f"{LIST}?cursor={last}"
    yield from itertools.repeat((path, token))


def upload(connection: http.client.HTTPConnection, token: str, number: int) -> float:
    """Upload a file that nobody has sent; return how many milliseconds it took."""
    reply = ask(connection, "POST", UPLOAD, SAMPLE + b"\n" * (1 + number), token)
    if reply.status != http.client.CREATED:
        raise RuntimeError(f"status {reply.status}: {reply.body.decode()}")
    return 1000 * reply.seconds


def print_command(name: str, folder: Path) -> None:
    """Print how long a command takes, and its peak memory."""
    output = ["-o", str(folder.parent / "backup.tar.gz")] if name == "backup" else []
    began = time.perf_counter()
    with subprocess.Popen(
        [COMMAND, "server", name, folder, *output], stdout=subprocess.PIPE
    ) as run:
        assert run.stdout is not None  # noqa: S101  # it was asked for
        said = run.stdout.read().decode()
        _, status, used = os.wait4(run.pid, 0)
        run.returncode = os.waitstatus_to_exitcode(status)
    if run.returncode:
        raise RuntimeError(said)
    seconds = time.perf_counter() - began
    print(f"    server {name}: {seconds:.0f} s, {used.ru_maxrss / 1000:.0f} MB at the peak")


if __name__ == "__main__":
    sys.exit(main())
