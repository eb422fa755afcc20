"""Where submissions come from: which files they are, how they are named, what their bytes are."""

import errno
import io
import os
import re
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from glob import escape, glob, has_magic
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import BinaryIO, TextIO, TypeAlias
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo, is_zipfile

from reverie_eval.errors import ProtocolError, SubmissionError
from reverie_eval.logs import is_run, submission_in
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._problems import show
from reverie_eval.text import count_text, damage_text, first_few

Source: TypeAlias = str | PathLike[str] | bytes | BinaryIO | TextIO
"""A path, also of a run's folder, ``-`` for standard input, the content itself, or an open file."""
STANDARD_INPUT = "-"
MAX_MEBIBYTES_VARIABLE = "REVERIE_EVAL_MAX_MEBIBYTES"
"""The environment variable that allows larger files, or smaller ones only."""
MAX_MEBIBYTES = 128
"""Enough for 3,521 trajectories of a thousand poses. It limits the unpacked size too."""
RECEIPT_ENDING = ".receipt.json"
"""The ending of the names of receipts, which are written beside submissions."""
_ENDINGS = (".json", ".json.gz", ".jsonl", ".jsonl.gz", ".zip")
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


# What the bytes are.

# Bytes to unpack at a time: Python reserves memory for as many, and since 3.12 twice for gzip.
_PIECE = 1 << 20
_JSON_BRACKETS = (("[", "]"), ("{", "}"))
_GZIP_MAGIC = b"\x1f\x8b"
# The first bytes of each member; in compressed bytes, one position in 16 million has the same.
_GZIP_MEMBER = _GZIP_MAGIC + b"\x08"
# Writers that compress by blocks make a few thousand. Empty ones have 20 bytes, and each takes as
# long as a kilobyte of text.
_MAX_GZIP_MEMBERS = 10_000
# The first bytes of an archive with files, and of an empty one.
_ZIP_MAGICS = (b"PK\x03\x04", b"PK\x05\x06")
# The first bytes of a file's entry in the directory of an archive.
_ZIP_ENTRY = b"PK\x01\x02"
# Opening an archive takes a hundred times the 46 bytes of each entry in memory.
_MAX_ZIP_ENTRIES = 1000
# The most digits of a limit in mebibytes, which is a terabyte then.
_MOST_DIGITS = 6
_ENCRYPTED = 0x1
# What zip programs use by default. Python unpacks what others use in one step, ignoring the
# limit, so a small archive could fill the memory.
_COMPRESSIONS = (ZIP_STORED, ZIP_DEFLATED)
# What `zipfile` raises on archives whose bytes were damaged, or crafted.
_DAMAGED_ZIP = (
    BadZipFile,
    EOFError,
    NotImplementedError,
    OSError,
    OverflowError,
    ValueError,
    zlib.error,
)


def read_bytes(source: Source) -> bytes:
    """Read a submission, and unpack it if it is gzip or zip.

    Raises
    ------
    SubmissionError
        If it is larger than any submission needs and no larger ones are allowed, or does not
        unpack to one file.
    ProtocolError
        If the environment variable with the largest size is not a whole number from 1.
    OSError
        If the file cannot be read.
    TypeError
        If it is not a source.
    """
    # Read for each submission, so that a notebook can change the variable.
    limit = _max_mebibytes() << 20
    content = source if isinstance(source, bytes) else _read(source, limit)
    return unpack(content, limit, MAX_MEBIBYTES_VARIABLE)


def _max_mebibytes() -> int:
    value = os.environ.get(MAX_MEBIBYTES_VARIABLE, str(MAX_MEBIBYTES))
    is_number = value.isascii() and value.isdigit() and len(value) <= _MOST_DIGITS
    if not is_number or int(value) == 0:
        raise ProtocolError(
            f"{MAX_MEBIBYTES_VARIABLE} is the largest size of a submission, a whole number of MiB "
            f"from 1, such as {MAX_MEBIBYTES}; got {value!r}"
        )
    return int(value)


