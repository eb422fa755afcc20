"""What the worker processes of one server share, and what is divided among them.

Requests are counted in one file, so rate limits hold for the whole server, whichever worker
answers. Slots for uploads and places in the queue are divided, because sharing them would need a
queue in a process of its own. Quotas are in the database, and metrics in the files of
prometheus_client's multiprocess mode.
"""

import sqlite3
import time
import weakref
from dataclasses import dataclass
from pathlib import Path

from limits.storage import MemoryStorage, Storage

_FILE = "requests.sqlite"
"""Not ``.db``: prometheus_client reads all files of the folder that end in this."""
SECONDS_TO_COUNT = 10
"""Time that a worker may wait while others count; each takes some microseconds."""


@dataclass(frozen=True, slots=True)
class Workers:
    """The worker processes of a server."""

    number: int = 1
    folder: Path | None = None
    """Where they count together; None for a single process, which counts in memory."""

    def share(self, total: int) -> int:
        """Return a worker's part of slots or places that are divided: at least one, if any."""
        return min(total, max(1, total // self.number))

    def counts(self) -> Storage:
        """Return the storage in which requests are counted."""
        return MemoryStorage() if self.folder is None else FileCounts(self.folder / _FILE)


ALONE = Workers()
"""A server that is a single process."""


class FileCounts(Storage):
    """Counts of requests in an SQLite file, for a few processes on one machine.

    SQLite's locks end with the process that holds them, so a worker that is killed stops no other.
    The file lives as long as the server, so nothing is flushed to the disk.
    """

    STORAGE_SCHEME = None

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._database = sqlite3.connect(
            file, timeout=SECONDS_TO_COUNT, isolation_level=None, check_same_thread=False
        )
        self._database.executescript(
            """
            PRAGMA journal_mode = WAL;
            PRAGMA synchronous = OFF;
            CREATE TABLE IF NOT EXISTS counted (
                key TEXT PRIMARY KEY, number INTEGER NOT NULL, until REAL NOT NULL
            ) WITHOUT ROWID;
            CREATE INDEX IF NOT EXISTS by_end ON counted (until);
            """
        )
        weakref.finalize(self, self._database.close)  # limits never closes a storage

    @property
    def base_exceptions(self) -> type[Exception]:
        """The errors of this storage."""
        return sqlite3.Error

    def incr(self, key: str, expiry: int, amount: int = 1) -> int:
        """Count a request; the first one begins a window of this many seconds."""
        now = time.time()
        ((number,),) = self._database.execute(
            """
            INSERT INTO counted VALUES (:key, :amount, :until)
            ON CONFLICT (key) DO UPDATE SET
                number = iif(until > :now, number, 0) + :amount,
                until = iif(until > :now, until, :until)
            RETURNING number
            """,
            {"key": key, "amount": amount, "until": now + expiry, "now": now},
        ).fetchall()
        if number == amount:
            self._database.execute("DELETE FROM counted WHERE until <= ?", [now])
        return int(number)

    def get(self, key: str) -> int:
        """Return the requests counted in the current window."""
        return int(self._current(key)[0])

    def get_expiry(self, key: str) -> float:
        """Return when the current window ends, in seconds since the epoch; now if none is open."""
        return float(self._current(key)[1])

    def check(self) -> bool:
        """Whether the file can be used."""
        return bool(self._database.execute("SELECT 1").fetchone())

    def reset(self) -> int:
        """Forget all counts, and return how many there were."""
        return self._database.execute("DELETE FROM counted").rowcount

    def clear(self, key: str) -> None:
        """Forget the count of a key."""
        self._database.execute("DELETE FROM counted WHERE key = ?", [key])

    def _current(self, key: str) -> tuple[int, float]:
        now = time.time()
        chosen = "SELECT number, until FROM counted WHERE key = ? AND until > ?"
        found: tuple[int, float] | None = self._database.execute(chosen, [key, now]).fetchone()
        return found or (0, now)
