"""Random worlds and sound submissions for them, and the ways from a world to a ground truth.

The whole way: a world is written in the published layout, compiled and loaded. So what holds for
random worlds holds for compiling as well as for scoring. The short way, where thousands of worlds
are wanted: its bundle is laid out by hand, with the oracle's distances.

Both come from one generator: of a seed for the thousands, of hypothesis for the rest, which then
finds a small world where it finds a fault.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from hypothesis import strategies as st

from reverie_eval import GroundTruth, Scores, evaluate
from reverie_eval.arrays import Array
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.ground_truth import Bundle, pack_texts
from tests.support.drawings import fields_of, random_box, random_drawing
from tests.support.oracle import (
    Item,
    Position,
    Prediction,
    Predictions,
    Scan,
    Viewpoint,
    World,
    distances_from,
    has_boxes,
    metres_to_centre,
)

SPLIT = "val_unseen"
OBJECT_POSITIONS = "objpos.json"
_INSTRUCTION = "go there"

Record = dict[str, Any]

_SIZES: Sequence[Callable[[Random], float]] = (
    lambda random: random.randint(-20_000, 20_000) / 1000,
    lambda random: random.randint(-2_500, 2_500) / 1000,
    lambda random: float(random.randint(0, 4)),
)
"""How a scan's coordinates are drawn: like a house, like a room, and in whole metres, where much
is exactly 3.0 m apart and some viewpoints share a position."""
_OBJECT_IDS = (0, 1, 2, 3, 999_999_999)
"""Few, so that scans share ids and viewpoints share objects; 0 is a name, not an absence."""
_ABSTAINED = -1


@dataclass(frozen=True)
class Case:
    """A world and a sound submission for it."""

    world: World
    predictions: Predictions


def random_case(random: Random, shares_of_boxes: Sequence[float] = (1, 0.5, 0)) -> Case:
    """Draw a world of up to three scans and five items, and a sound submission for it.

    One of the shares is that of answers that are boxes.
    """
    scans = {f"scan{number}": _scan(random, f"s{number}") for number in range(_up_to(random, 3))}
    items = []
    for number in range(_up_to(random, 5)):
        scan_id = random.choice(list(scans))
        item = _item(random, f"{number}_7", scan_id, scans[scan_id])
        scans[scan_id] = _with_item(scans[scan_id], item)
        items.append(item)
    world, share_of_boxes = World(scans, items), random.choice(shares_of_boxes)
    return Case(world, _predictions(random, world, share_of_boxes))


_randoms = st.integers(0, 2**32).map(Random)  # st.randoms takes ten times as long to draw a world
cases = _randoms.map(random_case)
cases_with_boxes = _randoms.map(lambda random: random_case(random, (1, 0.5))).filter(
    lambda case: has_boxes(case.predictions)
)
cases_without_boxes = _randoms.map(lambda random: random_case(random, (0,)))


def _up_to(random: Random, most: int) -> int:
    return random.randint(1, most)


def _scan(random: Random, prefix: str) -> Scan:
    """Lay out a corridor, wall up a few of its doors and break through elsewhere.

    Up to nine viewpoints, often in several components; some objects have no known centre.
    """
    coordinate = random.choice(_SIZES)

    def position() -> Position:
        return coordinate(random), coordinate(random), coordinate(random)

    viewpoints = {
        f"{prefix}v{number}": _viewpoint(random, position())
        for number in range(max(_up_to(random, 9), _up_to(random, 9)))
    }
    pairs = list(combinations(viewpoints, 2))
    changed = random.sample(pairs, min(len(pairs), random.randint(0, 4)))
    centres = {object_id: position() for object_id in _OBJECT_IDS if random.randint(0, 3) > 0}
    return Scan(viewpoints, frozenset(pairwise(viewpoints)) ^ frozenset(changed), centres)


def _viewpoint(random: Random, position: Position) -> Viewpoint:
    views = _views(random)
    boxes = {
        (object_id, view): random_box(random) for object_id, seen in views.items() for view in seen
    }
    return Viewpoint(position, included=random.randint(0, 7) > 0, views=views, boxes=boxes)


def _views(random: Random) -> Mapping[int, Sequence[int]]:
    """Draw what is listed at a viewpoint, some of it in no view at all."""
    listed = random.sample(_OBJECT_IDS, random.randint(0, 3))
    return {object_id: random.sample(range(36), random.randint(0, 2)) for object_id in listed}


def _item(random: Random, item_id: str, scan_id: str, scan: Scan) -> Item:
    """Draw a path inside one component; its ends may be the same, its legs need no edges."""
    starts = random.choices(list(scan.viewpoints), k=2)
    here, *elsewhere = max((_component(scan, start) for start in starts), key=len)
    goal = random.choice([here, *elsewhere, *elsewhere])
    between = random.choices([here, *elsewhere], k=random.randint(0, 2))
    path = [here, *between, goal]
    return Item(item_id, scan_id, path, random.choice(_OBJECT_IDS), _up_to(random, 3))


def _with_item(scan: Scan, item: Item) -> Scan:
    """Include the start, and make the target visible at the goal."""
    start, goal = item.path[0], item.path[-1]
    viewpoints = dict(scan.viewpoints)
    viewpoints[start] = replace(viewpoints[start], included=True)
    views = viewpoints[goal].views
    if not views.get(item.target):
        viewpoints[goal] = replace(viewpoints[goal], views={**views, item.target: [12]})
    return replace(scan, viewpoints=viewpoints)


def _component(scan: Scan, start: str) -> list[str]:
    """List what can be reached from a viewpoint, itself first."""
    return list(distances_from(scan, start))


def _predictions(random: Random, world: World, share_of_boxes: float) -> Predictions:
    """Draw a sound submission: every trajectory begins at the start and stays reachable from it.

    Viewpoints repeat, legs jump where there is no edge, some agents never leave; some answers are
    right, some wrong, some abstentions, and some of each written as text; a share of them are
    boxes. They come in any order.
    """
    episodes = [(instr_id, item) for item in world.items for instr_id in item.instr_ids]
    random.shuffle(episodes)
    return {
        instr_id: _prediction(random, world.scans[item.scan_id], item, share_of_boxes)
        for instr_id, item in episodes
    }


def _prediction(random: Random, scan: Scan, item: Item, share_of_boxes: float) -> Prediction:
    start, goal = item.path[0], item.path[-1]
    way = random.choices(_component(scan, start), k=random.choice([0, 0, 1, 1, 2, 3, 4, 5]))
    end = random.choice([[], [goal]])
    trajectory = [start, *way, *end]
    if random.random() < share_of_boxes:
        drawing = random_drawing(random, scan.viewpoints[trajectory[-1]], item.target)
        return Prediction(trajectory, _ABSTAINED, drawing=drawing)
    answer = random.choice([item.target, random.choice(_OBJECT_IDS), _ABSTAINED])
    return Prediction(trajectory, answer, as_text=random.randint(0, 2) == 0)


def scores_of(case: Case) -> Scores:
    """Score a case's submission, handed over as the text of a file."""
    return evaluate(file_of(case), split=SPLIT, ground_truth=ground_truth_by_hand(case.world))


