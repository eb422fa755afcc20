"""Whatever is killed, and whenever: an upload counts once, or it has cost nothing.

Servers are killed at every step of an upload and at random moments, and so are PostgreSQL and the
processes that score, while several people upload. Many of the kills come between the commit and the
reply, because some uploads wait there for it. After each kill the database is read without our
code. What was acknowledged has to be there once, with its scores, its file, its entry in the audit
log and its place in the quota. Everything else is there as completely, or has left no trace. Then
the server starts again, unless it has gone on; what was not acknowledged is sent once more,
together with something that was.
"""

import gzip
import hashlib
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from pathlib import Path
from random import Random
from signal import SIGKILL
from typing import Any, NamedTuple, get_args

import httpx
import pytest

from reverie_eval import evaluate
from reverie_eval.server.opening import acting
from reverie_eval.server.operations.folder import upgrade_folder
from reverie_eval.server.settings import SETTINGS_FILE, load_settings
from tests.support.amounts import amount, is_evidence, tell
from tests.support.killing import (
    PAUSES,
    STEPS,
    STEPS_OF_SCORING,
    Part,
    Running,
    is_running,
    kill_postgresql,
    kill_process,
    restart_postgresql,
    serving,
)
from tests.support.plain_sql import Stored, stored
from tests.support.server_data import faults
from tests.support.serving import (
    GOOD,
    MATE,
    NO_TLS,
    OPEN,
    OTHER,
    OWNER,
    PEOPLE,
    make_database,
    populate,
    running_postgresql,
)
from tests.support.signing import payload_in
from tests.support.waiting import PATIENCE, wait_until

SENDERS = (OWNER, MATE, OTHER)
"""The first two are of one team."""
FILES = 2
"""Which are not stored yet, that each of them sends between two kills."""
PADDING = 1 << 18
"""Bytes, so that an upload arrives in several pieces."""
QUOTA = 100_000
BEFORE_THE_FIRST = "0" * 64
NOT_REACHED, BUSY = "database-down", "busy"
BETWEEN_COMMIT_AND_REPLY = 5
"""One in so many kills, at least."""
OF_SCORING = 5
"""One in so many kills of the others."""

SETTINGS = """
database = "{database}"

[splits.val_unseen]
bundle = "bundles/val_unseen.npz"
visibility = "open"
quota = {{ day = {quota}, month = {quota}, year = {quota} }}

[limits]
requests_per_minute = 1000000
mebibytes_per_day = 1000000
"""


class Kill(NamedTuple):
    """What is killed, and when."""

    part: Part | None = None
    """Which part of PostgreSQL is killed; None for the server."""
    step: str | None = None
    """At which step of an upload to a server; None for a random moment."""

    def __str__(self) -> str:
        return self.part or self.step or "at any moment"


AT_STEPS = tuple(Kill(step=step) for step in STEPS)
AT_PAUSES = tuple(Kill(step=step) for step in PAUSES) * 3
AT_ANY_MOMENT = (Kill(),) * 3
OF_POSTGRESQL = tuple(Kill(part) for part in get_args(Part))


@dataclass
class Upload:
    """A file that somebody has sent, perhaps several times."""

    who: str
    content: bytes
    acknowledged: Any = None
    """The submission in the first reply, if there was one."""

    @cached_property
    def sha256(self) -> str:
        """The name under which it is stored."""
        return hashlib.sha256(self.content).hexdigest()


