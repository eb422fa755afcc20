"""How fast the pages of a long board are, and how heavy: a board of 10,000 results.

``python benchmarks/pages.py`` starts a real server process on the demo world, with its database in
a file of SQLite, and asks over one connection, one request after the other, as one reader does. The
first request after something was published reads the board anew; its time is printed, and has no
bar. Weight is everything that a browser fetches for the page, unpacked, without the chart's data;
beside it stands what is sent of it. A page of the API's longest list is timed, and the server's
peak memory while many ask for one. Then a browser opens the board, until its charts are drawn and
it has nothing more to do, and draws them anew by another metric. Latencies depend on the machine.
"""

import http.client
import os
import re
import secrets
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import urlsplit

from playwright.sync_api import Page
from sqlalchemy import insert, select

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.servers import make_folder
from reverie_eval.schemas.organising import NewPerson, NewTeam, NewToken
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import Method, QuotaReport, Receipt
from reverie_eval.server.accounts.people import add_person, add_team
from reverie_eval.server.accounts.tokens import create_token
from reverie_eval.server.audit.transactions import utc_now
from reverie_eval.server.opening import acting, open_server
from reverie_eval.server.settings import load_settings
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.paging import LONGEST
from reverie_eval.server.store.tables import Person, Submission
from tests.support.browser import browsing, chromium_path

SAMPLE = Path(__file__).parents[1] / "fixtures" / "submissions" / "good.json"
SPLIT = "val_unseen"
ENTRIES = 10_000
TEAMS = 300
REQUESTS = 60
"""How many requests of each kind are measured."""

TRIES = 5
"""In the browser."""

MOST_MILLISECONDS = 100.0
MOST_KILOBYTES = 300.0
MOST_TO_USE = 1000.0
"""Milliseconds until somebody can read the board, its charts and all; or until it is redrawn."""

SERVER = """
import sys
from pathlib import Path
from reverie_eval.server.run import run_server
from reverie_eval.server.store.paging import LONGEST
from reverie_eval.server.accounts.tokens import create_token
from reverie_eval.server.settings import load_settings
settings = load_settings(Path(sys.argv[1]))
run_server(settings, "127.0.0.1", 0, announce=lambda url: print(url, flush=True))
"""

BOARD = f"/splits/{SPLIT}"
SUBMISSIONS = "/api/v1/submissions"
AT_ONCE = 16
API = f"/api/v1/splits/{SPLIT}/leaderboard"
TIMED = (
    ("first page", BOARD, True),
    ("page 50", f"{BOARD}?page=50", True),
    ("sorted by SPL", f"{BOARD}?metric=spl", True),
    ("sorted by TL", f"{BOARD}?metric=path_length", True),
    ("filtered", f"{BOARD}?text=77&extra_data=without", True),
    ("all metrics", f"{BOARD}?columns=all", True),
    ("chart's data", f"{BOARD}/chart", False),
    ("JSON", API, False),
    ("CSV", f"{API}.csv", False),
)
"""What is asked for, and whether it has a bar."""


