"""SOON: the same digits as its challenge's script and DUET's, and the forms of its results.

The answered files were not available: recorded values are those of a file of their layout with
made-up targets. The public test file is as published.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from reverie_eval import DatasetError, GroundTruth, Scores, SubmissionError, evaluate, validate
from tests.conftest import SAMPLES
from tests.support.amounts import amount, tell
from tests.support.family import LENGTHS_WITHIN, Published, less_than_3_m, published_task
from tests.support.flat_world import Run
from tests.support.oracle import Scan, Viewpoint, World, distance, trajectory_length, weighted
from tests.support.soon import CORNERS, Walk, box, item, random_items, records_of, square, truth_of
from tests.support.worlds import SPLIT, random_case

SAMPLE = SAMPLES / "soon.json"
HOUSE = "SYNTHETIC_val_unseen_house"
SHARED = {
    "navigation_error": "nav_error",
    "oracle_error": "oracle_error",
    "goal_progress": "goal_progress",
    "detection_success": "det_success",
    "heading_error": "heading_error",
    "elevation_error": "elevation_error",
    "point_error": "point_det_error",
    "oracle_success": "oracle_success",
    "spl": "spl",
}
OFFICIAL = {
    **SHARED,
    "path_length": "trajectory_length",
    "shortest_length": "shortest_length",
    "steps": "steps",
    "success": "nav_success",
    "sfpl": "sfpl",
}
DUET = {
    **SHARED,
    "path_length": "trajectory_lengths",
    "steps": "trajectory_steps",
    "success": "success",
    "sfpl": "det_spl",
}
EXACT = ("success", "oracle_success", "detection_success", "steps")


@pytest.fixture(scope="module")
def soon(published: Path, tmp_path_factory: pytest.TempPathFactory) -> Published:
    """Compile the made-up answered file, and the published test file."""
    files = {HOUSE: f"{HOUSE}.json", "test": "test.json.new"}
    return published_task("soon", files, published, tmp_path_factory)


@pytest.mark.dataset
@pytest.mark.parametrize(
    ("protocol", "evaluator", "names"),
    [
        pytest.param("official-v1", "official", OFFICIAL, id="official"),
        pytest.param("duet", "duet", DUET, id="duet"),
    ],
)
def test_every_episode_has_the_recorded_value(
    protocol: str, evaluator: str, names: Mapping[str, str], soon: Published
) -> None:
    recorded = soon.recorded(f"{HOUSE}.mixed1", evaluator)["episodes"]
    scores = soon.scores(f"{HOUSE}.mixed1", protocol)
    assert set(scores.instr_ids) == recorded.keys()
    for ours, theirs in names.items():
        given = [recorded[instr_id].get(theirs) for instr_id in scores.instr_ids]
        expected = np.array([math.nan if value is None else float(value) for value in given])
        found = scores.episodes[ours]
        assert np.array_equal(np.isnan(found), np.isnan(expected)), ours
        within = 0.0 if ours in EXACT else LENGTHS_WITHIN
        assert np.nanmax(np.abs(found - expected)) <= within, ours


@pytest.mark.dataset
def test_the_aggregates_are_the_recorded_ones(soon: Published) -> None:
    """Three rates of the official script are divided by a count that is 1e-9 too large."""
    recorded = soon.recorded(f"{HOUSE}.mixed1", "official")["aggregate"]
    scores = soon.scores(f"{HOUSE}.mixed1", "official-v1")
    names = {
        "navigation_error": "nav_error",
        "oracle_error": "oracle_error",
        "path_length": "lengths",
        "steps": "steps",
        "heading_error": "heading_errors",
        "elevation_error": "elevation_errors",
        "point_error": "point_det_errors",
        "goal_progress": "goal_progress",
        "spl": "spl",
        "sfpl": "success_rate",
    }
    for ours, theirs in names.items():
        assert scores[ours] == pytest.approx(recorded[theirs], abs=LENGTHS_WITHIN)
    rates = {"detection_success": "det", "success": "nav", "oracle_success": "oracle"}
    for ours, theirs in rates.items():
        rate = recorded[f"{theirs}_rate" if theirs == "oracle" else f"{theirs}_success_rate"]
        assert rate == scores.episodes[ours].sum() / (len(scores.instr_ids) + 1e-9)
        assert scores[ours] == pytest.approx(rate, abs=2e-12)


@pytest.mark.dataset
def test_the_published_test_file_validates_a_result(soon: Published) -> None:
    truth = soon.truth("test")
    assert truth.solution is None
    assert len(truth.episodes.instr_ids) == 8450
    ids = truth.graph.viewpoint_ids
    items: dict[str, list[Any]] = {}
    for instr_id, start in zip(truth.episodes.instr_ids, truth.episodes.start, strict=True):
        trajectory = {"path": [[ids[start]]], "obj_heading": 0.5, "obj_elevation": 0.5}
        items.setdefault(instr_id.partition("#")[0], []).append(trajectory)
    records = [{"instr_id": int(item), "trajectory": them} for item, them in items.items()]
    checked = validate(records, split="test", ground_truth=truth)
    assert list(checked.notes) == [
        "read as: 8,450 poses without heading and elevation",
        "every trajectory has a single pose: no agent moves",
    ]


# The rules, on small worlds.


def corridor(*places: float) -> World:
    """Return viewpoints a, b, c, ... at these metres of a corridor."""
    names = "abcdefgh"[: len(places)]
    viewpoints = {
        name: Viewpoint((place, 0.0, 0.0)) for name, place in zip(names, places, strict=True)
    }
    edges = frozenset(zip(names[1:], names[:-1], strict=True))
    return World({"house": Scan(viewpoints, edges)}, [])


def walk(path: str, heading: float | None = 0.5, elevation: float | None = 0.5) -> dict[str, Any]:
    """Return a trajectory of viewpoints of one letter."""
    return {"path": [[it] for it in path], "obj_heading": heading, "obj_elevation": elevation}


def scored(truth: GroundTruth, *walks: Any, protocol: str = "official-v1") -> Scores:
    records = [{"instr_id": 7, "trajectory": list(walks)}]
    return evaluate(records, split=SPLIT, ground_truth=truth, protocol=protocol)


@pytest.mark.parametrize("protocol", ["official-v1", "duet", "navillm"])
@less_than_3_m
def test_success_is_less_than_3_m_from_the_paths_end(
    metres: float, success: float, protocol: str, tmp_path: Path
) -> None:
    truth = truth_of(tmp_path, corridor(0.0, metres, 9.0), [item(["cba"], [square("a")])])
    scores = scored(truth, walk("cb"), protocol=protocol)
    assert (scores["success"], scores["oracle_success"]) == (success, success)
    assert (scores["detection_success"], scores["sfpl"]) == (0.0, 0.0)


def test_a_stop_that_sees_the_target_becomes_the_goal_but_not_for_the_oracle(
    tmp_path: Path,
) -> None:
    """The path ends at a; the target is seen from e as well, far away. The agent passes b."""
    world = corridor(0.0, 4.0, 10.0, 16.0, 22.0)
    truth = truth_of(tmp_path, world, [item(["cba"], [square("a"), square("e")])])
    scores = scored(truth, walk("cbcde"))
    found = {key: scores[key] for key in ("success", "navigation_error", "oracle_success")}
    assert found == {"success": 1.0, "navigation_error": 0.0, "oracle_success": 0.0}
    assert scores["oracle_error"] == 18.0  # from b, the nearest to a
    assert (scores["shortest_length"], scores["goal_progress"]) == (12.0, 12.0)
    assert scores["spl"] == scores["sfpl"] == 12.0 / 24.0


@pytest.mark.parametrize(
    ("way", "expected"),
    [
        pytest.param("cba", [1.0, 1.0, 1.0, 1.0], id="the path's end"),
        pytest.param("cbcde", [0.0, 1.0, 0.0, 10 / 24], id="seen from elsewhere: no success"),
        pytest.param("cb", [0.0, 0.0, 0.0, 0.0], id="4 m before the end"),
        pytest.param("c", [0.0, 0.0, 0.0, 0.0], id="stays"),
    ],
)
def test_navillm_keeps_the_paths_end_as_goal(
    way: str, expected: Sequence[float], tmp_path: Path
) -> None:
    """The path ends at a; the target is seen from e as well, far away."""
    world = corridor(0.0, 4.0, 10.0, 16.0, 22.0)
    truth = truth_of(tmp_path, world, [item(["cba"], [square("a"), square("e")])])
    scores = scored(truth, walk(way), protocol="navillm")
    keys = ("success", "detection_success", "spl", "sfpl")
    assert [scores[key] for key in keys] == expected
    assert "goal_progress" not in scores


def test_standing_where_the_target_is_seen_has_no_spl(tmp_path: Path) -> None:
    truth = truth_of(tmp_path, corridor(0.0, 9.0), [item(["ab"], [square("a"), square("b")])])
    scores = scored(truth, walk("a"))
    assert (scores["success"], scores["detection_success"]) == (1.0, 1.0)
    assert (scores["spl"], scores["sfpl"]) == (0.0, 0.0)


@pytest.mark.parametrize(("protocol", "successes"), [("official-v1", [1, 1]), ("duet", [1, 0])])
def test_the_official_script_takes_the_first_path_from_a_start(
    protocol: str, successes: list[int], tmp_path: Path
) -> None:
    """Both trajectories end at a, where the first path ends; the second path ends at c."""
    world = corridor(0.0, 5.0, 10.0, 20.0)
    truth = truth_of(tmp_path, world, [item(["ba", "bc"], [square("d")])])
    scores = scored(truth, walk("ba"), walk("ba"), protocol=protocol)
    assert scores.instr_ids == ("7#0", "7#1")
    assert scores.episodes["success"].tolist() == successes


@pytest.mark.parametrize(("protocol", "detected"), [("official-v1", 1.0), ("duet", 0.0)])
def test_duet_takes_the_last_of_two_boxes(protocol: str, detected: float, tmp_path: Path) -> None:
    items = [item(["ab"], [square("b", 0.5), square("b", 0.8)])]
    scores = scored(truth_of(tmp_path, corridor(0.0, 9.0), items), walk("ab"), protocol=protocol)
    assert scores["detection_success"] == detected
    assert scores["heading_error"] == pytest.approx(0.0 if detected else 0.3, abs=1e-15)


@pytest.mark.parametrize(
    ("heading", "elevation", "detected"),
    [
        pytest.param(0.5, 0.5, 1.0, id="centre"),
        pytest.param(0.375, 0.5, 0.0, id="on the left side"),
        pytest.param(float(np.nextafter(0.375, 1)), 0.5, 1.0, id="right of it"),
        pytest.param(0.5, 0.625, 0.0, id="on the upper side"),
        pytest.param(0.625, 0.375, 0.0, id="a corner"),
        pytest.param(1.5, 0.5, 0.0, id="a whole turn away"),
        pytest.param(None, None, 0.0, id="no point"),
    ],
)
def test_the_point_is_strictly_inside_the_outline(
    heading: float | None, elevation: float | None, detected: float, tmp_path: Path
) -> None:
    truth = truth_of(tmp_path, corridor(0.0, 9.0), [item(["ab"], [square("b")])])
    scores = scored(truth, walk("ab", heading, elevation))
    assert scores["detection_success"] == scores["sfpl"] == detected
    assert scores["success"] == 1.0


def test_errors_are_means_over_those_that_have_one(tmp_path: Path) -> None:
    """One walk detects, one sees the target and points 0.3 beside it, one does not see it."""
    truth = truth_of(tmp_path, corridor(0.0, 5.0, 9.0), [item(["abc"] * 3, [square("c")])])
    walks = walk("abc", 0.5, 0.6), walk("abc", 0.8), walk("ab")
    official, duet = scored(truth, *walks), scored(truth, *walks, protocol="duet")
    assert official["heading_error"] == pytest.approx(0.15)
    assert official["point_error"] == pytest.approx(0.1)
    assert duet["point_error"] == pytest.approx(0.2)
    none = scored(truth, *[walk("ab")] * 3)
    assert math.isnan(none["point_error"])
    assert none.to_report().model_dump(mode="json")["scores"]["success"] == 0.0
    assert "NaN" not in none.to_report().model_dump_json()


def test_an_outline_across_heading_0_is_compared_as_plain_numbers(tmp_path: Path) -> None:
    """From 0.9 over 0 to 0.1: what is between 0.1 and 0.9 is inside."""
    outline = ((0.9, 0.6), (0.1, 0.6), (0.1, 0.4), (0.9, 0.4))
    items = [item(["ab", "ab"], [box("b", (0.0, 0.5), *outline)])]
    scores = scored(truth_of(tmp_path, corridor(0.0, 9.0), items), walk("ab"), walk("ab", 0.95))
    assert scores.episodes["detection_success"].tolist() == [1.0, 0.0]


# Random worlds, by the rules written once more.


def test_every_protocol_agrees_with_the_rules_written_once_more(tmp_path: Path) -> None:
    worlds = amount(20)
    for seed in range(worlds):
        random = Random(seed)
        world = random_case(random, (0,)).world
        case = random_items(random, world)
        truth = truth_of(tmp_path / str(seed), world, case.items)
        records = records_of(case.walks)
        for protocol in ("official-v1", "duet", "navillm"):
            scores = evaluate(records, split=SPLIT, ground_truth=truth, protocol=protocol)
            expected = [
                expected_values(
                    world.scans[it["scan"]],
                    it,
                    first_from(it, each.way[0]) if protocol == "official-v1" else it["path"][index],
                    each,
                    protocol,
                )
                for it in case.items
                for index, each in enumerate(case.walks[it["instr_id"]])
            ]
            for key in expected[0]:
                values = [each[key] for each in expected]
                found = scores.episodes[key].tolist()
                assert str(found) == str(values), (seed, protocol, key)
    tell(random_worlds_of_soon=worlds)


def first_from(it: Mapping[str, Any], start: str) -> Sequence[str]:
    """Return the first of the paths from a start."""
    starting: list[Sequence[str]] = [path for path in it["path"] if path[0] == start]
    return starting[0]


def expected_values(
    scan: Scan, it: Mapping[str, Any], path: Sequence[str], walked_by: Walk, protocol: str
) -> Mapping[str, float]:
    """Score a trajectory by the rules of the script, sentence by sentence."""
    official = protocol == "official-v1"
    way, point, goal = walked_by.way, walked_by.point, path[-1]
    nearest = min(way, key=lambda viewpoint: distance(scan, viewpoint, goal))
    boxes = [each for each in it["bboxes"] if each["image_id"] == way[-1]]
    detected, errors = False, (math.nan, math.nan)
    if boxes:
        goal = goal if protocol == "navillm" else way[-1]
        target = boxes[0 if official else -1]["target"]
        turns = [
            (at["heading"] / (2 * math.pi), (at["elevation"] + math.pi) / (2 * math.pi))
            for at in (target[name] for name in CORNERS)
        ]
        if point is not None:
            detected = strictly_inside(point, turns[1:])
            errors = abs(turns[0][0] - point[0]), abs(turns[0][1] - point[1])
    walked, shortest = trajectory_length(scan, way), distance(scan, way[0], goal)
    error = distance(scan, way[-1], goal)
    spl = weighted(walked, shortest, 0.01, achieved=error < 3.0)
    progress = {} if protocol == "navillm" else {"goal_progress": shortest - error}
    off = math.hypot(*errors)
    return {
        "path_length": walked,
        "navigation_error": error,
        "success": float(error < 3.0),
        "oracle_error": distance(scan, nearest, goal),
        "oracle_success": float(distance(scan, nearest, goal) < 3.0),
        "shortest_length": shortest,
        "spl": spl,
        "detection_success": float(detected),
        "sfpl": weighted(walked, shortest, 0.01, achieved=detected),
        "heading_error": errors[0],
        "elevation_error": errors[1],
        "point_error": off if detected or not official else math.nan,
        **progress,
    }


def strictly_inside(point: tuple[float, float], corners: Sequence[tuple[float, float]]) -> bool:
    """Count how often the border is met to the right of the point; none may be at it."""
    x, y = map(Fraction, point)
    exact = [(Fraction(a), Fraction(b)) for a, b in corners]
    met = 0
    for (x0, y0), (x1, y1) in zip(exact, [*exact[1:], exact[0]], strict=True):
        if y0 == y1:
            if y == y0 and min(x0, x1) <= x <= max(x0, x1):
                return False
            continue
        if min(y0, y1) <= y <= max(y0, y1):
            here = x0 + (x1 - x0) * (y - y0) / (y1 - y0)
            if here == x:
                return False
            met += here > x and y != max(y0, y1)
    return met % 2 == 1


# Forms of a result, on the demo world.


def changed(change: Callable[[dict[str, Any]], dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the sample with each trajectory changed."""
    return [
        {**record, "trajectory": [change(dict(each)) for each in record["trajectory"]]}
        for record in json.loads(SAMPLE.read_text())
    ]


