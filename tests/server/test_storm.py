"""A deadline: all teams upload at once, while many others look on, idle or are slow.

Uploads are as large as those to REVERIE's val_unseen. Every one has to be scored, every page has to
be shown, the memory of the server stays within bounds, and all teams get on equally.
"""

import http.client
import json
import statistics
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import pytest

from reverie_eval.server.opening import acting
from reverie_eval.server.settings import SETTINGS_FILE, load_settings
from tests.support.amounts import amount, is_evidence, tell
from tests.support.crowd import (
    Reply,
    ask,
    connect,
    idling,
    large,
    peak_megabytes,
    reading,
    sending_slowly,
)
from tests.support.plain_sql import stored
from tests.support.serving import OPEN, populate, running
from tests.support.waiting import PATIENCE

UPLOADS_IN_SUITE = 40
FILES = 5
"""That each team sends, one after the other."""
IDLE, IDLE_IN_SUITE = 1000, 100
SLOW = 8
"""Teams with slow connections."""
SLOW_SECONDS, SLOW_SECONDS_IN_SUITE = 40, 2
"""That an upload of theirs takes; more than 60 are not allowed."""
MOST_MEGABYTES = 600
"""The memory of the server process at its peak."""
MOST_AHEAD = 3
"""Files by which the fastest team may be ahead of the slowest."""

UPLOAD = f"/api/v1/splits/{OPEN}/submissions?name=Walker"
STATIC, HEALTH = "/static/style.css", "/healthz"
READ = (
    f"/splits/{OPEN}",
    f"/api/v1/splits/{OPEN}/leaderboard",
    f"/api/v1/splits/{OPEN}/leaderboard.csv",
    "/guide",
    HEALTH,
    STATIC,
)

SETTINGS = f"""
[splits.{OPEN}]
bundle = "{{bundle}}"
visibility = "private"
quota = {{{{ day = 100, month = 100, year = 100 }}}}

[limits]
requests_per_minute = 1000000
"""


@dataclass
class Race:
    """How far each team has come."""

    teams: Sequence[str]
    done: Counter[str] = field(default_factory=Counter)
    most_ahead: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def note(self, team: str) -> None:
        """Note that a file of a team was scored."""
        with self._lock:
            self.done[team] += 1
            counts = [self.done[each] for each in self.teams]
            self.most_ahead = max(self.most_ahead, max(counts) - min(counts))


class Storm(NamedTuple):
    """A server, and a file to send to it."""

    folder: Path
    tokens: dict[str, str]
    slow: Sequence[str]
    """Tokens of people with slow connections."""
    content: bytes

    def file(self, number: int) -> bytes:
        """Return a file that nobody else sends."""
        return self.content + b" " * (number + 1)


