"""How much slower a server is with a million submissions than with ten thousand.

``python benchmarks/million.py [SUBMISSIONS]`` makes a server on SQLite, of the demo world with
two leaderboards, and writes that many submissions straight into its database. Ten thousand of them
are published. Then it starts the server and asks, as one reader does, for pages and for lists
of submissions, and uploads files. At the end, ``server doctor`` and ``server backup`` run as
commands, whose peak memory is printed. ``server restore`` takes the backup to PostgreSQL, where all
is measured again. A million takes three quarters of an hour. Pages have bars for the time that the
processors spend on a request, in the server and in PostgreSQL, as the time until the reply depends
on what else the machine does.
"""

import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory

import httpx

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.bars import Figure, judge
from benchmarks.processors import processor_milliseconds
from fixtures.many_submissions import SAMPLE, SPLIT, fill
from fixtures.servers import make_folder
from reverie_eval.schemas.organising import NewPerson, NewToken
from reverie_eval.server.accounts.people import add_person
from reverie_eval.server.accounts.tokens import create_token
from reverie_eval.server.opening import acting, open_server
from reverie_eval.server.settings import SETTINGS_FILE, load_settings
from tests.support.serving import make_database, running, running_postgresql

SUBMISSIONS = 1_000_000
PUBLISHED = 10_000
FILES_OF_TEAM = 500
REQUESTS = 20
BARS = {"sqlite": 100.0, "postgresql": 50.0}
"""Milliseconds for the first page of a leaderboard, and the landing page."""

PAGES = ("/", f"/splits/{SPLIT}", f"/splits/{SPLIT}/boards/grounding")
"""With a bar."""
OTHER_PAGES = (f"/splits/{SPLIT}/feed.atom", f"/splits/{SPLIT}/chart", "/episodes")
DESK = ("", "/attempts", "/reviews", "/quotas", "/phases", "/snapshots", "/people", "/audit")
LIST = "/api/v1/submissions"
UPLOAD = f"/api/v1/splits/{SPLIT}/submissions?name=Walker"
COMMAND = Path(sys.executable).with_name("reverie-eval")
QUOTAS = {
    f"REVERIE_EVAL_SPLITS__{SPLIT}__QUOTA__{name}": "100000" for name in ("day", "month", "year")
}
"""How many uploads a team has; with the usual quotas it would soon have none left."""
OTHER_BOARDS = f"""
[splits.{SPLIT}.boards.grounding]
track = "grounding"
"""