def _read(source: str | PathLike[str] | BinaryIO | TextIO, limit: int) -> bytes:
    if isinstance(source, str) and source == STANDARD_INPUT:
        if sys.stdin is None:  # closed by the shell: `<&-`
            raise OSError(errno.EBADF, "is closed", "standard input")
        # One byte more than the limit, so that a file of just the limit is not too large.
        return sys.stdin.buffer.read(limit + 1)
    if isinstance(source, str | PathLike):
        return _read_file(source, limit)
    if not hasattr(source, "read"):
        kind = type(source).__name__
        raise TypeError(f"a submission is a path, bytes, an open file or records, got {kind}")
    content = source.read(limit + 1)
    # A lone surrogate must not fail here: the reader reports it with its location.
    return content.encode(errors="surrogatepass") if isinstance(content, str) else content


def _read_file(file: str | PathLike[str], limit: int) -> bytes:
    try:
        with Path(file).open("rb") as opened:
            # Python allocates all bytes that are asked for: asking for the limit would double the
            # time to read a small file. A pipe has no size.
            size = os.fstat(opened.fileno()).st_size or limit
            return opened.read(min(size, limit) + 1)
    except IsADirectoryError:
        if is_run(file):
            return _read_file(submission_in(file), limit)
        told = "is a folder, and not that of a run; name a result file in it"
        raise IsADirectoryError(errno.EISDIR, told, str(Path(file))) from None
    except (OSError, ValueError) as error:
        # Most libraries take JSON as text; here text is a path, and the system's error for one of
        # a hundred thousand letters would not help.
        text = str(file).strip()
        if (text[:1], text[-1:]) in _JSON_BRACKETS:
            raise TypeError("to score JSON text, pass it as bytes: text.encode()") from error
        raise


def unpack(content: bytes, limit: int, variable: str | None = None) -> bytes:
    """Unpack gzip, or a zip archive with one file; return any other content unchanged.

    The first bytes tell what it is, not the file's name. No more than the limit is unpacked,
    whatever the archive claims. With an environment variable that allows more, the error names it.

    Raises
    ------
    SubmissionError
        If it does not unpack, is larger than the limit (bytes), or is a zip archive of several
        files.
    """
    if content.startswith(_GZIP_MAGIC):
        content = _unpack_gzip(content, limit)
    elif content.startswith(_ZIP_MAGICS):
        content = _unpack_zip(content, limit)
    if len(content) > limit:
        too_large = problems.TOO_LARGE_FOR_NOW if variable else problems.TOO_LARGE
        raise SubmissionError([too_large.of_file(mebibytes=limit >> 20, variable=variable)])
    return content


def _unpack_gzip(content: bytes, limit: int) -> bytes:
    import gzip

    # Counted in the raw bytes, as the files of an archive are.
    if content.count(_GZIP_MEMBER) > _MAX_GZIP_MEMBERS:
        reason = f"it has more than {_MAX_GZIP_MEMBERS:,} gzip members"
        raise SubmissionError([problems.DAMAGED_GZIP.of_file(reason=reason)])
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            return _read_pieces(file.read, limit)
    except (EOFError, OSError, zlib.error) as error:
        reason = damage_text(error)
        raise SubmissionError([problems.DAMAGED_GZIP.of_file(reason=reason)]) from error


def _unpack_zip(content: bytes, limit: int) -> bytes:
    # Counted in the raw bytes, because `ZipFile` reads the whole directory when it is opened.
    if content.count(_ZIP_ENTRY) > _MAX_ZIP_ENTRIES:
        reason = f"it holds more than {_MAX_ZIP_ENTRIES:,} files"
        raise SubmissionError([problems.DAMAGED_ZIP.of_file(reason=reason)])
    try:
        with (
            ZipFile(io.BytesIO(content)) as archive,
            archive.open(_only_file(archive)) as file,
        ):
            return _read_pieces(file.read, limit)
    except _DAMAGED_ZIP as error:
        # An archive is recognised by its end.
        reason = damage_text(error if is_zipfile(io.BytesIO(content)) else EOFError())
        raise SubmissionError([problems.DAMAGED_ZIP.of_file(reason=reason)]) from error


