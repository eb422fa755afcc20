"""Tables of ids: all ids of a file are found at once, by their letters."""

from collections.abc import Sequence

import numpy as np

from reverie_eval.arrays import Array, IntArray, KeyTable

ID_LENGTH = 32
"""Letters of a viewpoint id: hexadecimal digits."""
# Bytes of the shortest row that can be found.
_KEY_LENGTH = 16


class ViewpointTable:
    """Finds viewpoint ids as they are in a file, without a text for each."""

    def __init__(self, ids: Sequence[str]) -> None:
        self.ids = ids
        """All of them; the table has those of the usual length, of letters and digits alone."""
        # JSON writes these as they are, and nothing else that a file has looks like them.
        is_usual = [len(each) == ID_LENGTH and each.isascii() and each.isalnum() for each in ids]
        # In 32 bits, they take half the memory where there are millions of poses.
        rows = np.flatnonzero(is_usual).astype(np.int32)
        letters = np.array([ids[row] for row in rows.tolist()], f"S{ID_LENGTH}")
        self._table = _LetterTable(letters, rows)

    def find(self, letters: Array) -> IntArray | None:
        """Return the index of each id, or None if there are others among them.

        ``letters`` has a row of ``ID_LENGTH`` bytes for each id, as one item.
        """
        return self._table.find(letters)


class InstrIdTable:
    """Finds instr_ids, which a dictionary would look up one by one, each somewhere in memory."""

    def __init__(self, instr_ids: Sequence[str]) -> None:
        longest = max(map(len, instr_ids), default=0)
        # A row ends with a zero. Ids that are too long are cut to rows that do not.
        self._type = f"S{max(_KEY_LENGTH, 8 * (longest // 8 + 1))}"
        letters = np.array([each.encode() for each in instr_ids], self._type)
        self._table = _LetterTable(letters, np.arange(len(letters)))

    def find(self, instr_ids: Sequence[str | None]) -> IntArray | None:
        """Return the index of each id, or None if there are others or unusual ones among them."""
        try:
            letters = "".join(instr_ids)  # type: ignore[arg-type]
        except TypeError:  # of None
            return None
        # Beyond ASCII, numpy raises an error; and it takes zeros for the end of a text.
        if "\0" in letters or not letters.isascii():
            return None
        return self._table.find(np.array(instr_ids, self._type))


class _LetterTable:
    """Finds rows of bytes of the same length, which is a multiple of eight."""

    def __init__(self, letters: Array, numbers: IntArray) -> None:
        words = _words_of(letters)
        keys = _key_of(words)
        order = np.argsort(keys)
        self._words, self._numbers = words[order], numbers[order]
        self._table = KeyTable(keys[order])

    def find(self, letters: Array) -> IntArray | None:
        """Return the number of each row, or None if there are others among them."""
        if not self._numbers.size:
            return None
        words = _words_of(letters)
        index, _ = self._table.find(_key_of(words))
        # Different keys have different words, too.
        is_known = (self._words.take(index, axis=0) == words).all()
        return self._numbers[index] if is_known else None


def _words_of(letters: Array) -> Array:
    return letters.view(np.uint64).reshape(-1, letters.itemsize // 8)


def _key_of(words: Array) -> IntArray:
    # The first sixteen letters of an id are its own. One that shares them is not found.
    return words[:, 0] * np.uint64(0xC2B2AE3D27D4EB4F) + words[:, 1]
