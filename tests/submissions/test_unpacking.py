"""Unpacking plain, gzipped and zipped files, and refusing others."""

import gzip
import io
import struct
import tracemalloc
import zlib
from collections.abc import Mapping
from contextlib import suppress
from itertools import chain
from random import Random
from zipfile import ZIP_BZIP2, ZIP_DEFLATED, ZIP_LZMA, ZIP_STORED, ZipFile

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reverie_eval import SubmissionError
from reverie_eval.submissions import read_predictions
from reverie_eval.submissions._sources import unpack

TEXT = b'[{"instr_id": "7_1_0"}]'
LIMIT = 1 << 20


def zipped(files: Mapping[str, bytes], method: int = ZIP_DEFLATED) -> bytes:
    archive = io.BytesIO()
    with ZipFile(archive, "w", method) as file:
        for name, content in files.items():
            file.writestr(name, content)
    return archive.getvalue()


def encrypted() -> bytes:
    """Return an archive whose directory says that its file is encrypted."""
    archive = bytearray(zipped({"submit.json": TEXT}))
    archive[archive.index(b"PK\x01\x02") + 8] |= 1
    return bytes(archive)


def claiming(size: int, *, is_zip64: bool = False, offset: int = 0) -> bytes:
    """Return an archive whose directory gives a wrong size and offset of its file."""
    name, checksum = b"submit.json", zlib.crc32(TEXT)
    local = struct.pack("<HHHHHIIIHH", 20, 0, 0, 0, 0, checksum, 23, 23, len(name), 0)
    member = b"PK\x03\x04" + local + name + TEXT
    unknown = 0xFFFFFFFF
    extra = struct.pack("<HHQQQ", 1, 24, size, 23, offset) if is_zip64 else b""
    sizes = (unknown,) * 2 if is_zip64 else (23, size)
    fields = 20, 20, 0, 0, 0, 0, checksum, *sizes, len(name), len(extra), 0, 0, 0, 0
    place = unknown if is_zip64 else offset
    entry = b"PK\x01\x02" + struct.pack("<HHHHHHIIIHHHHHII", *fields, place) + name + extra
    end = b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(entry), len(member), 0)
    return member + entry + end


def of_many_entries(number: int) -> bytes:
    """Return an archive whose directory repeats the same name, without any file."""
    entry = b"PK\x01\x02" + struct.pack("<HHHHHHIIIHHHHHII", *(0,) * 8, 0, 1, *(0,) * 6) + b"a"
    directory = entry * number
    end = struct.pack("<HHHHIIH", 0, 0, 0xFFFF, 0xFFFF, len(directory), 0, 0)
    return b"PK\x03\x04" + directory + b"PK\x05\x06" + end


@pytest.mark.parametrize(
    "packed",
    [
        pytest.param(TEXT, id="plain"),
        pytest.param(gzip.compress(TEXT), id="gzip"),
        pytest.param(gzip.compress(TEXT[:9]) + gzip.compress(TEXT[9:]), id="gzip in two members"),
        pytest.param(gzip.compress(TEXT) + b"\0" * 9, id="gzip padded with zeros"),
        pytest.param(zipped({"submit.json": TEXT}), id="zip"),
        pytest.param(zipped({"submit.json": TEXT}, ZIP_STORED), id="zip that compresses nothing"),
        pytest.param(zipped({"results/final.txt": TEXT}), id="in a folder, by any name"),
        pytest.param(zipped({"results/": b"", "results/a.json": TEXT}), id="with its folder"),
        pytest.param(
            zipped({"a.json": TEXT, "__MACOSX/._a.json": b"x", ".DS_Store": b"x"}), id="from a Mac"
        ),
        pytest.param(zipped({"r/a.json": TEXT, "__MACOSX/r/._a.json": b"x"}), id="from its folder"),
        pytest.param(zipped({"../../etc/passwd": TEXT}), id="by a name that leads elsewhere"),
        pytest.param(claiming(23), id="zip made by hand"),
    ],
)
def test_packed_content_is_unpacked(packed: bytes) -> None:
    assert unpack(packed, LIMIT) == TEXT


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(b"", id="nothing"),
        pytest.param(b"\x1f", id="half of gzip's first bytes"),
        pytest.param(b"PK", id="half of zip's first bytes"),
        pytest.param(b" " + gzip.compress(TEXT), id="gzip behind a space"),
        pytest.param(b"x" + zipped({"a": TEXT}), id="zip behind something else"),
        pytest.param(b"BZh91AY&SY", id="bzip2"),
    ],
)
def test_other_content_is_left_unchanged(content: bytes) -> None:
    assert unpack(content, LIMIT) == content


