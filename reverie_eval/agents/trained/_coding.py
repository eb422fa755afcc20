"""Instructions and observations as numbers: the same in training and in a run."""

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.geometry import HEIGHT, N_HEADINGS, WIDTH
from reverie_eval.simulator import Observation
from reverie_eval.text import tokenize

UNKNOWN = 0
"""The index of words, and of viewpoints, that training did not have."""
MAX_WORDS = 80
"""Words of an instruction that are read. Source: ``MAX_INPUT_LENGTH`` in ``trainFast.py`` of
YuankaiQi/REVERIE."""
N_LOCATION = 9
N_OFFSET = 5
N_AROUND = 5
"""Objects around a candidate that its relation module looks at. Source: Yu et al., 2018, section
3.2.3."""
_LEAST_COUNT = 3


def words_of(text: str) -> Sequence[str]:
    """Return the words of a text, each without a final s, so that chairs are a chair."""
    return [word.removesuffix("s") for word in tokenize(text)]


@dataclass(frozen=True)
class Vocabulary:
    """The words that a model knows; the index of the first is 1."""

    words: tuple[str, ...]

    @classmethod
    def build(cls, instructions: Iterable[str], names: Iterable[str]) -> "Vocabulary":
        """Take the words that occur in three instructions or in a name."""
        counts = Counter(word for text in instructions for word in {*words_of(text)})
        frequent = {word for word, count in counts.items() if count >= _LEAST_COUNT}
        return cls(tuple(sorted(frequent.union(*map(words_of, names)))))

    @cached_property
    def index(self) -> Mapping[str, int]:
        """The index of each word."""
        return {word: index for index, word in enumerate(self.words, 1)}

    @property
    def digest(self) -> str:
        """SHA-256 of the words in their order."""
        return hashlib.sha256(json.dumps(self.words).encode()).hexdigest()

    def encode(self, text: str) -> IntArray:
        """Return the indices of a text's words, of one at least."""
        known = self.index
        indices = [known.get(word, UNKNOWN) for word in words_of(text)[:MAX_WORDS]]
        return np.array(indices or [UNKNOWN])


@dataclass(frozen=True, eq=False)
class Panorama:
    """All that can be observed at a viewpoint, whichever way the agent faces.

    Slots are the actions: 0 is to stop, with the objects visible from here; the others are the
    neighbours, each with the objects in the view that faces it and in those beside that.
    """

    viewpoint_ids: tuple[str, ...]
    """Shape (n_slots,): this viewpoint, then the neighbours."""
    ways: FloatArray
    """Shape (n_slots - 1, 3): heading and elevation in radians, and metres."""
    viewpoint: IntArray
    """Shape (n_slots,): indices of viewpoints in the model's memory."""
    in_slot: BoolArray
    """Shape (n_slots, n_objects): which objects are in each slot."""
    slot: IntArray
    """Shape (n_seen,): the slot of each name that is seen there, ascending."""
    seen: IntArray
    """Shape (n_seen,): the name, an index into the coder's."""
    object_id: IntArray
    """Shape (n_objects,): the objects visible from here."""
    name: IntArray
    """Shape (n_objects,): their names."""
    box: FloatArray
    """Shape (n_objects, 4): heading, elevation, width and height of each one's largest box, as
    parts of a turn, of the height of a view, and of its width."""

    @cached_property
    def layout(self) -> "Layout":
        """Where the objects are among each other."""
        return Layout.of(self.name, self.box)


class Layout(NamedTuple):
    """Where the objects at a viewpoint are among each other."""

    location: FloatArray
    """Shape (n_objects, N_LOCATION): elevation, width, height and area of an object's box, how far
    it differs in these from the mean of those of its name, and the number of those."""
    around: IntArray
    """Shape (n_objects, N_AROUND): the names of the nearest objects of other names; -1 if there are
    fewer."""
    offset: FloatArray
    """Shape (n_objects, N_AROUND, N_OFFSET): the way to these: sine and cosine of the heading,
    elevation, and the ratios of widths and heights, as logarithms."""

    @classmethod
    def of(cls, name: IntArray, box: FloatArray) -> "Layout":
        """Compute it from names and largest boxes."""
        n_objects = len(name)
        own = np.column_stack([box[:, 1:], box[:, 2] * box[:, 3]])
        is_rival = name[:, None] == name
        n_rivals = is_rival.sum(axis=1, keepdims=True)
        location = np.column_stack([own, own - (is_rival @ own) / n_rivals, np.log(n_rivals)])
        turn = (box[None, :, 0] - box[:, None, 0]) * math.tau
        rise = box[None, :, 1] - box[:, None, 1]
        size = box[:, 2:].clip(min=1e-3)
        ratio = np.log(size / size[:, None])
        distance = np.where(is_rival, np.inf, 2 - 2 * np.cos(turn) + rise**2)
        nearest = np.argsort(distance, axis=1, kind="stable")[:, :N_AROUND]
        is_there = np.isfinite(np.take_along_axis(distance, nearest, axis=1))
        around = np.full((n_objects, N_AROUND), -1)
        offset = np.zeros((n_objects, N_AROUND, N_OFFSET))
        width = nearest.shape[1]
        around[:, :width] = np.where(is_there, name[nearest], -1)
        ways = np.dstack([np.sin(turn), np.cos(turn), rise, ratio])
        near = np.take_along_axis(ways, nearest[:, :, None], axis=1)
        offset[:, :width] = np.where(is_there[:, :, None], near, 0)
        return cls(location, around, offset)


