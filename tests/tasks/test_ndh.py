"""NDH: the same digits as its own script by each of its three paths, and as HAMT's."""

import json
import math
from collections.abc import Mapping, Sequence
from random import Random
from typing import Any

import numpy as np
import pytest

from reverie_eval import SubmissionError, evaluate
from reverie_eval.ground_truth import Bundle
from reverie_eval.submissions import read_predictions
from reverie_eval.tasks import find_task
from tests.conftest import REPOSITORY
from tests.support.amounts import amount, tell
from tests.support.family import (
    LENGTHS_WITHIN,
    Published,
    differences,
    less_than_3_m,
    published_task,
)
from tests.support.flat_world import Run
from tests.support.ndh import Region, random_region, truth_of
from tests.support.oracle import Item, Scan, Viewpoint, World, distance, trajectory_length, weighted
from tests.support.worlds import SPLIT, random_case

SAMPLE = REPOSITORY / "fixtures" / "submissions" / "ndh.json"
FILES = [
    f"{split}.{kind}"
    for split in ("val_seen", "val_unseen")
    for kind in ("mixed1", "seq2seq_published")
]
OFFICIAL = {
    "navigation_error": "nav_error",
    "oracle_error": "oracle_error",
    "path_length": "trajectory_length",
    "shortest_length": "shortest_path_length",
    "success": "success",
    "oracle_success": "oracle_success",
    "oracle_path_success": "oracle_path_success",
    "spl": "spl",
    "goal_progress": "goal_progress",
}
HAMT = {
    "path_length": "trajectory_lengths",
    "success": "success",
    "oracle_success": "oracle_success",
    "spl": "spl",
    "goal_progress": "gp",
    "steps": "trajectory_steps",
}
EXACT = ("success", "oracle_success", "oracle_path_success", "steps")
PATHS = {"official-v1": "trusted", "official-planner": "planner", "official-player": "player"}


@pytest.fixture(scope="module")
def ndh(published: Any, tmp_path_factory: pytest.TempPathFactory) -> Published:
    """Compile the published NDH."""
    files = {split: f"{split}.json" for split in ("val_seen", "val_unseen")}
    return published_task("ndh", files, published, tmp_path_factory)


@pytest.mark.dataset
@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("protocol", [*PATHS, "hamt"])
def test_every_episode_has_the_recorded_value(protocol: str, name: str, ndh: Published) -> None:
    evaluator = f"official_{PATHS[protocol]}_path" if protocol in PATHS else protocol
    recorded = ndh.recorded(name, evaluator)["episodes"]
    names = OFFICIAL if protocol in PATHS else HAMT
    found = differences(ndh.scores(name, protocol), recorded, names)
    assert {key: found[key] for key in EXACT if found.get(key)} == {}
    assert max(found.values()) < LENGTHS_WITHIN


@pytest.mark.dataset
@pytest.mark.parametrize(
    ("protocol", "seen", "unseen"),
    [
        ("official-v1", 9.52, 9.58),
        ("official-planner", 8.29, 8.36),
        ("official-player", 7.63, 7.99),
    ],
)
def test_the_goal_progress_of_the_annotated_paths(
    protocol: str, seen: float, unseen: float, ndh: Published
) -> None:
    """The paper's table 2, of an agent that walks the path."""
    for split, metres in (("val_seen", seen), ("val_unseen", unseen)):
        truth = ndh.truth(split)
        path = truth.along(
            "" if PATHS[protocol] == "trusted" else PATHS[protocol]
        ).require_solution()
        records = [
            {"inst_idx": int(id_), "trajectory": [[truth.graph.viewpoint_ids[it]] for it in walk]}
            for id_, walk in zip(
                truth.episodes.instr_ids,
                np.split(path.path, path.path_offsets[1:-1]),
                strict=True,
            )
        ]
        scores = evaluate(records, split=split, ground_truth=truth, protocol=protocol)
        assert round(scores["goal_progress"], 2) == metres
        assert scores["success"] == 1.0