def main() -> int:
    """Print every figure; exit with 1 if one misses its bar."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary) / "server"
        make_folder(folder)
        token = fill(folder)
        with running(folder) as (url, server):
            connection = http.client.HTTPConnection(urlsplit(url).netloc)
            medians = [timed(connection, *each) for each in TIMED]
            touch(folder)
            print(f"first page after a change: {1000 * ask(connection, BOARD)[0]:.1f} ms")
            kilobytes = weight(connection)
            lists(url, server, token)
            slowest = in_browser(url)
    is_slow = max(medians) >= MOST_MILLISECONDS or slowest >= MOST_TO_USE
    return int(is_slow or kilobytes >= MOST_KILOBYTES)


def fill(folder: Path) -> str:
    """Put results on the board, as if each had been submitted; return a token of an organiser."""
    state = open_server(load_settings(folder))
    board = state.board(SPLIT)
    report = board.score(board.read(SAMPLE.read_bytes())).with_intervals().to_report()
    sample, receipt = report.model_dump(mode="json"), _receipt(state, report)
    random, now = Random(0), utc_now()  # noqa: S311  # figures, no secrets
    with state.transactions.begin("benchmark") as transaction:
        session = transaction.session
        teams = [f"Team {number} of the University" for number in range(TEAMS)]
        for number, team in enumerate(teams):
            add_team(transaction, NewTeam(name=team))
            add_person(transaction, NewPerson(team=team, name=f"P {number}"))
        people = session.scalars(select(Person)).all()
        rows = [
            _row(number, people[number % TEAMS], _varied(sample, random), receipt)
            | {"published_at": now - timedelta(hours=number)}
            for number in range(ENTRIES)
        ]
        session.execute(insert(Submission), rows)
        add_person(transaction, NewPerson(team=teams[-1], name="Organiser", role="organiser"))
        token = create_token(transaction, NewToken(person="Organiser", kind="access")).token
    state.database.close()
    return token


def _receipt(state: ServerState, report: ScoreReport) -> dict[str, Any]:
    receipt = Receipt(
        server=state.signer.server,
        submission_id="any",
        team="any",
        sha256="0" * 64,
        received_at=utc_now(),
        split=SPLIT,
        signature=report.signature,
        scores=report.scores,
        quota=QuotaReport(remaining=0, next_at=None, seconds_to_next=0, windows=[]),
    )
    return state.signer.sign(receipt).model_dump(mode="json")


def _varied(report: dict[str, Any], random: Random) -> dict[str, Any]:
    scores = {key: value * random.uniform(0.5, 1) for key, value in report["scores"].items()}
    return {**report, "scores": scores}


def _row(
    number: int, person: Person, report: dict[str, Any], receipt: dict[str, Any]
) -> dict[str, Any]:
    method = Method.model_validate(
        {
            "name": f"Method {number} with memory",
            "description": "A transformer over the navigation graph. " * 5,
            "paper": "https://arxiv.org/abs/1904.10151",
            "code": "https://github.com/YuankaiQi/REVERIE",
            "extra_data": number % 3 == 0,
            "ground_truth_objects": number % 5 == 0,
        }
    )
    return {
        "id": secrets.token_hex(8),
        "split": SPLIT,
        "team_id": person.team_id,
        "person_id": person.id,
        "sha256": secrets.token_hex(32),
        "size": 1_000_000,
        "received_at": utc_now(),
        "scored_at": utc_now(),
        "method": method.model_dump(mode="json"),
        "report": report,
        "receipt": receipt,
    }


def touch(folder: Path) -> None:
    """Record something that may change a board, from another process than the server's."""
    with acting(load_settings(folder), "benchmark") as transaction:
        submission = transaction.session.scalars(select(Submission).limit(1)).one()
        transaction.record("changed", submission, submission.id)


@contextmanager
def running(folder: Path) -> Iterator[tuple[str, int]]:
    """Run a server in a process of its own; return the URL that it prints, and its number."""
    words = [sys.executable, "-c", SERVER, str(folder)]
    often = {**os.environ, "REVERIE_EVAL_LIMITS__REQUESTS_PER_MINUTE": "1000000"}
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=often
    ) as process:
        assert process.stdout is not None  # noqa: S101  # it was asked for
        try:
            yield process.stdout.readline().strip(), process.pid
        finally:
            process.terminate()


def timed(connection: http.client.HTTPConnection, name: str, path: str, has_bar: bool) -> float:  # noqa: FBT001  # as the table has it
    """Print how long a page takes; return the median in milliseconds, 0 where there is no bar."""
    ask(connection, path)
    times = [1000 * ask(connection, path)[0] for _ in range(REQUESTS)]
    median = statistics.median(times)
    verdict = ""
    if has_bar:
        verdict = f"   below {MOST_MILLISECONDS:g}   {_verdict(median < MOST_MILLISECONDS)}"
    print(f"{name}, {ENTRIES:,} entries: median {median:.1f} ms, max {max(times):.1f} ms{verdict}")
    return median if has_bar else 0.0


def lists(url: str, server: int, token: str) -> None:
    """Print what a page of the API's longest list takes; it has no bar but its bounded length."""
    connection = http.client.HTTPConnection(urlsplit(url).netloc)
    for limit in (100, LONGEST):
        path = f"{SUBMISSIONS}?limit={limit}"
        size = len(ask(connection, path, token=token)[1])
        times = [1000 * ask(connection, path, token=token)[0] for _ in range(5)]
        median = statistics.median(times)
        print(f"{limit:,} of {ENTRIES:,} submissions: median {median:.1f} ms, {size / 1e6:.2f} MB")
    before = _peak_megabytes(server)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        connections = [http.client.HTTPConnection(urlsplit(url).netloc) for _ in range(AT_ONCE)]
        list(pool.map(lambda each: ask(each, path, token=token), connections))
    after = _peak_megabytes(server)
    print(f"peak memory, {AT_ONCE} such requests at once: {before:.0f} MB before, {after:.0f} MB")


