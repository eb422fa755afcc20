"""How fast the server scores uploads, on the published REVERIE files.

``python benchmarks/server.py`` starts a real server process, with its database and uploads on this
disk and every commit durable, and sends it val_unseen.mixed1 as plain JSON; each upload differs
from all others in one digit of a heading, so that each is scored. Latencies depend on the machine.
The figure with a bar is throughput as a ratio to a bare FastAPI route under the same uvicorn
settings that only reads the same bodies and calls ``orjson.loads``. Both run in turn, several
times, and the median of the ratios counts. Beside it stands what an upload costs the processors in
either process, which depends less on what else the machine does. The uploads come from many teams
in turn, as they would before a deadline. The server has one process that scores, beside the one
that answers. Then two processes that score are compared with one in the same way; the sender takes
its part of the same processors.
Needs the published files (see ``fixtures/published.py``).
"""

import gzip
import http.client
import itertools
import os
import re
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import local
from typing import NamedTuple
from urllib.parse import urlsplit

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.processors import busy_milliseconds, family_of, processor_milliseconds
from fixtures.published import published_folder, unpack_dataset
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.schemas.organising import NewPerson, NewTeam, NewToken
from reverie_eval.server.accounts.people import add_person, add_team
from reverie_eval.server.accounts.tokens import create_token
from reverie_eval.server.audit.signing import make_key
from reverie_eval.server.opening import acting
from reverie_eval.server.operations.folder import upgrade_folder
from reverie_eval.server.settings import load_settings

SPLIT = "val_unseen"
SUBMISSION = f"{SPLIT}.mixed1"
PATH = f"/api/v1/splits/{SPLIT}/submissions?name=mixed1"
ROUNDS = 5
UPLOADS = 120
"""In each round, of each kind."""
TEAMS = 100
CONCURRENCY = (1, 8, 32)
COMPARED_AT = 8
BAR = 0.7
WORKERS = 2
BAR_OF_WORKERS = 1.6

SETTINGS = """
[splits.val_unseen]
bundle = "val_unseen.npz"
visibility = "{visibility}"
quota = {{ day = 1000000, month = 1000000, year = 1000000 }}

[limits]
requests_per_minute = 1000000
"""

SERVER = """
import sys
from functools import partial
from pathlib import Path
from reverie_eval.server.run import run_server
from reverie_eval.server.settings import load_settings
folder, workers = sys.argv[1:]
announce = partial(print, flush=True)
run_server(load_settings(Path(folder)), "127.0.0.1", 0, announce, workers=int(workers))
"""

BARE = """
import orjson
import uvicorn
from fastapi import FastAPI, Request
from reverie_eval.server.run import configuration, listen, url_of
app = FastAPI()
@app.post("/")
async def read(request: Request) -> int:
    return len(orjson.loads(await request.body()))
listening = listen("127.0.0.1", 0)
print(url_of(listening), flush=True)
uvicorn.Server(configuration(app)).run(sockets=[listening])
"""


class Target(NamedTuple):
    """Where uploads go, and what comes back for one that was taken."""

    url: str
    process: int
    path: str
    status: int
    tokens: Iterator[str] = itertools.repeat("")
    """One for each upload."""


class Load(NamedTuple):
    """What a round of uploads took."""

    seconds: float
    latencies: Sequence[float]
    processor_milliseconds: float
    """The processor time that the server takes for all uploads."""
    answering_milliseconds: float
    """The part of the server's time that the process takes that answers requests."""
    busy_milliseconds: float
    """The processor time of all processes of the machine, the sender's included."""

    @property
    def throughput(self) -> float:
        """Uploads per second."""
        return len(self.latencies) / self.seconds

    @property
    def cost(self) -> float:
        """Milliseconds of the processors for an upload."""
        return self.processor_milliseconds / len(self.latencies)

    @property
    def answering_cost(self) -> float:
        """Milliseconds of the processor for an upload, in the process that answers requests."""
        return self.answering_milliseconds / len(self.latencies)

    @property
    def busy(self) -> float:
        """The number of processors that were busy, on average."""
        return self.busy_milliseconds / (1000 * self.seconds)


class Comparison(NamedTuple):
    """Medians of several rounds of two targets in turn."""

    ratio: float
    """The second target's throughput divided by the first's."""
    throughputs: Sequence[float]
    costs: Sequence[float]
    answering_costs: Sequence[float]
    busy: Sequence[float]