@dataclass
class Lab:
    """A server's folder, what was sent to the server, and what has to be true of it."""

    folder: Path
    database: str
    postgresql: Any
    """What starts PostgreSQL; None with SQLite."""
    random: Random = field(default_factory=lambda: Random(0))
    uploads: list[Upload] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)
    """How many replies had each status, and how many uploads had no reply."""
    unheard: list[Upload] = field(default_factory=list)
    """Uploads that were sent since the database was last read, and not acknowledged."""
    fates: Counter[str] = field(default_factory=Counter)
    """How many of these were stored, and how many had been before."""
    between: int = 0
    """Kills of the server after which something was there that had been committed without a
    reply."""
    serial: Iterator[int] = field(default_factory=count)
    known: dict[str, Any] = field(default_factory=dict)
    """The receipts that were in the database when it was last read, by SHA-256."""
    typical_seconds: float = 0.0
    """That a round of uploads takes if nothing is killed."""
    excuse: str = ""
    """The code of a reply with status 503; there is none if it is empty."""

    def __post_init__(self) -> None:
        """Set up the server."""
        settings = SETTINGS.format(database=self.database, quota=QUOTA)
        (self.folder / SETTINGS_FILE).write_text(settings)
        upgrade_folder(self.folder)
        with acting(load_settings(self.folder), "test") as transaction:
            self.tokens = populate(transaction, PEOPLE)
        self.scores = evaluate(GOOD, split=OPEN).to_report().scores

    def calmly(self) -> None:
        """Upload something while nothing is killed."""
        with serving(self.folder) as server:
            self.ask_quotas(server.url)
            began = time.monotonic()
            self.send_all(server.url, self.plans())
            self.typical_seconds = time.monotonic() - began
        assert not self.unacknowledged()
        self.check()

    def disturb(self, kill: Kill) -> None:
        """Upload something, kill meanwhile, and check what is left."""
        with serving(self.folder) as server:
            self.ask_quotas(server.url)
            if kill.step is not None:
                server.plant(kill.step, self.random.randint(1, FILES * len(SENDERS)))
            with ThreadPoolExecutor(1) as other:
                sending = other.submit(self.send_all, server.url, self.plans())
                self.kill(server, kill)
                sending.result()
            if kill.part is not None:
                restart_postgresql(self.postgresql)
                self.check()
                self.send_again(server)
        self.check()

    def kill(self, server: Running, kill: Kill) -> None:
        """Kill what is to be killed, while uploads are sent."""
        if kill.step in STEPS:
            assert server.process.wait(PATIENCE) == -SIGKILL, kill
            return
        if kill.step in PAUSES:
            server.told()
        self.wait_for_any_moment()
        if kill.part is None:
            server.process.kill()
        else:
            kill_postgresql(self.postgresql, kill.part)

    def disturb_scoring(self, server: Running, step: str | None) -> None:
        """Upload something, kill a process that scores meanwhile, and check what is left."""
        self.ask_quotas(server.url)
        if step is not None:
            # After a reply of 503, not all files come to a step again.
            server.plant(step, self.random.randint(1, len(SENDERS)))
        with ThreadPoolExecutor(1) as other:
            sending = other.submit(self.send_all, server.url, self.plans())
            if step is None:
                self.wait_for_any_moment()
                wait_until(server.scorers)
                kill_process(self.random.choice(sorted(server.scorers())))
            else:
                victim = server.told()
                wait_until(lambda: not is_running(victim))
            sending.result()
        self.check()
        self.send_again(server)
        self.check()

    def wait_for_any_moment(self) -> None:
        """Wait for a part of the time that uploads take."""
        time.sleep(self.random.uniform(0, self.typical_seconds))

    def send_again(self, server: Running) -> None:
        """Send what was not acknowledged to the server that went on."""
        self.send_all(server.url, [self.unacknowledged()])
        assert not self.unacknowledged(), "the server works again, without a restart"

    def plans(self) -> Sequence[Sequence[Upload]]:
        """Return what each sends: what was not acknowledged, something that was, and new files."""
        acknowledged = [upload for upload in self.uploads if upload.acknowledged]
        plans = []
        for who in SENDERS:
            pending = [upload for upload in self.unacknowledged() if upload.who == who]
            again = self.random.sample(acknowledged, min(1, len(acknowledged)))
            absent = sum(upload.sha256 not in self.known for upload in pending)
            new = [Upload(who, self.new_file()) for _ in range(FILES - absent)]
            self.uploads += new
            plans.append([*pending, *again, *new])
        return plans

    def new_file(self) -> bytes:
        """Return a file that nobody has sent."""
        return GOOD + b" " * (PADDING + next(self.serial))

    def unacknowledged(self) -> Sequence[Upload]:
        """Return the uploads whose senders do not know what became of them."""
        return [upload for upload in self.uploads if upload.acknowledged is None]

    def send_all(self, url: str, plans: Sequence[Sequence[Upload]]) -> None:
        """Send several people's uploads, each one after the other, until the server is gone."""

        def send_each(uploads: Sequence[Upload]) -> None:
            with httpx.Client(base_url=url, timeout=PATIENCE, verify=NO_TLS) as client:
                for upload in uploads:
                    if not self.send(client, upload):
                        return

        with ThreadPoolExecutor(len(plans)) as senders:
            list(senders.map(send_each, plans))

    def send(self, client: httpx.Client, upload: Upload) -> bool:
        """Send an upload, and compare the reply with what is known; whether there was one."""
        try:
            reply = client.post(
                f"/api/v1/splits/{OPEN}/submissions",
                params={"name": "Walker"},
                content=upload.content,
                headers={"Authorization": f"Bearer {self.tokens[upload.who]}"},
            )
        except httpx.TransportError:
            self.statuses["none"] += 1
            self.unheard.append(upload)
            return False
        self.statuses[str(reply.status_code)] += 1
        if self.excuse and reply.status_code == 503:
            assert reply.json()["code"] == self.excuse, reply.text
            assert reply.headers["retry-after"]
            self.unheard.append(upload)
            return True
        assert reply.status_code in {200, 201}, reply.text
        submission = reply.json()["submission"]
        receipt = self.known.get(upload.sha256)
        if receipt is not None:
            assert (reply.status_code, submission["receipt"]) == (200, receipt)
        if upload.acknowledged is not None:
            assert (reply.status_code, submission) == (200, upload.acknowledged)
        upload.acknowledged = submission
        return True

    def ask_quotas(self, url: str) -> None:
        """Check that the server counts what is stored, each once, and nothing else."""
        rows = stored(self.database).submissions
        for who in SENDERS:
            used = sum(row.team == PEOPLE[who] for row in rows)
            headers = {"Authorization": f"Bearer {self.tokens[who]}"}
            reply = httpx.get(
                f"{url}/api/v1/splits/{OPEN}", headers=headers, timeout=PATIENCE, verify=NO_TLS
            )
            assert reply.json()["quota"]["remaining"] == QUOTA - used

    def check(self) -> None:
        """Read the database, and check that each upload is there once, or not at all."""
        found = stored(self.database)
        sent = {upload.sha256: upload for upload in self.uploads}
        rows = {row.sha256: row for row in found.submissions}
        assert len(rows) == len(found.submissions), "a file is stored twice"
        assert rows.keys() <= sent.keys()
        for sha256, upload in sent.items():
            if upload.acknowledged is not None:
                row = rows[sha256]
                assert row.id == upload.acknowledged["id"]
                assert row.receipt == upload.acknowledged["receipt"]
        for sha256 in rows.keys() - self.known.keys():
            row, upload = rows[sha256], sent[sha256]
            assert (row.team, row.split) == (PEOPLE[upload.who], OPEN)
            assert row.scores == _signed_scores(row.receipt) == self.scores
            packed = self.folder / "uploads" / sha256[:2] / f"{sha256}.json.gz"
            assert gzip.decompress(packed.read_bytes()) == upload.content
        self.check_counts(found)
        fates = [self.fate(each, rows.keys()) for each in self.unheard]
        self.fates.update(fates)
        self.between += "stored" in fates
        self.unheard.clear()
        self.known = {row.sha256: row.receipt for row in found.submissions}

    def fate(self, upload: Upload, stored: AbstractSet[str]) -> str:
        """Say what became of an upload that was not acknowledged."""
        if upload.sha256 in self.known:
            return "stored before"
        return "stored" if upload.sha256 in stored else "absent"

    def check_counts(self, found: Stored) -> None:
        """Check that each row was counted once by the quota, and once by the audit log."""
        for team in {PEOPLE[who] for who in SENDERS}:
            left = [
                payload_in(row.receipt)["predicate"]["quota"]["remaining"]
                for row in found.submissions
                if row.team == team
            ]
            assert sorted(left, reverse=True) == [QUOTA - 1 - used for used in range(len(left))]
        recorded = [entry.subject for entry in found.audit if entry.action == "submitted"]
        assert sorted(recorded) == sorted(row.id for row in found.submissions)
        digests = [BEFORE_THE_FIRST, *(entry.digest for entry in found.audit)]
        assert [entry.previous for entry in found.audit] == digests[:-1]