def file_of(case: Case) -> bytes:
    """Return a case's submission as the content of a file."""
    return json.dumps(records_of(case.predictions)).encode()


def records_of(predictions: Predictions) -> list[Record]:
    """Return a submission in the official result format, but for ids that are written as text."""
    return [
        {
            "instr_id": instr_id,
            "trajectory": _poses(prediction),
            "predObjId": str(prediction.object_id) if prediction.as_text else prediction.object_id,
            **(fields_of(prediction.drawing) if prediction.drawing else {}),
        }
        for instr_id, prediction in predictions.items()
    ]


def _poses(prediction: Prediction) -> list[tuple[str, float, float]]:
    *way, stop = prediction.trajectory
    camera = prediction.drawing.camera if prediction.drawing else (0.0, 0.0)
    return [*((viewpoint_id, 0.0, 0.0) for viewpoint_id in way), (stop, *camera)]


def with_arrays(bundle: Bundle, **arrays: Array) -> Bundle:
    """Return a bundle with other arrays in place of some of its own."""
    header, texts = bundle.header, bundle.texts
    changed = {**bundle.arrays, **arrays}
    origin = header.split, header.dataset, header.sources
    return Bundle.build(*origin, changed, bundle.other_splits, texts=texts)


def ground_truth_of(world: World) -> GroundTruth:
    """Write a world's files, compile them and take the bundle for ground truth."""
    with TemporaryDirectory() as folder:
        write_world(world, Path(folder))
        positions = Path(folder, OBJECT_POSITIONS)
        files = DatasetFiles.find(Path(folder), split=SPLIT, object_positions=positions)
        bundle = compile_split(files, SPLIT)
    return GroundTruth.from_bundle(bundle)


def ground_truth_by_hand(world: World) -> GroundTruth:
    """Lay out a world's bundle with what the oracle says, and take it for ground truth."""
    arrays = ground_truth_arrays(world)
    texts = instructions_of(world) | {
        "target_category": pack_texts([""] * len(world.items)),
        "candidate_category": pack_texts([""] * len(arrays["candidate_object"])),
    }
    return GroundTruth.from_bundle(Bundle.build(SPLIT, "custom", {}, arrays, {}, texts=texts))


def instructions_of(world: World) -> dict[str, Array]:
    """Return the texts of a world's bundle that are public."""
    count = sum(item.instructions for item in world.items)
    return {"instruction": pack_texts([_INSTRUCTION] * count)}


