"""Declared subsets: some episodes of a split, for quick or costly evaluations.

A list of episodes has a digest, which is part of the signature of every score: results on a subset
are comparable with each other, and never with those on the whole split.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from reverie_eval.arrays import IntArray
from reverie_eval.errors import SHOWN_PROBLEMS, Problem, ProtocolError, SubsetError
from reverie_eval.tasks import BUILT_IN, find_task
from reverie_eval.text import count_text, tokenize

_DIGEST_SHOWN = 12
# The fields of a record that can hold its id, in any of the tasks.
_ID_KEYS = [
    *dict.fromkeys(key for name in BUILT_IN for key in find_task(name).id_field.names),
    "id",
]
_JSON = ("[", "{", '"')


def read_episode_ids(file: str | PathLike[str]) -> Sequence[str]:
    """Read a list of episodes: an id a line; blank lines are left out.

    A JSON list of ids, of numbers or of records with an id is read as well, and so is a list under
    the only key of an object. The text may be UTF-8 or UTF-16, and begin with a byte order mark.

    Raises
    ------
    SubsetError
        If the file is neither.
    OSError
        If it cannot be read.
    """
    content = Path(file).read_bytes()
    try:
        text = content.decode(json.detect_encoding(content))
    except UnicodeDecodeError:
        message = "is not a text file; expected an instr_id on each line"
        raise SubsetError([Problem("not-text", "file", message)]) from None
    if text.lstrip().startswith(_JSON):
        return _ids_of_json(text)
    return [line.strip() for line in text.splitlines() if line.strip()]


def _ids_of_json(text: str) -> Sequence[str]:
    listed = _parse(text)
    if isinstance(listed, dict) and len(listed) == 1:
        (listed,) = listed.values()
    entries = listed if isinstance(listed, list) else [None]
    ids = [_id_of(each) for each in entries]
    if None in ids:
        where = f"entry {ids.index(None) + 1}" if entries is listed else "file"
        message = 'is not a JSON list of ids; write ["...", "..."], or an id on each line'
        raise SubsetError([Problem("not-a-list", where, message)])
    return [str(each).strip() for each in ids]


def _parse(text: str) -> Any:
    """Parse JSON, or JSON Lines; None if it is neither."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        pass
    try:
        return [json.loads(line) for line in text.splitlines() if line.strip()]
    except (ValueError, RecursionError):
        return None


def _id_of(entry: Any) -> str | int | None:
    """Return the id that an entry of a JSON list is, or has; None if it has none."""
    found = entry
    if isinstance(entry, dict):
        found = next((entry[key] for key in _ID_KEYS if key in entry), None)
    return found if isinstance(found, str | int) and not isinstance(found, bool) else None


def subset_rows(chosen: Sequence[str], index: Mapping[str, int], split: str) -> IntArray:
    """Return the rows of the chosen episodes, ascending, or raise SubsetError with all problems."""
    if not chosen:
        message = f"no episode is listed; list the instr_ids of some episodes of {split}"
        raise SubsetError([Problem("no-episode", "list", message)])
    if len(chosen) > SHOWN_PROBLEMS and not any(each in index for each in chosen):
        message = (
            f"none of its {len(chosen):,} entries is an episode of {split}, the first is "
            f"{chosen[0]!r}; choose their split"
        )
        raise SubsetError([Problem("unknown-episode", "list", message)])
    first: dict[str, int] = {}
    problems = []
    for number, instr_id in enumerate(chosen, 1):
        where = f"entry {number}"
        if instr_id not in index:
            message = f"{instr_id!r} is not an episode of {split}; remove it, or choose its split"
            problems.append(Problem("unknown-episode", where, message, (number,)))
        elif first.setdefault(instr_id, number) < number:
            message = f"{instr_id} is listed already, in entry {first[instr_id]}; remove one"
            problems.append(Problem("duplicate-episode", where, message, (number,)))
    if problems:
        raise SubsetError(problems)
    return np.array(sorted(index[instr_id] for instr_id in chosen))


def subset_digest(instr_ids: Sequence[str]) -> str:
    """Return the digest of a list of episodes; their order does not matter."""
    return _digest("\n".join(sorted(instr_ids)))[:_DIGEST_SHOWN]


def draw_subset(strata: Mapping[str, str], number: int, seed: int, split: str) -> Sequence[str]:
    """Draw episodes at random, from each stratum in proportion to its size.

    Episodes are ordered by the SHA-256 of the seed and their id, so that the same ones are drawn by
    every version of every program.

    Parameters
    ----------
    strata : mapping of str to str
        The stratum of each episode, by instr_id; use a single stratum to draw from all alike.
    number : int
        Number of episodes to draw.
    seed : int
    split : str
        The split's name, for the error.

    Raises
    ------
    ProtocolError
        If there are not that many.
    """
    if not 1 <= number <= len(strata):
        raise ProtocolError(
            f"{split} has {count_text(len(strata), 'episode')}; choose between 1 and all of them, "
            f"got {number:,}"
        )
    members: defaultdict[str, list[str]] = defaultdict(list)
    for instr_id in sorted(strata, key=lambda each: _digest(f"{seed}:{each}")):
        members[strata[instr_id]].append(instr_id)
    # Largest remainders: each stratum has its share, rounded down or up.
    exact = {stratum: number * len(ids) / len(strata) for stratum, ids in members.items()}
    count = {stratum: int(share) for stratum, share in exact.items()}
    by_remainder = sorted(exact, key=lambda each: (count[each] - exact[each], each))
    for stratum in by_remainder[: number - sum(count.values())]:
        count[stratum] += 1
    drawn = {each for stratum, ids in members.items() for each in ids[: count[stratum]]}
    return [instr_id for instr_id in strata if instr_id in drawn]


def find_words(words: Sequence[str], instructions: Mapping[str, str]) -> Sequence[str]:
    """Return the episodes whose instruction has all of the words; see :meth:`Scores.with_words`."""
    wanted = {token for word in words for token in tokenize(word)}
    if not wanted:
        raise ProtocolError("with_words needs a word that instructions may have")
    tokens = {instr_id: set(tokenize(text)) for instr_id, text in instructions.items()}
    chosen = [instr_id for instr_id, found in tokens.items() if wanted <= found]
    if not chosen:
        unknown = sorted(wanted.difference(*tokens.values()))
        which = f": {', '.join(unknown)} is in none of them" if unknown else ""
        raise ProtocolError(f"no instruction has all the words {' '.join(words)!r}{which}")
    return chosen


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
