"""SQLite's write-ahead log: whether all transactions in it would be read.

After a crash, SQLite reads the log as far as its checksums are right, and forgets the rest without
a word. If the crash was a power cut, the last transaction may be incomplete, and nobody was told
that it was stored. Every other was flushed to the disk before the next one began: if it cannot be
read although another one follows, it was damaged later.

References
----------
https://www.sqlite.org/fileformat2.html#the_write_ahead_log
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_HEADER, _FRAME = 32, 24
"""Bytes of the log's header, and of a frame's before its page."""
_MAGIC = b"\x37\x7f\x06"
_BIG_ENDIAN = 0x83
"""The byte after that, if checksums are of big-endian numbers."""
_PAGE = 4096
_BITS = np.uint64(0xFFFFFFFF)

_Numbers = NDArray[np.uint64]


def has_lost_transactions(database: Path) -> bool:
    """Whether SQLite would forget transactions in the log of a file. Nothing is changed."""
    path = database.with_name(f"{database.name}-wal")
    # A running server may add to the log while it is read; what is lost stays lost.
    return all(_loses_some(path) for _ in range(2))


def _loses_some(path: Path) -> bool:
    try:
        content = path.read_bytes()
        with path.open("rb") as file:
            is_same_log = content.startswith(file.read(_HEADER))
    except OSError:
        return False
    number = (len(content) - _HEADER) // (_FRAME + _PAGE)
    if number < 1 or not is_same_log:  # a running server has begun the log again meanwhile
        return False
    frames = np.frombuffer(content, ">u4", number * (_FRAME + _PAGE) // 4, _HEADER)
    frames = frames.reshape(number, -1)
    readable = _count_readable(content[:_HEADER], frames)
    # The salts are those of this log: frames of earlier ones may follow. A damaged header may have
    # others.
    salts = frames[0, 2:4] if readable is None else np.frombuffer(content, ">u4", 2, 16)
    own = np.flatnonzero((frames[:, 2:4] == salts).all(axis=1))
    commits = own[frames[own, 1] != 0]
    return bool(((commits >= (readable or 0)) & (commits < own.max(initial=-1))).any())


def _count_readable(header: bytes, frames: NDArray[Any]) -> int | None:
    """Return how many frames, from the first on, are right; None if the header is not."""
    kind = ">u4" if header[3] == _BIG_ENDIAN else "<u4"
    order = np.frombuffer(header, kind, 6).astype(np.uint64)
    fields = np.frombuffer(header, ">u4").astype(np.uint64)
    state = _sums(order[None, :])[0]
    if not header.startswith(_MAGIC) or (state != fields[6:8]).any():
        return None
    numbers = frames.view(kind)
    added = _sums(np.concatenate([numbers[:, :2], numbers[:, 6:]], axis=1).astype(np.uint64))
    advance, _ = _weights((8 + _PAGE) // 8)
    stored = frames.astype(np.uint64)
    for index, frame in enumerate(stored):
        state = (advance @ state + added[index]) & _BITS
        if (frame[2:4] != fields[4:6]).any() or (frame[4:6] != state).any():
            return index
    return len(frames)


def _sums(numbers: _Numbers) -> _Numbers:
    """Return SQLite's checksum of each row, begun with zeros."""
    _, weights = _weights(numbers.shape[1] // 2)
    sums: _Numbers = (numbers @ weights) & _BITS
    return sums


def _weights(pairs: int) -> tuple[_Numbers, _Numbers]:
    """Return how a checksum depends on the one before and on each number.

    For each pair ``x, y`` of numbers, it goes on from ``s, t`` to ``s + t + x`` and
    ``s + 2t + x + y``, modulo 2 ** 32. That is linear, so there is no loop over numbers.
    """
    step = np.array([[1, 1], [1, 2]], np.uint64)
    power = np.eye(2, dtype=np.uint64)
    weights = np.empty((pairs, 2, 2), np.uint64)
    for pair in reversed(range(pairs)):
        weights[pair] = [power.sum(axis=1), power[:, 1]]
        power = (power @ step) & _BITS
    return power, weights.reshape(2 * pairs, 2)
