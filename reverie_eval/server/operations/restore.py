"""Restoring a backup: after a loss, on another machine, into another database, or for an export.

The settings in an archive are another machine's, or anybody's. So what they name outside the folder
is not used: a restore writes to its folder, or to the database and the store that the environment
variables of the caller name.
"""

import errno
import hashlib
import json
import posixpath
import re
import tarfile
import tomllib
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from gzip import BadGzipFile
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

from sqlalchemy import make_url
from sqlalchemy.exc import ArgumentError

from reverie_eval.errors import Problem, RejectedError, ReverieEvalError
from reverie_eval.server.boards.leaderboard import Rankings
from reverie_eval.server.opening import database_errors, open_server, opened_server
from reverie_eval.server.operations.backup import (
    DATABASE,
    FORMAT,
    KEY_SETTING,
    MANIFEST,
    UPLOADS,
    Manifest,
    dump_with_bundles,
)
from reverie_eval.server.operations.folder import building, check_empty, make_private
from reverie_eval.server.settings import SETTINGS_FILE, Settings, load_settings
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.database import Database, known_revisions
from reverie_eval.server.store.dump import Row, RowsError, load
from reverie_eval.server.store.uploads import open_uploads

_CHUNK = 1 << 20
_UNLIMITED = 1 << 31
"""Requests per minute to a copy, to which nobody else has access."""
_SQLITE = "sqlite:///"
_OWN = {"database": f"{_SQLITE}server.db", "uploads": "uploads"}
"""Settings for a database and uploads in the folder."""
_UPLOAD = re.compile(rf"{UPLOADS}([0-9a-f]{{64}})\.json")
_TOML_STRING = r"""(?:'[^'\n]*'|"(?:\\.|[^"\\\n])*")"""
_NO_SUCH_NAME = {errno.EEXIST, errno.EISDIR, errno.ENAMETOOLONG, errno.ENOTDIR}
"""Errors of a name that is too long, or of a file and a folder with one name."""
_NOT_WHOLE = (tarfile.TarError, BadGzipFile, EOFError, zlib.error, ValueError)
"""Errors of reading a file that is truncated, damaged or not an archive."""


class BackupError(RejectedError):
    """An archive is not a complete backup, cannot be restored, or was made by a later version."""

    subject = "backup"


@dataclass(frozen=True, slots=True)
class ChangedPlace:
    """A setting in an archive that named a place outside the folder."""

    setting: str
    before: str
    """Without a password."""
    after: str
    variable: str | None
    """The environment variable that restores to another place; None for a file of the archive."""


@dataclass(frozen=True, slots=True)
class RestoreReport:
    """A backup that was restored."""

    manifest: Manifest
    changed: Sequence[ChangedPlace]


@contextmanager
def unpacked(
    archive: Path, place: Path | None = None
) -> Iterator[tuple[Settings, Manifest, Iterator[Row]]]:
    """Unpack a backup temporarily; yield its settings, its manifest and its rows.

    Its uploads are in the folder of the settings; its rows are in no database yet. The temporary
    folder is in ``place``, or where the system has such folders.

    Raises
    ------
    BackupError
        If the archive is damaged or of a later version.
    """
    with archive.open("rb"), TemporaryDirectory(prefix="reverie-eval-", dir=place) as temporary:
        folder, extras = Path(temporary, "folder"), Path(temporary, "extras")
        manifest = _unpack(archive, folder, extras)
        settings = _of_archive(load_settings(folder), manifest).model_copy(update=_OWN)
        _keep_uploads(settings, extras / UPLOADS)
        with (extras / DATABASE).open(encoding="utf-8") as lines:
            yield settings, manifest, map(json.loads, lines)


@contextmanager
def copied_server(source: Path) -> Iterator[ServerState]:
    """Open a copy of a server, from its folder or a backup, with its ground truth of that moment.

    The rows are in a database of its own, and its clock stands still. The server may be running.

    Raises
    ------
    BackupError, SettingsError, ReceiptError
        If the source cannot be opened.
    """
    with (
        TemporaryDirectory(prefix="reverie-eval-") as folder,
        _opened(source, Path(folder)) as (original, made_at, revision, rows),
    ):
        limits = original.limits.model_copy(update={"requests_per_minute": _UNLIMITED})
        own = {"database": f"sqlite:///{folder}/server.db", "limits": limits}
        settings = original.model_copy(update=own)
        with database_errors(), closing(Database(settings.database_url)) as database:
            load(database, revision, rows)
        moment = made_at.replace(microsecond=0)
        state = open_server(settings, lambda: moment)
        with closing(state.database):
            yield state


