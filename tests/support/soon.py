"""Items of SOON, made up: on small worlds by hand, and on the random worlds of :mod:`worlds`."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from reverie_eval import GroundTruth
from reverie_eval.dataset import DatasetFiles, compile_split
from tests.support.oracle import World
from tests.support.worlds import SPLIT, write_world

CORNERS = ("center", "left_top", "right_top", "right_bottom", "left_bottom")


def box(viewpoint: str, *corners: tuple[float, float]) -> dict[str, Any]:
    """Return the target as a viewpoint sees it: centre and corners in turns."""
    target = {
        name: {"heading": 2 * math.pi * x, "elevation": 2 * math.pi * y - math.pi}
        for name, (x, y) in zip(CORNERS, corners, strict=True)
    }
    return {"image_id": viewpoint, "heading": 0.0, "elevation": 0.0, "target": target}


def square(viewpoint: str, x: float = 0.5) -> dict[str, Any]:
    """Return a square of a quarter turn around (x, 0.5)."""
    a = 0.125
    around = ((x - a, 0.5 + a), (x + a, 0.5 + a), (x + a, 0.5 - a), (x - a, 0.5 - a))
    return box(viewpoint, (x, 0.5), *around)


def item(paths: Sequence[Any], bboxes: Sequence[Any]) -> dict[str, Any]:
    """Return the only item of a split."""
    return {
        "instr_id": 7,
        "scan": "house",
        "instructions": ["an", "object", "in", "a", "the full text"],
        "path": [list(path) for path in paths],
        "bboxes": list(bboxes),
    }


def truth_of(folder: Path, world: World, items: Sequence[Mapping[str, Any]]) -> GroundTruth:
    """Compile items on a world's graphs."""
    write_world(world, folder)
    data = folder / "tasks" / "SOON" / "data"
    data.mkdir(parents=True)
    (data / f"{SPLIT}.json").write_text(json.dumps(items))
    files = DatasetFiles.find(folder, split=SPLIT, task="soon")
    return GroundTruth.from_bundle(compile_split(files, SPLIT))


@dataclass(frozen=True)
class Walk:
    """What an agent did: the viewpoints it took, and where it points, if it does."""

    way: Sequence[str]
    point: tuple[float, float] | None


@dataclass(frozen=True)
class Case:
    """Items, and for each an agent's walks."""

    items: Sequence[Mapping[str, Any]]
    walks: Mapping[int, Sequence[Walk]]


def random_items(random: Random, world: World) -> Case:
    """Draw items with starts that repeat, viewpoints with two boxes, and points on borders."""
    items, walks = [], {}
    walkable = [
        (name, scan)
        for name, scan in world.scans.items()
        if any(viewpoint.included for viewpoint in scan.viewpoints.values())
    ]
    for number in range(random.randint(1, 3)):
        name, scan = random.choice(walkable)
        included = [it for it, viewpoint in scan.viewpoints.items() if viewpoint.included]
        within = [it for it in scan.routes[random.choice(included)] if it in included]
        starts, seen = draw(random, within, 1, 2), draw(random, within, 1, 4)
        paths = [
            [random.choice(starts), *draw(random, within, 0, 3)]
            for _ in range(random.randint(1, 4))
        ]
        angles = [[(eighth(random), eighth(random)) for _ in CORNERS] for _ in seen]
        boxes = [box(it, *corners) for it, corners in zip(seen, angles, strict=True)]
        items.append({**item(paths, boxes), "instr_id": number, "scan": name})
        walks[number] = [
            Walk(
                [
                    path[0],
                    *draw(random, within, 0, 4),
                    *random.choice([[], [path[-1]], [random.choice(seen)]]),
                ],
                random.choice([None, (eighth(random), eighth(random)), (0.47, 0.52)]),
            )
            for path in paths
        ]
    return Case(items, walks)


def draw(random: Random, of: Sequence[str], least: int, most: int) -> list[str]:
    return random.choices(of, k=random.randint(least, most))


def eighth(random: Random) -> float:
    return random.randint(0, 8) / 8


def records_of(walks: Mapping[int, Sequence[Walk]]) -> list[dict[str, Any]]:
    """Return an agent's walks as a submission."""
    return [
        {
            "instr_id": number,
            "trajectory": [
                {
                    "path": [[it, 0.0, 0.0] for it in each.way],
                    "obj_heading": each.point and each.point[0],
                    "obj_elevation": each.point and each.point[1],
                }
                for each in of_item
            ],
        }
        for number, of_item in walks.items()
    ]
