"""Which files are submissions, and how they are named."""

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from glob import escape, glob, has_magic
from itertools import chain
from os import PathLike
from pathlib import Path

from reverie_eval.errors import ProtocolError
from reverie_eval.logs import is_run
from reverie_eval.submissions._sources import STANDARD_INPUT

_ENDINGS = (".json", ".json.gz", ".jsonl", ".jsonl.gz", ".zip")
RECEIPT_ENDING = ".receipt.json"
"""The ending of the names of receipts, which are written beside submissions."""
# A field of a pattern: a part of a file's or a folder's name, with a name of its own.
_FIELD = re.compile(r"\{([A-Za-z]\w*)\}")
_JSON_SUFFIX = re.compile(r"(?<=.)(\.jsonl?)?(\.gz|\.zip)?$")


def find_files(names: Sequence[str]) -> list[str]:
    """Replace folders and patterns, also with fields in braces, by the files in them.

    A folder's files are those that end as submissions do and are not receipts; the folders in it
    are not searched.

    Raises
    ------
    ProtocolError
        If there is no submission in a folder, or no file for a pattern, or a name is empty.
    """
    if "" in names:  # which would be the current folder
        raise ProtocolError("a file's name is empty; is a variable of the shell not set?")
    found = {name: _files(name) for name in names}
    for name, files in found.items():
        if not files:
            raise ProtocolError(
                f"{name}: no submission found; submissions end in {', '.join(_ENDINGS)}"
            )
    return list(dict.fromkeys(chain.from_iterable(found.values())))


def find_fields(pattern: str) -> Mapping[str, Mapping[str, str]]:
    """Return the files of a pattern such as ``runs/seed{seed}/{checkpoint}.json``, and their parts.

    A field in braces stands for a part of one file's or folder's name; where a field comes twice,
    both parts are the same.

    Returns
    -------
    mapping of mappings of str
        What each field stands for, by path; empty if the pattern fits no file. A file or folder is
        itself, without fields.
    """
    if Path(pattern).exists():
        return {pattern: {}}
    constants, names = _FIELD.split(pattern)[::2], _FIELD.findall(pattern)
    first = re.escape(constants[0])
    form = first + "".join(
        (rf"(?P<{name}>[^/]+?)" if name not in names[:number] else f"(?P={name})")
        + re.escape(after)
        for number, (name, after) in enumerate(zip(names, constants[1:], strict=True))
    )
    files = sorted(glob("*".join(map(escape, constants))))  # noqa: PTH207  # it may begin with /
    found = ((file, re.fullmatch(form, file)) for file in files)
    return {file: match.groupdict() for file, match in found if match}


def find_runs(word: str) -> tuple[str, Sequence[str]] | None:
    """Split ``NAME=FILE,FILE`` into a method's name and the files of its runs.

    Files may be folders and patterns, as for :func:`find_files`. A word that is itself a file,
    folder or pattern, or has no name, gives None.

    Raises
    ------
    ProtocolError
        As :func:`find_files`; or if a file is named twice, or not at all between two commas.
    """
    name, _, files = word.partition("=")
    # A path may contain an equals sign, so what exists is never taken apart.
    if not files or not name or "/" in name or has_magic(name) or Path(word).exists():
        return None
    named = [files] if Path(files).exists() else files.split(",")
    if "" in named:
        raise ProtocolError(f"{word}: a comma has no file before or after it; remove the comma")
    found: dict[str, str] = {}
    for file in chain.from_iterable(find_files([each]) for each in named):
        resolved = os.path.realpath(file)
        if resolved in found:
            raise ProtocolError(f"{word}: {found[resolved]} is named twice; name each run once")
        found[resolved] = file
    return name, list(found.values())