def main() -> int:
    """Print all figures; return 1 if a page misses its bar."""
    submissions = int(sys.argv[1]) if len(sys.argv) > 1 else SUBMISSIONS
    os.environ |= QUOTAS | {"REVERIE_EVAL_LIMITS__REQUESTS_PER_MINUTE": "1000000"}
    with ExitStack() as stack:
        temporary = Path(stack.enter_context(TemporaryDirectory()))
        folder, backup = temporary / "sqlite", temporary / "backup.tar.gz"
        make_folder(folder)
        with (folder / SETTINGS_FILE).open("a", encoding="utf-8") as settings:
            settings.write(OTHER_BOARDS)
        state = open_server(load_settings(folder))
        fill(state, submissions, min(submissions, PUBLISHED), max(2, submissions // FILES_OF_TEAM))
        state.database.close()
        print(f"sqlite, {submissions:,} submissions")
        figures = measure("sqlite", folder, None)
        print_command("backup", folder, "-o", backup)
        postgresql = stack.enter_context(running_postgresql())
        os.environ["REVERIE_EVAL_DATABASE"] = make_database(postgresql, "million")
        print(f"postgresql, {submissions:,} submissions")
        print_command("restore", backup, temporary / "postgresql")
        figures += measure("postgresql", temporary / "postgresql", postgresql.get_pid())
        print_command("backup", temporary / "postgresql", "-o", backup)
    return judge(figures)


def measure(kind: str, folder: Path, postmaster: int | None) -> list[Figure]:
    """Print what a server needs; return the processors' milliseconds for pages with a bar."""
    tokens = make_tokens(folder, kind)
    with (
        running(folder) as (process, url),
        httpx.Client(base_url=url, timeout=600) as visitor,
        httpx.Client(base_url=url, timeout=600) as organiser,
    ):
        processes = Processes(process.pid, postmaster)
        print(f"    leaderboard, first of all: {milliseconds(visitor, PAGES[1]):.0f} ms")
        figures = [
            (f"{kind}: {page}, ms", processes.measure(page, visitor), BARS[kind]) for page in PAGES
        ]
        for page in OTHER_PAGES:
            processes.measure(page, visitor)
        upload(visitor, tokens["member"], 0)
        print(f"    leaderboard, after an upload: {milliseconds(visitor, PAGES[1]):.0f} ms")
        organiser.post("/sign-in", data={"token": tokens["organiser"]})
        for page in DESK:
            processes.measure(f"/desk{page}", organiser)
        member, lists = {"Authorization": f"Bearer {tokens['member']}"}, f"{LIST}?cursor="
        processes.measure(LIST, visitor, member)
        processes.measure(f"/api/v1/splits/{SPLIT}", visitor, member)
        all_of_them = {"Authorization": f"Bearer {tokens['organiser']}"}
        processes.measure(LIST, visitor, all_of_them)
        processes.measure(lists + sixth_page(visitor, all_of_them), visitor, all_of_them)
        times = [upload(visitor, tokens["member"], number) for number in range(1, REQUESTS)]
        print(f"    upload: {spread(times)}")
    print_command("doctor", folder, "--quick")
    print_command("doctor", folder)
    return figures


def make_tokens(folder: Path, kind: str) -> Mapping[str, str]:
    """Return tokens of an organiser, who is added, and of a member of the first team."""
    name = f"Organiser on {kind}"
    with acting(load_settings(folder), "benchmark") as transaction:
        team = "Team 1 of the University"
        add_person(transaction, NewPerson(team=team, name=name, role="organiser"))
        return {
            role: create_token(transaction, NewToken(person=person, kind="access")).token
            for role, person in (("organiser", name), ("member", "P 0"))
        }


class Processes:
    """The processes of a server, and of its PostgreSQL if it has one."""

    def __init__(self, server: int, postmaster: int | None) -> None:
        self._server = server
        self._postmaster = postmaster

    def measure(
        self, path: str, client: httpx.Client, headers: Mapping[str, str] = httpx.Headers()
    ) -> float:
        """Ask for an address again and again; print times, and return that of the processors."""
        milliseconds(client, path, headers)
        before = self._milliseconds()
        times = [milliseconds(client, path, headers) for _ in range(REQUESTS)]
        spent = (self._milliseconds() - before) / REQUESTS
        print(f"    {path}: {spent:.1f} ms of the processors; {spread(times)}", flush=True)
        return spent

    def _milliseconds(self) -> float:
        """Return what processors have spent so far."""
        processes = [self._server]
        if self._postmaster is not None:
            of_it = f"/proc/{self._postmaster}/task/{self._postmaster}/children"
            processes += map(int, Path(of_it).read_text().split())
        return processor_milliseconds(*processes)


def milliseconds(
    client: httpx.Client, path: str, headers: Mapping[str, str] = httpx.Headers()
) -> float:
    """Return how long a reply took."""
    began = time.perf_counter()
    client.get(path, headers=headers).raise_for_status()
    return 1000 * (time.perf_counter() - began)


def spread(times: Sequence[float]) -> str:
    """Say how long replies take."""
    return f"fastest {min(times):.1f} ms, median {statistics.median(times):.1f} ms"


def sixth_page(client: httpx.Client, headers: Mapping[str, str]) -> str:
    """Return the cursor of a page deep in the list of all submissions."""
    last = ""
    for _ in range(5):
        page = client.get(LIST, params={"cursor": last} if last else {}, headers=headers)
        last = page.json()[-1]["id"]
    return last


def upload(client: httpx.Client, token: str, number: int) -> float:
    """Upload a file that nobody has sent; return how many milliseconds it took."""
    began = time.perf_counter()
    content, headers = SAMPLE + b"\n" * (1 + number), {"Authorization": f"Bearer {token}"}
    client.post(UPLOAD, content=content, headers=headers).raise_for_status()
    return 1000 * (time.perf_counter() - began)


def print_command(name: str, *arguments: Path | str) -> None:
    """Print how long a command takes, and its peak memory."""
    began, before = time.perf_counter(), getrusage(RUSAGE_CHILDREN)
    peak = 0
    words = [COMMAND, "server", name, *arguments]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as run:
        # Its resource usage would count the memory of this process too.
        while run.poll() is None:
            found = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{run.pid}/status").read_text())
            peak = int(found[1]) if found else peak
            time.sleep(0.1)
        if run.returncode:
            assert run.stdout is not None  # noqa: S101  # it was asked for
            raise RuntimeError(run.stdout.read())
    seconds, after = time.perf_counter() - began, getrusage(RUSAGE_CHILDREN)
    spent = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    print(
        f"    server {name}: {seconds:.0f} s, {spent:.0f} s of the processors, "
        f"{peak / 1000:.0f} MB at the peak",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
