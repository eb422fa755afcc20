"""The problems that alignment finds in a submission, and the result for a valid one.

The house has a hall, 3 m further a kitchen, 4 m further a pantry, and an attic without a way up;
the barn has a stall and a loft. Two episodes go to the pantry, one to the loft.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from fixtures.demo_world.broken import FOREIGN, SPOILED
from fixtures.demo_world.episodes import Answer, Record, episodes_of, submitted
from reverie_eval import GroundTruth, Problem, SubmissionError, evaluate, validate
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle
from reverie_eval.scoring import Track
from reverie_eval.submissions import (
    Submission,
    SubmissionColumns,
    align,
    align_answers_only,
    check_navigation_only,
    read_predictions,
)
from tests.conftest import SAMPLES
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.worlds import SPLIT, ground_truth_of

SPOON, OWL, HAY = 424_242, 515_151, 616_161
HOUSE = {
    "hall": (0.0, 0.0, 0.0),
    "kitchen": (3.0, 0.0, 0.0),
    "pantry": (3.0, 4.0, 0.0),
    "attic": (0.0, 0.0, 9.0),
}
BARN = {"stall": (0.0, 0.0, 0.0), "loft": (0.0, 0.0, 2.0)}


def world(to_house: Item, to_barn: Item) -> World:
    """Return house and barn, where each target is visible only from the end of its path."""
    seen = {item.path[-1]: {item.target: [12]} for item in (to_house, to_barn)}
    house, barn = (
        {name: Viewpoint(position, views=seen.get(name, {})) for name, position in places.items()}
        for places in (HOUSE, BARN)
    )
    scans = {
        "house": Scan(house, frozenset({("hall", "kitchen"), ("kitchen", "pantry")})),
        "barn": Scan(barn, frozenset({("stall", "loft")})),
    }
    return World(scans, [to_house, to_barn])


FARM = world(
    Item("7_1", "house", ["hall", "kitchen", "pantry"], SPOON, instructions=2),
    Item("8_2", "barn", ["stall", "loft"], OWL),
)
OTHER_ANSWERS = world(
    Item("7_1", "house", ["hall", "kitchen"], HAY, instructions=2),
    Item("8_2", "barn", ["stall"], SPOON),
)
"""Equal episodes in equal buildings, with entirely different answers."""


def record(instr_id: str, *viewpoint_ids: str, answer: int = -1) -> Record:
    """Return the record of an agent that took these viewpoints."""
    poses = [[viewpoint_id, 0.0, 0.0] for viewpoint_id in viewpoint_ids]
    return {"instr_id": instr_id, "trajectory": poses, "predObjId": answer}


FIRST = record("7_1_0", "hall", "kitchen")
SECOND = record("7_1_1", "hall", answer=7)
THIRD = record("8_2_0", "stall", "loft", "stall", answer=9)
SOUND = [FIRST, SECOND, THIRD]


@pytest.fixture(scope="module")
def farm() -> GroundTruth:
    """Compile the ground truth of the three episodes."""
    return ground_truth_of(FARM)


def problems_of(
    submission: Submission, truth: GroundTruth, track: Track = "full"
) -> Sequence[Problem]:
    """Return all problems of a submission."""
    with pytest.raises(SubmissionError) as rejected:
        validate(submission, split=SPLIT, ground_truth=truth, track=track)
    return rejected.value.problems


def test_ids_that_are_those_of_the_split_by_chance() -> None:
    """R2R and R4R number their paths alike, in different buildings."""
    crowd = ground_truth_of(
        world(
            Item("7_1", "house", ["hall", "kitchen", "pantry"], SPOON, instructions=15),
            Item("8_2", "barn", ["stall", "loft"], OWL, instructions=15),
        )
    )
    elsewhere = [
        record(f"{item}_{index}", start)
        for item, start in (("7_1", "stall"), ("8_2", "hall"))
        for index in range(15)
    ]
    (problem,) = problems_of([*elsewhere, record("9_9_0", "hall")], crowd)
    assert (problem.code, problem.where) == ("other-scan", "file")
    assert problem.message.startswith("30 of 30 trajectories begin in another building")
    # The graph of a split lacks the buildings of others.
    strange = [record(each["instr_id"], "4bc21ec71c2eb1724484d2974c46412c") for each in elsewhere]
    assert [each.where for each in problems_of(strange, crowd)] == ["file"]
    # Some may be mixed up, and are told one by one.
    found = [*(record(f"8_2_{index}", "stall") for index in range(15)), *elsewhere[:15]]
    assert [each.where for each in problems_of(found, crowd)] == [
        f"[{row}].trajectory[0][0]" for row in range(15, 30)
    ]


faults = pytest.mark.parametrize(
    ("submission", "code", "where", "fragment"),
    [
        pytest.param(
            [],
            "missing-episode",
            "file",
            "no prediction for any of the 3 episodes",
            id="no records",
        ),
        pytest.param(
            [SECOND, THIRD],
            "missing-episode",
            "file",
            "episode 7_1_0 has no prediction; every episode of val_unseen needs one",
            id="missing episode",
        ),
        pytest.param(
            [*SOUND, record("7_1_2", "hall")],
            "unknown-episode",
            "[3].instr_id",
            "'7_1_2' is not an episode of val_unseen; ids are <item id>_<index of the instruction>",
            id="unknown episode",
        ),
        pytest.param(
            [*SOUND, {**FIRST, "predObjId": 5}],
            "duplicate-episode",
            "[3].instr_id",
            "7_1_0 already has a prediction in [0]; keep one per episode",
            id="episode given twice",
        ),
        pytest.param(
            [*SOUND, SECOND],
            "duplicate-episode",
            "[3].instr_id",
            "has the same trajectory and answer as an earlier record, such as '7_1_1'; remove",
            id="record given twice",
        ),
        pytest.param(
            [record("7_1_0", "hall", "cellar"), SECOND, THIRD],
            "unknown-viewpoint",
            "[0].trajectory[1][0]",
            "viewpoint 'cellar' is not in the navigation graph of scan house",
            id="unknown viewpoint",
        ),
        pytest.param(
            [record("7_1_0", "hall", "loft"), SECOND, THIRD],
            "other-scan",
            "[0].trajectory[1][0]",
            "viewpoint loft belongs to scan barn, but the episode is in scan house",
            id="viewpoint of another scan",
        ),
        pytest.param(
            [FIRST, SECOND, record("8_2_0", "hall")],
            "other-scan",
            "[2].trajectory[0][0]",
            "viewpoint hall belongs to scan house, but the episode is in scan barn",
            id="start in another scan",
        ),
        pytest.param(
            [FIRST, SECOND, record("8_2_0", "hall", "kitchen", "hall")],
            "other-scan",
            "[2].trajectory[0][0]",
            "viewpoint hall belongs to scan house, but the episode is in scan barn",
            id="walk in another scan",
        ),
        pytest.param(
            [FIRST, SECOND, record("8_2_0", "cellar", "loft")],
            "unknown-viewpoint",
            "[2].trajectory[0][0]",
            "viewpoint 'cellar' is not in the navigation graph of scan barn",
            id="unknown start of a walk in the right scan",
        ),
        pytest.param(
            [FIRST, record("7_1_1", "kitchen", "hall"), THIRD],
            "wrong-start",
            "[1].trajectory[0]",
            "episode 7_1_1 starts at viewpoint hall, got kitchen; list the start viewpoint",
            id="wrong start",
        ),
        pytest.param(
            [FIRST, record("7_1_1", "attic"), THIRD],
            "wrong-start",
            "[1].trajectory[0]",
            "episode 7_1_1 starts at viewpoint hall, got attic",
            id="start that cannot be reached",
        ),
        pytest.param(
            [FIRST, record("7_1_1", "hall", "kitchen", "attic"), THIRD],
            "unreachable",
            "[1].trajectory[2][0]",
            "viewpoint attic cannot be reached from the start",
            id="viewpoint that cannot be reached",
        ),
    ],
)


@faults
def test_a_fault(
    submission: list[Record], code: str, where: str, fragment: str, farm: GroundTruth
) -> None:
    (problem,) = problems_of(submission, farm)
    assert (problem.code, problem.where) == (code, where)
    assert fragment in problem.message


def test_everything_is_reported_at_once_with_what_reading_found(farm: GroundTruth) -> None:
    submission = [
        record("7_1_0", "kitchen", "cellar", "loft", "attic"),
        {**THIRD, "predObjId": "owl"},
        record("7_1_0", "hall"),
        record("7_1_2", "hall"),
        {"instr_id": "8_2_0", "trajectory": [["stall"], 7, ["hall"]], "predObjId": -1},
    ]
    assert [(problem.where, problem.code) for problem in problems_of(submission, farm)] == [
        ("file", "missing-episode"),
        ("[0].trajectory[0]", "wrong-start"),
        ("[0].trajectory[1][0]", "unknown-viewpoint"),
        ("[0].trajectory[2][0]", "other-scan"),
        ("[0].trajectory[3][0]", "unreachable"),
        ("[1].predObjId", "wrong-type"),
        ("[2].instr_id", "duplicate-episode"),
        ("[3].instr_id", "unknown-episode"),
        ("[4].trajectory[1]", "wrong-type"),
        ("[4].instr_id", "duplicate-episode"),
        ("[4].trajectory[2][0]", "other-scan"),
    ]


# The sample of a broken submission, fault by fault.

CODES = {
    "unknown viewpoint": "unknown-viewpoint",
    "viewpoint of another building": "other-scan",
    "viewpoint that cannot be reached": "unreachable",
    "begins after the start": "wrong-start",
    "empty trajectory": "empty-trajectory",
    "trajectory is a string": "wrong-type",
    "trajectory missing": "missing-field",
    "pose is a number": "wrong-type",
    "viewpoint is a number": "wrong-type",
    "heading is a string": "wrong-type",
    "heading is NaN": "not-finite",
    "elevation is Infinity": "not-finite",
    "object is a list": "wrong-type",
    "object is a fraction": "wrong-type",
    "object is true": "wrong-type",
    "object missing": "missing-field",
    "unknown episode": "unknown-episode",
    "episode of another split": "other-split",
    "episode given twice": "duplicate-episode",
    "episode is a number": "wrong-type",
    "episode missing": "missing-field",
    "record is a string": "wrong-type",
}


def test_the_broken_sample(demo: GroundTruth) -> None:
    """Two episodes are missing; the first and the last records are faulty."""
    missing, also_missing, *of_records = problems_of(SAMPLES / "broken.json", demo)
    assert {missing.code, also_missing.code} == {"missing-episode"}
    # "pose is a number" and "viewpoint is a number" have one cause, and are one problem.
    faults = [fault for fault in (*SPOILED, *FOREIGN) if fault != "viewpoint is a number"]
    assert [problem.code for problem in of_records] == [CODES[fault] for fault in faults]
    assert len({problem.where.partition("]")[0] for problem in of_records}) == len(of_records)


# Submissions for something else.


@pytest.mark.parametrize("track", ["full", "grounding"])
def test_a_submission_for_another_release(demo: GroundTruth, track: Track) -> None:
    """Most ids of a release are those of the other, so they look like missing episodes."""
    second = replace(demo, header=replace(demo.header, dataset="REVERIE v2"))
    good = json.loads((SAMPLES / "good.json").read_text("utf-8"))
    others = [{**good[0], "instr_id": f"9{number}_7_0"} for number in range(3_521 - len(good))]
    (problem,) = problems_of([*good, *others], second, track)
    assert (problem.code, problem.where) == ("other-release", "file")
    assert problem.message == (
        "has 3,521 records, as many as REVERIE v1 has episodes of val_unseen, but the ground truth "
        "is REVERIE v2, with 84; name one of REVERIE v1 by --ground-truth, or send the predictions "
        "for REVERIE v2"
    )
    codes = {problem.code for problem in problems_of([*good, *others[1:]], second, track)}
    assert codes == {"unknown-episode"}


def test_a_submission_for_another_split(demo: GroundTruth) -> None:
    others = episodes_of("val_seen")
    submission = [submitted(episode, Answer(episode.item.path[:1], -1)) for episode in others]
    (other,) = problems_of(submission, demo)
    assert (other.code, other.where, other.split) == ("other-split", "[0].instr_id", "val_seen")
    assert other.message == (
        f"holds val_seen ({len(others)} records), and no episode of val_unseen; the first is "
        f"{others[0].instr_id!r}: score the file as val_seen, or send the predictions for "
        "val_unseen"
    )


def test_a_real_submission_against_the_demo_world(demo: GroundTruth) -> None:
    """The message explains how to compile the real data."""
    submission = [record("4774_267_1", "a68b5ae6571e4a66a4727573b88227e4"), record("2_3_0", "c1")]
    (problem,) = problems_of(submission, demo)
    assert (problem.code, problem.where) == ("not-the-demo-world", "file")
    assert "(2 are not, the first is '4774_267_1')" in problem.message
    assert "clone github.com/YuankaiQi/REVERIE" in problem.message
    assert "reverie-eval compile REVERIE --split val_unseen -o val_unseen.npz" in problem.message
    assert "--ground-truth val_unseen.npz" in problem.message
    # The demo world numbers some episodes as REVERIE does.
    real = [record(each, "a68b5ae6571e4a66a4727573b88227e4") for each in demo.episodes.instr_ids]
    (problem,) = problems_of(real, demo)
    assert (problem.code, problem.where) == ("not-the-demo-world", "file")
    assert problem.message.startswith("84 of 84 trajectories begin in no building of the demo")


def test_a_submission_for_another_item(demo: GroundTruth) -> None:
    (problem,) = problems_of([record("4332_0", "c1"), record("2_3", "c1")], demo)
    assert (problem.code, problem.where) == ("other-task", "file")
    assert problem.message.startswith("2 ids look like ")
    assert "; the first is '4332_0': score the file with --task " in problem.message


def test_checking_stops_after_too_many_problems(
    farm: GroundTruth, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("reverie_eval.submissions._faults.MAX_PROBLEMS", 3)
    submission = [record("7_1_0", "hall", *["nowhere"] * 5), SECOND, THIRD]
    found = problems_of(submission, farm)
    assert [problem.where for problem in found] == [
        *(f"[0].trajectory[{number}][0]" for number in (1, 2, 3)),
        "file",
    ]
    assert found[-1].code == "too-many-problems"


# Nothing of the answers is told.


@faults
def test_no_message_depends_on_an_answer(
    submission: list[Record], code: str, where: str, fragment: str, farm: GroundTruth
) -> None:
    told = problems_of(submission, farm)
    assert told == problems_of(submission, ground_truth_of(OTHER_ANSWERS))
    text = str(SubmissionError(told))
    assert not [answer for answer in ("pantry", str(SPOON), str(OWL)) if answer in text]


def test_a_public_bundle_finds_the_same_problems(demo: GroundTruth) -> None:
    public = GroundTruth.from_bundle(Bundle.load(DEMO_BUNDLES / "val_unseen.npz").public())
    broken = SAMPLES / "broken.json"
    assert problems_of(broken, public) == problems_of(broken, demo)


def test_scoring_rejects_what_validating_rejects(demo: GroundTruth) -> None:
    broken = SAMPLES / "broken.json"
    with pytest.raises(SubmissionError) as rejected:
        evaluate(broken, split=SPLIT, ground_truth=demo)
    assert rejected.value.problems == problems_of(broken, demo)


# What is sound.


@pytest.mark.parametrize("records", list(permutations(SOUND)))
def test_the_order_of_records_does_not_matter(
    records: Sequence[dict[str, Any]], farm: GroundTruth
) -> None:
    aligned = align(read_predictions(records), farm)
    viewpoints = [farm.graph.viewpoint_ids[number] for number in aligned.viewpoint]
    assert viewpoints == ["hall", "kitchen", "hall", "stall", "loft", "stall"]
    assert aligned.offsets.tolist() == [0, 2, 3, 6]
    assert aligned.predicted_object.tolist() == [-1, 7, 9]


def test_a_jump_counts_at_shortest_path_distance(farm: GroundTruth) -> None:
    jumps_twice = record("7_1_0", "hall", "pantry", "pantry", "hall", "kitchen")
    scores = evaluate([jumps_twice, SECOND, THIRD], split=SPLIT, ground_truth=farm)
    assert scores.episodes["path_length"].tolist() == [7.0 + 0.0 + 7.0 + 3.0, 0.0, 4.0]
    assert scores.episodes["jumps"].tolist() == [2, 0, 0]
    assert scores.notes[-1] == (
        "2 jumps in 1 episode: moves between unconnected viewpoints, counted at shortest-path "
        "distance"
    )


def test_validating_reports_jumps_and_abstentions(farm: GroundTruth) -> None:
    submission = [record("7_1_0", "hall", "pantry"), SECOND, record("8_2_0", "stall")]
    checked = validate(submission, split=SPLIT, ground_truth=farm)
    assert checked.jumps.tolist() == [1, 0, 0]
    assert checked.abstained.tolist() == [True, False, True]
    silent, elsewhere, jumps = checked.notes
    assert silent == "2 of 3 answers predict no object"
    assert elsewhere.startswith("no predicted object is visible where its agent stops")
    assert jumps == (
        "1 jump in 1 episode: moves between unconnected viewpoints, counted at shortest-path "
        "distance"
    )


@pytest.mark.parametrize(
    ("found", "declared", "says"),
    [
        pytest.param(False, False, None, id="answers, as usual"),
        pytest.param(True, True, None, id="no answers, as declared"),
        pytest.param(True, False, "no record has an answer", id="answers are lost"),
        pytest.param(False, True, "has answers, but", id="answers are there after all"),
    ],
)
def test_a_file_without_answers_must_be_declared_and_one_with_answers_must_not(
    found: bool,  # noqa: FBT001
    declared: bool,  # noqa: FBT001
    says: str | None,
) -> None:
    if says is None:
        check_navigation_only(found=found, declared=declared)
        return
    with pytest.raises(SubmissionError) as refused:
        check_navigation_only(found=found, declared=declared)
    (problem,) = refused.value.problems
    assert problem.message.startswith(says)


def test_answers_alone_are_aligned_at_the_goals(farm: GroundTruth) -> None:
    """In any order, and at the starts where there are no answers, in a public bundle."""
    box = {"instr_id": "8_2_0", "predBox": [10, 10, 20, 20], "predView": 12}
    answers = [box, {"instr_id": "7_1_1", "predObjId": 5}, {"instr_id": "7_1_0", "predObjId": 4}]
    predictions = read_predictions(answers, answers_only=True)
    for truth, stops in (
        (farm, ["pantry", "pantry", "loft"]),
        (replace(farm, solution=None), ["hall", "hall", "stall"]),
    ):
        aligned = align_answers_only(predictions, truth)
        assert [truth.graph.viewpoint_ids[stop] for stop in aligned.viewpoint] == stops
        assert aligned.offsets.tolist() == [0, 1, 2, 3]
        assert aligned.predicted_object.tolist()[:2] == [4, 5]
        assert aligned.boxes.row.tolist() == [2]


def test_problems_of_answers_alone_are_all_listed(farm: GroundTruth) -> None:
    answers: list[Record] = [
        {"instr_id": "7_1_1", "predObjId": "sofa"},
        {"instr_id": "7_1_0", "predObjId": 4},
    ]
    with pytest.raises(SubmissionError) as refused:
        align_answers_only(read_predictions(answers, answers_only=True), farm)
    codes = [problem.code for problem in refused.value.problems]
    assert sorted(codes) == ["missing-episode", "wrong-type"]
    answers.append({"instr_id": "7_1_0", "predObjId": 5})
    with pytest.raises(SubmissionError, match="7_1_0 already has a prediction in"):
        align_answers_only(read_predictions(answers, answers_only=True), farm)


def test_answers_of_a_subset_are_aligned_alone(farm: GroundTruth) -> None:
    answers = [
        {"instr_id": each["instr_id"], "predObjId": 7 + row} for row, each in enumerate(SOUND)
    ]
    predictions = read_predictions(answers[::-1], answers_only=True)
    aligned = align_answers_only(predictions, farm.subset(["8_2_0", "7_1_1"]))
    assert aligned.predicted_object.tolist() == [8, 9]
    assert [farm.graph.viewpoint_ids[stop] for stop in aligned.viewpoint] == ["pantry", "loft"]


def drawing(instr_id: str, *viewpoint_ids: str, x: int) -> Record:
    """Return the record of an agent that predicts a box."""
    walk = record(instr_id, *viewpoint_ids)
    return {**walk, "predObjId": -1, "predBox": [x, 0, 10, 10], "predView": 12}


@pytest.mark.parametrize(
    ("x", "message"),
    [
        pytest.param(1, "has the same trajectory and answer as an earlier record", id="equal"),
        pytest.param(2, "7_1_0 already has a prediction in [0]", id="another box"),
    ],
)
def test_boxes_tell_whether_a_record_is_given_twice(
    x: int, message: str, farm: GroundTruth
) -> None:
    records = [drawing("7_1_0", "hall", x=1), drawing("7_1_0", "hall", x=x), SECOND, THIRD]
    (problem,) = problems_of(records, farm)
    assert (problem.code, problem.where) == ("duplicate-episode", "[1].instr_id")
    assert problem.message.startswith(message)


def test_parts_of_aligned_submissions(farm: GroundTruth) -> None:
    """Taken in any order, and put together again."""
    drawn = [drawing("7_1_0", "hall", x=1), SECOND, drawing("8_2_0", "stall", "loft", x=3)]
    whole = align(read_predictions(drawn), farm)
    turned = whole.take(np.array([2, 1]))
    assert [farm.graph.viewpoint_ids[each] for each in turned.viewpoint] == [
        "stall",
        "loft",
        "hall",
    ]
    assert turned.offsets.tolist() == [0, 2, 3]
    assert turned.predicted_object.tolist() == [-1, 7]
    assert (turned.boxes.row.tolist(), turned.boxes.xywh[:, 0].tolist()) == ([0], [3.0])
    assert turned.abstained.tolist() == [False, False]
    both = SubmissionColumns.concatenate([turned, whole])
    assert both.offsets.tolist() == [0, 2, 3, 4, 5, 7]
    assert both.predicted_object.tolist() == [-1, 7, -1, 7, -1]
    assert (both.boxes.row.tolist(), both.boxes.xywh[:, 0].tolist()) == ([0, 2, 4], [3.0, 1.0, 3.0])
    assert both.point is None
    assert whole.is_navigation_only is turned.is_navigation_only is both.is_navigation_only is False


def test_parts_of_a_submission_without_answers(farm: GroundTruth) -> None:
    walks = [{key: each[key] for key in ("instr_id", "trajectory")} for each in SOUND]
    alone, answered = (align(read_predictions(each), farm) for each in (walks, SOUND))
    assert alone.take(np.array([1])).is_navigation_only is True
    assert SubmissionColumns.concatenate([alone, alone]).is_navigation_only is True
    assert SubmissionColumns.concatenate([alone, answered]).is_navigation_only is False
