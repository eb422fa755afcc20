"""Backups: a server's folder, database and uploads in one archive, also while the server runs.

::

    reverie-eval.toml, signing-key.pem, bundles/...    unchanged
    database.jsonl        all rows at one moment, for any database
    uploads/SHA-256.json  every upload that a row refers to, unpacked
    manifest.json         the contents of the archive, with their SHA-256

An upload is stored before the row that refers to it, and never changed or deleted. So every upload
that the rows of one moment refer to can still be read later. A correction replaces ground truth and
rows, so if there is one meanwhile, both are read again; if it was killed at its end, the new ground
truth is in the archive where it waits, and the restored server finishes the correction.
"""

import hashlib
import io
import json
import os
import tarfile
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from datetime import datetime
from gzip import BadGzipFile
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryFile
from typing import IO, Any, NamedTuple, TypeAlias

from pydantic import BaseModel, ConfigDict

from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import naming
from reverie_eval.ground_truth import bundle_name
from reverie_eval.server.audit.signing import file_of_key
from reverie_eval.server.audit.transactions import utc_now
from reverie_eval.server.opening import check_known, database_errors
from reverie_eval.server.operations.folder import SIGNING_KEY
from reverie_eval.server.scoring.boards import waiting_beside
from reverie_eval.server.settings import SETTINGS_FILE, Settings, load_settings
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.dump import dump
from reverie_eval.server.store.uploads import Uploads, open_uploads
from reverie_eval.version import __version__

DATABASE = "database.jsonl"
MANIFEST = "manifest.json"
UPLOADS = "uploads/"
FORMAT = 1
KEY_SETTING = "signing_key"
_GONE = {"person": "deleted_at", "team": "merged_at"}
"""The column of a table that says since when a row only keeps what happened."""
_LEVEL = 6
"""The usual level of gzip. At 9, as of tarfile, submissions take 2.5 times as long for 2 % less."""


class Manifest(BaseModel):
    """The contents of an archive."""

    model_config = ConfigDict(frozen=True)

    format: int
    version: str
    """The version of reverie-eval."""
    made_at: datetime
    """When the rows were read."""
    revision: str
    """The migration of the database."""
    rows: dict[str, int]
    """The number of rows of each table that has any."""
    gone: dict[str, int] = {}
    """How many of them are people who were deleted, and teams that were merged, by table."""
    lacking: tuple[str, ...]
    """The SHA-256 of uploads that were missing or damaged."""
    files: dict[str, str]
    """The name in the archive of each file that the settings name, by setting."""
    sha256: dict[str, str]
    """The SHA-256 of every other file in the archive."""


@dataclass(frozen=True, slots=True)
class BackupReport:
    """A backup that was written."""

    manifest: Manifest
    size: int
    """Bytes of the archive."""
    moved: Mapping[str, str]
    """Where a restore puts files that are outside the server's folder, by their setting."""


def write_backup(
    folder: Path, output: Path, check: Callable[[Path], None] | None = None
) -> BackupReport:
    """Write a backup; the server may be running.

    ``check`` is called with the complete archive before it takes its place; if it raises an error,
    a former backup stays there.

    Raises
    ------
    ReverieEvalError
        If the archive would be in the server's folder, overwrite a file of the server, or be in a
        folder that does not exist; if the database is empty or was made by a later version; or if
        the server's signing key is missing, or was rotated while the backup was made.
    """
    settings = load_settings(folder)
    if output.resolve().is_relative_to(settings.folder):
        raise ReverieEvalError(f"{output} is in the server's folder; write the backup elsewhere")
    if output.resolve() in {path.resolve() for _, path in _files(settings).values()}:
        raise ReverieEvalError(f"{output} is a file of the server; write the backup elsewhere")
    if output.is_dir() or not output.parent.is_dir():
        raise ReverieEvalError(f"{output} cannot be written; name a file in an existing folder")
    # Files of NamedTemporaryFile are private: the archive contains solutions and the signing key.
    with (
        naming(output, output),
        NamedTemporaryFile(dir=output.parent, prefix=f".{output.name}-", delete=False) as file,
    ):
        try:
            with tarfile.open(fileobj=file, mode="w:gz", compresslevel=_LEVEL) as archive:
                manifest = _write(settings, archive, output.parent)
            file.flush()
            os.fsync(file.fileno())
            if check is not None:
                check(Path(file.name))
            Path(file.name).replace(output)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise
    return BackupReport(manifest, output.stat().st_size, _moved(settings))


def _write(settings: Settings, archive: tarfile.TarFile, place: Path) -> Manifest:
    contents = _Contents(archive)
    contents.add(SETTINGS_FILE, (settings.folder / SETTINGS_FILE).read_bytes())
    with TemporaryFile(dir=place) as lines:
        dumped, bundles = dump_with_bundles(settings, lines)
        contents.add_file(DATABASE, lines)
    for name, content in bundles.values():
        contents.add(name, content)
    key_name, key_path = _files(settings)[KEY_SETTING]
    contents.add(key_name, file_of_key(key_path, dumped.key_id).read_bytes())
    uploads = open_uploads(settings.uploads, settings.folder)
    lacking = tuple(
        name for name in sorted(dumped.uploads) if not contents.add_upload(uploads, name)
    )
    manifest = Manifest(
        format=FORMAT,
        version=__version__,
        made_at=dumped.made_at,
        revision=dumped.revision,
        rows=dumped.counts,
        gone=dumped.gone,
        lacking=lacking,
        files={KEY_SETTING: key_name, **{key: name for key, (name, _) in bundles.items()}},
        sha256=contents.digests,
    )
    contents.add(MANIFEST, manifest.model_dump_json(indent=2).encode())
    return manifest


