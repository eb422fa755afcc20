"""A solution that appears nowhere else, planted in a private split, and a search for it.

Real object ids are short numbers, which any reply holds for some other reason. Planted ones have
ten digits, the boxes are all the same odd one, and the categories are no words. Viewpoint ids are
known to everybody; what gives an answer away is one that nobody has sent and no episode starts
from.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from reverie_eval import GroundTruth, Scores
from reverie_eval.arrays import Array
from reverie_eval.ground_truth import Bundle, pack_texts
from tests.support.signing import payloads_in
from tests.support.worlds import with_arrays

FIRST_OBJECT = 1_999_000_019
BOX = (601, 433, 37, 29)
CATEGORY = "zzcategory"
_DECIMALS = 4
"""Decimals of a fraction that has two decimals in percent."""
_FEW = 10
"""Numbers in a row that are no list of episodes."""
_CLOCK = re.compile(
    r"(?<=\d\d:\d\d:\d\d)\.\d{6}|^(\w+_(?:seconds|created)\w*(?:\{.*\})?) \S+$", re.MULTILINE
)
"""Microseconds of times, and metrics' values that a clock gave: the digits may be any score's."""


def planted(bundle: Bundle) -> Bundle:
    """Return a split with an unmistakable solution in the place of its own."""
    arrays = bundle.arrays
    changed = with_arrays(
        bundle,
        task_target=_planted(arrays["task_target"]),
        candidate_object=_planted(arrays["candidate_object"]),
        box_xywh=np.tile(np.array(BOX), (len(arrays["box_xywh"]), 1)),
    )
    items = len(arrays["task_target"])
    texts = {
        **bundle.texts,
        "target_category": pack_texts([f"{CATEGORY}{n}" for n in range(items)]),
        "candidate_category": pack_texts([CATEGORY] * len(arrays["candidate_object"])),
    }
    origin = changed.header.split, changed.header.dataset, changed.header.sources
    return Bundle.build(*origin, changed.arrays, bundle.other_splits, texts=texts)


def _planted(object_id: Array) -> Array:
    """Keep the order of ids, so that candidates stay sorted."""
    return FIRST_OBJECT + 7_919 * object_id.astype(np.int64)


@dataclass(frozen=True)
class Secrets:
    """What nobody may be told of a split, each kind as what a text would hold."""

    patterns: Mapping[str, re.Pattern[str]]

    @classmethod
    def of(cls, truth: GroundTruth, sent: Iterable[bytes], scores: Iterable[Scores]) -> "Secrets":
        """Gather the secrets of a planted split that these submissions were sent to."""
        known = b"".join(sent).decode()
        starts = {truth.graph.viewpoint_ids[start] for start in truth.episodes.start.tolist()}
        goals = {truth.graph.viewpoint_ids[goal] for goal in truth.require_solution().path.tolist()}
        hidden = sorted(each for each in goals - starts if each not in known)
        exact = sorted({re.escape(digits) for each in scores for digits in _exact_digits(each)})
        assert len(hidden) > 10
        assert len(exact) > 5
        box = r"\D{1,4}".join(rf"{number}(\.0)?" for number in BOX)
        return cls(
            {
                "target object": re.compile(r"(?<![0-9a-f])1999\d{6}(?![0-9a-f])"),
                "goal or path": re.compile("|".join(hidden)),
                "box": re.compile(box),
                "category": re.compile(CATEGORY),
                "mean that is not rounded": re.compile(rf"(?<!\d)({'|'.join(exact)})"),
            }
        )

    def found_in(self, text: str) -> Iterator[str]:
        """Return what kinds of secrets a text holds, also within what is signed in it."""
        for signed in payloads_in(text):
            yield from self.found_in(signed)
        timeless = _CLOCK.sub(r"\1", text)
        yield from (kind for kind, pattern in self.patterns.items() if pattern.search(timeless))
        try:
            document = json.loads(text)
        except ValueError:
            return
        yield from _found_in_document(document)


def _exact_digits(scores: Scores) -> Iterator[str]:
    """Return the first digits of means and of percentages, if rounded ones have others."""
    for mean in scores.values():
        for value, digits in ((mean, 6), (100 * mean, 4)):
            written = f"{value:.12f}"
            shown = written[: written.index(".") + 1 + digits]
            if not re.search(r"(0|9){2}$", shown):
                yield shown


def _found_in_document(document: Any) -> Iterator[str]:
    if isinstance(document, float) and round(document, _DECIMALS) != document:
        yield "number that is not rounded"
    if isinstance(document, list):
        numbers = [each for each in document if isinstance(each, int | float)]
        if len(numbers) > _FEW:
            yield "list of numbers"
        for each in document:
            yield from _found_in_document(each)
    if isinstance(document, dict):
        boxes = document.get("boxes")
        if isinstance(boxes, dict) and any(
            isinstance(each, int | float) for each in boxes.values()
        ):
            yield "what became of boxes"
        for each in document.values():
            yield from _found_in_document(each)
