"""Submissions that come packed: gzip, or a zip archive with one file in it.

What a file is, its first bytes say, not its name. At most so many bytes are unpacked as a
submission may have, whatever the archive claims.
"""

import io
import zlib
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

from reverie_eval.errors import SubmissionError
from reverie_eval.reading import problems

_GZIP_MAGIC = b"\x1f\x8b"
_ZIP_MAGICS = (b"PK\x03\x04", b"PK\x05\x06")
"""Of an archive with files in it, and of one without."""
_ZIP_MEMBER = b"PK\x01\x02"
_ENCRYPTED = 0x1
_METHODS = (ZIP_STORED, ZIP_DEFLATED)
"""What zip programs use if nobody tells them otherwise. Of the others, Python unpacks all there is
at once, however much that may be."""
_MAX_MEMBERS = 1000
"""Of a zip archive; each takes a hundred times its 46 bytes in memory."""
_DAMAGED_ZIP = (
    BadZipFile,
    EOFError,
    NotImplementedError,
    OSError,
    OverflowError,
    ValueError,
    zlib.error,
)


def unpack(content: bytes, limit: int) -> bytes:
    """Return what is packed in the content, or the content if it is not packed.

    Raises
    ------
    SubmissionError
        If it does not unpack, is larger than the limit (bytes), or a zip archive of several files.
    """
    if content.startswith(_GZIP_MAGIC):
        content = _unpack_gzip(content, limit)
    elif content.startswith(_ZIP_MAGICS):
        content = _unpack_zip(content, limit)
    if len(content) > limit:
        raise SubmissionError([problems.too_large(limit)])
    return content


def _unpack_gzip(content: bytes, limit: int) -> bytes:
    import gzip

    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            return file.read(limit + 1)
    except (EOFError, OSError, zlib.error) as error:
        raise SubmissionError([problems.damaged_gzip(str(error))]) from error


def _unpack_zip(content: bytes, limit: int) -> bytes:
    if content.count(_ZIP_MEMBER) > _MAX_MEMBERS:
        raise SubmissionError([problems.damaged_zip(f"it holds more than {_MAX_MEMBERS:,} files")])
    try:
        with (
            ZipFile(io.BytesIO(content)) as archive,
            archive.open(_only_file(archive)) as file,
        ):
            return file.read(limit + 1)
    except _DAMAGED_ZIP as error:
        raise SubmissionError([problems.damaged_zip(str(error))]) from error


def _only_file(archive: ZipFile) -> ZipInfo:
    files = [member for member in archive.infolist() if _is_meant(member)]
    if len(files) != 1:
        names = [member.filename for member in files]
        raise SubmissionError([problems.not_one_file(names)])
    (file,) = files
    if file.flag_bits & _ENCRYPTED:
        raise SubmissionError([problems.damaged_zip("it is encrypted")])
    if file.compress_type not in _METHODS:
        raise SubmissionError([problems.damaged_zip("it is compressed in an unusual way")])
    return file


def _is_meant(member: ZipInfo) -> bool:
    """Whether somebody put this into the archive, and not their operating system."""
    *folders, name = member.filename.split("/")
    return bool(name) and not name.startswith(".") and "__MACOSX" not in folders
