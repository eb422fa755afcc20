"""Files and folders that appear complete or not at all, whether others may read them, and TOML."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from errno import EDQUOT, EFBIG, ENOSPC
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

from reverie_eval.errors import ReverieEvalError

# The permissions of a file for its group and for others.
_OTHERS = 0o077
# The disk, the user's part of it, or the largest file that the process may write.
_FULL = (ENOSPC, EDQUOT, EFBIG)


def is_private(path: Path) -> bool:
    """Whether only the owner of a file may use it. Raises OSError if it cannot be examined."""
    return not path.stat().st_mode & _OTHERS


@contextmanager
def staged_file(path: Path, *, mode: int = 0o666) -> Iterator[BinaryIO]:
    """Open a file for writing that replaces ``path`` once it is complete.

    The new file keeps the permissions of the old one, and its owner, if it may. Devices and pipes
    are written to directly.

    Parameters
    ----------
    path : Path
        A file in an existing folder.
    mode : int
        Permissions of a new file, before the process's umask.
    """
    if path.exists() and not path.is_file():
        with path.open("wb") as file:
            yield file
        return
    # In the same folder, because renaming is atomic within a file system only.
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with naming(path, draft):
            descriptor = os.open(draft, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, mode)
            with os.fdopen(descriptor, "wb") as file:
                if path.exists():
                    status = path.stat()
                    draft.chmod(status.st_mode)
                    with suppress(PermissionError):  # an administrator may write for a service
                        os.chown(draft, status.st_uid, status.st_gid)
                yield file
            draft.replace(path)
    finally:
        # After a rename there is no draft any more; after an error there may be.
        draft.unlink(missing_ok=True)


@contextmanager
def naming(path: Path, draft: Path) -> Iterator[None]:
    """Let errors name the caller's file or folder instead of the draft.

    Of a full disk, the system names no file, or the one that was copied.
    """
    try:
        yield
    except OSError as error:
        if error.filename == str(draft) or error.errno in _FULL:
            error.filename = str(path)
        raise


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder, and those above it; at the end, remove those of them that are empty."""
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for each in made:
            with suppress(OSError):  # it has files, or could not be made
                each.rmdir()


@contextmanager
def replacing_folder(folder: Path) -> Iterator[Path]:
    """Yield a hidden folder to fill; at the end it takes the place of ``folder``.

    Between two renames there is no folder for a moment, but never half of one.

    Parameters
    ----------
    folder : Path
        A folder to replace, or one that does not exist yet.
    """
    target = folder.resolve()
    with made_folder(target.parent), _hidden_folder(target, target.parent) as hidden:
        staging = Path(hidden, "new")
        staging.mkdir()
        with naming(folder, staging):
            yield staging
        # A folder with files cannot be replaced by a rename, so the old one steps aside first.
        if target.exists():
            target.rename(Path(hidden, "old"))
        staging.rename(target)


def _hidden_folder(target: Path, parent: Path) -> TemporaryDirectory[str]:
    """Make a folder beside or in ``target``, which an error names instead of the hidden one."""
    try:
        return TemporaryDirectory(prefix=f".{target.name}-", dir=parent)
    except OSError as error:
        error.filename = str(target)
        raise


@contextmanager
def staged_folder(folder: Path, *, mode: int = 0o777, last: str = "") -> Iterator[Path]:
    """Yield a hidden folder to fill; its contents move to ``folder`` at the end.

    A new folder appears in one step. An existing folder may be a mounted disk or a shell's working
    directory, so it is not replaced: the contents are moved into it one by one.

    Parameters
    ----------
    folder : Path
        A folder that does not exist yet, or is empty.
    mode : int
        Permissions of a new folder, before the process's umask.
    last : str
        The entry to move last; its presence then means that the folder is complete.
    """
    target = folder.absolute()
    is_new = not target.exists()
    # Renaming is atomic only within one file system, so the hidden folder is on the target's.
    parent = target.parent if is_new else target
    with made_folder(parent), _hidden_folder(target, parent) as hidden:
        # One level deeper, because the temporary folder is private to its owner.
        staging = Path(hidden, target.name)
        staging.mkdir(mode)
        with naming(folder, staging):
            yield staging
        if is_new:
            staging.rename(target)
            return
        for entry in sorted(staging.iterdir(), key=lambda entry: entry.name == last):
            entry.rename(target / entry.name)


def parse_toml(text: str, parse_float: Callable[[str], Any] = float) -> dict[str, Any]:
    """Return the table that a text in TOML describes. Raises ValueError if it is not TOML."""
    # Imported here: scoring a file reads none.
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib

    return tomllib.loads(text, parse_float=parse_float)


def read_toml(file: Path) -> dict[str, Any]:
    """Read a table in TOML. Raises ReverieEvalError if a file is not TOML."""
    try:
        return parse_toml(file.read_text("utf-8"))
    except ValueError as error:
        raise ReverieEvalError(f"{file}: {error}") from None
