"""All submissions to a split as one tar archive, for the organiser.

Its first member, ``metadata.csv``, has a row per submission; the others are the submitted files,
unpacked, named by the submission's id, unless they were deleted because of their age. The archive
is written piece by piece, and its length is known before it begins: a download that is cut short
ends with an error, because bytes are missing.
"""

import csv
import io
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import TextIO, cast

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.schemas.service import Method
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.csv_files import spreadsheet_cell
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.store.database import AT_ONCE
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.uploads import PIECE, Uploads, stored_pieces

METADATA = "metadata.csv"
_FILE = ("file", "sha256", "size")
_ABOUT = ("id", "team", "person", "received_at", "status", "published_at", "withdrawn_at")
_END = bytes(2 * tarfile.BLOCKSIZE)


@dataclass(frozen=True, slots=True)
class Archive:
    """A tar archive that is written while it is read."""

    length: int
    """Bytes of the archive."""
    files: int
    """The number of submissions, including those whose files were deleted."""
    metadata: TextIO
    """The first member, which also lists the others; closed at the end."""
    uploads: Uploads

    def pieces(self) -> Iterator[bytes]:
        """Return the archive in pieces.

        Raises
        ------
        UploadsError
            If an upload is missing or damaged; the archive then is incomplete.
        """
        with self.metadata as file:
            size = file.seek(0, io.SEEK_END)
            file.seek(0)
            yield _header(METADATA, size)
            while piece := file.buffer.read(PIECE):
                yield piece
            yield _padding(size)
            file.seek(0)
            for row in csv.DictReader(file):
                if row["file"]:
                    yield _header(row["file"], int(row["size"]))
                    yield from self._upload(row["sha256"], int(row["size"]))
                    yield _padding(int(row["size"]))
            yield _END

    def _upload(self, sha256: str, size: int) -> Iterator[bytes]:
        """Yield an upload, but never more than there is room for in the archive."""
        length = 0
        for piece in stored_pieces(self.uploads, sha256):
            length += len(piece)
            if length <= size:
                yield piece


def archive_of(session: Session, board: Board, uploads: Uploads, view: View) -> Archive:
    """Return an archive of all submissions to a split, the earliest first.

    Scores that are held back are left out.
    """
    chosen = (
        select(Submission)
        .where(Submission.split == board.split)
        .order_by(Submission.received_at, Submission.id)
        .execution_options(yield_per=AT_ONCE)
    )
    metadata = cast(
        "TextIO",
        TemporaryFile("w+", encoding="utf-8", newline=""),  # noqa: SIM115  # closed later
    )
    writer = csv.writer(metadata, lineterminator="\n")
    writer.writerow([*_FILE, *_ABOUT, *Method.model_fields, "signature", *board.task.metrics])
    length, files = 0, 0
    for row in session.scalars(chosen):
        report = view.report(row)
        has_file = row.upload_deleted_at is None
        about = report.model_dump(mode="json", include=set(_ABOUT))
        method = report.method.model_dump(mode="json")
        words = [
            *(f"{row.id}.json" if has_file else "", row.sha256, row.size),
            *(about[name] for name in _ABOUT),
            *(method[name] for name in Method.model_fields),
            report.report.signature,
        ]
        scores = [report.report.scores.get(key) for key in board.task.metrics]
        writer.writerow([*map(spreadsheet_cell, words), *scores])
        length += _length(row.size) if has_file else 0
        files += 1
        session.expunge(row)
    length += _length(metadata.tell()) + len(_END)
    return Archive(length, files, metadata, uploads)


def _header(name: str, size: int) -> bytes:
    member = tarfile.TarInfo(name)
    member.size = size
    member.mode = 0o600
    return member.tobuf(tarfile.USTAR_FORMAT)


def _padding(size: int) -> bytes:
    return bytes(-size % tarfile.BLOCKSIZE)


def _length(size: int) -> int:
    """Return how many bytes a member of the archive takes."""
    return tarfile.BLOCKSIZE + size + len(_padding(size))