def in_lists(each: dict[str, Any]) -> dict[str, Any]:
    return {**each, **{key: [each[key]] for key in ("obj_heading", "obj_elevation")}}


NO_POINTS = "9 trajectories without a point"


@pytest.mark.parametrize(
    ("form", "read_as"),
    [
        pytest.param(changed(dict), [NO_POINTS], id="official"),
        pytest.param(
            changed(in_lists), ["144 angles in lists of one", NO_POINTS], id="lists of one"
        ),
        pytest.param(
            [
                {"instr_id": str(record["instr_id"]), "trajectory": each}
                for record in changed(dict)
                for each in record["trajectory"]
            ],
            ["72 records with a single trajectory instead of a list", NO_POINTS],
            id="a record for each trajectory",
        ),
        pytest.param(
            changed(lambda each: {**each, "path": [[pose[0]] for pose in each["path"]]}),
            ["without heading and elevation", NO_POINTS],
            id="nested hops",
        ),
    ],
)
def test_forms_of_a_result(form: Any, read_as: Sequence[str]) -> None:
    expected = evaluate(SAMPLE, split="val_unseen", task="soon")
    for given in (form, json.dumps(form).encode()):
        found = evaluate(given, split="val_unseen", task="soon")
        assert np.array_equal(found.episodes["sfpl"], expected.episodes["sfpl"])
        assert dict(found) == dict(expected)
        (note,) = found.notes
        assert all(phrase in note for phrase in read_as)


