"""Damage that appears while a server runs: of its database, its files and its uploads."""

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.files import is_private
from reverie_eval.ground_truth import Bundle
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.keys import current_key, file_of_key
from reverie_eval.server.service.receipts import Signer, load_key
from reverie_eval.server.settings import SETTINGS_FILE, Settings, load_settings
from reverie_eval.server.store.damage import find_damage, is_of_rows
from reverie_eval.server.store.database import Database, FileReplacedError
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.uploads import Uploads, stored_pieces
from reverie_eval.text import first_few

Result = TypeVar("Result")

SECONDS_BETWEEN = 60
"""Seconds between two searches for damage, at least."""
_SHARE = 100
"""A search may take one in this many seconds: that of a million submissions takes half a minute."""

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
                raise UnsoundError(f"others can read the answers in {path}; run `chmod 600 {path}`")

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
