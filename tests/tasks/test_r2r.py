"""R2R: the same digits as its own script and HAMT's, and what is peculiar about its files."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from random import Random

import pytest

from reverie_eval import Evaluator, GroundTruth, Scores, SubmissionError, evaluate, validate
from reverie_eval.ground_truth import find_ground_truth
from reverie_eval.runner import run_agent
from tests.conftest import REPOSITORY
from tests.support.amounts import amount, tell
from tests.support.family import (
    HAMT,
    LENGTHS_WITHIN,
    Published,
    differences,
    less_than_3_m,
    published_task,
    walks_of,
    world_of_task,
)
from tests.support.flat_world import Run
from tests.support.oracle import Item, Scan, Viewpoint, World, measure, score_episode, weighted
from tests.support.worlds import SPLIT, random_case

SAMPLE = REPOSITORY / "fixtures" / "submissions" / "r2r.json"
FILES = ["val_seen.mixed1", "val_unseen.mixed1"] + [
    f"{split}.seq2seq_published" for split in ("val_seen", "val_unseen")
]
OFFICIAL = {
    "navigation_error": "nav_error",
    "oracle_error": "oracle_error",
    "path_length": "trajectory_length",
    "shortest_length": "shortest_path_length",
    "success": "success",
    "oracle_success": "oracle_success",
    "spl": "spl",
}
EXACT = ("success", "oracle_success", "steps")


@pytest.fixture(scope="module")
def r2r(published: Path, tmp_path_factory: pytest.TempPathFactory) -> Published:
    """Compile the published R2R."""
    splits = ("val_seen", "val_unseen", "test")
    return published_task(
        "r2r", {split: f"R2R_{split}.json" for split in splits}, published, tmp_path_factory
    )


@pytest.mark.dataset
@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize(
    ("protocol", "evaluator", "names"),
    [
        pytest.param("official-v1", "official", OFFICIAL, id="official"),
        pytest.param("hamt", "hamt", HAMT, id="hamt"),
    ],
)
def test_every_episode_has_the_recorded_value(
    protocol: str, evaluator: str, names: Mapping[str, str], name: str, r2r: Published
) -> None:
    recorded = r2r.recorded(name, evaluator)["episodes"]
    found = differences(r2r.scores(name, protocol), recorded, names)
    assert {key: found[key] for key in EXACT if found.get(key)} == {}
    assert max(found.values()) < LENGTHS_WITHIN


@pytest.mark.dataset
@pytest.mark.parametrize(("protocol", "episodes"), [("official-v1", 1020), ("duet", 1021)])
def test_the_official_script_never_scores_a_fourth_instruction(
    protocol: str, episodes: int, r2r: Published
) -> None:
    scores = r2r.scores("val_seen.mixed1", protocol)
    assert f"|n:{episodes}|" in scores.signature
    assert ("757_3" in scores.instr_ids) == (episodes == 1021)
    assert any("757_3" in note for note in scores.notes) == (episodes == 1020)


@pytest.mark.dataset
def test_a_test_submission_can_be_validated(r2r: Published) -> None:
    truth = r2r.truth("test")
    assert truth.solution is None
    checked = validate(r2r.submission("test.seq2seq_published"), split="test", ground_truth=truth)
    assert checked.notes == []


@pytest.mark.dataset
def test_known_answers(r2r: Published) -> None:
    """The Shortest agent of the paper's table 2: 10.19 m and 9.48 m."""
    for split, metres in (("val_seen", 10.19), ("val_unseen", 9.48)):
        shortest = r2r.scores(f"{split}.mixed1", "official-v1")["shortest_length"]
        assert round(shortest, 2) == metres


@pytest.mark.dataset
def test_published_files_are_known_by_their_digest(r2r: Published) -> None:
    assert {r2r.truth(split).header.dataset for split in ("val_seen", "val_unseen")} == {"R2R"}


def corridor(metres: float) -> World:
    """Return a world whose agent stops this far from the path's end."""
    viewpoints = {
        "goal": Viewpoint((0.0, 0.0, 0.0)),
        "stop": Viewpoint((metres, 0.0, 0.0)),
        "start": Viewpoint((10.0, 0.0, 0.0)),
    }
    edges = frozenset({("goal", "stop"), ("stop", "start")})
    path = ["start", "stop", "goal"]
    return World({"house": Scan(viewpoints, edges)}, [Item("1", "house", path, 0)])


@pytest.mark.parametrize("protocol", ["official-v1", "duet"])
@less_than_3_m
def test_success_is_less_than_3_m_from_the_paths_end(
    metres: float, success: float, protocol: str
) -> None:
    records = [{"instr_id": "1_0", "trajectory": [["start", 0, 0], ["stop", 0, 0]]}]
    truth = world_of_task(corridor(metres), "r2r")
    scores = evaluate(records, split=SPLIT, ground_truth=truth, protocol=protocol)
    assert (scores["success"], scores["oracle_success"]) == (success, success)


def test_both_protocols_agree_with_the_oracle() -> None:
    worlds = amount(25)
    for seed in range(worlds):
        case = random_case(Random(seed), (0,))
        truth, records = world_of_task(case.world, "r2r"), walks_of(case.predictions)
        official = evaluate(records, split=SPLIT, ground_truth=truth)
        duet = evaluate(records, split=SPLIT, ground_truth=truth, protocol="duet")
        episodes = [
            measure(case.world.scans[item.scan_id], item, case.predictions[instr_id])
            for item in case.world.items
            for instr_id in item.instr_ids
        ]
        expected = [score_episode(episode, "r2r-style") for episode in episodes]
        for key in official:
            values = [each[key] for each in expected]
            assert official.episodes[key] == pytest.approx(values, abs=1e-12), (seed, key)
        by_annotated = [
            weighted(each.walked, each.annotated, 0.01, achieved=bool(values["success"]))
            for each, values in zip(episodes, expected, strict=True)
        ]
        assert duet.episodes["spl"].tolist() == by_annotated, seed
    tell(random_worlds_of_r2r=worlds)