def ground_truth_arrays(world: World) -> Mapping[str, Array]:
    """Return the arrays of a world's bundle."""
    numbered = [
        (number, scan, viewpoint_id)
        for number, scan in enumerate(world.scans.values())
        for viewpoint_id, viewpoint in scan.viewpoints.items()
        if viewpoint.included
    ]
    row = {viewpoint_id: row for row, (_, _, viewpoint_id) in enumerate(numbered)}
    pairs = [(scan, a, b) for _, scan, a in numbered for b in scan.viewpoints if b in row]
    seen = [
        (scan, viewpoint_id, object_id)
        for _, scan, viewpoint_id in numbered
        for object_id, views in sorted(scan.viewpoints[viewpoint_id].views.items())
        if views
    ]
    shown = [
        (candidate, view, scan.viewpoints[viewpoint_id].box(object_id, view))
        for candidate, (scan, viewpoint_id, object_id) in enumerate(seen)
        for view in scan.viewpoints[viewpoint_id].views[object_id]
    ]
    items = world.items
    return {
        "instr_id": np.array([instr_id for item in items for instr_id in item.instr_ids]),
        "episode_task": np.repeat(np.arange(len(items)), [item.instructions for item in items]),
        "task_start": np.array([row[item.path[0]] for item in items]),
        "scan_id": np.array(list(world.scans)),
        "viewpoint_id": np.array(list(row)),
        "viewpoint_scan": np.array([number for number, _, _ in numbered]),
        "viewpoint_position": np.array(
            [scan.viewpoints[id_].position for _, scan, id_ in numbered]
        ),
        "distance": np.array([scan.routes[a].get(b, np.inf) for scan, a, b in pairs]),
        "edge": np.array([scan.has_edge(a, b) for scan, a, b in pairs]),
        "viewpoint_rotation": np.tile(np.eye(3), (len(row), 1, 1)),
        "task_heading": np.zeros(len(items)),
        "task_target": np.array([item.target for item in items]),
        "path": np.array([row[viewpoint_id] for item in items for viewpoint_id in item.path]),
        "path_offsets": np.cumsum([0, *(len(item.path) for item in items)]),
        "candidate_viewpoint": np.array([row[viewpoint_id] for _, viewpoint_id, _ in seen]),
        "candidate_object": np.array([object_id for _, _, object_id in seen]),
        "candidate_distance": np.array([metres_to_centre(*candidate) for candidate in seen]),
        "target_position": np.array(
            [world.scans[item.scan_id].centres.get(item.target, [np.inf] * 3) for item in items]
        ),
        "box_candidate": np.array([candidate for candidate, _, _ in shown]),
        "box_view": np.array([view for _, view, _ in shown]),
        "box_xywh": np.array([box for _, _, box in shown]).reshape(-1, 4),
    }


def write_world(world: World, folder: Path) -> None:
    """Write a world in the published layout, with all boxes in one file as DUET has them."""
    data, connectivity = folder / "tasks" / "REVERIE" / "data", folder / "connectivity"
    data.mkdir(parents=True)
    connectivity.mkdir()
    _write(data / f"REVERIE_{SPLIT}.json", [_annotation(item) for item in world.items])
    _write(data / "BBoxes.json", _boxes(world.scans))
    _write(folder / OBJECT_POSITIONS, _object_positions(world.scans))
    for scan_id, scan in world.scans.items():
        _write(connectivity / f"{scan_id}_connectivity.json", _connectivity(scan))


def _write(path: Path, content: object) -> None:
    path.write_text(json.dumps(content))


def _annotation(item: Item) -> Record:
    return {
        "scan": item.scan_id,
        "id": item.item_id,
        "objId": item.target,
        "path": item.path,
        "instructions": [_INSTRUCTION] * item.instructions,
    }


def _boxes(scans: Mapping[str, Scan]) -> Record:
    return {
        f"{scan_id}_{viewpoint_id}": {
            str(object_id): {
                "visible_pos": views,
                "bbox2d": [viewpoint.box(object_id, view) for view in views],
            }
            for object_id, views in viewpoint.views.items()
        }
        for scan_id, scan in scans.items()
        for viewpoint_id, viewpoint in scan.viewpoints.items()
    }


def _object_positions(scans: Mapping[str, Scan]) -> Record:
    """Return the known centres; a scan without any is left out."""
    return {
        scan_id: {str(object_id): centre for object_id, centre in scan.centres.items()}
        for scan_id, scan in scans.items()
        if scan.centres
    }


def _connectivity(scan: Scan) -> Sequence[Record]:
    pairs = scan.unobstructed | {(b, a) for a, b in scan.unobstructed}
    return [
        {
            "image_id": here,
            "pose": _pose(*viewpoint.position),
            "included": viewpoint.included,
            "unobstructed": [(here, there) in pairs for there in scan.viewpoints],
        }
        for here, viewpoint in scan.viewpoints.items()
    ]


def _pose(x: float, y: float, z: float) -> list[float]:
    return [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1]