def test_converting_writes_the_official_form(run: Run) -> None:
    done = run("convert", str(SAMPLE), "--task", "soon", "--split", "val_unseen")
    assert json.loads(done.out) == json.loads(SAMPLE.read_text())


def broken(**changes: Any) -> list[dict[str, Any]]:
    """Return the sample with a change in the second trajectory of the third record."""
    records = changed(dict)
    for key, value in changes.items():
        if value is ...:
            del records[2]["trajectory"][1][key]
        else:
            records[2]["trajectory"][1][key] = value
    return records


@pytest.mark.parametrize(
    ("changes", "where", "message"),
    [
        ({"obj_heading": ...}, "[2].trajectory[1]", "has no obj_heading; add it"),
        ({"obj_heading": None}, "[2].trajectory[1]", "the other is null; give both or neither"),
        (
            {"obj_elevation": "up"},
            "[2].trajectory[1].obj_elevation",
            "expected a number of turns, or null",
        ),
        ({"obj_heading": math.inf}, "[2].trajectory[1].obj_heading", "got inf; expected a number"),
        ({"path": []}, "[2].trajectory[1].path", "is empty; an agent that does not move"),
        ({"path": [[3, 0, 0]]}, "[2].trajectory[1].path[0]", "viewpoints given as numbers"),
        ({"path": [["x" * 32, 0, 0]]}, "[2].trajectory[1].path[0][0]", "is not in the navigation"),
        ({"path": ...}, "[2].trajectory[1]", "has no path; add it"),
    ],
)
def test_faults_are_told_with_their_place(
    changes: dict[str, Any], where: str, message: str
) -> None:
    with pytest.raises(SubmissionError) as refused:
        evaluate(broken(**changes), split="val_unseen", task="soon")
    (problem,) = refused.value.problems
    assert problem.where == where
    assert message in problem.message


