"""Decide which objects are listed at a viewpoint, and find their boxes in its views."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.dataset._houses import House
from reverie_eval.geometry._framing import boxes_in_views

Occlusion = Literal["none", "paper"]
"""``none`` keeps every box; ``paper`` removes those that :func:`is_hidden` finds."""

MAX_DISTANCE = 3.0
"""Metres. Source: Qi et al., "REVERIE", CVPR 2020, section 3: objects within 3 metres. The released
files list objects nearer than 2 metres (38,283 of their 38,293 entries)."""

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
"""Raw category names that are frequent in Matterport3D but never occur in the released files.

Only equal names are excluded: the released files do list ``shower wall``, ``garage door`` and
``doorway``.
"""


@dataclass(frozen=True, slots=True)
class BoxRules:
    """How boxes are built."""

    max_distance: float = MAX_DISTANCE
    """Metres; objects whose centre is at least this far from the camera are not listed."""
    occlusion: Occlusion = "none"
    excluded_names: frozenset[str] = EXCLUDED_NAMES
    """Objects with these names are not listed and do not hide others."""


Box: TypeAlias = Sequence[int]
"""Left, top, width and height in pixels."""
ListedBoxes: TypeAlias = Mapping[int, Mapping[int, Box]]
"""By object id and view index; an object without boxes is listed but not visible."""


def exclude_names(house: House, rules: BoxRules) -> House:
    """Return the house without the objects that have excluded names."""
    return house.take(
        np.array([name not in rules.excluded_names for name in house.names], dtype=np.bool_)
    )


def list_objects(house: House, position: FloatArray, rules: BoxRules) -> ListedBoxes:
    """Return the objects listed at a viewpoint, in the order of object ids and views.

    ``position``, shape (3,), is the camera's in the scan's frame, metres. The rules' names are
    ignored here: all objects of the house may be listed, and may hide each other.
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
    """Return the objects listed at a viewpoint in the published form."""
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
    """Return the metres from the camera to the objects' centres."""
    # Written out because numpy's norm differs in the last bit between machines, and the files must
    # have the same bytes everywhere.
    x, y, z = (house.boxes.centre - position).T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def is_hidden(view: IntArray, box_xywh: IntArray, distance: FloatArray) -> BoolArray:
    """Whether each box lies entirely within the box of a nearer object in the same view.

    Boxes are compared with all others, including hidden ones, so their order does not matter. Equal
    boxes lie within each other; objects at the same distance do not hide each other.

    ``view`` is the view that each box is in, and ``distance`` the metres from the camera to the
    centre of its object.

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
    for index in np.unique(view):
        rows = np.flatnonzero(view == index)
        near, far = box_xywh[rows, :2], box_xywh[rows, :2] + box_xywh[rows, 2:]
        contains = ((near[:, None] <= near) & (far[:, None] >= far)).all(axis=-1)
        is_nearer = distance[rows, None] < distance[rows]
        hidden[rows] = (contains & is_nearer).any(axis=0)
    return hidden