def main() -> int:
    """Print every figure; exit with 1 if one misses its bar."""
    folder = published_folder()
    if folder is None:
        print("the published REVERIE files are not here (REVERIE_DATA names their folder)")
        return 2
    with gzip.open(folder / "reference" / "submissions" / f"{SUBMISSION}.json.gz") as packed:
        bodies = variants(packed.read())
    with TemporaryDirectory() as temporary:
        work = Path(temporary)
        dataset = unpack_dataset(folder, work)
        bundle = compile_split(DatasetFiles.find(dataset, split=SPLIT), SPLIT)
        ratios, gains = [], []
        for visibility in ("private", "open"):
            server = work / visibility
            server.mkdir()
            bundle.save(server / f"{SPLIT}.npz")
            tokens = itertools.cycle(make_server(server, visibility))
            with running(SERVER, server, 1) as ours, running(BARE) as theirs:
                scored, bare = Target(*ours, PATH, 201, tokens), Target(*theirs, "/", 200)
                ratios.append(compare(visibility, scored, bare, bodies))
            with running(SERVER, server, 1) as alone, running(SERVER, server, WORKERS) as several:
                one, crew = (Target(*each, PATH, 201, tokens) for each in (alone, several))
                gains.append(compare_workers(visibility, one, crew, bodies))
    return int(min(ratios) < BAR or min(gains) < BAR_OF_WORKERS)


def compare(visibility: str, scored: Target, bare: Target, bodies: Iterator[bytes]) -> float:
    """Print a server's latencies and its throughput against the bare route's; return the ratio."""
    for target in (scored, bare):
        upload(target, itertools.islice(bodies, 32), COMPARED_AT)
    for concurrency in CONCURRENCY:
        latencies = sorted(
            latency
            for _ in range(ROUNDS)
            for latency in upload(scored, itertools.islice(bodies, UPLOADS), concurrency).latencies
        )
        median, p99 = (1000 * quantile(latencies, share) for share in (0.5, 0.99))
        print(
            f"{visibility} split, {concurrency:2} at once: median {median:6.1f} ms, p99 "
            f"{p99:6.1f} ms, of {len(latencies)} uploads"
        )
    ratio, (ours, theirs), costs, *_ = in_turns(scored, bare, bodies)
    verdict = "ok" if ratio >= BAR else "MISSED"
    print(
        f"{visibility} split, {COMPARED_AT} at once: {ours:.1f} uploads/s, bare route "
        f"{theirs:.1f}; ratio {ratio:.2f}   at least {BAR}   {verdict}"
    )
    print(
        f"{visibility} split, {COMPARED_AT} at once: an upload takes {costs[0]:.1f} ms of the "
        f"processors, of the bare route {costs[1]:.1f}; ratio {costs[1] / costs[0]:.2f}"
    )
    return ratio


def compare_workers(visibility: str, one: Target, crew: Target, bodies: Iterator[bytes]) -> float:
    """Print the throughput of several scoring processes against that of one; return the ratio."""
    for target in (one, crew):
        upload(target, itertools.islice(bodies, 32), COMPARED_AT)
    ratio, (several, single), costs, answering, busy = in_turns(crew, one, bodies)
    verdict = "ok" if ratio >= BAR_OF_WORKERS else "MISSED"
    print(
        f"{visibility} split, {COMPARED_AT} at once: {WORKERS} scoring processes {several:.1f} "
        f"uploads/s, one {single:.1f}; ratio {ratio:.2f}   at least {BAR_OF_WORKERS}   {verdict}"
    )
    print(
        f"{visibility} split, {COMPARED_AT} at once: with {WORKERS}, {busy[0]:.2f} of "
        f"{os.cpu_count()} processors are busy, with one {busy[1]:.2f}, the sender included"
    )
    print(
        f"{visibility} split, {COMPARED_AT} at once: of the {costs[0]:.1f} ms of an upload with "
        f"{WORKERS}, the process that answers takes {answering[0]:.1f}"
    )
    return ratio


