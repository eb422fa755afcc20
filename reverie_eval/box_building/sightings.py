"""What is listed at a viewpoint: the objects nearby, and their boxes in its views."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.box_building.house import House
from reverie_eval.box_building.occlusion import is_hidden
from reverie_eval.box_building.rules import Rules
from reverie_eval.geometry.framing import boxes_in_views

Box: TypeAlias = Sequence[int]
"""Left, top, width and height in pixels."""
Sightings: TypeAlias = Mapping[int, Mapping[int, Box]]
"""Object id, view index; an object without boxes is listed, and not visible."""


def listable(house: House, rules: Rules) -> House:
    """Return the house without the objects whose names are excluded."""
    return house.take(
        np.array([name not in rules.excluded_names for name in house.names], dtype=np.bool_)
    )


def look_around(house: House, position: FloatArray, rules: Rules) -> Sightings:
    """Return what is listed at a viewpoint, in the order of object ids and views.

    Parameters
    ----------
    house : House
        The objects that may be listed, and hide each other.
    position : float array of shape (3,)
        The camera's place in the world, metres.
    rules : Rules
        What is near, and what is hidden; names are not looked at.
    """
    near = house.take(_distances(house, position) < rules.max_distance)
    box, view, box_xywh = boxes_in_views(position, near.boxes)
    if rules.occlusion == "paper":
        shown = ~is_hidden(view, box_xywh, _distances(near, position)[box])
        box, view, box_xywh = box[shown], view[shown], box_xywh[shown]
    listed: dict[int, dict[int, Box]] = {object_id: {} for object_id in near.object_id.tolist()}
    found = near.object_id[box].tolist(), view.tolist(), box_xywh.tolist()
    for object_id, index, xywh in zip(*found, strict=True):
        listed[object_id][index] = xywh
    return listed


def annotation(house: House, sightings: Sightings) -> dict[str, dict[str, Any]]:
    """Return what is listed at a viewpoint in the published form."""
    names = dict(zip(house.object_id.tolist(), house.names, strict=True))
    return {
        str(object_id): {
            "name": names[object_id],
            "visible_pos": list(boxes),
            "bbox2d": list(boxes.values()),
        }
        for object_id, boxes in sightings.items()
    }


def _distances(house: House, position: FloatArray) -> FloatArray:
    """Metres from the camera to the objects' centres, spelled out so that all machines agree."""
    x, y, z = (house.boxes.centre - position).T
    return np.asarray(np.sqrt(x * x + y * y + z * z))
