"""How large the boxes are, and how they lie in the picture."""

import numpy as np

from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.geometry import HEIGHT, WIDTH
from reverie_eval.linting.boxes import Boxes
from reverie_eval.linting.rows import Count, Found, Spread, fact, remark, spread
from reverie_eval.linting.visibility_checks import found_visible

SLIVER = 4
"""Pixels of the shorter side up to which a box is a sliver."""
SPECK = 100
"""Pixels of area up to which an object's largest box is a speck."""


def border(xywh: IntArray) -> BoolArray:
    """Whether boxes touch the picture's left, upper, right and lower border: shape (n, 4)."""
    near, far = xywh[:, :2], xywh[:, :2] + xywh[:, 2:]
    return np.concatenate([near <= 0, far >= (WIDTH, HEIGHT)], axis=1)


def box_size_counts(boxes: Boxes) -> list[Count]:
    """Count boxes that are cut by the picture's border, fill it, or are next to nothing."""
    size, touches = boxes.box_xywh[:, 2:], border(boxes.box_xywh)
    largest = largest_area(boxes)
    return [
        fact("at-border", "boxes that touch a border", int(touches.any(axis=1).sum()), len(size)),
        *(
            fact(f"at-{side}", f"boxes that touch the {words} border", number, len(size))
            for (side, words), number in zip(_SIDES, touches.sum(axis=0).tolist(), strict=True)
        ),
        remark(
            "full-picture",
            "boxes that are the whole picture",
            "Any box of half the picture matches them: report how a whole-picture answer does.",
            Found.where((size == (WIDTH, HEIGHT)).all(axis=1), boxes.name_of_box),
        ),
        remark(
            "sliver",
            f"boxes with a side of at most {SLIVER} pixels",
            "What is left of an object at a border, or seen between others.",
            Found.where(size.min(axis=1) <= SLIVER, boxes.name_of_box),
        ),
        remark(
            "one-pixel",
            "boxes of a single pixel",
            "They are among the slivers.",
            Found.where((size == 1).all(axis=1), boxes.name_of_box),
        ),
        remark(
            "speck",
            f"visible objects whose largest box has at most {SPECK} pixels",
            "They count as visible although hardly anything is seen.",
            found_visible(boxes, largest <= SPECK),
        ),
        remark(
            "one-pixel-object",
            "visible objects whose largest box is a single pixel",
            "They are among the specks.",
            found_visible(boxes, largest == 1),
        ),
    ]


_SIDES = (("left", "left"), ("top", "upper"), ("right", "right"), ("bottom", "lower"))


def box_size_spreads(boxes: Boxes) -> list[Spread]:
    """Measure places and sizes of the boxes."""
    left, top, width, height = boxes.box_xywh.T
    return [
        spread("box-left", "left edge of the boxes", "px", left),
        spread("box-top", "upper edge of the boxes", "px", top),
        spread("box-width", "width of the boxes", "px", width),
        spread("box-height", "height of the boxes", "px", height),
        spread("box-right", "right edge of the boxes: left and width", "px", left + width),
        spread("box-bottom", "lower edge of the boxes: top and height", "px", top + height),
        spread("box-area", "area of the boxes", "px", width * height),
    ]


def largest_area(boxes: Boxes) -> IntArray:
    """Pixels of the largest box of each entry, shape (n_entries,); 0 without a box."""
    area = np.zeros(len(boxes.listed), dtype=np.int64)
    np.maximum.at(area, boxes.box_entry, boxes.box_xywh[:, 2:].prod(axis=1))
    return area