@contextmanager
def _opened(source: Path, place: Path) -> Iterator[tuple[Settings, datetime, str, Iterator[Row]]]:
    """Yield the settings, the time, the migration and the rows of a folder or a backup.

    A correction may replace the ground truth in the folder meanwhile, so a copy of it is put into
    ``place``.
    """
    if not source.is_dir():
        with unpacked(source) as (settings, manifest, rows):
            yield settings, manifest.made_at, manifest.revision, rows
        return
    settings = load_settings(source)
    with TemporaryFile(dir=place) as lines:
        dumped, bundles = dump_with_bundles(settings, lines)
        for name, content in bundles.values():
            file = place / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.touch(mode=0o600)
            file.write_bytes(content)
        splits = {
            name: split.model_copy(update={"bundle": place / bundles[f"splits.{name}.bundle"][0]})
            for name, split in settings.splits.items()
        }
        lines.seek(0)
        copied = settings.model_copy(update={"splits": splits})
        yield copied, dumped.made_at, dumped.revision, map(json.loads, lines)


def restore_backup(archive: Path, folder: Path) -> RestoreReport:
    """Restore a backup into an empty folder.

    The database and the uploads are in the folder too, unless ``REVERIE_EVAL_DATABASE`` names an
    empty database, or ``REVERIE_EVAL_UPLOADS`` a store.

    Raises
    ------
    BackupError
        If the archive is damaged or of a later version, or its rows cannot be stored.
    FolderTakenError, DatabaseTakenError
        If the folder or the database is not empty.
    """
    with archive.open("rb"), building(folder) as aside:
        with TemporaryDirectory(dir=aside.parent, prefix=f"{aside.name}-") as temporary:
            extras = Path(temporary)
            manifest = _unpack(archive, aside, extras)
            load_settings(aside)  # before they are changed: it reports whatever is wrong
            changed = _keep_inside(aside, manifest)
            _fill(load_settings(aside), manifest, extras)
        return RestoreReport(manifest, changed)


def verify_backup(archive: Path) -> None:
    """Restore a backup to a temporary folder beside it, and compute all leaderboards there.

    All rows and uploads are read again and compared. Environment variables that name a database or
    a store are ignored.

    Raises
    ------
    BackupError
        If the backup cannot be restored, or the server in it cannot be opened.
    """
    try:
        with unpacked(archive, archive.parent) as (settings, manifest, rows):
            with database_errors():
                _load(settings, manifest, rows)
            with opened_server(settings) as state, state.database.reading() as session:
                for board in state.all_boards:
                    state.get(Rankings).ranking(session, board)
    except BackupError:
        raise
    except ReverieEvalError as error:
        raise BackupError([Problem("not-restorable", "server", str(error))]) from None


def _of_archive(settings: Settings, manifest: Manifest) -> Settings:
    """Return settings with the files of the archive, whatever they or variables name."""
    splits = {
        name: split.model_copy(update={"bundle": Path(manifest.files[f"splits.{name}.bundle"])})
        for name, split in settings.splits.items()
        if f"splits.{name}.bundle" in manifest.files
    }
    own = {KEY_SETTING: Path(manifest.files[KEY_SETTING]), "splits": splits}
    return settings.model_copy(update=own)


def _keep_inside(folder: Path, manifest: Manifest) -> Sequence[ChangedPlace]:
    """Let the settings in a folder name no place outside, and return what was changed."""
    file = folder / SETTINGS_FILE
    text = file.read_bytes().decode()
    content = tomllib.loads(text)
    changed = []
    for key, own in _own_places(content, manifest):
        place, setting = _value(content, key), ".".join(key)
        if place is not None and place != own:
            text = _with_value(text, key, own)
            variable = f"REVERIE_EVAL_{setting.upper()}" if setting in _OWN else None
            changed.append(ChangedPlace(setting, _without_password(place), own, variable))
    file.write_bytes(text.encode())
    return changed


