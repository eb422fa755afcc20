"""Submissions that come packed: gzip, or a zip archive with one file in it.

What a file is, its first bytes say, not its name. At most so many bytes are unpacked as a
submission may have, whatever the archive claims.
"""

import io
import zlib
from zipfile import BadZipFile, ZipFile, ZipInfo

from reverie_eval.errors import SubmissionError
from reverie_eval.reading import problems

_GZIP_MAGIC = b"\x1f\x8b"
_ZIP_MAGIC = b"PK\x03\x04"
_ENCRYPTED = 0x1
_DAMAGED_ZIP = (BadZipFile, EOFError, NotImplementedError, OSError, ValueError, zlib.error)


def unpack(content: bytes, limit: int) -> bytes:
    """Return what is packed in the content, or the content if it is not packed.

    Raises
    ------
    SubmissionError
        If it does not unpack, is larger than the limit (bytes), or a zip archive of several files.
    """
    if content.startswith(_GZIP_MAGIC):
        content = _unpack_gzip(content, limit)
    elif content.startswith(_ZIP_MAGIC):
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
    try:
        with ZipFile(io.BytesIO(content)) as archive:
            files = [member for member in archive.infolist() if _is_meant(member)]
            if len(files) != 1:
                names = [member.filename for member in files]
                raise SubmissionError([problems.not_one_file(names)])
            if files[0].flag_bits & _ENCRYPTED:
                raise SubmissionError([problems.damaged_zip("it is encrypted")])
            with archive.open(files[0]) as file:
                return file.read(limit + 1)
    except _DAMAGED_ZIP as error:
        raise SubmissionError([problems.damaged_zip(str(error))]) from error


def _is_meant(member: ZipInfo) -> bool:
    """Whether somebody put this into the archive, and not their operating system."""
    *folders, name = member.filename.split("/")
    return bool(name) and not name.startswith(".") and "__MACOSX" not in folders