@pytest.fixture
def storm(folder: Path, request: pytest.FixtureRequest) -> Storm:
    """Return a server with many teams, which has the published ground truth if it is there."""
    bundle, content = large(request)
    (folder / SETTINGS_FILE).write_text(SETTINGS.format(bundle=bundle))
    (folder / bundle).chmod(0o600)
    uploads = amount(UPLOADS_IN_SUITE)
    teams = [f"Team {number}" for number in range(uploads // FILES + SLOW)]
    with acting(load_settings(folder), "test") as transaction:
        tokens = dict(populate(transaction, {f"P of {team}": team for team in teams}))
    slow = [tokens.pop(f"P of {team}") for team in teams[-SLOW:]]
    return Storm(folder, tokens, slow, content)


@pytest.fixture
def url_and_process(storm: Storm) -> Iterator[tuple[str, int]]:
    """Run the server in a process of its own."""
    # That nobody waits longer is only true of a fast machine.
    patience = {} if is_evidence() else {"REVERIE_EVAL_LIMITS__SECONDS_FOR_BODY": f"{PATIENCE}"}
    with running(storm.folder, **patience) as (process, url):
        yield url, process.pid


@pytest.mark.slow
def test_all_uploads_of_a_deadline_are_scored(
    storm: Storm, url_and_process: tuple[str, int]
) -> None:
    url, process = url_and_process
    publish_one(url, storm)
    before = peak_megabytes(process)
    race = Race(list(storm.tokens))
    with ExitStack() as stack:
        idle = IDLE if is_evidence() else IDLE_IN_SUITE
        pace = SLOW_SECONDS if is_evidence() else SLOW_SECONDS_IN_SUITE
        stack.enter_context(idling(url, idle))
        replies = stack.enter_context(reading(url, READ))
        slow_statuses = stack.enter_context(
            sending_slowly(url, UPLOAD, storm.content, storm.slow, pace)
        )
        began = time.monotonic()
        uploads = upload_all(url, storm, race)
        seconds = time.monotonic() - began
    statuses = Counter(reply.status for team in uploads for reply in team)
    assert statuses == {201: FILES * len(storm.tokens)}
    assert {reply.status for path in READ for reply in replies[path]} == {200}
    assert set(slow_statuses) <= {200, 201}
    rows = stored(f"sqlite:///{storm.folder}/server.db").submissions
    assert len(rows) == statuses[201] + slow_statuses.count(201) + 1
    assert race.most_ahead <= MOST_AHEAD
    peak = peak_megabytes(process)
    assert peak <= MOST_MEGABYTES
    waits = [sum(reply.seconds for reply in team) for team in uploads]
    tell(
        uploads=f"{statuses[201]} of {len(storm.content):,} bytes, {len(storm.tokens)} teams",
        seconds=f"{seconds:.1f}, {statuses[201] / seconds:.1f} uploads a second",
        replies_to_uploads=percentiles([reply for team in uploads for reply in team]),
        slowest_team=f"{max(waits) / statistics.median(waits):.2f} of the median team's time",
        files_ahead=race.most_ahead,
        meanwhile=f"{idle} idle connections, slow uploads {dict(Counter(slow_statuses))}",
        megabytes=f"{before:.0f} before, {peak:.0f} at the peak",
    )
    for path in READ:
        tell(reads=f"{path}, {len(replies[path])} times: {percentiles(replies[path])}")


def publish_one(url: str, storm: Storm) -> None:
    """Put something on the leaderboard, so that readers have something to read."""
    token, connection = storm.slow[0], connect(url)
    publish(connection, ask(connection, "POST", UPLOAD, storm.content + b"\n", token), token)
    connection.close()


def upload_all(url: str, storm: Storm, race: Race) -> Sequence[Sequence[Reply]]:
    """Upload the files of all teams, and publish the first of each; return the replies by team."""
    ready = threading.Barrier(len(storm.tokens))

    def upload(number: int, person: str) -> Sequence[Reply]:
        token, connection = storm.tokens[person], connect(url)
        ready.wait()
        replies = []
        for file in range(FILES):
            content = storm.file(number * FILES + file)
            replies.append(ask(connection, "POST", UPLOAD, content, token))
            race.note(person)
            if file == 0:
                publish(connection, replies[0], token)
        connection.close()
        return replies

    with ThreadPoolExecutor(len(storm.tokens)) as senders:
        return list(senders.map(upload, range(len(storm.tokens)), storm.tokens))


def publish(connection: http.client.HTTPConnection, reply: Reply, token: str) -> None:
    """Put a submission on the leaderboard."""
    assert reply.status == 201, reply.body
    submission = json.loads(reply.body)["submission"]["id"]
    path = f"/api/v1/submissions/{submission}"
    changed = ask(connection, "PATCH", path, b'{"published": true}', token)
    assert changed.status == 200, changed.body


def percentiles(replies: Sequence[Reply]) -> str:
    """Say how long replies took."""
    times = sorted(1000 * reply.seconds for reply in replies)
    median, p95, p99 = (times[int(share * len(times))] for share in (0.5, 0.95, 0.99))
    return f"median {median:.0f} ms, 95 % {p95:.0f}, 99 % {p99:.0f}, longest {times[-1]:.0f}"
