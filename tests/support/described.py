"""A dataset of three scans and three splits, whose description is worked out by hand."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

Record = dict[str, Any]

PLACES: Mapping[str, Mapping[str, tuple[float, float, float]]] = {
    "hut": {"hut-a": (0, 0, 0), "hut-b": (3, 4, 0), "hut-c": (3, 4, 12)},
    "barn": {"barn-a": (0, 0, 0), "barn-b": (0, 2, 0)},
    "shed": {"shed-a": (0, 0, 0)},
}
"""Scans with their viewpoints, each joined to the next: 5 m and 12 m in the hut. Nobody has an item
in the shed, and each scan has one viewpoint more that is not included."""
SEEN: Mapping[str, Mapping[str, tuple[str, Sequence[int]]]] = {
    "hut-b": {"2": ("lamp", [1, 2, 3, 4])},
    "hut-c": {"1": ("coffee#table", [0, 1]), "2": ("lamp", [5]), "3": ("rug", [])},
}
"""Objects by viewpoint: name and views. The rug is listed, but not visible."""


def item(id_: str, path: str, target: int | None, *instructions: str) -> Record:
    """Write an item; without a target as in a public test file."""
    scan = path.split(maxsplit=1)[0].partition("-")[0]
    answer = {} if target is None else {"objId": target}
    return {
        "scan": scan,
        "id": id_,
        "path": path.split(),
        "instructions": list(instructions),
        **answer,
    }


SPLITS: Mapping[str, Sequence[Record]] = {
    "test": [item("9", "barn-a", None, "find it")],
    "val_seen": [
        item("1_1", "hut-a hut-b hut-c", 1, "Go to the coffee table.", "Don't go!"),
        item("2_2", "hut-a hut-b", 2, "GO to the lamp"),
        item("3_2", "hut-b hut-c", 2, "the lamp, the lamp"),
    ],
    "val_unseen": [
        item("4_3", "hut-a hut-b hut-c", 3, "the rug"),
        item("5_2", "hut-a hut-b", 2, "get it"),
    ],
}
TABLE = """\
                       val_seen  val_unseen  test  total
items                         3           2     1      6
instructions                  4           2     1      7
scans                         1           1     1      2
viewpoints in scans           3           3     2      5
words per instruction       4.0         2.0   2.0    3.1
    range                   3-5         2-2   2-2    2-5
distinct words                8           4     2     12
frequent words                0           0     0      1
target objects                2           2     -      4
target categories             2           2     -      3
objects at the goal         1.7         1.5     -    1.6
    range                   1-2         1-2     -    1-2
boxes at the goal           3.3         3.5     -    3.4
    range                   3-4         3-4     -    3-4
path steps                  1.3         1.5     -    1.4
    range                   1-2         1-2     -    1-2
path length (m)            11.3        11.0     -   11.2
    range                  5-17        5-17     -   5-17

                       splits      dataset   paper
buildings                                3      90
viewpoints                               6  10,567
instructions           all               7  21,702  without train
instructions           train             -  10,466
instructions           val               6   4,944
instructions           val_unseen        2   3,573
instructions           test              1   6,292
words per instruction  all             3.1      18  without train
frequent words         all               1   1,600  without train
scans                  train             -      59
scans                  val               1      63
scans                  val_unseen        1      10
scans                  test              1      16
target objects         all               4   4,140  without train, test
target objects         train             -   2,353
target objects         val               4     953
target objects         val_unseen        2     525
target objects         test              -     834
target categories      all               3     489  without train, test
objects at the goal    all             1.6       7  without train, test
boxes at the goal      all             3.4      50  without train, test

paper: Qi et al., REVERIE, CVPR 2020, section 3
note: test has no targets: its goals and paths are unknown
note: val_unseen: the target is not visible at the goal in 1 of 2 items; `reverie-eval lint` lists \
them
"""


def write_dataset(root: Path, splits: Mapping[str, Sequence[Record]] = SPLITS) -> Path:
    """Write a dataset in the published layout and return its root."""
    data, connectivity = root / "tasks" / "REVERIE" / "data", root / "connectivity"
    (data / "BBox").mkdir(parents=True)
    connectivity.mkdir()
    for split, items in splits.items():
        (data / f"REVERIE_{split}.json").write_text(json.dumps(items))
    for scan, places in PLACES.items():
        (connectivity / f"{scan}_connectivity.json").write_text(json.dumps(_connectivity(places)))
        for viewpoint in places:
            content = {viewpoint: {key: listed(*it) for key, it in SEEN.get(viewpoint, {}).items()}}
            (data / "BBox" / f"{scan}_{viewpoint}.json").write_text(json.dumps(content))
    return root


def _connectivity(places: Mapping[str, tuple[float, float, float]]) -> Sequence[Record]:
    positions = [*places.values(), (9, 9, 9)]
    return [
        {
            "image_id": name,
            "pose": [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1],
            "included": name != "outside",
            "unobstructed": [abs(row - column) == 1 for column in range(len(positions))],
        }
        for row, (name, (x, y, z)) in enumerate(zip([*places, "outside"], positions, strict=True))
    ]


def listed(name: str, views: Sequence[int]) -> Record:
    """Write an object as it is listed at a viewpoint."""
    return {"name": name, "visible_pos": views, "bbox2d": [[0, 0, 9, 9] for _ in views]}
