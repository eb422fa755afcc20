"""Random worlds and sound submissions for them, and the way from a world to a ground truth.

A world goes the whole way: it is written in the published layout, compiled and loaded. So what
holds for random worlds holds for compiling as well as for scoring.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st

from reverie_eval import GroundTruth, Scores, evaluate
from reverie_eval.ground_truth.compile import compile_split
from reverie_eval.ground_truth.dataset import DatasetFiles
from tests.oracle import Prediction, Predictions, Scan, Task, Viewpoint, World, distances_from

SPLIT = "val_unseen"

Record = dict[str, Any]

unhurried = settings(deadline=None)
"""No deadline per example: a slow machine is no failure."""

_coordinates = st.integers(-20_000, 20_000).map(lambda millimetres: millimetres / 1000)
_positions = st.tuples(_coordinates, _coordinates, _coordinates)
_object_ids = st.sampled_from([0, 1, 2, 3, 999_999_999])
"""Few, so that scans share ids and viewpoints share objects; 0 is a name, not an absence."""
_views = st.lists(st.integers(0, 35), max_size=2, unique=True).map(sorted)


@dataclass(frozen=True)
class Case:
    """A world and a sound submission for it."""

    world: World
    predictions: Predictions


def scans(prefix: str) -> st.SearchStrategy[Scan]:
    """Draw a scan of up to nine viewpoints, often in several components."""
    viewpoints = st.builds(
        Viewpoint,
        position=_positions,
        included=st.sampled_from([True] * 7 + [False]),
        views=st.dictionaries(_object_ids, _views, max_size=3),
    )
    return st.lists(viewpoints, min_size=1, max_size=9).flatmap(
        lambda drawn: _joined({f"{prefix}v{number}": seen for number, seen in enumerate(drawn)})
    )


def _joined(viewpoints: Mapping[str, Viewpoint]) -> st.SearchStrategy[Scan]:
    """Lay out a corridor, then wall up a few of its doors and break through elsewhere."""
    pairs = list(combinations(viewpoints, 2))
    corridor = frozenset(pairwise(viewpoints))
    changed = st.frozensets(st.sampled_from(pairs), max_size=4) if pairs else st.just(corridor)
    return changed.map(lambda drawn: Scan(viewpoints, corridor ^ drawn))


@st.composite
def worlds(draw: st.DrawFn) -> World:
    """Draw a world of up to three scans and five tasks, every target visible at its goal."""
    numbers = range(draw(st.integers(1, 3)))
    drawn = {f"scan{number}": draw(scans(f"s{number}")) for number in numbers}
    tasks = []
    for number in range(draw(st.integers(1, 5))):
        scan_id = draw(st.sampled_from(list(drawn)))
        task = draw(_tasks(f"{number}_7", scan_id, drawn[scan_id]))
        drawn[scan_id] = _with_task(drawn[scan_id], task)
        tasks.append(task)
    return World(drawn, tasks)


@st.composite
def _tasks(draw: st.DrawFn, task_id: str, scan_id: str, scan: Scan) -> Task:
    """Draw a path inside one component; its ends may be the same, its legs need no edges."""
    start = draw(st.sampled_from(list(scan.viewpoints)))
    here, *elsewhere = _component(scan, start)
    goal = draw(st.sampled_from([here, *elsewhere, *elsewhere]))
    between = draw(st.lists(st.sampled_from([here, *elsewhere]), max_size=2))
    instructions = draw(st.integers(1, 3))
    return Task(task_id, scan_id, [start, *between, goal], draw(_object_ids), instructions)


def _with_task(scan: Scan, task: Task) -> Scan:
    """Include the start, and make the target visible at the goal."""
    start, goal = task.path[0], task.path[-1]
    viewpoints = dict(scan.viewpoints)
    viewpoints[start] = replace(viewpoints[start], included=True)
    views = viewpoints[goal].views
    if not views.get(task.target):
        viewpoints[goal] = replace(viewpoints[goal], views={**views, task.target: [12]})
    return replace(scan, viewpoints=viewpoints)


def _component(scan: Scan, start: str) -> list[str]:
    """List what can be reached from a viewpoint, itself first."""
    return list(distances_from(scan, start))


def predictions_for(world: World) -> st.SearchStrategy[Predictions]:
    """Draw a sound submission: every trajectory begins at the start and stays reachable from it.

    Viewpoints repeat, legs jump where there is no edge, some agents never leave; some answers are
    right, some wrong, some abstentions.
    """
    return st.fixed_dictionaries(
        {
            instr_id: _predictions(world.scans[task.scan_id], task)
            for task in world.tasks
            for instr_id in task.instr_ids
        }
    )


def _predictions(scan: Scan, task: Task) -> st.SearchStrategy[Prediction]:
    start, goal = task.path[0], task.path[-1]
    reachable = st.sampled_from(_component(scan, start))
    ways = st.one_of(st.lists(reachable, max_size=1), st.lists(reachable, max_size=5))
    ends = st.sampled_from([[], [goal]])
    trajectories = st.builds(lambda way, end: [start, *way, *end], ways, ends)
    answers = st.one_of(st.just(task.target), _object_ids, st.just(-1))
    return st.builds(Prediction, trajectory=trajectories, object_id=answers)


cases = worlds().flatmap(
    lambda world: st.builds(Case, world=st.just(world), predictions=predictions_for(world))
)


def scores_of(case: Case) -> Scores:
    """Score a case's submission, handed over as the text of a file."""
    submission = json.dumps(records_of(case.predictions)).encode()
    return evaluate(submission, split=SPLIT, ground_truth=ground_truth_of(case.world))


def records_of(predictions: Predictions) -> list[Record]:
    """Return a submission in the official result format."""
    return [
        {
            "instr_id": instr_id,
            "trajectory": [[viewpoint_id, 0.0, 0.0] for viewpoint_id in prediction.trajectory],
            "predObjId": prediction.object_id,
        }
        for instr_id, prediction in predictions.items()
    ]


def ground_truth_of(world: World) -> GroundTruth:
    """Write a world's files, compile them and take the bundle for ground truth."""
    with TemporaryDirectory() as folder:
        write_world(world, Path(folder))
        bundle = compile_split(DatasetFiles.find(SPLIT, Path(folder)), SPLIT)
    return GroundTruth.from_bundle(bundle)


def write_world(world: World, folder: Path) -> None:
    """Write a world in the published layout, with all boxes in one file as DUET has them."""
    data, connectivity = folder / "tasks" / "REVERIE" / "data", folder / "connectivity"
    data.mkdir(parents=True)
    connectivity.mkdir()
    _write(data / f"REVERIE_{SPLIT}.json", [_annotation(task) for task in world.tasks])
    _write(data / "BBoxes.json", _boxes(world.scans))
    for scan_id, scan in world.scans.items():
        _write(connectivity / f"{scan_id}_connectivity.json", _connectivity(scan))


def _write(path: Path, content: object) -> None:
    path.write_text(json.dumps(content))


def _annotation(task: Task) -> Record:
    return {
        "scan": task.scan_id,
        "id": task.task_id,
        "objId": task.target,
        "path": task.path,
        "instructions": ["go there"] * task.instructions,
    }


def _boxes(scans: Mapping[str, Scan]) -> Record:
    return {
        f"{scan_id}_{viewpoint_id}": {
            str(object_id): {"visible_pos": views, "bbox2d": [[1, 2, 30, 40]] * len(views)}
            for object_id, views in viewpoint.views.items()
        }
        for scan_id, scan in scans.items()
        for viewpoint_id, viewpoint in scan.viewpoints.items()
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