def watch_files(names: Sequence[str], pause: Callable[[], object]) -> Iterator[str]:
    """Yield existing files, then those that appear or change, without end.

    A file is yielded once its size and time of change are the same before and after a pause: until
    then it may be half written.

    Parameters
    ----------
    names : sequence of str
        Files, folders and patterns, as for :func:`find_files`; they need not exist yet. The folders
        in a folder are watched as well.
    pause : function
        Waits before the files are looked at again.
    """
    seen: dict[str, tuple[int, int] | None] = {}
    yielded: dict[str, tuple[int, int] | None] = {}
    while True:
        for name in dict.fromkeys(chain.from_iterable(map(_files_within, names))):
            state = _state(name)
            # Unchanged since the last look, and not the state that was yielded before.
            if state and state == seen.get(name) != yielded.get(name):
                yielded[name] = state
                yield name
            seen[name] = state
        pause()


def _state(name: str) -> tuple[int, int] | None:
    """Return a file's size and time of change; None if it is not there."""
    try:
        found = Path(name).stat()
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns


def _files(name: str) -> Sequence[str]:
    path = Path(name)
    if path.is_dir() and not is_run(path):
        return sorted(str(file) for file in path.iterdir() if _is_submission(file))
    if has_fields(name):
        return list(find_fields(name))
    if is_pattern(name):
        return sorted(glob(name, recursive=True))  # noqa: PTH207  # a pattern may begin with /
    return [name]


def has_fields(name: str) -> bool:
    """Whether a name has fields in braces, and is not itself a file or a folder."""
    return bool(_FIELD.search(name)) and not Path(name).exists()


def is_pattern(name: str) -> bool:
    """Whether a name has wildcards or fields, and is not itself a file or a folder."""
    return has_fields(name) or (has_magic(name) and not Path(name).exists())


def _files_within(name: str) -> Iterator[str]:
    """Yield the files of a name and, of a folder, those of the folders in it."""
    yield from _files(name)
    path = Path(name)
    if path.is_dir() and not is_run(path):
        for folder in sorted(each for each in path.iterdir() if each.is_dir() and not is_run(each)):
            # A link may lead back up, and hidden folders have copies.
            if not (folder.is_symlink() or folder.name.startswith(".")):
                yield from _files_within(str(folder))


def _is_submission(file: Path) -> bool:
    ends_so = file.name.endswith(_ENDINGS) and not file.name.endswith(RECEIPT_ENDING)
    return (ends_so and file.is_file()) or is_run(file)


def source_name(file: str | PathLike[str]) -> str:
    """Return a path as messages show it: ``-`` is standard input."""
    return "standard input" if file == STANDARD_INPUT else str(file)


def submission_names(submissions: Sequence[object]) -> Sequence[str]:
    """Name submissions after their files, as briefly as possible.

    These are the names of the files without their endings if they differ, or else the parts of the
    paths that differ. Submissions are numbered if some are not files, or two are the same file.

    >>> submission_names(["runs/a.json", "b.json.gz"])
    ['a', 'b']
    >>> submission_names(["runs/a/test/submit.json", "runs/b/test/submit.json"])
    ['a', 'b']
    >>> submission_names([b"[]", "a.json"])
    ['submission 1', 'submission 2']
    """
    named = [each for each in submissions if isinstance(each, (str, os.PathLike))]
    files = [Path(source_name(each)) for each in named]
    bare = [file.with_name(_JSON_SUFFIX.sub("", file.name)) for file in files]
    # From short to long; the first in which no two are alike is taken.
    for names in ([file.name for file in bare], _differing_parts(bare), _differing_parts(files)):
        if len(set(names)) == len(submissions):
            return names
    return [f"submission {number}" for number in range(1, len(submissions) + 1)]


def _differing_parts(files: Sequence[Path]) -> Sequence[str]:
    """Return the paths without their common beginning and their common end."""
    parts = [list(file.parts) for file in files]
    for end in (0, -1):
        # A part stays of each path, however alike they are.
        while len({each[end] for each in parts}) == 1 and min(map(len, parts)) > 1:
            for each in parts:
                each.pop(end)
    return [str(Path(*each)) for each in parts]


def check_names(names: Iterable[object]) -> None:
    """Check that the names of submissions are text.

    Raises
    ------
    ProtocolError
        Showing the first name that is not.
    """
    for name in names:
        if not isinstance(name, str):
            raise ProtocolError(f"names of submissions must be text; got {name!r}")