class Dumped(NamedTuple):
    """What is known of rows that were read at one moment."""

    made_at: datetime
    revision: str
    """The migration."""
    key_id: str | None
    """The signing key in use, if any."""
    uploads: Collection[str]
    """The SHA-256 of those that rows refer to."""
    counts: Mapping[str, int]
    """The number of rows, by table."""
    gone: Mapping[str, int]
    """The number of rows of deleted people and merged teams, by table."""


Bundles: TypeAlias = Mapping[str, tuple[str, bytes]]
"""The name in a backup and the content of each bundle, also of those that wait, by setting."""


def dump_with_bundles(settings: Settings, lines: IO[bytes]) -> tuple[Dumped, Bundles]:
    """Write all rows of one moment as lines of JSON, and return the bundles that belong to them.

    Raises ReverieEvalError if the database is empty or was made by a later version.
    """
    while True:
        bundles = _bundles(settings)
        dumped = _dump(settings, lines)
        if _bundles(settings) == bundles:
            return dumped, bundles


def _dump(settings: Settings, lines: IO[bytes]) -> Dumped:
    """Write all rows as lines of JSON, in place of what is in the file."""
    lines.seek(0)
    lines.truncate()
    made_at, key_id = utc_now(), None
    uploads: set[str] = set()
    counts: Counter[str] = Counter()
    gone: Counter[str] = Counter()
    url = settings.database_url
    with database_errors(url), closing(Database(url)) as database:
        revision = check_known(database)
        if revision is None:
            raise ReverieEvalError(
                f"there is no database; run `reverie-eval server doctor --quick {settings.folder}`"
            )
        for table, columns in dump(database):
            counts[table] += 1
            gone[table] += table in _GONE and columns[_GONE[table]] is not None
            if table == "submission" and columns["upload_deleted_at"] is None:
                uploads.add(columns["sha256"])
            elif table == "signing_key" and columns["replaced_at"] is None:
                key_id = columns["key_id"]
            lines.write(f"{json.dumps([table, columns])}\n".encode())
    return Dumped(made_at, revision, key_id, uploads, counts, +gone)


def _bundles(settings: Settings) -> Bundles:
    found = {}
    for setting, (name, path) in _files(settings).items():
        if setting == KEY_SETTING:
            continue
        # First the one that waits: it may be moved to its place meanwhile.
        with suppress(FileNotFoundError):
            waiting = waiting_beside(path).read_bytes()
            found[f"{setting}.next"] = waiting_beside(Path(name)).as_posix(), waiting
        found[setting] = name, path.read_bytes()
    return found


class _Contents:
    """Adds files to an archive and records their digests."""

    def __init__(self, archive: tarfile.TarFile) -> None:
        self._archive = archive
        self.digests: dict[str, str] = {}

    def add(self, name: str, content: bytes) -> None:
        self.add_file(name, io.BytesIO(content))

    def add_file(self, name: str, file: io.BufferedIOBase) -> None:
        """Add all of a file."""
        member = tarfile.TarInfo(name)
        member.size, member.mode = file.seek(0, io.SEEK_END), 0o600
        file.seek(0)
        digest = hashlib.file_digest(file, "sha256")
        file.seek(0)
        self._archive.addfile(member, file)
        self.digests[name] = digest.hexdigest()

    def add_upload(self, uploads: Uploads, sha256: str) -> bool:
        """Add an upload and return True; return False if it is missing or damaged."""
        try:
            content = uploads.get(sha256)
        except (FileNotFoundError, BadGzipFile):
            return False
        is_whole = hashlib.sha256(content).hexdigest() == sha256
        if is_whole:
            self.add(f"{UPLOADS}{sha256}.json", content)
        return is_whole


def _files(settings: Settings) -> Mapping[str, tuple[str, Path]]:
    """Return the files that the settings name, as name in the archive and path, by setting."""
    bundles: dict[str, Any] = {
        f"splits.{name}.bundle": (split.bundle, f"bundles/{bundle_name(name, public=False)}")
        for name, split in settings.splits.items()
    }
    named = {KEY_SETTING: (settings.signing_key, SIGNING_KEY), **bundles}
    taken = {_name(settings, path) for path, _ in named.values()}
    files = {}
    for setting, (path, otherwise) in named.items():
        name = _name(settings, path)
        if name is None:
            name = otherwise
            while name in taken:
                name = f"{name.removesuffix('.npz')}-2.npz"
            taken.add(name)
        files[setting] = name, settings.path(path)
    return files


def _name(settings: Settings, path: Path) -> str | None:
    """Return a file's path relative to the server's folder; None if it is outside."""
    place = Path(os.path.normpath(settings.path(path)))
    if not place.is_relative_to(settings.folder):
        return None
    return place.relative_to(settings.folder).as_posix()


def _moved(settings: Settings) -> Mapping[str, str]:
    return {
        setting: name
        for setting, (name, path) in _files(settings).items()
        if _name(settings, path) is None
    }
