"""Restoring a backup: after a loss, on another machine, or into another database."""

import hashlib
import json
import tarfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from gzip import BadGzipFile
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from reverie_eval.errors import Problem, RejectedError
from reverie_eval.server.operations.backup import (
    DATABASE,
    FORMAT,
    MANIFEST,
    UPLOADS,
    Manifest,
    restored,
)
from reverie_eval.server.operations.checks import database_errors
from reverie_eval.server.operations.folder import building, check_empty, make_private
from reverie_eval.server.settings import Settings, load_settings
from reverie_eval.server.store.database import Database, known_revisions
from reverie_eval.server.store.dump import Row, RowsError, load
from reverie_eval.server.store.uploads import open_uploads

_CHUNK = 1 << 20
_NOT_WHOLE = (tarfile.TarError, BadGzipFile, EOFError, zlib.error, ValueError)
"""Errors of reading a file that is truncated, damaged or not an archive."""


class BackupError(RejectedError):
    """An archive is not a complete backup, or was made by a later version."""

    subject = "backup"


@contextmanager
def unpacked(archive: Path) -> Iterator[tuple[Settings, Manifest, Iterator[Row]]]:
    """Unpack a backup temporarily; yield its settings, its manifest and its rows.

    Raises
    ------
    BackupError
        If the archive is damaged or of a later version.
    """
    with archive.open("rb"), TemporaryDirectory(prefix="reverie-eval-") as temporary:
        folder, extras = Path(temporary, "folder"), Path(temporary, "extras")
        manifest = _unpack(archive, folder, extras)
        with (extras / DATABASE).open(encoding="utf-8") as lines:
            yield restored(load_settings(folder)), manifest, map(json.loads, lines)


def restore_backup(archive: Path, folder: Path) -> Manifest:
    """Restore a backup into an empty folder and the empty database that its settings name.

    Raises
    ------
    BackupError
        If the archive is damaged or of a later version.
    FolderTakenError, DatabaseTakenError
        If the folder or the database is not empty.
    """
    with archive.open("rb"), building(folder) as aside:
        with TemporaryDirectory(dir=aside.parent, prefix=f"{aside.name}-") as temporary:
            extras = Path(temporary)
            manifest = _unpack(archive, aside, extras)
            settings = load_settings(aside)
            with database_errors():
                check_empty(settings)
                _keep_uploads(settings, extras / UPLOADS)
                _load(settings, manifest, extras / DATABASE)
        return manifest


def _keep_uploads(settings: Settings, folder: Path) -> None:
    """Store the uploads; if loading the database fails later, storing them again is harmless."""
    uploads = open_uploads(settings.uploads, settings.folder)
    for file in sorted(folder.glob("*.json")):
        uploads.put(file.stem, file.read_bytes())


def _load(settings: Settings, manifest: Manifest, file: Path) -> None:
    with closing(Database(settings.database_url)) as database:
        make_private(database)
        with file.open(encoding="utf-8") as lines:
            try:
                load(database, manifest.revision, map(json.loads, lines))
            except RowsError as error:
                message = f"its rows cannot be restored ({error}); use another backup"
                raise BackupError([Problem("unusable-rows", DATABASE, message)]) from None


def _unpack(archive: Path, aside: Path, extras: Path) -> Manifest:
    """Unpack an archive, check that it is complete, and return its manifest."""
    digests: dict[str, str] = {}
    try:
        with tarfile.open(archive, "r:gz") as members:
            for member in members:
                is_extra = member.name in (DATABASE, MANIFEST) or member.name.startswith(UPLOADS)
                target = (extras if is_extra else aside) / _safe(member)
                digests[member.name] = _extract(members, member, target)
        manifest = _manifest(archive, extras / MANIFEST)
    except _NOT_WHOLE as error:
        message = f"is not a complete backup ({error}); use another"
        raise BackupError([Problem("not-whole", str(archive), message)]) from None
    problems = list(_problems(manifest, digests))
    if problems:
        raise BackupError(problems)
    return manifest


def _manifest(archive: Path, file: Path) -> Manifest:
    """Read the manifest; that of a later version may have other fields."""
    try:
        written = json.loads(file.read_bytes())
        if written["format"] == FORMAT and written["revision"] in known_revisions():
            return Manifest.model_validate(written)
        version = written["version"]
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        raise tarfile.ReadError(f"there is no valid {MANIFEST} at its end") from None
    message = f"was made by reverie-eval {version}; install that version or a later one"
    raise BackupError([Problem("later-version", str(archive), message)])


def _safe(member: tarfile.TarInfo) -> PurePosixPath:
    """Return where to put a member: always below the folder, even if the archive is malicious."""
    path = PurePosixPath(member.name)
    if not member.isfile() or path.is_absolute() or ".." in path.parts:
        raise tarfile.TarError(f"{member.name!r} does not belong in one")
    return path


def _extract(members: tarfile.TarFile, member: tarfile.TarInfo, target: Path) -> str:
    """Write a member to a file that other users cannot read, and return its SHA-256."""
    target.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    target.touch(mode=0o600)
    digest = hashlib.sha256()
    content = members.extractfile(member)
    with target.open("wb") as file:
        while content is not None and (chunk := content.read(_CHUNK)):
            digest.update(chunk)
            file.write(chunk)
    return digest.hexdigest()


def _problems(manifest: Manifest, digests: Mapping[str, str]) -> Iterator[Problem]:
    for name in sorted({*manifest.sha256, *digests} - {MANIFEST}):
        if digests.get(name) != manifest.sha256.get(name):
            found = "is missing" if name not in digests else "differs from what was backed up"
            yield Problem("damaged-backup", name, f"{found}; use another backup")