@pytest.fixture
def lab(kind_of_database: str, folder: Path) -> Iterator[Lab]:
    """Return a server to be killed, on each kind of database."""
    if kind_of_database == "sqlite":
        yield Lab(folder, f"sqlite:///{folder}/server.db", None)
        return
    with running_postgresql() as running:
        yield Lab(folder, make_database(running, "killed"), running, excuse=NOT_REACHED)


@pytest.mark.slow
def test_no_kill_loses_an_upload_or_counts_it_twice(lab: Lab) -> None:
    kinds = [*AT_PAUSES, *AT_STEPS, *AT_ANY_MOMENT, *(OF_POSTGRESQL if lab.postgresql else ())]
    every = 1 if is_evidence() else 2
    kills = [kinds[number % len(kinds)] for number in range(0, amount(len(kinds)), every)]
    lab.calmly()
    for kill in kills:
        lab.disturb(kill)
    lab.calmly()
    assert faults(lab.folder) == []
    assert lab.fates["stored"] > 0 < lab.fates["absent"]
    assert lab.between >= len(kills) // BETWEEN_COMMIT_AND_REPLY
    tell(
        database=lab.database.partition(":")[0],
        kills=len(kills),
        killed=dict(Counter(map(str, kills))),
        between_commit_and_reply=lab.between,
        uploads=len(lab.uploads),
        replies=dict(lab.statuses),
        without_a_reply=dict(lab.fates),
    )


@pytest.mark.slow
def test_a_server_loses_nothing_when_what_scores_is_killed(folder: Path) -> None:
    lab = Lab(folder, f"sqlite:///{folder}/server.db", None, excuse=BUSY)
    kinds = [*STEPS_OF_SCORING, None, None]
    kills = amount(OF_SCORING * len(kinds)) // OF_SCORING
    steps = [kinds[number % len(kinds)] for number in range(kills)]
    lab.calmly()
    with serving(folder) as server:
        for step in steps:
            lab.disturb_scoring(server, step)
        assert server.process.poll() is None
    lab.calmly()
    assert faults(folder) == []
    assert lab.fates["stored"] == 0 < lab.statuses["503"]
    assert lab.statuses["none"] == 0
    tell(
        kills_of_a_scoring_process=kills,
        killed=dict(Counter(step or "at any moment" for step in steps)),
        uploads=len(lab.uploads),
        replies=dict(lab.statuses),
        with_503=dict(lab.fates),
    )


def _signed_scores(receipt: Mapping[str, Any]) -> Mapping[str, float]:
    """Return the scores on a receipt."""
    return {key: float(text) for key, text in payload_in(receipt)["predicate"]["scores"].items()}