class Coder:
    """Turns instructions and observations into numbers.

    Parameters
    ----------
    vocabulary : Vocabulary
    remembered : sequence of str
        Viewpoints of the buildings in which a model was trained.
    reads_objects : bool
        Whether names and boxes are read; without, nothing is visible.
    """

    def __init__(
        self, vocabulary: Vocabulary, remembered: Sequence[str] = (), *, reads_objects: bool = True
    ) -> None:
        self._reads_objects = reads_objects
        self.vocabulary = vocabulary
        self.remembered = tuple(remembered)
        self._viewpoints = {each: index for index, each in enumerate(remembered, 1)}
        self._names: dict[str, int] = {}
        self._tokens: list[IntArray] = []
        self._padded: IntArray = np.zeros((0, 1), dtype=np.int64)
        self._name("")  # so that there is one, even where nothing is visible

    @property
    def tokens(self) -> IntArray:
        """Shape (n_names, n_tokens): the words of all names so far, then -1."""
        if len(self._padded) < len(self._tokens):
            self._padded = np.full((len(self._tokens), max(map(len, self._tokens))), -1)
            for row, tokens in zip(self._padded, self._tokens, strict=True):
                row[: len(tokens)] = tokens
        return self._padded

    def matches(self, words: IntArray) -> FloatArray:
        """Return the share of each name's words that are among some words, shape (n_names,)."""
        is_said = np.zeros(len(self.vocabulary.words) + 2, dtype=np.bool_)  # the last is for -1
        is_said[words] = True
        is_said[UNKNOWN] = False
        tokens = self.tokens
        return np.asarray(is_said[tokens].sum(axis=1) / (tokens >= 0).sum(axis=1))

    def panorama(self, seen: Observation) -> Panorama:
        """Return an observation without the direction of the agent."""
        objects = seen.candidates if self._reads_objects else ()
        name = np.array([self._name(each.name) for each in objects], dtype=np.int64)
        views = [{box.view for box in each.boxes} for each in objects]
        facing = [_beside(way.view) for way in seen.neighbours]
        in_slot = np.array(
            [[True] * len(views), *[[bool(its & v) for v in views] for its in facing]],
            dtype=np.bool_,
        )
        slot, index = in_slot.nonzero()
        pairs = np.array(sorted({*zip(slot.tolist(), name[index].tolist(), strict=True)}))
        slot_and_name = pairs.reshape(-1, 2).astype(np.int64)
        ids = (seen.viewpoint_id, *(each.viewpoint_id for each in seen.neighbours))
        return Panorama(
            viewpoint_ids=ids,
            in_slot=in_slot,
            ways=np.array(
                [
                    (
                        each.relative_heading + seen.heading,
                        each.relative_elevation + seen.elevation,
                        each.distance,
                    )
                    for each in seen.neighbours
                ]
            ).reshape(-1, 3),
            viewpoint=np.array([self._viewpoints.get(each, UNKNOWN) for each in ids]),
            slot=slot_and_name[:, 0],
            seen=slot_and_name[:, 1],
            object_id=np.array([each.object_id for each in objects], dtype=np.int64),
            name=name,
            box=np.array([_largest(each.boxes) for each in objects]).reshape(-1, 4),
        )

    def _name(self, name: str) -> int:
        index = self._names.setdefault(name, len(self._names))
        if index == len(self._tokens):
            self._tokens.append(self.vocabulary.encode(name))
        return index


def _beside(view: int) -> set[int]:
    """Return a view and the two beside it, in the same row."""
    first = view - view % N_HEADINGS
    return {first + (view + turn) % N_HEADINGS for turn in (-1, 0, 1)}


def _largest(boxes: Sequence[tuple[int, tuple[int, int, int, int]]]) -> tuple[float, ...]:
    """Return the direction and the size of an object's largest box."""
    view, (x, y, width, height) = max(boxes, key=lambda box: box[1][2] * box[1][3])
    row, column = divmod(view, N_HEADINGS)
    # A view is 60 degrees high, so 80 wide; rows and columns are 30 degrees apart.
    heading = (column * 30 + ((x + width / 2) / WIDTH - 0.5) * 80) / 360
    elevation = ((row - 1) * 30 + (0.5 - (y + height / 2) / HEIGHT) * 60) / 60
    return heading, elevation, width / WIDTH, height / HEIGHT