def test_a_missing_start_and_one_too_many() -> None:
    records = changed(dict)
    del records[0]["trajectory"][2]
    records[1]["trajectory"].append(records[1]["trajectory"][0])
    with pytest.raises(SubmissionError) as refused:
        evaluate(records, split="val_unseen", task="soon")
    missing, extra = refused.value.problems
    assert extra.where == "[1].instr_id"
    assert "ids are <instr_id of the item>#<index of the start>" in extra.message
    assert missing.message.startswith(f"episode {records[0]['instr_id']}#2 has no prediction")


def test_trajectories_in_another_order_are_told() -> None:
    records = changed(dict)
    records[3]["trajectory"].reverse()
    records[3]["trajectory"].append(records[3]["trajectory"].pop(0))
    with pytest.raises(SubmissionError) as refused:
        evaluate(records, split="val_unseen", task="soon")
    first, _ = refused.value.problems
    assert first.where == "[3].trajectory[0].path[0]"
    assert "list the trajectories in the order of the item's paths" in first.message


def test_ids_of_duets_own_episodes_are_told() -> None:
    record = {"instr_id": "4-0_0", "trajectory": changed(in_lists)[0]["trajectory"][0]}
    with pytest.raises(SubmissionError, match="is an episode id of DUET's own files"):
        evaluate([record], split="val_unseen", task="soon")