def _read_pieces(read: Callable[[int], bytes], limit: int) -> bytes:
    """Return a file's content; one byte more than the limit tells that it is too large."""
    unpacked = io.BytesIO()
    # Piece by piece: an archive may claim any size, and a bomb is unpacked no farther than the
    # limit.
    while piece := read(min(_PIECE, limit + 1 - unpacked.tell())):
        unpacked.write(piece)
    return unpacked.getvalue()


def _only_file(archive: ZipFile) -> ZipInfo:
    files = [member for member in archive.infolist() if not _is_system_file(member)]
    if len(files) != 1:
        names = first_few(show(member.filename) for member in files)
        found = f"{count_text(len(files), 'file')}: {names}" if files else "no file"
        raise SubmissionError([problems.NOT_ONE_FILE.of_file(found=found)])
    (file,) = files
    if file.flag_bits & _ENCRYPTED:
        raise SubmissionError([problems.DAMAGED_ZIP.of_file(reason="it is encrypted")])
    # The others need modules that a Python may lack.
    if file.compress_type not in _COMPRESSIONS:
        reason = "it is compressed in an unusual way"
        raise SubmissionError([problems.DAMAGED_ZIP.of_file(reason=reason)])
    return file


def _is_system_file(member: ZipInfo) -> bool:
    """Whether this is a folder, or a file that the operating system added."""
    *folders, name = member.filename.split("/")
    # macOS puts a hidden file beside each file of an archive.
    return not name or name.startswith(".") or "__MACOSX" in folders


# What people send instead of a result file, by its first bytes.
_NOT_JSON = {
    b"PK\x03\x04": "a zip archive within another",
    b"\xfd7zXZ": "an xz archive",
    b"BZh": "a bzip2 archive",
    b"7z\xbc\xaf": "a 7z archive",
    b"Rar!": "a rar archive",
    b"(\xb5/\xfd": "a Zstandard archive",
    b"\x1f\x8b": "packed twice",
    b"\x80": "a Python pickle",
    b"\x93NUMPY": "a numpy array",
    b"\x89HDF": "an HDF5 file",
    b"version https://git-lfs": "a git-lfs pointer, not the file itself",
    b"\0\0\0\0": "a file of zero bytes, as a full disk leaves it",
    b"<<<<<<<": "two versions with the marks of a merge conflict",
    b"<": "a web page",
}
_TAR_MARK = b"ustar"
# The offset of that mark.
_TAR_MARK_AT = 257
_PYTHON_LITERAL = re.compile(rb"[\s\[{(]+'")


def check_kind(content: bytes) -> None:
    """Refuse what is not JSON at all, and say what it is."""
    for beginning, kind in _NOT_JSON.items():
        if content.startswith(beginning):
            raise SubmissionError([problems.ANOTHER_KIND.of_file(kind=kind)])
    if content.startswith(_TAR_MARK, _TAR_MARK_AT):
        raise SubmissionError([problems.ANOTHER_KIND.of_file(kind="a tar archive")])
    if not content.strip():
        raise SubmissionError([problems.ANOTHER_KIND.of_file(kind="empty")])
    if is_python_literal(content):
        fault = faults.PYTHON_LITERAL
        raise SubmissionError([fault.problem(1, problems.WHOLE_FILE, (), None)])


def is_python_literal(content: bytes) -> bool:
    """Whether this is what Python prints for a list or a dictionary, which is not JSON."""
    return _PYTHON_LITERAL.match(content) is not None


def check_value_count(content: bytes, limit: int) -> None:
    """Refuse JSON text that would take gigabytes once it is parsed."""
    if len(content) <= limit:
        return  # nearly always: counting takes as long as a third of parsing
    # Every value but the first follows a comma or the beginning of a list or an object. Counting
    # these bytes is an upper bound that takes milliseconds and no memory.
    count = sum(map(content.count, (b"[", b"{", b",")))
    if count > limit:
        raise SubmissionError([problems.TOO_MANY_VALUES.of_file(found=count, limit=limit)])
