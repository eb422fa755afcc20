"""Which objects can be seen, from how many viewpoints and in how many views."""

from collections import Counter

import numpy as np

from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.geometry import N_VIEWS
from reverie_eval.linting.boxes import Boxes
from reverie_eval.linting.rows import Count, Found, Spread, fact, remark, spread
from reverie_eval.wording import category_in_words

OFTEN = 100
"""Times that a name is listed, from which on the share of them that is visible says something."""


def visibility_counts(boxes: Boxes) -> list[Count]:
    """Count objects and viewpoints by what is visible, which listed alone is not."""
    listing = len(np.unique(boxes.place))
    seeing = len(np.unique(boxes.place[boxes.is_visible]))
    objects, first = np.unique(boxes.scan_object, return_index=True)
    seen_from = _viewpoints_per_object(boxes)
    never = ~np.isin(objects, boxes.scan_object[boxes.is_visible])
    return [
        fact("listing-viewpoints", "viewpoints that list an object", listing, len(boxes.places)),
        fact("seeing-viewpoints", "viewpoints that see an object", seeing, len(boxes.places)),
        fact("objects", "objects listed somewhere", len(objects)),
        fact("visible-objects", "objects visible somewhere", len(seen_from), len(objects)),
        remark(
            "never-visible",
            "objects that are listed and visible nowhere",
            "None of them can be a target.",
            Found.where(never, lambda row: boxes.name_of_entry(first[row])),
        ),
        remark(
            "listed-not-visible",
            "listed objects that no view shows",
            "Listed is not visible: the dataset's own eval_release.py leaves them out.",
            Found.where(~boxes.is_visible, boxes.name_of_entry),
        ),
        _hidden_names(boxes),
        fact("visible", "listed objects that a view shows", len(boxes.visible), len(boxes.listed)),
        *(
            fact(code, f"objects visible from {words}", int((seen_from == n).sum()), len(seen_from))
            for code, words, n in _FEW
        ),
        remark(
            "in-all-views",
            f"visible objects that have a box in each of the {N_VIEWS} views",
            "As if the camera stood inside them.",
            found_visible(boxes, boxes.n_views == N_VIEWS),
        ),
    ]


def _hidden_names(boxes: Boxes) -> Count:
    names = [entry.name for _, _, entry in boxes.listed]
    listed, visible = Counter(names), Counter(names[row] for row in boxes.visible.tolist())
    often = {name: visible[name] / count for name, count in listed.items() if count >= OFTEN}
    hidden = sorted((share, name) for name, share in often.items() if share < 1 / 2)
    return remark(
        "hidden-name",
        f"names that are listed {OFTEN} times or more, mostly where no view shows the object",
        "Large things near the camera are often not visible in v1; small ones nearly always are.",
        Found.among(
            [
                f"{category_in_words(name)}: {listed[name] - visible[name]} of {listed[name]}"
                for _, name in hidden
            ],
            len(often),
        ),
    )


_FEW = (
    ("seen-once", "one viewpoint", 1),
    ("seen-twice", "two viewpoints", 2),
    ("seen-thrice", "three viewpoints", 3),
)


def visibility_spreads(boxes: Boxes) -> list[Spread]:
    """Measure how much of the objects can be seen."""
    return [
        spread(
            "viewpoints-per-object",
            "viewpoints that see an object, of visible objects",
            "",
            _viewpoints_per_object(boxes),
        ),
        spread(
            "views-per-sighting",
            "views that show an object at a viewpoint that sees it",
            "",
            boxes.n_views[boxes.visible],
        ),
    ]


def found_visible(boxes: Boxes, mask: BoolArray) -> Found:
    """Count entries among those that are visible."""
    visible = boxes.visible
    return Found.where(mask[visible], lambda row: boxes.name_of_entry(visible[row]))


def _viewpoints_per_object(boxes: Boxes) -> IntArray:
    _, viewpoints = np.unique(boxes.scan_object[boxes.is_visible], return_counts=True)
    return viewpoints