def compare_fields(work: Path, bundle: Path, plain: bytes, with_field: bytes) -> float:
    """Return the throughput of files with one field more, to that of plain ones: private split."""
    folder = work / "server"
    folder.mkdir()
    shutil.copy(bundle, folder / f"{SPLIT}.npz")
    tokens = itertools.cycle(make_server(folder, "private"))
    bodies = variants(with_field), variants(plain)
    with running(SERVER, folder, 1) as ours:
        target = Target(*ours, PATH, 201, tokens)
        rounds = [
            [upload(target, itertools.islice(each, UPLOADS), COMPARED_AT) for each in bodies]
            for _ in range(ROUNDS)
        ]
    return statistics.median(more.throughput / none.throughput for more, none in rounds)


def in_turns(first: Target, second: Target, bodies: Iterator[bytes]) -> Comparison:
    """Send the same uploads to two targets in turn, in several rounds."""
    rounds = [
        [
            upload(target, itertools.islice(bodies, UPLOADS), COMPARED_AT)
            for target in (first, second)
        ]
        for _ in range(ROUNDS)
    ]
    return Comparison(
        statistics.median(one.throughput / other.throughput for one, other in rounds),
        [
            statistics.median(load.throughput for load in loads)
            for loads in zip(*rounds, strict=True)
        ],
        [statistics.median(load.cost for load in loads) for loads in zip(*rounds, strict=True)],
        [
            statistics.median(load.answering_cost for load in loads)
            for loads in zip(*rounds, strict=True)
        ],
        [statistics.median(load.busy for load in loads) for loads in zip(*rounds, strict=True)],
    )


def quantile(ordered: Sequence[float], share: float) -> float:
    """Return the value that this share of the others does not exceed."""
    return ordered[min(int(share * len(ordered)), len(ordered) - 1)]


def variants(content: bytes) -> Iterator[bytes]:
    """Return the submission again and again, never twice the same: one digit varies."""
    places = [match.end() - 1 for match in re.finditer(rb'", *\d\.\d+', content)]
    for digit in b"1234567890":
        for place in places:
            if content[place] != digit:
                yield b"%b%c%b" % (content[:place], digit, content[place + 1 :])


def make_server(folder: Path, visibility: str) -> Sequence[str]:
    """Make the folder of a server with a quota that does not bite; return a token of each team."""
    (folder / "reverie-eval.toml").write_text(SETTINGS.format(visibility=visibility))
    (folder / f"{SPLIT}.npz").chmod(0o600)
    make_key(folder / "signing-key.pem")
    upgrade_folder(folder)
    tokens = []
    with acting(load_settings(folder), "benchmark") as transaction:
        for number in range(TEAMS):
            team, name = f"Team {number}", f"P {number}"
            add_team(transaction, NewTeam(name=team))
            add_person(transaction, NewPerson(team=team, name=name))
            tokens.append(create_token(transaction, NewToken(person=name, kind="access")).token)
    return tokens


@contextmanager
def running(program: str, *arguments: Path | int) -> Iterator[tuple[str, int]]:
    """Run a server in a process of its own; return the URL that it prints, and the process."""
    words = [sys.executable, "-c", program, *map(str, arguments)]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None  # noqa: S101  # it was asked for
        try:
            url = process.stdout.readline().strip()
            if not url:
                raise RuntimeError("a server has ended before it began")
            yield url, process.pid
        finally:
            process.terminate()


def upload(target: Target, bodies: Iterator[bytes], concurrency: int) -> Load:
    """Send bodies, so many at once; each sender keeps a connection."""
    address = urlsplit(target.url).netloc
    own = local()

    def send(body: bytes, token: str) -> float:
        if not hasattr(own, "connection"):
            own.connection = http.client.HTTPConnection(address)
        headers = {"Content-Type": "application/json", "Authorization": f"Bearer {token}"}
        start = time.perf_counter()
        own.connection.request("POST", target.path, body, headers)
        reply = own.connection.getresponse()
        reply.read()
        if reply.status != target.status:
            raise RuntimeError(f"status {reply.status} instead of {target.status}")
        return time.perf_counter() - start

    prepared = list(bodies)
    with ThreadPoolExecutor(concurrency) as senders:
        start, busy = time.perf_counter(), busy_milliseconds()
        spent = processor_milliseconds(*family_of(target.process))
        answering = processor_milliseconds(target.process)
        latencies = list(senders.map(send, prepared, target.tokens))
        seconds = time.perf_counter() - start
        spent = processor_milliseconds(*family_of(target.process)) - spent
        answering = processor_milliseconds(target.process) - answering
        return Load(seconds, latencies, spent, answering, busy_milliseconds() - busy)


if __name__ == "__main__":
    sys.exit(main())
