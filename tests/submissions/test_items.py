"""Results of items: a record for each trajectory, with the point that the agent predicts."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from reverie_eval import SubmissionError
from reverie_eval.submissions import read_predictions
from reverie_eval.submissions._answers import NO_POINT, official_point
from reverie_eval.submissions._trajectories import join_items
from reverie_eval.tasks import find_task

SOON = find_task("soon")


def walk(viewpoint_id: str, **point: Any) -> dict[str, Any]:
    """Return a trajectory of one pose, pointing to the right and level unless told otherwise."""
    return {"path": [[viewpoint_id, 0, 0]], "obj_heading": 0.25, "obj_elevation": 0.5} | point


def test_every_trajectory_of_an_item_is_a_record() -> None:
    """Also behind a record that is not an item, and where an item has two records."""
    flat = {"instr_id": "7#0", "trajectory": [["a", 0, 0]], "obj_heading": 0, "obj_elevation": 0.5}
    items = [
        {"instr_id": 8, "trajectory": [walk("b"), walk("c", obj_heading=0.75)]},
        {"instr_id": 9, "trajectory": [walk("d")]},
        {"instr_id": 8, "trajectory": [walk("e")]},
    ]
    predictions = read_predictions([flat, *items], SOON)
    assert not predictions.problems
    assert list(predictions.instr_ids) == ["7#0", "8#0", "8#1", "9#0", "8#2"]
    assert list(predictions.viewpoint_ids) == ["a", "b", "c", "d", "e"]
    assert [str(predictions.location(row)) for row in range(5)] == [
        *("[0]", "[1].trajectory[0]", "[1].trajectory[1]", "[2].trajectory[0]"),
        "[3].trajectory[0]",
    ]
    assert predictions.point is not None
    assert predictions.point[:, 0].tolist() == [0.0, 0.25, 0.75, 0.25, 0.25]


def test_items_keyed_by_their_ids() -> None:
    predictions = read_predictions({"7": {"trajectory": [walk("a")]}}, SOON)
    assert list(predictions.instr_ids) == ["7#0"]
    assert not predictions.problems


def test_single_trajectories_and_listed_angles_are_counted() -> None:
    single = walk("a", obj_heading=[0.5], obj_elevation=[0.25])
    records = [{"instr_id": number, "trajectory": single} for number in (7, 8)]
    predictions = read_predictions(records, SOON)
    assert predictions.read_as == [
        "2 records with a single trajectory instead of a list",
        "4 angles in lists of one",
    ]
    assert predictions.point is not None
    assert predictions.point.tolist() == [[0.5, 0.25]] * 2


@pytest.mark.parametrize(
    ("point", "message"),
    [
        pytest.param({"obj_heading": [0.5, 0.5]}, "got [0.5, 0.5]; expected a number", id="two"),
        pytest.param({"obj_heading": []}, "got []; expected a number of turns", id="empty list"),
        pytest.param({"obj_elevation": "up"}, "got 'up'; expected a number of turns", id="text"),
        pytest.param({"obj_heading": np.inf}, "got inf; expected a number of turns", id="infinite"),
        pytest.param({"obj_heading": None}, "has only one of obj_heading and", id="half a point"),
    ],
)
def test_what_is_no_point(point: Mapping[str, Any], message: str) -> None:
    predictions = read_predictions([{"instr_id": 7, "trajectory": [walk("a", **point)]}], SOON)
    (problem,) = predictions.problems
    assert problem.message.startswith(message)
    assert problem.where.startswith("[0].trajectory[0]")
    assert predictions.point is not None
    assert np.isnan(predictions.point).all()


def test_a_trajectory_without_a_point_and_one_without_a_path() -> None:
    no_point = walk("a", obj_heading=None, obj_elevation=None)
    predictions = read_predictions([{"instr_id": 7, "trajectory": [no_point] * 2}], SOON)
    assert predictions.read_as == ["2 trajectories without a point"]
    no_path = {"obj_heading": 0.5, "obj_elevation": 0.5}
    (problem,) = read_predictions(
        [{"instr_id": 7, "trajectory": [no_point, no_path]}], SOON
    ).problems
    assert (problem.where, problem.message) == ("[0].trajectory[1]", "has no path; add it")


def test_an_episode_of_duets_files_is_not_an_item() -> None:
    with pytest.raises(SubmissionError, match="'1-2_3' is an episode id of DUET's own files"):
        read_predictions([{"instr_id": "1-2_3", "trajectory": [walk("a")]}], SOON)


def test_records_are_joined_to_items() -> None:
    records: list[dict[str, Any]] = [
        {"instr_id": "7#0", "trajectory": [1], "obj_heading": 0.5, "note": "left out"},
        {"instr_id": "x#1#0", "trajectory": [2]},
        {"instr_id": "7#1", "trajectory": [3]},
    ]
    assert join_items(records) == [
        {"instr_id": 7, "trajectory": [{"path": [1], "obj_heading": 0.5}, {"path": [3]}]},
        {"instr_id": "x", "trajectory": [{"path": [2]}]},
    ]
    assert official_point(NO_POINT) == {"obj_heading": None, "obj_elevation": None}
    assert official_point((0.5, 0.25)) == {"obj_heading": 0.5, "obj_elevation": 0.25}
