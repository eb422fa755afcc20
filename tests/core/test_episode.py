"""Single episodes: trajectory, annotation, values and outcome."""

import json
from pathlib import Path
from random import Random

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.geometry import view_angles
from tests.conftest import SAMPLES
from tests.support.home_world import HOME, LAMP, SOFA, WALKS, home_scores, records
from tests.support.worlds import ground_truth_by_hand, random_case, records_of

OUTCOMES = {
    "1_3_0": "correct",
    "1_3_1": "wrong object",
    "1_3_2": "correct object at the wrong stop",
    "2_4_0": "overshot",
    "2_4_1": "never reached",
}


@pytest.fixture(scope="module")
def scores(tmp_path_factory: pytest.TempPathFactory) -> rv.Scores:
    """Score an episode of every outcome."""
    return home_scores(tmp_path_factory.mktemp("home"))


@pytest.mark.parametrize("instr_id", WALKS)
def test_an_episode_has_what_was_submitted(instr_id: str, scores: rv.Scores) -> None:
    episode = scores.episode(instr_id)
    walk, answer = WALKS[instr_id]
    assert list(episode.trajectory) == walk
    assert episode.predicted_object == (None if answer == -1 else answer)
    assert (episode.start, episode.stop) == (walk[0], walk[-1])
    assert episode.outcome == OUTCOMES[instr_id]
    assert (episode.scan, episode.instruction, episode.box_outcome) == ("home", "go there", "")


def test_an_episode_has_what_is_annotated(scores: rv.Scores) -> None:
    lamp, sofa = scores.episode("1_3_0"), scores.episode("2_4_1")
    assert (lamp.target_object, sofa.target_object) == (LAMP, SOFA)
    assert (lamp.annotated_path, lamp.goal) == (("hall", "room"), "room")
    assert (sofa.annotated_path, sofa.goal) == (("porch", "room", "hall"), "hall")


def test_values_are_those_of_the_episode(scores: rv.Scores) -> None:
    episode = scores.episode("1_3_1")
    assert episode.values["path_length"] == pytest.approx(6 + np.sqrt(16.04))
    assert episode.values["shortest_length"] == 6.0
    assert (episode.values["success"], episode.values["rgs"]) == (1.0, 0.0)
    assert list(episode.values) == list(scores)


def test_positions_in_metres(scores: rv.Scores) -> None:
    episode = scores.episode("2_4_0")
    assert episode.positions(episode.trajectory).tolist() == [
        [10.0, 14.0, 3.2],
        [10.0, 10.0, 3.0],
        [10.0, 14.0, 3.2],
    ]


@pytest.mark.parametrize(
    ("protocol", "instr_id", "expected"),
    [
        pytest.param("official-v1", "1_3_0", {"room", "porch"}, id="where the lamp is seen"),
        pytest.param("official-v1", "2_4_0", {"hall", "room"}, id="where the sofa is seen"),
        pytest.param("r2r-style", "1_3_0", {"room"}, id="less than 3 m from the end"),
    ],
)
def test_goal_viewpoints_depend_on_the_protocol(
    protocol: str, instr_id: str, expected: set[str], tmp_path: Path
) -> None:
    episode = home_scores(tmp_path, protocol=protocol).episode(instr_id)
    assert set(episode.goal_viewpoints) == expected


def test_goal_viewpoints_of_the_demo_world_match_its_files(demo_world: Path) -> None:
    """Counted in the published files, without the code under test."""
    data = demo_world / "tasks" / "REVERIE" / "data"
    scores = rv.evaluate(SAMPLES / "good.json", split="val_unseen")
    items = json.loads((data / "REVERIE_val_unseen.json").read_text())
    for item in items:
        graph = json.loads(
            (demo_world / "connectivity" / f"{item['scan']}_connectivity.json").read_text()
        )
        seeing = set()
        for viewpoint in graph:
            name = viewpoint["image_id"]
            file = data / "BBox" / f"{item['scan']}_{name}.json"
            listed = json.loads(file.read_text())[name] if file.exists() else {}
            seen = listed.get(str(item["objId"]), {"visible_pos": []})["visible_pos"]
            if viewpoint["included"] and seen:
                seeing.add(name)
        episode = scores.episode(f"{item['id']}_0")
        assert set(episode.goal_viewpoints) == seeing
        assert episode.instruction == item["instructions"][0]


@pytest.mark.parametrize("seed", range(30))
def test_a_stop_is_a_success_exactly_at_goal_viewpoints(seed: int) -> None:
    case = random_case(Random(seed), (0,))
    truth = ground_truth_by_hand(case.world)
    protocols = rv.evaluate_protocols(
        json.dumps(records_of(case.predictions)).encode(), split="val_unseen", ground_truth=truth
    )
    for scores in protocols.values():
        for row, instr_id in enumerate(scores.instr_ids):
            episode = scores.episode(instr_id)
            stopped_right = episode.stop in episode.goal_viewpoints
            came = bool({*episode.trajectory} & {*episode.goal_viewpoints})
            assert scores.episodes["success"][row] == stopped_right
            assert scores.episodes["oracle_success"][row] == came