@pytest.mark.dataset
@pytest.mark.parametrize(
    ("name", "percent", "goal_progress"),
    [
        pytest.param("val_unseen.mixed1", [20.84, 29.99, 15.40], 5.056, id="mixed1"),
        pytest.param("val_unseen.seq2seq_published", [6.73, 21.06, 5.94], 0.396, id="seq2seq"),
    ],
)
def test_navillms_own_functions_gave_these_digits(
    name: str, percent: Sequence[float], goal_progress: float, ndh: Published
) -> None:
    """SR, OSR, SPL and goal progress, of its functions as executed on these files."""
    scores = ndh.scores(name, "navillm")
    found = [round(100 * scores[key], 2) for key in ("success", "oracle_success", "spl")]
    assert found == percent
    assert round(scores["goal_progress"], 3) == goal_progress


@pytest.mark.dataset
def test_published_files_are_known_by_their_digest(ndh: Published) -> None:
    assert {ndh.truth(split).header.dataset for split in ("val_seen", "val_unseen")} == {"NDH"}


@less_than_3_m
def test_success_is_less_than_3_m_from_the_paths_end(metres: float, success: float) -> None:
    viewpoints = {
        "end": Viewpoint((0.0, 0.0, 0.0)),
        "stop": Viewpoint((metres, 0.0, 0.0)),
        "start": Viewpoint((10.0, 0.0, 0.0)),
    }
    scan = Scan(viewpoints, frozenset({("end", "stop"), ("stop", "start")}))
    path = ["start", "stop", "end"]
    truth = truth_of(
        World({"house": scan}, [Item("1", "house", path, 0)]), [Region(["stop"], path, path)]
    )
    records = [{"instr_id": "1_0", "trajectory": [["start", 0, 0], ["stop", 0, 0]]}]
    official = evaluate(records, split=SPLIT, ground_truth=truth)
    keys = ("success", "oracle_success", "oracle_path_success")
    assert [official[key] for key in keys] == [success] * 3
    hamt = evaluate(records, split=SPLIT, ground_truth=truth, protocol="hamt")
    assert (hamt["success"], hamt["spl"]) == (1.0, 1.0)
    staying = [{"instr_id": "1_0", "trajectory": [["start", 0, 0]]}]
    assert evaluate(staying, split=SPLIT, ground_truth=truth)["goal_progress"] == 0.0


# s - a - b - c, and s - d: c is nearer to s by metres than d, and more moves away.
FORK = {"s": (0.0, 0.0), "a": (1.0, 0.0), "b": (2.0, 0.0), "c": (3.5, 0.0), "d": (0.0, 9.0)}


@pytest.mark.parametrize(
    ("goals", "planner", "way", "expected"),
    [
        pytest.param("cb", "sab", "sab", [1.0, 1.0, 0.0], id="the planner ends in the region"),
        pytest.param("cb", "sab", "s", [1.0, 1.0, 2.0], id="2 m before its end"),
        pytest.param("cb", "sab", "sabcb", [1.0, 0.4, 0.0], id="with a detour of 3 m"),
        pytest.param("cd", "sab", "sd", [1.0, 1.0, 0.0], id="else the goal of fewest moves"),
        pytest.param("dc", "sab", "sabc", [0.0, 0.0, 12.5], id="not the nearest by metres"),
        pytest.param("bd", "sa", "sab", [0.0, 0.0, 11.0], id="one move is fewer than two"),
        pytest.param("ad", "sab", "sa", [1.0, 1.0, 0.0], id="the first of two as near"),
        pytest.param("da", "sab", "sa", [0.0, 0.0, 10.0], id="the first of two, the other way"),
        pytest.param("sd", "sab", "s", [1.0, 0.0, 0.0], id="the start: the floor makes it 0"),
    ],
)
def test_navillms_goal(goals: str, planner: str, way: str, expected: Sequence[float]) -> None:
    """SR, SPL and the navigation error."""
    viewpoints = {name: Viewpoint((x, y, 0.0)) for name, (x, y) in FORK.items()}
    edges = frozenset({("s", "a"), ("a", "b"), ("b", "c"), ("s", "d")})
    world = World({"house": Scan(viewpoints, edges)}, [Item("1", "house", ["s", "a"], 0)])
    truth = truth_of(world, [Region(list(goals), list(planner), ["s", "a"])])
    records = [{"instr_id": "1_0", "trajectory": [[it, 0, 0] for it in way]}]
    scores = evaluate(records, split=SPLIT, ground_truth=truth, protocol="navillm")
    assert [scores[key] for key in ("success", "spl", "navigation_error")] == expected


