"""What a server was started with must still be there, and the same: settings, bundles, key."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.files import is_private
from reverie_eval.ground_truth import Bundle
from reverie_eval.server.audit.keys import current_key, file_of_key
from reverie_eval.server.audit.receipts import Signer, load_key
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import SETTINGS_FILE, Settings, load_settings
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.uploads import Uploads, stored_pieces
from reverie_eval.server.store.watches import UnsoundError

Result = TypeVar("Result")

_NEWEST = select(Submission.sha256, Submission.upload_deleted_at).order_by(
    Submission.received_at.desc()
)
_LOGGER = logging.getLogger("reverie_eval.server")


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
        path, scoring = self._settings.path(board.settings.bundle), board.truth.fingerprint

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