def test_scores_are_saved_with_their_points(tmp_path: Path) -> None:
    scores = evaluate(SAMPLE, split="val_unseen", task="soon", protocol="duet")
    scores.with_intervals(resamples=50).save(tmp_path / "scores.npz")
    loaded = Scores.load(tmp_path / "scores.npz")
    assert dict(loaded) == dict(scores)
    assert loaded.intervals is not None
    assert "sfpl" in loaded.intervals
    assert "point_error" not in loaded.intervals


def test_annotations_of_several_instructions_and_without_a_scan(tmp_path: Path) -> None:
    given = item(["ab"], [{**square("b"), "scan": "house"}])
    del given["scan"]
    given["instructions"] = [given["instructions"], ["another"] * 5]
    truth = truth_of(tmp_path / "one", corridor(0.0, 9.0), [given])
    assert truth.episodes.instructions == ("the full text",)
    del given["bboxes"][0]["scan"]
    with pytest.raises(DatasetError, match="neither the item nor its bboxes have a scan"):
        truth_of(tmp_path / "other", corridor(0.0, 9.0), [given])


@pytest.mark.parametrize(
    ("point", "hint"),
    [
        pytest.param(None, "no trajectory has a point: SFPL will be 0", id="none"),
        pytest.param(3.5, "obj_heading is heading / (2 pi)", id="radians"),
    ],
)
def test_hints_about_points(point: float | None, hint: str) -> None:
    records = changed(lambda each: {**each, "obj_heading": point, "obj_elevation": point})
    notes = evaluate(records, split="val_unseen", task="soon").notes
    assert any(hint in note for note in notes)