def _own_places(
    content: Mapping[str, Any], manifest: Manifest
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield all settings that name a place, with one in the folder."""
    for setting, own in _OWN.items():
        place = str(content.get(setting, own))
        is_own = _is_inside(place.removeprefix(_SQLITE if setting == "database" else ""))
        yield (setting,), place if is_own else own
    splits = content.get("splits")
    names = splits if isinstance(splits, dict) else ()
    for key in [(KEY_SETTING,), *(("splits", name, "bundle") for name in names)]:
        setting, place = ".".join(key), _value(content, key)
        if setting not in manifest.files:
            message = "is not in the backup; use another"
            raise BackupError([Problem("damaged-backup", setting, message)])
        own = manifest.files[setting]
        yield key, place if posixpath.normpath(str(place)) == own else own


def _is_inside(path: str) -> bool:
    """Whether a path, not the address of a database or a store, is below the folder."""
    first, *_ = PurePosixPath(posixpath.normpath(path)).parts or (".",)
    return "://" not in path and first not in ("/", "//", "..")


def _value(content: Mapping[str, Any], key: Sequence[str]) -> Any:
    """Return the value of a setting; None if it is not set."""
    value: Any = content
    for part in key:
        value = value.get(part) if isinstance(value, dict) else None
    return value


def _with_value(text: str, key: Sequence[str], value: str) -> str:
    """Return the text of settings with another value of one, and everything else as it is."""
    expected = tomllib.loads(text)
    _value(expected, key[:-1])[key[-1]] = value
    for written in re.finditer(rf"{re.escape(key[-1])}[\"']?\s*=\s*({_TOML_STRING})", text):
        before, after = text[: written.start(1)], text[written.end(1) :]
        changed = f"{before}{json.dumps(value, ensure_ascii=False)}{after}"
        with suppress(tomllib.TOMLDecodeError):
            if tomllib.loads(changed) == expected:
                return changed
    message = f'names a place outside the folder, and is not written as {key[-1]} = "..."'
    raise BackupError([Problem("outside", ".".join(key), message)])


def _without_password(place: object) -> str:
    """Return a place, or the address of a database as it may be shown."""
    try:
        return make_url(str(place)).set(query={}).render_as_string()
    except (ArgumentError, ValueError):
        return str(place)


def _fill(settings: Settings, manifest: Manifest, extras: Path) -> None:
    """Store the uploads and the rows of an archive.

    If loading the rows fails, storing the uploads again later is harmless.
    """
    with database_errors():
        check_empty(settings)
        _keep_uploads(settings, extras / UPLOADS)
        with (extras / DATABASE).open(encoding="utf-8") as lines:
            _load(settings, manifest, map(json.loads, lines))


def _keep_uploads(settings: Settings, folder: Path) -> None:
    uploads = open_uploads(settings.uploads, settings.folder)
    for file in sorted(folder.glob("*.json")):
        uploads.put(file.stem, file.read_bytes())
        if hashlib.sha256(uploads.get(file.stem)).hexdigest() != file.stem:
            message = "was not stored as it is in the backup; check the disk or the store"
            raise BackupError([Problem("altered-upload", f"{UPLOADS}{file.name}", message)])


def _load(settings: Settings, manifest: Manifest, rows: Iterator[Row]) -> None:
    with closing(Database(settings.database_url)) as database:
        if database.is_sqlite:
            folder = Path(str(database.engine.url.database)).parent
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        make_private(database)
        try:
            load(database, manifest.revision, rows)
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
    is_plain = member.name.isprintable() and path.as_posix() == member.name
    if not (member.isfile() and is_plain and _is_inside(member.name)) or ".." in path.parts:
        raise _foreign(member)
    return path


def _foreign(member: tarfile.TarInfo) -> tarfile.TarError:
    return tarfile.TarError(f"{member.name!r} does not belong in one")


def _extract(members: tarfile.TarFile, member: tarfile.TarInfo, target: Path) -> str:
    """Write a member to a file that other users cannot read, and return its SHA-256."""
    digest = hashlib.sha256()
    try:
        target.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        target.touch(mode=0o600)
        file = target.open("wb")
    except OSError as error:
        if error.errno in _NO_SUCH_NAME:
            raise _foreign(member) from None
        raise
    content = members.extractfile(member)
    with file:
        while content is not None and (chunk := content.read(_CHUNK)):
            digest.update(chunk)
            file.write(chunk)
    return digest.hexdigest()


def _problems(manifest: Manifest, digests: Mapping[str, str]) -> Iterator[Problem]:
    if KEY_SETTING not in manifest.files:
        yield Problem("damaged-backup", KEY_SETTING, "is not in the backup; use another")
    known = {SETTINGS_FILE, DATABASE, MANIFEST, *manifest.files.values()}
    for name in sorted({*manifest.sha256, *manifest.files.values(), *digests} - {MANIFEST}):
        upload = _UPLOAD.fullmatch(name)
        if name not in digests:
            yield Problem("damaged-backup", name, "is missing; use another backup")
        elif digests[name] != (upload[1] if upload else manifest.sha256.get(name)):
            message = "differs from what was backed up; use another backup"
            yield Problem("damaged-backup", name, message)
        elif not upload and name not in known:
            yield Problem("damaged-backup", name, "does not belong in a backup; use another")
