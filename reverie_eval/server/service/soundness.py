"""Damage that appears while a server runs: of its database, its files and its uploads."""

import logging
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session

from reverie_eval.files import is_private
from reverie_eval.ground_truth import Bundle
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.keys import current_key, file_of_key
from reverie_eval.server.service.receipts import Signer, load_key
from reverie_eval.server.settings import SETTINGS_FILE, Settings, load_settings
from reverie_eval.server.store.damage import find_damage, is_of_rows
from reverie_eval.server.store.database import AT_ONCE, Database, FileReplacedError
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.uploads import Uploads, UploadsError, stored_pieces
from reverie_eval.text import first_few

Result = TypeVar("Result")

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

_NEWEST = select(Submission.sha256, Submission.upload_deleted_at).order_by(
    Submission.received_at.desc()
)
_LOGGER = logging.getLogger("reverie_eval.server")


class UnsoundError(Exception):
    """Something that the server needs is damaged, missing or not what it was."""


def read_each(
    boards: Sequence[Board], read: Callable[[Sequence[Board]], Sequence[Result]]
) -> Sequence[Result | None]:
    """Read something of several leaderboards at once; None for each whose rows cannot be read.

    Only if there are such rows, each leaderboard is read on its own.
    """
    try:
        return read(boards)
    except Exception as error:
        if not is_of_rows(error):
            raise
        if len(boards) > 1:
            return [each for board in boards for each in read_each([board], read)]
        _LOGGER.warning("rows of %s cannot be read: %s", boards[0].label, type(error).__name__)
        return [None]


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


class FileWatch:
    """Reads files of the server's folder again when they have changed."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._seen: dict[Path, tuple[object, ...]] = {}

    def check_settings(self) -> None:
        """Raise an error if the server could not start with the settings as they are now."""
        folder = self._settings.folder
        self._once(folder / SETTINGS_FILE, (), lambda: load_settings(folder))

    def check_bundle(self, board: Board) -> None:
        """Raise an error if a split's ground truth is missing, or not the one that scores."""
        path, scoring = self._settings.path(board.split.bundle), board.truth.fingerprint

        def compare() -> None:
            if Bundle.load(path).header.fingerprint != scoring:
                raise UnsoundError(f"{path} is not the ground truth that this server scores with")
            if board.is_private and not is_private(path):
                raise UnsoundError(
                    f"others can read the solution in {path}; run `chmod 600 {path}`"
                )

        self._once(path, (scoring,), compare)

    def _once(self, path: Path, given: tuple[object, ...], check: Callable[[], object]) -> None:
        """Check a file, unless neither it nor what it is compared with has changed since."""
        status = path.stat()
        changes = status.st_ino, status.st_size, status.st_mtime_ns, status.st_mode, *given
        if self._seen.get(path) != changes:
            check()
            self._seen[path] = changes


def check_key(session: Session, settings: Settings, signer: Signer) -> None:
    """Check that a server signs with the key in use, and that its file is still there.

    Raises
    ------
    UnsoundError
        If another key is in use.
    ReceiptError
        If the file cannot be used.
    """
    current = current_key(session)
    if current is not None and current.key_id != signer.key_id:
        raise UnsoundError(
            f"this server signs with {signer.key_id}, which {current.key_id} has replaced; restart "
            "it"
        )
    load_key(file_of_key(settings.path(settings.signing_key), signer.key_id))


def try_newest(session: Session, uploads: Uploads) -> None:
    """Test whether the newest upload can be read: then the others are in their place, too.

    Raises UploadsError if not.
    """
    newest = session.execute(_NEWEST.limit(1)).first()
    if newest is not None and newest.upload_deleted_at is None:
        next(stored_pieces(uploads, newest.sha256))
