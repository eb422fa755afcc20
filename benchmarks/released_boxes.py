"""How well the released v1 boxes agree with projections of oriented boxes, judged by centres.

``python benchmarks/released_boxes.py DATASET OBJPOS`` prints the figures of
``docs/how-to/boxes-from-houses.md``. DATASET is a clone of the dataset repository, OBJPOS the file
``tasks/REVERIE/data_v2/objpos.json`` of its history (commit 58a17aa) with the objects' centres.

A box in the world contains its centre, so its image contains the centre's image.
"""

import sys
from pathlib import Path

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.dataset import DatasetFiles
from reverie_eval.dataset._agreement_rules import Distances
from reverie_eval.dataset._box_building import is_hidden
from reverie_eval.dataset._boxes import Boxes
from reverie_eval.dataset._dataset import read_dataset
from reverie_eval.geometry import HEIGHT, NEAR, VIEW_AXES, WIDTH, pixels_of
from reverie_eval.processes import no_progress

MARGIN = 1.0
"""Pixels by which a box may miss a centre: boxes are whole pixels, centres are not."""
NEAREST, FARTHEST = 2.0, 3.0
"""Metres: the reach of v1's entries, and the reach that the paper gives."""


def main() -> int:
    """Print the figures."""
    if len(sys.argv) != 3:  # the script, and what its docstring names
        print("usage: python benchmarks/released_boxes.py DATASET OBJPOS")
        return 2
    root, object_positions = map(Path, sys.argv[1:])
    files = DatasetFiles.find(root, object_positions=object_positions)
    dataset = read_dataset(files, no_progress)
    distances = Distances(dataset.boxes, dataset.centres or {}, [])
    box_xywh, centre, hidden = measured(dataset.boxes, distances)
    known = distances.listed[np.isfinite(distances.listed)]
    pixels = pixels_of(np.where(centre[:, 2:] > NEAR, centre, (0.0, 0.0, 1.0)))
    within = ((pixels >= 0) & (pixels <= (WIDTH, HEIGHT))).all(axis=1)
    shown = np.asarray((centre[:, 2] > NEAR) & within)
    start, end = box_xywh[:, :2], box_xywh[:, :2] + box_xywh[:, 2:]
    missed = np.asarray(((pixels < start - MARGIN) | (pixels > end + MARGIN)).any(axis=1))
    whole = (start > 0).all(axis=1) & (end < (WIDTH, HEIGHT)).all(axis=1)
    show("entries nearer than 2 m", known < NEAREST)
    show("entries nearer than 3 m", known < FARTHEST)
    show("boxes that miss the centre's pixel", missed[shown])
    show("the same, of boxes within the image", missed[shown & whole])
    show("boxes that the paper's rule would remove", hidden)
    return 0


def show(name: str, holds: BoolArray) -> None:
    """Print a share."""
    print(f"{name:42} {holds.sum():8,} of {len(holds):8,}  {100 * holds.mean():5.1f} %")


def measured(boxes: Boxes, distances: Distances) -> tuple[IntArray, FloatArray, BoolArray]:
    """Return the boxes whose object's centre is known.

    Returns
    -------
    int array of shape (n, 4)
        The boxes.
    float array of shape (n, 3)
        The object's centre in the frame of the box's view, metres.
    bool array of shape (n,)
        Whether the paper's rule would remove the box.
    """
    known = np.flatnonzero(np.isfinite(distances.listed[boxes.box_entry]))
    entry, view, box_xywh = boxes.box_entry[known], boxes.box_view[known], boxes.box_xywh[known]
    viewpoint, distance = boxes.viewpoint[entry], distances.listed[entry]
    centre = np.einsum("nj,nij->ni", distances.offset[entry], VIEW_AXES[view])
    hidden = [
        is_hidden(view[rows], box_xywh[rows], distance[rows])
        for rows in np.split(np.arange(len(known)), np.flatnonzero(np.diff(viewpoint)) + 1)
    ]
    return box_xywh, centre, np.concatenate(hidden)


if __name__ == "__main__":
    sys.exit(main())