def _peak_megabytes(process: int) -> float:
    status = Path(f"/proc/{process}/status").read_text()
    return int(re.findall(r"VmHWM:\s+(\d+) kB", status)[0]) / 1000


def weight(connection: http.client.HTTPConnection) -> float:
    """Print what a browser fetches for the heaviest usual page; return kilobytes."""
    _, html = ask(connection, f"{BOARD}?page=2")
    needed = re.findall(r'(?:src|href)="(/static/[^"]+)"', html.decode())
    sent = sum(len(ask(connection, path, packed=True)[1]) for path in (f"{BOARD}?page=2", *needed))
    whole = len(html) + sum(len(ask(connection, path)[1]) for path in needed)
    print(
        f"weight of a board's page: {whole / 1000:.1f} kB unpacked, {sent / 1000:.1f} kB sent, of "
        f"which HTML {len(html) / 1000:.1f} kB   below {MOST_KILOBYTES:g}   "
        f"{_verdict(whole / 1000 < MOST_KILOBYTES)}"
    )
    return whole / 1000


DRAWN = """name => document.getElementById("against").ariaLabel.includes(name)"""
IDLE = "() => new Promise(done => requestIdleCallback(() => done()))"
FETCHED = """() => {
    const fetched = performance.getEntriesByType("resource");
    const chart = fetched.find(it => it.name.includes("/chart?"));
    return [chart.decodedBodySize, chart.encodedBodySize];
}"""


def in_browser(url: str) -> float:
    """Print how long a browser takes to show and to redraw a board; return the longer median."""
    chromium = chromium_path()
    if chromium is None:
        print("in the browser: not tried, there is no Chromium here")
        return 0.0
    with browsing(chromium) as browser:
        tries = [_look(browser.new_page(), f"{url}{BOARD}") for _ in range(TRIES)]
    unpacked, sent = tries[0][2]
    print(f"chart's data in the browser: {unpacked / 1000:.1f} kB, {sent / 1000:.1f} kB sent")
    medians = []
    for name, times in (("open", [it[0] for it in tries]), ("redraw", [it[1] for it in tries])):
        median = statistics.median(times)
        medians.append(median)
        print(
            f"{name} in the browser, {ENTRIES:,} entries: median {median:.0f} ms, max "
            f"{max(times):.0f} ms   below {MOST_TO_USE:g}   {_verdict(median < MOST_TO_USE)}"
        )
    return max(medians)


def _look(page: Page, address: str) -> tuple[float, float, Sequence[int]]:
    """Open a board and redraw it; return milliseconds of both, and the size of the chart's data."""
    start = time.perf_counter()
    page.goto(address)
    _wait_for_chart(page, "remote grounding success against success rate")
    opened = time.perf_counter()
    page.get_by_label("Horizontal axis").select_option("spl")
    _wait_for_chart(page, "remote grounding success against success weighted")
    redrawn = time.perf_counter()
    fetched: Sequence[int] = page.evaluate(FETCHED)
    page.close()
    return 1000 * (opened - start), 1000 * (redrawn - opened), fetched


def _wait_for_chart(page: Page, name: str) -> None:
    """Wait until a chart is drawn and the browser has nothing more to do."""
    page.wait_for_function(DRAWN, arg=name)  # up to half a minute
    page.evaluate(IDLE)


def ask(
    connection: http.client.HTTPConnection, path: str, *, packed: bool = False, token: str = ""
) -> tuple[float, bytes]:
    """Return how many seconds a reply took, and the reply."""
    start = time.perf_counter()
    headers = {"Accept-Encoding": "gzip"} if packed else {}
    headers |= {"Authorization": f"Bearer {token}"} if token else {}
    connection.request("GET", path, headers=headers)
    reply = connection.getresponse()
    body = reply.read()
    if reply.status != http.client.OK:
        raise RuntimeError(f"status {reply.status} for {path}")
    return time.perf_counter() - start, body


def _verdict(is_met: bool) -> str:  # noqa: FBT001
    return "ok" if is_met else "MISSED"


if __name__ == "__main__":
    sys.exit(main())