@pytest.mark.parametrize(
    ("protocol", "spl"), [("official-v1", 1.0), ("hamt", 0.0), ("navillm", 0.0)]
)
def test_standing_at_the_goal(protocol: str, spl: float) -> None:
    """HAMT's smallest denominator makes it 0; the dataset's own script says 1."""
    scan = Scan({"here": Viewpoint((0.0, 0.0, 0.0))}, frozenset())
    world = World({"house": scan}, [Item("1", "house", ["here"], 0)])
    truth = truth_of(world, [Region(["here"], ["here"], ["here"])])
    records = [{"instr_id": "1_0", "trajectory": [["here", 0, 0]]}]
    scores = evaluate(records, split=SPLIT, ground_truth=truth, protocol=protocol)
    assert (scores["success"], scores["spl"]) == (1.0, spl)


def test_every_protocol_agrees_with_the_rules_written_once_more() -> None:
    worlds = amount(25)
    for seed in range(worlds):
        random = Random(seed)
        case = random_case(random, (0,))
        regions = [random_region(random, case.world, item) for item in case.world.items]
        truth = truth_of(case.world, regions)
        records = [
            {"instr_id": id_, "trajectory": [[it] for it in each.trajectory]}
            for id_, each in case.predictions.items()
        ]
        for protocol in (*PATHS, "hamt", "navillm"):
            scores = evaluate(records, split=SPLIT, ground_truth=truth, protocol=protocol)
            expected = {
                id_: expected_values(
                    case.world.scans[item.scan_id],
                    item,
                    region,
                    case.predictions[id_].trajectory,
                    protocol,
                )
                for item, region in zip(case.world.items, regions, strict=True)
                for id_ in item.instr_ids
            }
            for key in expected[scores.instr_ids[0]]:
                values = [expected[id_][key] for id_ in scores.instr_ids]
                assert scores.episodes[key].tolist() == values, (seed, protocol, key)
    tell(random_worlds_of_ndh=worlds)


def expected_values(
    scan: Scan, item: Item, region: Region, trajectory: Sequence[str], protocol: str
) -> Mapping[str, float]:
    """Score an episode by the rules of the script, sentence by sentence."""
    paths = {"trusted": item.path, "planner": region.planner, "player": region.player}
    start, stop, walked = trajectory[0], trajectory[-1], trajectory_length(scan, trajectory)
    at_start = min(distance(scan, start, goal) for goal in region.goals)
    progress = at_start - min(distance(scan, stop, goal) for goal in region.goals)
    if protocol == "hamt":
        success = stop in region.goals
        return {
            "goal_progress": progress,
            "success": float(success),
            "oracle_success": float(any(it in region.goals for it in trajectory)),
            "spl": weighted(walked, at_start, 0.01, achieved=success),
        }
    path = paths[PATHS[protocol]] if protocol in PATHS else navillms_path(scan, region)
    end = path[-1]
    errors = [distance(scan, it, end) for it in trajectory]
    length = distance(scan, start, end) if protocol in PATHS else trajectory_length(scan, path)
    floor = 0.0 if protocol in PATHS else 0.01
    planned = min(distance(scan, it, region.planner[-1]) for it in trajectory)
    return {
        "goal_progress": progress,
        "navigation_error": errors[-1],
        "success": float(errors[-1] < 3.0),
        "oracle_success": float(min(errors) < 3.0),
        "oracle_path_success": float(planned < 3.0),
        "spl": weighted(walked, length, floor, achieved=errors[-1] < 3.0),
    }


def navillms_path(scan: Scan, region: Region) -> Sequence[str]:
    """Return the planner's path if it ends in the region, or else the way to one of the goals.

    That of fewest viewpoints, the first of several.
    """
    if region.planner[-1] in region.goals:
        return region.planner
    ways = [shortest_way(scan, region.planner[0], goal) for goal in region.goals]
    return min(ways, key=len)


def shortest_way(scan: Scan, start: str, goal: str) -> Sequence[str]:
    """Walk as Dijkstra's algorithm does: of equally short ways, keep the one found first."""
    ways, reached, finished, tries = {start: [start]}, {start: (0.0, 0)}, set[str](), 0
    while goal not in finished:
        here = min(reached.keys() - finished, key=lambda it: reached[it])
        finished.add(here)
        for there, metres in scan.edges[here].items():
            length = reached[here][0] + metres
            if length < reached.get(there, (math.inf, 0))[0]:
                tries += 1
                ways[there], reached[there] = [*ways[here], there], (length, tries)
    return ways[goal]