# The demo world.

R2R_HEADINGS = ["TL", "m", "NE", "m", "OSR", "%", "SR", "%", "SPL", "%"]


def test_the_sample_submission(run: Run) -> None:
    done = run(str(SAMPLE), "--task", "r2r", "--split", "val_unseen")
    assert done.out.splitlines()[0].split() == R2R_HEADINGS
    assert "task:r2r|split:val_unseen|protocol:official-v1|" in done.out
    assert "the synthetic demo world that ships with reverie-eval, not R2R" in done.out


def test_answers_are_not_read() -> None:
    """R2R has no objects: what a record says about one is a field like any other."""
    records = [{**record, "predObjId": 7} for record in json.loads(SAMPLE.read_text())]
    scores = evaluate(records, split="val_unseen", task="r2r")
    assert list(scores.notes) == [f"ignored fields: predObjId ({len(records)})"]
    assert scores == evaluate(SAMPLE, split="val_unseen", task="r2r")


def test_jumps_are_counted_and_said_to_stop_the_official_script() -> None:
    truth = GroundTruth.load(
        REPOSITORY / "reverie_eval" / "ground_truth" / "demo" / "r2r" / "val_unseen.npz"
    )
    assert truth.solution is not None
    viewpoint_ids, episodes = truth.graph.viewpoint_ids, truth.episodes
    ends = zip(episodes.start, truth.solution.goal, strict=True)
    records = [
        {"instr_id": instr_id, "trajectory": [[viewpoint_ids[it], 0, 0] for it in pair]}
        for instr_id, pair in zip(episodes.instr_ids, ends, strict=True)
    ]
    scores = evaluate(records, split="val_unseen", task="r2r")
    assert scores["success"] == 1.0
    assert any("official-v1's own evaluator stops at a jump" in note for note in scores.notes)
    duet = evaluate(records, split="val_unseen", task="r2r", protocol="duet")
    assert not any("stops at a jump" in note for note in duet.notes)


def test_a_file_of_another_task_is_recognised() -> None:
    with pytest.raises(SubmissionError) as error:
        evaluate(SAMPLE, split="val_unseen")
    (problem,) = error.value.problems
    assert problem.code == "other-task"
    assert "look like R2R ids, not like REVERIE ids (4774_267_1)" in problem.message
    assert problem.message.endswith("score the file with --task r2r")
    good = SAMPLE.with_name("good.json")
    with pytest.raises(SubmissionError, match="look like REVERIE ids, not like R2R ids"):
        evaluate(good, split="val_unseen", task="r2r")


def test_a_missing_fourth_instruction_is_no_problem(demo_world: Path) -> None:
    """The demo's val_seen has a path with four, as the published one has."""
    records = run_agent("shortest", find_ground_truth(None, "val_seen", "r2r"))
    (fourth,) = (record for record in records if record["instr_id"].endswith("_3"))
    rest = [record for record in records if record is not fourth]
    scores = evaluate(rest, split="val_seen", task="r2r")
    assert fourth["instr_id"] not in scores.instr_ids
    assert scores["spl"] == 1.0
    with pytest.raises(SubmissionError, match="has no prediction"):
        evaluate(rest, split="val_seen", task="r2r", protocol="duet")
    whole = evaluate(records, split="val_seen", task="r2r")
    assert whole.signature == scores.signature


def test_a_fourth_instruction_in_batches_and_in_saved_scores(tmp_path: Path) -> None:
    evaluator = Evaluator(split="val_seen", task="r2r")
    evaluator.update(run_agent("shortest", find_ground_truth(None, "val_seen", "r2r")))
    scores = evaluator.compute()
    assert any("scores the first 3 instructions" in note for note in scores.notes)
    scores.save(tmp_path / "scores.npz")
    half = len(scores.instr_ids) // 2
    parts = [scores.subset(scores.instr_ids[:half]), scores.subset(scores.instr_ids[half:])]
    for other in (Scores.load(tmp_path / "scores.npz"), Scores.concatenate(parts)):
        assert other.signature == scores.signature
        assert other.notes == scores.notes


def test_an_edited_copy_is_named(demo_world: Path, tmp_path: Path, run: Run) -> None:
    """Any other file is said not to be a known release, with its digest."""
    done = run(
        *("compile", str(demo_world), "--task", "r2r", "--split", "val_seen"),
        *("-o", str(tmp_path / "val_seen.npz")),
    )
    assert done.status == 0
    assert "the annotations are not a published file of R2R; their SHA-256 is " in done.err


def test_a_bundle_is_of_its_task(demo_world: Path) -> None:
    place = REPOSITORY / "reverie_eval" / "ground_truth" / "demo" / "r2r" / "val_unseen.npz"
    assert evaluate(SAMPLE, split="val_unseen", ground_truth=place).ground_truth.task.name == "r2r"
    with pytest.raises(Exception, match="is the ground truth of R2R, not of REVERIE"):
        evaluate(SAMPLE, split="val_unseen", ground_truth=place, task="reverie")


def test_a_signature_without_a_task_is_of_reverie(demo: GroundTruth) -> None:
    good = SAMPLE.with_name("good.json")
    assert evaluate(good, split="val_unseen").signature.startswith("split:val_unseen|")
    assert replace(demo).task.name == "reverie"
