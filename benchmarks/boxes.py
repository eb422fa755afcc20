"""How fast boxes are built and compared.

``python benchmarks/boxes.py`` prints each measurement with its limit. The scan is synthetic: 1,000
objects and 200 viewpoints in a house of 400 square metres on two floors. In "everything in range",
every object is in range of every viewpoint.
"""

import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.bars import judge
from reverie_eval.arrays import FloatArray
from reverie_eval.dataset import BoxSettings, Occlusion, Scan, build_boxes
from reverie_eval.metrics import box_iou

OBJECTS, VIEWPOINTS = 1_000, 200
HOUSE = (20.0, 20.0, 5.6)
"""Metres."""
PAIRS = 1_000_000


def main() -> int:
    """Print every measurement; return 1 if one is over its limit."""
    rng = np.random.default_rng(0)
    with TemporaryDirectory() as temporary:
        scan = write_scan(Path(temporary), rng)
        figures = [
            ("1,000 objects, 200 viewpoints, s", build_seconds(scan, 3.0, "none"), 60.0),
            ("the same with occlusion, s", build_seconds(scan, 3.0, "paper"), 60.0),
            ("everything in range, s", build_seconds(scan, 100.0, "none"), 60.0),
            ("the same with occlusion, s", build_seconds(scan, 100.0, "paper"), 60.0),
            ("IoU of a million pairs, s", iou_seconds(rng), 0.3),
        ]
    return judge(figures)


def write_scan(folder: Path, rng: np.random.Generator) -> Scan:
    """Write the files of a synthetic scan."""
    house, connectivity = folder / "x.house", folder / "x_connectivity.json"
    columns = [
        np.arange(OBJECTS)[:, None],
        np.full((OBJECTS, 2), [-1, 0]),
        rng.uniform(0, HOUSE, (OBJECTS, 3)),
        rng.normal(size=(OBJECTS, 6)),
        rng.uniform(0.05, 0.6, (OBJECTS, 3)),
    ]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    lines = [" ".join(["O", *(str(word) for part in row for word in part)]) for row in rows]
    header = f"H x - 0 0 0 0 0 {OBJECTS} 1 0 0 0"
    house.write_text("\n".join(["ASCII 1.1", header, "C 0 0 thing 0 -", *lines]))
    poses = [
        {
            "image_id": f"{index:032x}",
            "pose": [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1],
            "included": True,
            "unobstructed": [False] * VIEWPOINTS,
        }
        for index, (x, y, z) in enumerate(rng.uniform(0, HOUSE, (VIEWPOINTS, 3)).tolist())
    ]
    connectivity.write_text(json.dumps(poses))
    return Scan("x", house, connectivity)


def build_seconds(scan: Scan, max_distance: float, occlusion: Occlusion) -> float:
    """Time building a scan in one process, including reading and writing files."""
    with TemporaryDirectory() as temporary:
        settings = BoxSettings(max_distance, occlusion)
        return seconds(lambda: build_boxes([scan], Path(temporary, "boxes"), settings))


def iou_seconds(rng: np.random.Generator) -> float:
    """Time the overlap of pairs of boxes."""
    first, second = (random_boxes(rng) for _ in range(2))
    return statistics.median(seconds(lambda: box_iou(first, second)) for _ in range(11))


def random_boxes(rng: np.random.Generator) -> FloatArray:
    """Return boxes anywhere in a view."""
    return np.concatenate([rng.uniform(0, 400, (PAIRS, 2)), rng.uniform(1, 240, (PAIRS, 2))], 1)


def seconds(action: Callable[[], object]) -> float:
    """Time one call."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


if __name__ == "__main__":
    sys.exit(main())