@pytest.mark.parametrize(
    ("packed", "code", "message"),
    [
        pytest.param(gzip.compress(TEXT)[:-9], "damaged-gzip", "cut short", id="cut gzip"),
        pytest.param(
            gzip.compress(TEXT) + b"x", "damaged-gzip", "bytes are wrong", id="gzip and more"
        ),
        pytest.param(b"\x1f\x8b\x07", "damaged-gzip", "cut short", id="gzip of another method"),
        pytest.param(zipped({"a": TEXT})[:-9], "damaged-zip", "cut short", id="cut zip"),
        pytest.param(
            zipped({"a": TEXT}, ZIP_STORED).replace(b"7_1_0", b"7_1_1"),
            "damaged-zip",
            "bytes are wrong",
            id="zip with a wrong bit",
        ),
        pytest.param(encrypted(), "damaged-zip", "encrypted", id="encrypted"),
        pytest.param(zipped({"a": TEXT}, ZIP_BZIP2), "damaged-zip", "unusual", id="bzip2 in zip"),
        pytest.param(zipped({"a": TEXT}, ZIP_LZMA), "damaged-zip", "unusual", id="LZMA in zip"),
        pytest.param(claiming(22), "damaged-zip", "bytes are wrong", id="claims to be smaller"),
        pytest.param(
            claiming(23, is_zip64=True, offset=2**64 - 1),
            "damaged-zip",
            "bytes are wrong",
            id="claims to lie beyond all files",
        ),
        pytest.param(zipped({}), "several-files", "with no file", id="empty zip"),
        pytest.param(zipped({"a/": b""}), "several-files", "with no file", id="only a folder"),
        pytest.param(zipped({".a": TEXT}), "several-files", "with no file", id="only hidden files"),
        pytest.param(
            zipped({"b.json": TEXT, "a\x1b[2J": TEXT}),
            "several-files",
            r"2 files: 'b.json', 'a\x1b[2J'; pack only the result file",
            id="several files",
        ),
        pytest.param(of_many_entries(1001), "damaged-zip", "more than 1,000", id="1,001 entries"),
    ],
)
def test_anything_but_a_single_file_is_refused(packed: bytes, code: str, message: str) -> None:
    with pytest.raises(SubmissionError) as rejected:
        unpack(packed, LIMIT)
    (problem,) = rejected.value.problems
    assert (problem.code, problem.where) == (code, "file")
    assert message in problem.message


def test_a_thousand_entries_are_accepted() -> None:
    with pytest.raises(SubmissionError, match="1,000 files: 'a'"):
        unpack(of_many_entries(1000), LIMIT)


@pytest.mark.parametrize("pack", [bytes, gzip.compress, lambda text: zipped({"a": text})])
@pytest.mark.parametrize(("size", "fits"), [(999, True), (1000, True), (1001, False)])
def test_the_limit_holds_for_the_unpacked_size(pack: type[bytes], size: int, *, fits: bool) -> None:
    packed = pack(b" " * size)
    if fits:
        assert len(unpack(packed, 1000)) == size
        return
    with pytest.raises(SubmissionError, match="is larger than"):
        unpack(packed, 1000)


@pytest.mark.slow
@pytest.mark.parametrize(
    "pack",
    [
        pytest.param(gzip.compress, id="gzip"),
        pytest.param(lambda text: zipped({"a": text}), id="zip"),
        pytest.param(lambda text: zipped({"a": text}, ZIP_BZIP2), id="bzip2 in zip"),
        pytest.param(lambda text: zipped({"a": text}, ZIP_LZMA), id="LZMA in zip"),
    ],
)
def test_a_bomb_is_not_unpacked_further_than_the_limit(pack: type[bytes]) -> None:
    bomb = pack(bytes(100 << 20))
    tracemalloc.start()
    try:
        with pytest.raises(SubmissionError):
            unpack(bomb, LIMIT)
        assert tracemalloc.get_traced_memory()[1] < 10 * LIMIT
    finally:
        tracemalloc.stop()


def test_the_size_that_an_archive_claims_is_not_trusted() -> None:
    assert unpack(claiming(2**40, is_zip64=True), LIMIT) == TEXT


@pytest.mark.parametrize(
    ("packed", "message"),
    [
        pytest.param(gzip.compress(gzip.compress(TEXT)), "packed twice", id="gzip in gzip"),
        pytest.param(zipped({"a": zipped({"b": TEXT})}), "within another", id="zip in zip"),
        pytest.param(zipped({"a.json.gz": gzip.compress(TEXT)}), "packed twice", id="gzip in zip"),
    ],
)
def test_a_file_is_unpacked_once(packed: bytes, message: str) -> None:
    with pytest.raises(SubmissionError, match=message):
        read_predictions(packed)


SPOILED = [
    gzip.compress(TEXT * 9),
    zipped({"a": TEXT * 9, "__MACOSX/a": b"x"}),
    claiming(23),
    claiming(23, is_zip64=True),
]


@given(st.sampled_from(SPOILED), st.integers(0, 3), st.randoms(use_true_random=False))
def test_a_damaged_file_is_unpacked_or_refused(packed: bytes, times: int, random: Random) -> None:
    spoiled = bytearray(packed)
    for place in random.sample(range(4, len(packed)), times):
        spoiled[place] = random.choice([0, 1, 0x7F, 0x80, 0xFF])
    cut = random.choice([len(spoiled), random.randrange(4, len(spoiled))])
    with suppress(SubmissionError):
        assert len(unpack(bytes(spoiled[:cut]), LIMIT)) <= LIMIT


@given(st.lists(st.binary(max_size=9), max_size=9))
def test_any_bytes_survive_packing(parts: list[bytes]) -> None:
    content = b"[" + bytes(chain.from_iterable(parts))
    assert unpack(gzip.compress(content), LIMIT) == content
    assert unpack(zipped({"a": content}), LIMIT) == content
