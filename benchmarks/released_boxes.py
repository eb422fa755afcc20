"""How far the released v1 boxes are from projections of oriented boxes, as far as centres tell.

``python benchmarks/released_boxes.py DATASET OBJPOS`` prints the figures of
``docs/boxes-from-houses.md``. DATASET is a clone of the dataset repository, OBJPOS the file
``tasks/REVERIE/data_v2/objpos.json`` of its history (commit 58a17aa) with the objects' centres.

A box in the world contains its centre, so its picture contains the centre's picture.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.box_building.occlusion import is_hidden
from reverie_eval.box_building.scans import read_poses
from reverie_eval.geometry import HEIGHT, NEAR, VIEW_AXES, WIDTH, pixels_of
from reverie_eval.ground_truth.dataset import connectivity_files
from reverie_eval.schemas.dataset import BOXES, OBJECT_POSITIONS, ObjectBoxes, Position

MARGIN = 1.0
"""Pixels by which a box may miss a centre: boxes are whole pixels, centres are not."""
NEAREST, FARTHEST = 2.0, 3.0
"""Metres: how far v1's entries reach, and how far the paper says."""


class Seen(NamedTuple):
    """The boxes at a viewpoint, a row each."""

    box_xywh: IntArray
    centre: FloatArray
    """Shape (n, 3): the object's centre in the frame of the view."""
    is_hidden: BoolArray
    """Whether the paper's rule would take the box away."""


def main() -> int:
    """Print the figures."""
    if len(sys.argv) != 3:  # the script, and what its docstring names
        print("usage: python benchmarks/released_boxes.py DATASET OBJPOS")
        return 2
    dataset, object_positions = map(Path, sys.argv[1:])
    centres = OBJECT_POSITIONS.validate_json(object_positions.read_bytes())
    listed, seen = [], []
    for position, objects, in_scan in viewpoints(dataset, centres):
        known = {key: thing for key, thing in objects.items() if key in in_scan}
        listed += [np.linalg.norm(np.subtract(in_scan[key], position)) for key in known]
        seen.append(boxes_at(position, known, in_scan))
    box_xywh, centre, hidden = (np.concatenate(column) for column in zip(*seen, strict=True))
    pixels = pixels_of(np.where(centre[:, 2:] > NEAR, centre, (0.0, 0.0, 1.0)))
    shown = (centre[:, 2] > NEAR) & ((pixels >= 0) & (pixels <= (WIDTH, HEIGHT))).all(axis=1)
    start, end = box_xywh[:, :2], box_xywh[:, :2] + box_xywh[:, 2:]
    missed = ((pixels < start - MARGIN) | (pixels > end + MARGIN)).any(axis=1)
    whole = (start > 0).all(axis=1) & (end < (WIDTH, HEIGHT)).all(axis=1)
    show("entries nearer than 2 m", np.array(listed) < NEAREST)
    show("entries nearer than 3 m", np.array(listed) < FARTHEST)
    show("boxes that miss the centre's pixel", missed[shown])
    show("the same, of boxes within the picture", missed[shown & whole])
    show("boxes that the paper's rule would remove", hidden)
    return 0


def show(name: str, holds: BoolArray) -> None:
    """Print a share."""
    print(f"{name:42} {holds.sum():8,} of {len(holds):8,}  {100 * holds.mean():5.1f} %")


def viewpoints(
    dataset: Path, centres: dict[str, dict[str, Position]]
) -> Iterator[tuple[Position, dict[str, ObjectBoxes], dict[str, Position]]]:
    """Yield each viewpoint's position, what is listed there, and the centres in its scan."""
    boxes = dataset / "tasks" / "REVERIE" / "data" / "BBox"
    for scan, file in connectivity_files(dataset / "connectivity").items():
        for viewpoint in read_poses(file):
            content = (boxes / f"{scan}_{viewpoint.image_id}.json").read_bytes()
            objects = BOXES.validate_json(content)[viewpoint.image_id]
            yield viewpoint.position, objects, centres.get(scan, {})


def boxes_at(
    position: Position, objects: dict[str, ObjectBoxes], centres: dict[str, Position]
) -> Seen:
    """Return the boxes at a viewpoint."""
    rows = [
        (view, box, centres[key])
        for key, thing in objects.items()
        for view, box in zip(thing.visible_pos, thing.bbox2d, strict=True)
    ]
    view = np.array([view for view, _, _ in rows], dtype=np.int64)
    box_xywh = np.array([box for _, box, _ in rows], dtype=np.int64).reshape(-1, 4)
    away = np.array([centre for _, _, centre in rows]).reshape(-1, 3) - position
    distance = np.linalg.norm(away, axis=1)
    centre = np.einsum("nj,nij->ni", away, VIEW_AXES[view])
    return Seen(box_xywh, centre, is_hidden(view, box_xywh, distance))


if __name__ == "__main__":
    sys.exit(main())
