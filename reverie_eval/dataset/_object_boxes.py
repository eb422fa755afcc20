"""Which objects are listed at a viewpoint, and their boxes in its views."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.dataset._houses import House
from reverie_eval.geometry._framing import boxes_in_views

Occlusion = Literal["none", "paper"]
"""``none``: every box stays. ``paper``: those of :func:`is_hidden` are removed."""

MAX_DISTANCE = 3.0
"""Metres. Source: Qi et al., "REVERIE", CVPR 2020, section 3: objects within 3 metres. The released
files list what is nearer than 2 metres (38,283 of their 38,293 entries)."""

EXCLUDED_NAMES = frozenset(
    {
        "ceiling",
        "delete",
        "door",
        "door frame",
        "doorframe",
        "floor",
        "handrail",
        "object",
        "remove",
        "roof",
        "shower floor",
        "stairs",
        "unknown",
        "wall",
        "wall frame",
    }
)
"""Raw category names that are frequent in Matterport3D and occur nowhere in the released files.

They are compared unchanged: ``shower wall``, ``garage door`` and ``doorway`` are listed there.
"""


@dataclass(frozen=True, slots=True)
class BoxRules:
    """How boxes are built."""

    max_distance: float = MAX_DISTANCE
    """Metres from the camera to an object's centre; what is not nearer is not listed."""
    occlusion: Occlusion = "none"
    excluded_names: frozenset[str] = EXCLUDED_NAMES
    """Objects with these names are not listed, and do not hide others."""


Box: TypeAlias = Sequence[int]
"""Left, top, width and height in pixels."""
ListedBoxes: TypeAlias = Mapping[int, Mapping[int, Box]]
"""By object id and view index; an object without boxes is listed, and not visible."""


def listable(house: House, rules: BoxRules) -> House:
    """Return the house without the objects whose names are excluded."""
    return house.take(
        np.array([name not in rules.excluded_names for name in house.names], dtype=np.bool_)
    )


def list_objects(house: House, position: FloatArray, rules: BoxRules) -> ListedBoxes:
    """Return what is listed at a viewpoint, in the order of object ids and views.

    Parameters
    ----------
    house : House
        The objects that may be listed, and may hide each other.
    position : float array of shape (3,)
        The camera's place in the world, metres.
    rules : BoxRules
        What is near, and what is hidden; names are not considered.
    """
    near = house.take(_distances(house, position) < rules.max_distance)
    box, view, box_xywh = boxes_in_views(position, near.boxes)
    if rules.occlusion == "paper":
        shown = ~is_hidden(view, box_xywh, _distances(near, position)[box])
        box, view, box_xywh = box[shown], view[shown], box_xywh[shown]
    boxes_of: dict[int, dict[int, Box]] = {object_id: {} for object_id in near.object_id.tolist()}
    columns = near.object_id[box].tolist(), view.tolist(), box_xywh.tolist()
    for object_id, index, xywh in zip(*columns, strict=True):
        boxes_of[object_id][index] = xywh
    return boxes_of


def published_form(house: House, listed: ListedBoxes) -> dict[str, dict[str, Any]]:
    """Return what is listed at a viewpoint in the published form."""
    names = dict(zip(house.object_id.tolist(), house.names, strict=True))
    return {
        str(object_id): {
            "name": names[object_id],
            "visible_pos": list(boxes),
            "bbox2d": list(boxes.values()),
        }
        for object_id, boxes in listed.items()
    }


def _distances(house: House, position: FloatArray) -> FloatArray:
    """Metres from the camera to the objects' centres."""
    # Written out, because numpy's norm differs between machines in the last bit.
    x, y, z = (house.boxes.centre - position).T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def is_hidden(view: IntArray, box_xywh: IntArray, distance: FloatArray) -> BoolArray:
    """Whether each box lies wholly within the box of a nearer object in the same view.

    Boxes are compared with all others, hidden ones included, so their order does not matter.
    Equal boxes count as within each other; objects at the same distance do not hide each other.

    Parameters
    ----------
    view : int array of shape (n,)
        The view that each box is in.
    box_xywh : int array of shape (n, 4)
        Left, top, width and height in pixels.
    distance : float array of shape (n,)
        Metres from the camera to the centre of the box's object.

    Returns
    -------
    bool array of shape (n,)

    References
    ----------
    .. [1] Qi et al., "REVERIE", CVPR 2020, section 3: a box that is fully covered by another and
       has a larger depth is removed.

    Examples
    --------
    >>> boxes = np.array([[0, 0, 9, 9], [0, 0, 9, 5], [0, 0, 9, 9]])
    >>> is_hidden(np.array([12, 12, 13]), boxes, np.array([1.0, 2.0, 2.0]))
    array([False,  True, False])
    """
    hidden = np.zeros(len(view), dtype=np.bool_)
    for shown in np.unique(view):
        rows = np.flatnonzero(view == shown)
        hidden[rows] = _is_hidden_in_view(box_xywh[rows], distance[rows])
    return hidden


def _is_hidden_in_view(box_xywh: IntArray, distance: FloatArray) -> BoolArray:
    """Whether each box of one view is hidden by another."""
    left, top, width, height = box_xywh.T
    right, bottom = left + width, top + height
    contains = (
        (left[:, None] <= left)
        & (top[:, None] <= top)
        & (right[:, None] >= right)
        & (bottom[:, None] >= bottom)
    )
    return np.asarray((contains & (distance[:, None] < distance)).any(axis=0))
