"""Answers by box: a record of one, and random ones, drawn in a view or by a camera."""

import math
from random import Random
from typing import Any

from tests.support.oracle import Drawing, Viewpoint
from tests.support.panorama import PICTURE, Box, Camera, area, camera_of, common, drawn_from

_IMAGE_SIZES = ((640, 480), (640, 480), (1280, 960), (320, 960))
"""All of them scale by powers of two, so that whole pixels stay exact."""
_FULL_TURNS = (-1, 0, 0, 2)

Record = dict[str, Any]

BOX = [10, 20, 30, 40]
POSE_ANGLES = [1.5, 0.25]
"""Heading and elevation at the stop: no view's."""
WITHOUT = object()
"""Stands for a field that is left out."""


def answer(**fields: Any) -> Record:
    """Return a record that is answered by box, with other values for some of its fields."""
    record: Record = {
        "instr_id": "7_1_0",
        "trajectory": [["hall", 0, 0], ["bath", *POSE_ANGLES]],
        "predBox": BOX,
        "predView": 14,
    }
    return {key: value for key, value in (record | fields).items() if value is not WITHOUT}


def random_drawing(random: Random, stop: Viewpoint, target: int) -> Drawing:
    """Draw a box, often near the target's, in a view or by a camera that may be off the grid."""
    shows_target = stop.views.get(target, [])
    view = random.choice([*shows_target, *shows_target, random.randrange(36)])
    box = _near(random, stop.box(target, view)) if view in shows_target else random_box(random)
    size = random.choice(_IMAGE_SIZES)
    match random.choice(["view", "view", "camera of a view", "other camera", "steep camera"]):
        case "view":
            return Drawing(_resized(box, size), view, _camera(random, view, 2.0), size)
        case "camera of a view":
            return Drawing(_resized(box, size), None, _camera(random, view, 0.0009), size)
        case "other camera":
            camera, cut = _camera(random, view, 0.25), common(box, PICTURE)
            seen = _to_eighths(drawn_from(camera, view, cut if area(cut) else PICTURE))
            return Drawing(_resized(seen, size), None, camera, size)
        case _:
            camera = _camera(random, view, 0.25)
            steep = camera[0], camera[1] * random.uniform(1, 2)
            box = random.choice([random_box(random), PICTURE])
            return Drawing(_resized(box, size), None, steep, size)


def random_box(random: Random) -> Box:
    """Draw a box of whole pixels in a picture; halves and quarters of it are whole too."""
    width, height = 4 * random.randint(1, 160), 4 * random.randint(1, 120)
    return random.randint(0, 640 - width), random.randint(0, 480 - height), width, height


def fields_of(drawing: Drawing) -> Record:
    """Return the fields of a record that say it; what goes without saying is left out."""
    return {
        "predBox": list(drawing.box),
        **({} if drawing.view is None else {"predView": drawing.view}),
        **({} if drawing.image_size == (640, 480) else {"predImageSize": drawing.image_size}),
    }


def _near(random: Random, box: Box) -> Box:
    """Draw a box that matches, that just does or does not, or that reaches out of the picture."""
    x, y, width, height = box
    return random.choice(
        [
            box,
            (x, y, width / 2, height),  # an IoU of exactly one half
            (x, y, width / 2 - 1, height),
            (x, y, width, height * 3 / 4),  # of three quarters
            (x + width / 4, y + height / 2, width / 2, height / 2),  # of one quarter
            (x + width / 2, y, width, height),
            (x - 1000, y - 1000, 2000, 2000),
            (x + 640, y, width, height),
        ]
    )


def _camera(random: Random, view: int, off: float) -> Camera:
    """Draw a camera that looks up to so many radians away from a view, after any full turns."""
    heading, elevation = camera_of(view)
    return (
        heading + random.uniform(-off, off) + random.choice(_FULL_TURNS) * math.tau,
        elevation + random.uniform(-off, off),
    )


def _to_eighths(box: Box) -> Box:
    """Round to eighths of a pixel, so that a camera that is on the grid all the same is exact."""
    x, y, width, height = (round(8 * value) / 8 for value in box)
    return x, y, max(width, 1), max(height, 1)


def _resized(box: Box, size: tuple[float, float]) -> Box:
    """Write a box of a 640 x 480 picture in the pixels of a picture of another size."""
    across, down = size[0] / 640, size[1] / 480
    return box[0] * across, box[1] * down, box[2] * across, box[3] * down