def test_the_objects_that_are_visible(scores: rv.Scores) -> None:
    episode = scores.episode("1_3_0")
    seen = {
        place: [(each.object_id, each.view.tolist()) for each in episode.visible_objects(place)]
        for place in ("cellar", "hall", "room", "porch")
    }
    assert seen == {
        "cellar": [],
        "hall": [(SOFA, [12])],
        "room": [(LAMP, [12]), (SOFA, [12])],
        "porch": [(LAMP, [13])],
    }
    for each in episode.visible_objects("room"):
        assert each.xywh.shape == (1, 4)
        assert each.name == episode.object_name(each.object_id)


def test_objects_have_the_names_of_their_own_scan() -> None:
    """Ids are numbered within each building: object 0 is in both of the demo world's."""
    scores = rv.evaluate(SAMPLES / "good.json", split="val_unseen")
    truth = scores.ground_truth
    solution = truth.require_solution()
    scans = truth.graph.viewpoint_scan[solution.candidate_viewpoint]
    for scan in set(truth.scans):
        episode = scores.episode(truth.episodes.instr_ids[truth.scans.index(scan)])
        rows = np.flatnonzero(scans == truth.graph.scan_ids.index(scan)).tolist()
        named = {
            int(solution.candidate_object[row]): solution.candidate_categories[row] for row in rows
        }
        assert {each: episode.object_name(each) for each in named} == {
            each: f"{name.replace('#', ' ')} {each}" for each, name in named.items()
        }
        assert episode.object_name(99_999) == "object 99999"
        (first, *_) = episode.visible_objects(
            truth.graph.viewpoint_ids[solution.candidate_viewpoint[rows[0]]]
        )
        assert first.name == episode.object_name(first.object_id)


def test_an_episode_of_a_task_without_objects() -> None:
    scores = rv.evaluate(SAMPLES / "r2r.json", split="val_unseen", task="r2r")
    episode = scores.episode(scores.instr_ids[0])
    assert (episode.target_object, episode.target_category) == (None, "")
    assert episode.caption.startswith(("walked ", f"{episode.outcome}; walked "))


def test_an_unknown_episode(scores: rv.Scores) -> None:
    with pytest.raises(rv.ReverieEvalError) as error:
        scores.episode("1_3_00")
    assert str(error.value) == (
        "no episode '1_3_00' among the 5 episodes of val_unseen; did you mean 1_3_0, 1_3_2, 1_3_1?"
    )
    with pytest.raises(rv.ReverieEvalError) as error:
        scores.episode("x")
    assert str(error.value).endswith("of val_unseen; it has 1_3_0, 1_3_1, 1_3_2 and 2 more")


@pytest.mark.parametrize(
    ("instr_id", "caption"),
    [
        pytest.param(
            "1_3_0",
            "correct: predicted the target, object 3; walked 6.0 m, shortest 6.0 m; "
            "stopped 0.0 m from the path's end",
            id="correct",
        ),
        pytest.param(
            "1_3_1",
            "wrong object: predicted object 4, the target is object 3; walked 10.0 m, "
            "shortest 6.0 m; stopped 4.0 m from the path's end",
            id="wrong object",
        ),
        pytest.param(
            "2_4_1",
            "never reached: predicted no object, the target is object 4; walked 0.0 m, "
            "shortest 10.0 m; stopped 10.0 m from the path's end",
            id="never reached",
        ),
    ],
)
def test_the_caption_of_an_episode(instr_id: str, caption: str, scores: rv.Scores) -> None:
    episode = scores.episode(instr_id)
    assert episode.caption == caption
    assert repr(episode) == f"<Episode {instr_id} in home: {caption}>"


def test_an_episode_with_a_box() -> None:
    scores = rv.evaluate(SAMPLES / "drawn.json", split="val_unseen")
    row = scores.box_outcomes.index("wrong view")
    episode = scores.episode(scores.instr_ids[row])
    assert (episode.predicted_object, episode.box_outcome) == (None, "wrong view")
    assert "predicted a box (wrong view), the target is " in episode.caption
    records = json.loads((SAMPLES / "drawn.json").read_bytes())
    (record,) = [each for each in records if each["instr_id"] == episode.instr_id]
    box = episode.predicted_box
    assert box is not None
    assert box.xywh.tolist() == pytest.approx(record["predBox"])
    assert box.view == record["predView"]
    assert box.camera.tolist() == view_angles(np.array([box.view])).tolist()[0]
    assert episode.solution is scores.ground_truth.solution


def test_the_grounding_track_has_no_outcome() -> None:
    scores = rv.evaluate(SAMPLES / "good.json", split="val_unseen", track="grounding")
    episode = scores.episode(scores.instr_ids[0])
    assert episode.outcome == ""
    assert episode.trajectory == (episode.goal,)
    assert episode.start == episode.annotated_path[0]


def test_a_target_without_a_name() -> None:
    truth = ground_truth_by_hand(HOME)
    episode = rv.evaluate(records(WALKS), split="val_unseen", ground_truth=truth).episode("1_3_0")
    assert episode.target_category == ""
    assert episode.object_name(3) == "object 3"


def test_trajectories_are_not_in_the_report(scores: rv.Scores) -> None:
    assert "submission" not in scores.to_report().model_dump()
    assert "porch" not in repr(scores) + scores._repr_html_() + scores.to_report().model_dump_json()
