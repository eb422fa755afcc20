"""Damage to the files of a server: to each kind of page of its database, and at random."""

import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from random import Random
from types import MappingProxyType

PAGE = 4096
LENGTH = 512
"""Bytes that are overwritten at once."""
_LEAF_OF_TABLE = 13
_KINDS = {
    _LEAF_OF_TABLE: "leaf of a table",
    5: "interior of a table",
    10: "leaf of an index",
    2: "interior of an index",
}
"""Pages by their first byte; others begin with a number: https://www.sqlite.org/fileformat2.html"""

Rows = Mapping[str, Sequence[tuple[object, ...]]]


def overwrite(content: bytearray, place: int, random: Random) -> None:
    """Overwrite a block with bytes as they come, or with zeros, as a lost write leaves them."""
    content[place : place + LENGTH] = random.choice([random.randbytes(LENGTH), bytes(LENGTH)])


def damage_at_random(database: Path, seed: int, blocks: int = 5) -> None:
    """Overwrite some blocks of a file, wherever they are."""
    random = Random(seed)
    content = bytearray(database.read_bytes())
    for _ in range(blocks):
        overwrite(content, random.randrange(len(content) - LENGTH), random)
    database.write_bytes(content)


def pages_by_kind(content: bytes | bytearray) -> Mapping[str, Sequence[int]]:
    """Return where the pages of each kind begin; free pages without content are left out."""
    free = _free_pages(content)
    kinds: dict[str, list[int]] = {"header": [0], "free list": free[:1]}
    for place in range(PAGE, len(content), PAGE):
        if place not in free:
            kinds.setdefault(_kind(content[place : place + PAGE]), []).append(place)
    return kinds


def _kind(page: bytes | bytearray) -> str:
    is_leaf_of_table = page[0] == _LEAF_OF_TABLE
    return "schema" if is_leaf_of_table and b"CREATE " in page else _KINDS.get(page[0], "overflow")


def _free_pages(content: bytes | bytearray) -> list[int]:
    """Return where the free pages begin: first those that list others."""
    listing, listed = [], []
    number = _number(content, 32)
    while number:
        place = (number - 1) * PAGE
        listing.append(place)
        listed += [
            (_number(content, place + 8 + 4 * each) - 1) * PAGE
            for each in range(_number(content, place + 4))
        ]
        number = _number(content, place)
    return [*listing, *listed]


def _number(content: bytes | bytearray, place: int) -> int:
    return int.from_bytes(content[place : place + 4])


def rows_of_file(database: Path) -> Rows | None:
    """Return schema and rows of a file, read without our code; None if it cannot be read."""
    with suppress(sqlite3.DatabaseError), closing(sqlite3.connect(database)) as file:
        file.text_factory = bytes
        schema = file.execute("SELECT type, name, sql FROM sqlite_schema")
        kept = {"schema": sorted(schema, key=repr)}
        for (name,) in file.execute("SELECT name FROM sqlite_schema WHERE type = 'table'"):
            rows = file.execute(f'SELECT * FROM "{name.decode()}" NOT INDEXED')
            kept[name.decode()] = sorted(rows, key=repr)
        return kept
    return None


def _remove(path: Path) -> None:
    path.unlink()


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _empty(path: Path) -> None:
    path.write_bytes(b"")


def _put_a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _fill_with_anything(path: Path) -> None:
    path.write_bytes(Random(1).randbytes(5000))


def _link_to_itself(path: Path) -> None:
    path.unlink()
    path.symlink_to(path.name)


SPOILS: Mapping[str, Callable[[Path], None]] = MappingProxyType(
    {
        "missing": _remove,
        "cut off": _cut,
        "empty": _empty,
        "a folder": _put_a_folder,
        "anything": _fill_with_anything,
        "a link to itself": _link_to_itself,
    }
)
"""What may have become of a file."""
