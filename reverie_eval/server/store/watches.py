"""Damage that appears while a server runs, of its database and its uploads."""

import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress

from sqlalchemy import ColumnElement, select

from reverie_eval.server.store.damage import find_damage
from reverie_eval.server.store.database import AT_ONCE, Database, FileReplacedError
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.uploads import Uploads, UploadsError, stored_pieces
from reverie_eval.text import first_few

SECONDS_BETWEEN = 60
"""Seconds between two searches for damage, at least."""
_SHARE = 100
"""A search may take one in this many seconds: that of a million submissions takes half a minute."""

READING = 1.0
"""Seconds in which a search reads stored uploads, until the end of the last one."""
_BETWEEN_ROUNDS = 24 * 60 * 60
"""Seconds from the beginning of a round through all uploads to that of the next, at least."""
_MOST_DAMAGED = 20
"""Damaged uploads that each search reads again; with so many, it looks for no others."""


class UnsoundError(Exception):
    """Something that the server needs is damaged, missing or not what it was."""


class DatabaseWatch:
    """Looks for damage in the database, again and again, and remembers what it found."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._next = time.monotonic() + SECONDS_BETWEEN  # it was searched before the start
        self.found = ""
        """The damage that the last search found; empty if there is none."""

    def search(self) -> None:
        """Search the whole database, if it is time to, and its file is still there."""
        begun = time.monotonic()
        if begun < self._next:
            return
        with suppress(FileReplacedError):
            self._database.check_file()  # searching would create it
            self.found = first_few(find_damage(self._database.engine.url), 1)
        now = time.monotonic()
        self._next = now + max(SECONDS_BETWEEN, _SHARE * (now - begun))

    def hurry(self) -> None:
        """Let the next call of :meth:`search` search: a request has met damage."""
        self._next = 0

    def check(self) -> None:
        """Raise an error if the last search found damage, or the file is another one now.

        Raises UnsoundError or FileReplacedError.
        """
        if self.found:
            raise UnsoundError(self.found)
        self._database.check_file()


class UploadsWatch:
    """Reads all stored uploads, a few at a time, and remembers the damaged ones."""

    def __init__(self, database: Database, uploads: Uploads) -> None:
        self._database, self._uploads = database, uploads
        self._last = ""
        """The id of the submission whose upload was the last one to be read in this round."""
        self._next_round = 0.0
        self._suspects: Sequence[str] = ()
        """The ids of submissions whose uploads were damaged when they were last read."""
        self._found = ""

    def search(self) -> None:
        """Read the next uploads of a round, and again those that were damaged.

        Only what is damaged twice counts: a file may be deleted after its row was read.
        """
        begun = time.monotonic()
        damaged = self._damaged(self._rows(Submission.id.in_(self._suspects)))
        self._found = first_few([*damaged.values()], 1)
        if begun >= self._next_round and len(damaged) < _MOST_DAMAGED:
            damaged |= self._go_on(begun)
        self._suspects = [*damaged][:_MOST_DAMAGED]

    def check(self) -> None:
        """Raise UnsoundError if an upload is missing or damaged."""
        if self._found:
            raise UnsoundError(self._found)

    def _go_on(self, begun: float) -> Mapping[str, str]:
        """Read the next uploads of a round; return what is wrong with the damaged ones."""
        damaged: dict[str, str] = {}
        rows = self._rows(Submission.id > self._last)
        for row in rows:
            damaged |= self._damaged([row])
            self._last, _ = row
            if time.monotonic() >= begun + READING:
                return damaged
        if len(rows) < AT_ONCE:
            self._last, self._next_round = "", begun + _BETWEEN_ROUNDS
        return damaged

    def _rows(self, where: ColumnElement[bool]) -> Sequence[tuple[str, str]]:
        """Return id and SHA-256 of submissions whose uploads are kept, in the order of ids."""
        kept = select(Submission.id, Submission.sha256).where(
            Submission.upload_deleted_at.is_(None), where
        )
        with self._database.reading() as session:
            rows = session.execute(kept.order_by(Submission.id).limit(AT_ONCE))
            return [(name, sha256) for name, sha256 in rows]

    def _damaged(self, rows: Iterable[tuple[str, str]]) -> dict[str, str]:
        """Read uploads; return what is wrong with each that is damaged, by submission."""
        damaged = {}
        for name, sha256 in rows:
            try:
                for _ in stored_pieces(self._uploads, sha256):
                    pass
            except UploadsError as error:
                damaged[name] = str(error)
        return damaged