# The demo world.


def test_ids_may_be_numbers_or_text_under_either_name() -> None:
    records = json.loads(SAMPLE.read_text())
    scores = evaluate(SAMPLE, split="val_unseen", task="ndh")
    assert list(scores.notes) == []
    forms = [
        [{"instr_id": each["inst_idx"], "trajectory": each["trajectory"]} for each in records],
        [{"instr_id": str(each["inst_idx"]), "trajectory": each["trajectory"]} for each in records],
        [{**each, "inst_idx": str(each["inst_idx"])} for each in records],
        [{**each, "instr_id": None} for each in records],
        [{**each, "inst_idx": None, "instr_id": each["inst_idx"]} for each in records],
    ]
    for form in forms:
        assert evaluate(form, split="val_unseen", task="ndh") == scores


@pytest.mark.parametrize("value", [9.5, True, None])
def test_what_is_no_number_of_an_episode(value: object) -> None:
    records = [{"inst_idx": value, "trajectory": [["v", 0, 0]]}]
    (problem,) = read_predictions(records, find_task("ndh")).problems
    assert problem.where == "[0].inst_idx"
    assert problem.message.endswith("expected the number of the episode: 5354")


def test_problems_name_the_field_that_a_record_has() -> None:
    records = json.loads(SAMPLE.read_text())
    records[1]["inst_idx"] = "none"
    records[2] = {"instr_id": "none", "trajectory": records[2]["trajectory"]}
    del records[3]["inst_idx"]
    again = {**records[0], "trajectory": records[0]["trajectory"][:1]}
    with pytest.raises(SubmissionError) as refused:
        evaluate([*records, again], split="val_unseen", task="ndh")
    found = [str(each).split(";")[0] for each in refused.value.problems if each.where != "file"]
    assert found == [
        "[1].inst_idx: 'none' is not an episode of val_unseen",
        "[2].instr_id: 'none' is not an episode of val_unseen",
        "[3]: has no inst_idx",
        f"[{len(records)}].inst_idx: {records[0]['inst_idx']} already has a prediction in [0]",
    ]


def test_converting_writes_the_official_form(run: Run) -> None:
    done = run("convert", str(SAMPLE), "--task", "ndh", "--split", "val_unseen")
    assert json.loads(done.out) == json.loads(SAMPLE.read_text())


def test_a_file_of_another_task_is_recognised() -> None:
    with pytest.raises(SubmissionError, match="look like R2R ids, not like NDH ids"):
        evaluate(SAMPLE.with_name("r2r.json"), split="val_unseen", task="ndh")
    other = [{"inst_idx": 9, "trajectory": [["v"]]}]
    with pytest.raises(SubmissionError, match="to score NDH itself, clone"):
        evaluate(other, split="val_unseen", task="ndh")
    for task in ("reverie", "r2r"):
        with pytest.raises(SubmissionError) as refused:
            evaluate(SAMPLE, split="val_unseen", task=task)
        (problem,) = refused.value.problems
        assert (problem.code, problem.where) == ("other-task", "file")
        assert problem.message.endswith("'inst_idx'; score the file with --task ndh")


def test_goal_progress_can_be_negative() -> None:
    """An agent that starts in the goal region and leaves it."""
    scan = Scan(
        {"in": Viewpoint((0.0, 0.0, 0.0)), "out": Viewpoint((4.0, 0.0, 0.0))},
        frozenset({("in", "out")}),
    )
    truth = truth_of(
        World({"house": scan}, [Item("1", "house", ["in", "out"], 0)]),
        [Region(["in"], ["in", "out"], ["in", "out"])],
    )
    records = [{"instr_id": "1_0", "trajectory": [["in", 0, 0], ["out", 0, 0]]}]
    assert evaluate(records, split=SPLIT, ground_truth=truth)["goal_progress"] == -4.0


def test_a_public_bundle_of_the_test_split_has_starts_only() -> None:
    folder = REPOSITORY / "reverie_eval" / "ground_truth" / "demo" / "ndh"
    public = Bundle.load(folder / "test.public.npz")
    private = Bundle.load(folder / "private" / "test.npz")
    assert public.is_public
    assert not any(name.startswith(("path", "goal")) for name in public.arrays)
    assert private.public().header.fingerprint == public.header.fingerprint
