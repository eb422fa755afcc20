"""Whatever a file holds, it is read or refused, in time and memory that its size bounds.

The files are damaged ones of every form and every known mistake. ``scripts/evidence readers``
searches for more of them.
"""

import gzip
import time
import tracemalloc
from collections.abc import Callable, Iterable, Mapping
from random import Random
from types import MappingProxyType

import pytest

from tests.support.mutated_files import damaged
from tests.support.readers import READERS

POSE = b'["door",0,0]'
RECORD = b'{"instr_id":"7_1_0","trajectory":[%s],"predObjId":1}' % POSE
BOX_RECORD = RECORD.replace(
    b'"predObjId":1', b'"predBox":[1,2,3,4],"predView":1,"predImageSize":[640,480]'
)


def _records(records: Iterable[bytes]) -> bytes:
    return b"[%s]" % b",".join(records)


def _misspelt(number: int) -> bytes:
    marks = f"{number:b}".replace("0", "-").replace("1", "_")
    return b'{"pred%sObjId":1}' % marks.encode()


FILES = {"submissions": 400, "houses": 400, "datasets": 30}
BYTES_AT_LEAST = 4 << 20
BYTES_PER_BYTE = {"submissions": 250, "houses": 250, "datasets": 600}
"""Memory that a file may take: at least so much, and more for each byte that it has unpacked."""
SECONDS_AT_LEAST, SECONDS_PER_MEBIBYTE = 5, 30
"""Processor time that a file may take, which others on the machine hardly change."""
PIECES = 20_000
HOSTILE: Mapping[str, Callable[[int], bytes]] = MappingProxyType(
    {
        "nested lists": lambda n: b"[" * n,
        "nested lists in the second line": lambda n: b"{}\n" + b"[" * n,
        "nested objects": lambda n: b'{"":' * n,
        "empty lists": lambda n: b"[" + b"[]," * n + b"[]]",
        "empty objects": lambda n: b"[" + b"{}," * n + b"{}]",
        "a long number": lambda n: b"[" + b"9" * n + b"]",
        "a long text": lambda n: b'["' + b"x" * n + b'"]',
        "escapes": lambda n: b'["' + b"\\u0000" * n + b'"]',
        "a field again and again": lambda n: b"[{" + b'"instr_id":"7_1_0",' * n + b'"x":0}]',
        "a long trajectory": lambda n: RECORD.replace(POSE, b",".join([POSE] * n)),
        "lines": lambda n: b"{}\n" * n,
        "objects one after another": lambda n: b"{}" * (2 * n),
        "numbers one after another": lambda n: b"1 " * (10 * n),
        "different fields": lambda n: _records(b'{"predictobj%dx":1}' % i for i in range(n)),
        "different misspelt fields": lambda n: _records(map(_misspelt, range(n))),
        "a record again and again": lambda n: _records([RECORD] * (n // 20)),
        "boxes again and again": lambda n: _records([BOX_RECORD] * (n // 20)),
        "spaces": lambda n: b" " * n,
        "Python": lambda n: b"[" + b"(None,)," * n + b"]",
        "quotes": lambda n: b"'" * n,
        "comments": lambda n: b"//\n" * n,
        "packed zeros": lambda n: gzip.compress(bytes(20 * n)),
        "packed again": lambda n: gzip.compress(gzip.compress(bytes(20 * n))),
    }
)
"""Files of so many pieces that are made to be slow or large when read."""


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused(name: str) -> None:
    reader, random = READERS[name], Random(0)
    examples = reader.examples()
    for _ in range(FILES[name]):
        content = random.choice(examples)
        kept = content[: reader.head]
        reader.accepts(kept + damaged(random, content[reader.head :]))


@pytest.mark.parametrize("name", READERS)
def test_some_files_are_read(name: str) -> None:
    reader = READERS[name]
    assert sum(map(reader.accepts, reader.examples())) >= 1


@pytest.mark.slow
@pytest.mark.parametrize("what", HOSTILE)
@pytest.mark.parametrize("name", READERS)
def test_a_hostile_file_takes_little_time(name: str, what: str) -> None:
    content = hostile(name, what, PIECES)
    begun = time.process_time()
    READERS[name].accepts(content)
    mebibytes = (len(content) + 20 * PIECES) / 2**20
    assert time.process_time() - begun < SECONDS_AT_LEAST + SECONDS_PER_MEBIBYTE * mebibytes


@pytest.mark.slow
@pytest.mark.parametrize("what", HOSTILE)
@pytest.mark.parametrize("name", READERS)
def test_a_hostile_file_takes_little_memory(name: str, what: str) -> None:
    pieces = PIECES // 10  # watching the memory takes time
    content = hostile(name, what, pieces)
    READERS[name].accepts(READERS[name].examples()[0])  # loads what is kept for later files
    tracemalloc.start()
    try:
        READERS[name].accepts(content)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < BYTES_AT_LEAST + BYTES_PER_BYTE[name] * len(content)


def hostile(name: str, what: str, pieces: int) -> bytes:
    """Return a hostile file for a reader."""
    return (b"\0" if name == "datasets" else b"") + HOSTILE[what](pieces)
