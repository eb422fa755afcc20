"""What a file is, by its form and all of its ids, and what is advised.

A file of the split's own is never said to be another task's, and ids that are mere numbers are
never said to be NDH's.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from fixtures.published import reference_submission
from reverie_eval import GroundTruth, Problem, SubmissionError, evaluate, validate
from reverie_eval.ground_truth import find_ground_truth
from reverie_eval.runner import run_agent
from reverie_eval.submissions import convert
from reverie_eval.tasks import BUILT_IN, find_task
from tests.conftest import SAMPLES
from tests.support.flat_world import Run
from tests.support.worlds import SPLIT

every_task = pytest.mark.parametrize("task", BUILT_IN)
WITH_IDS_OF_PARTS = ("reverie", "r2r", "r4r", "rxr")
Record = dict[str, Any]


def sample(task: str) -> list[Record]:
    """Return the records of a task's sample."""
    name = "good" if task == "reverie" else task
    return json.loads((SAMPLES / f"{name}.json").read_bytes())  # type: ignore[no-any-return]


def with_ids(task: str, change: Callable[[Any], object]) -> list[Record]:
    """Return the sample with other ids."""
    key = find_task(task).id_field.name
    return [{**record, key: change(record[key])} for record in sample(task)]


def with_key(task: str, key: str) -> list[Record]:
    """Return the sample with its ids under another key."""
    own = find_task(task).id_field.name
    return [
        {(key if name == own else name): value for name, value in record.items()}
        for record in sample(task)
    ]


def problems_of(document: object, task: str, split: str = SPLIT) -> list[Problem]:
    """Return what is wrong with a file."""
    content = document if isinstance(document, bytes) else json.dumps(document).encode()
    with pytest.raises(SubmissionError) as rejected:
        validate(content, split=split, task=task)
    told = str(rejected.value)
    assert "--task ndh" not in told
    return list(rejected.value.problems)


def the_problem_of(document: object, task: str) -> Problem:
    """Return the only thing that is wrong with a file."""
    (problem,) = problems_of(document, task)
    return problem


def assert_converted(document: object, task: str) -> None:
    """Check that what is converted scores as the sample, to the last bit."""
    content = document if isinstance(document, bytes) else json.dumps(document).encode()
    converted = convert(content, split=SPLIT, task=task)
    assert len(converted.fixed) == 1
    found, expected = (
        evaluate(records, split=SPLIT, task=task) for records in (converted.records, sample(task))
    )
    assert dict(found) == dict(expected)


# A continuous environment.

PATH = [[1.5, 0.1, -2.5], [1.75, 0.1, -2.5]]
POSITIONS: Mapping[str, object] = {
    "RxR-Habitat, JSON Lines": b"\n".join(
        json.dumps({"instruction_id": row, "path": PATH}).encode() for row in range(40)
    ),
    "RxR-Habitat, a list": [{"instruction_id": row, "path": PATH} for row in range(40)],
    "VLN-CE": {
        str(row): [{"position": it, "heading": 0.5, "stop": False} for it in PATH]
        for row in range(40)
    },
    "VLN-CE, one episode": {"7": [{"position": it, "heading": 0, "stop": True} for it in PATH]},
    "the official keys": [{"instr_id": f"7_1_{row}", "trajectory": PATH} for row in range(3)],
    "positions with headings": [{"instr_id": "7_1_0", "trajectory": [[*PATH[0], 0.5]]}],
    "axes": [{"instr_id": "7_1_0", "trajectory": [{"x": 1.5, "y": 0.0, "z": 2}]}],
    "under positions": [{"episode_id": row, "positions": PATH} for row in range(3)],
    "in a wrapper": {"results": [{"episode_id": row, "path": PATH} for row in range(3)]},
}


@every_task
@pytest.mark.parametrize("form", POSITIONS)
def test_positions_in_metres_are_told_in_one_problem(form: str, task: str) -> None:
    problem = the_problem_of(POSITIONS[form], task)
    assert (problem.code, problem.where) == ("continuous-environment", "file")
    assert "are positions, such as " in problem.message
    assert "(VLN-CE, RxR-Habitat)" in problem.message
    assert "score the file with" not in problem.message


@every_task
def test_the_samples_and_viewpoints_by_number_are_not_positions(task: str) -> None:
    evaluate(sample(task), split=SPLIT, task=task)
    numbered = [{"instr_id": "7_1_0", "trajectory": [[7, 1.459, 0.0]]}]
    assert "continuous-environment" not in {each.code for each in problems_of(numbered, task)}


# Ids.


@every_task
@pytest.mark.parametrize("prefix", ["x_{}_", "{}-", "r2r_{}_", "a_b_{}_", "{}_", "val_unseen/{}/"])
def test_a_prefix_of_any_parts_is_one_problem(prefix: str, task: str) -> None:
    """NaviLLM's ids of NDH have two before the number: ``cvdn_<row>_<inst_idx>``."""
    row = count()
    document = with_ids(task, lambda instr_id: f"{prefix.format(next(row))}{instr_id}")
    problem = the_problem_of(document, task)
    assert problem.code == "unknown-episode"
    assert f"{len(document)} records have a prefix before the id" in problem.message
    assert_converted(document, task)


@pytest.mark.parametrize("prefix", ["soon_7_4-0_1", "4-0_1"])
def test_duets_episodes_of_soon_with_navillms_prefix(prefix: str) -> None:
    records = [{**sample("soon")[0], "instr_id": prefix}]
    assert "an episode id of DUET's own files" in the_problem_of(records, "soon").message


@every_task
@pytest.mark.parametrize(
    "write",
    [
        pytest.param("{}\r\n".format, id="a line end"),
        pytest.param("\t{}".format, id="a tab"),
        pytest.param(lambda instr_id: [[instr_id]], id="lists of one"),
        pytest.param("b'{}'".format, id="bytes"),
        pytest.param("['{}']".format, id="a printed list"),
    ],
)
def test_ids_that_are_printed_or_in_lists(write: Callable[[Any], object], task: str) -> None:
    document = with_ids(task, write)
    assert f"{len(document)} records have " in the_problem_of(document, task).message
    assert_converted(document, task)


@pytest.mark.parametrize("task", ["ndh", "soon"])
@pytest.mark.parametrize("write", [float, "tensor({})".format, "array([{}])".format])
def test_numbers_of_episodes(write: Callable[[Any], object], task: str) -> None:
    assert_converted(with_ids(task, write), task)


@every_task
@pytest.mark.parametrize("key", ["instrID", "instIdx", "Instr_Id", "episode_id", "id"])
def test_another_spelling_of_the_id_is_told_with_the_tasks_own(key: str, task: str) -> None:
    document = with_key(task, key)
    own = find_task(task).id_field.name
    told = f"the field '{key}', which is not read; did you mean {own}?"
    assert told in the_problem_of(document, task).message
    assert_converted(document, task)


@every_task
@pytest.mark.parametrize("key", ["inst_idx", "instr_id", "instruction_id"])
def test_ids_of_the_split_under_another_tasks_key(key: str, task: str) -> None:
    document = with_key(task, key)
    if key in find_task(task).id_field.names:
        evaluate(document, split=SPLIT, task=task)
    else:
        assert the_problem_of(document, task).code == "misspelt-field"
        assert_converted(document, task)


LACKING = [
    pytest.param("reverie", (0,), "the path id", id="path"),
    pytest.param("reverie", (1,), "the object id", id="object"),
    pytest.param("reverie", (2,), "the index of the instruction", id="instruction"),
    pytest.param("reverie", (1, 2), "the object id and the index of the instruction", id="two"),
    pytest.param("r2r", (1,), "the index of the instruction", id="R2R's instruction"),
    pytest.param("r4r", (1,), "the index of the instruction", id="R4R's instruction"),
    pytest.param("rxr", (1,), "the instruction id", id="RxR's instruction"),
]


@pytest.mark.parametrize(("task", "places", "lacking"), LACKING)
@pytest.mark.parametrize("as_numbers", [False, True], ids=["text", "numbers"])
def test_ids_with_parts_left_out(
    task: str, places: tuple[int, ...], lacking: str, *, as_numbers: bool
) -> None:
    """Several episodes fit such an id, so it does not tell which is meant."""

    def shorten(instr_id: str) -> str | int:
        parts = [part for at, part in enumerate(instr_id.split("_")) if at not in places]
        return int(parts[0]) if as_numbers and len(parts) == 1 else "_".join(parts)

    document = with_ids(task, shorten)
    problem = the_problem_of(document, task)
    assert problem.message.startswith(f"{len(document)} records have an id without {lacking}, ")
    assert "several episodes, so the file does not tell which is meant" in problem.message
    assert "convert" not in problem.message
    with pytest.raises(SubmissionError, match="an id without"):
        convert(document, split=SPLIT, task=task)


WITHOUT_UNDERSCORES = [
    (write, task)
    for write in (str, int)
    for task in WITH_IDS_OF_PARTS
    if (write, task) != (int, "r4r")  # as numbers, ids of its path 0 lose the 0
]


@pytest.mark.parametrize(("write", "task"), WITHOUT_UNDERSCORES)
def test_ids_without_their_underscores(write: Callable[[str], object], task: str) -> None:
    document = with_ids(task, lambda instr_id: instr_id.replace("_", ""))
    numbers = [{**record, "instr_id": write(record["instr_id"])} for record in document]
    assert "without the marks between its parts" in the_problem_of(numbers, task).message
    assert_converted(numbers, task)


def test_ids_of_which_each_fits_one_episode_are_completed() -> None:
    """A path of one object: its ids tell the object without giving it."""
    records = sample("reverie")
    objects: dict[str, set[str]] = {}
    for record in records:
        path, target, _ = record["instr_id"].split("_")
        objects.setdefault(path, set()).add(target)
    for record in records:
        path, _, index = record["instr_id"].split("_")
        if len(objects[path]) == 1:
            record["instr_id"] = f"{path}_{index}"
    problem = the_problem_of(records, "reverie")
    assert problem.message.endswith("or let `reverie-eval convert --split` do it")
    assert_converted(records, "reverie")


@pytest.mark.parametrize("task", WITH_IDS_OF_PARTS)
def test_numbers_of_rows_for_ids_are_one_problem(task: str) -> None:
    document = [{**record, "instr_id": 10**6 + row} for row, record in enumerate(sample(task))]
    problem = the_problem_of(document, task)
    if task == "rxr":  # where the number of an instruction is an id
        assert problem.code == "not-the-demo-world"
    else:
        told = f"{len(document)} records have a number for the id, such as '1000000'"
        assert problem.message.startswith(told)


# Splits.


def shortest(task: str, split: str) -> list[Record]:
    """Return the results of the shortest agent."""
    return json.loads(json.dumps(run_agent("shortest", find_ground_truth(None, split, task))))  # type: ignore[no-any-return]


@pytest.mark.parametrize("task", [task for task in BUILT_IN if task != "r4r"])  # splits share ids
@pytest.mark.parametrize("others", [("val_seen",), ("train", "val_seen")], ids=["both", "three"])
@pytest.mark.parametrize("is_first", [True, False])
def test_several_splits_in_one_file(others: tuple[str, ...], task: str, *, is_first: bool) -> None:
    own, rest = shortest(task, SPLIT), [each for it in others for each in shortest(task, it)]
    document = [*own, *rest] if is_first else [*rest, *own]
    problem = the_problem_of(document, task)
    assert problem.code == "other-split"
    assert f"an id of {' or '.join(sorted(others))}, such as " in problem.message
    assert f"episodes of {SPLIT}; remove these records" in problem.message
    converted = convert(document, split=SPLIT, task=task)
    assert converted.records == convert(own, split=SPLIT, task=task).records
    assert evaluate(converted.records, split=SPLIT, task=task)["success"] == 1.0


def test_an_incomplete_split_beside_another(demo: GroundTruth) -> None:
    document = [*shortest("reverie", SPLIT)[1:], *shortest("reverie", "val_seen")]
    missing, other = problems_of(document, "reverie")
    assert missing.code == "missing-episode"
    assert f"beside 83 of the {len(demo.episodes.instr_ids)} episodes" in other.message


def test_splits_under_their_names() -> None:
    document = {split: shortest("reverie", split) for split in ("val_seen", SPLIT)}
    wrapped, other = problems_of(document, "reverie")
    assert wrapped.message.startswith("has lists of records under several keys, such as 'val_seen'")
    assert other.code == "other-split"
    converted = convert(json.dumps(document).encode(), split=SPLIT)
    assert evaluate(converted.records, split=SPLIT)["success"] == 1.0


def test_a_folder_of_splits_says_what_the_others_hold(run: Run, tmp_path: Any) -> None:
    for split in ("train", "val_seen", SPLIT):
        records = json.dumps(shortest("reverie", split))
        (tmp_path / f"submit_{split}.json").write_text(records)
    status, out, err = run("score", str(tmp_path), "--split", SPLIT)
    assert status == 1
    assert f"submit_{SPLIT}" in out
    lines = err.splitlines()
    assert "holds train (" in lines[0]
    assert "holds val_seen (" in lines[1]
    assert not any("no prediction" in line or "more)" in line for line in lines)


# Forms of other tasks.


@pytest.mark.parametrize("task", [task for task in BUILT_IN if task != "soon"])
@pytest.mark.parametrize("is_list", [False, True], ids=["an object", "a list of one"])
def test_a_path_in_an_object_is_one_problem(task: str, *, is_list: bool) -> None:
    objects = [{**record, "trajectory": {"path": record["trajectory"]}} for record in sample(task)]
    document = [
        {**each, "trajectory": [each["trajectory"]]} if is_list else each for each in objects
    ]
    problem = the_problem_of(document, task)
    assert (problem.code, problem.where) == ("wrong-type", "[0].trajectory")
    assert "a trajectory that is an object with a path, as in SOON" in problem.message
    assert "soon" not in problem.message
    assert_converted(document, task)


def test_several_paths_of_an_episode_do_not_tell_which_is_meant() -> None:
    document = [
        {**record, "trajectory": [{"path": record["trajectory"]}] * 2}
        for record in sample("reverie")
    ]
    problem = the_problem_of(document, "reverie")
    assert "several trajectories" in problem.message
    assert "convert" not in problem.message


def walks() -> Iterator[tuple[Any, Record]]:
    """Yield the trajectories of SOON's sample with their items."""
    for record in sample("soon"):
        for walk in record["trajectory"]:
            yield record["instr_id"], walk


def test_soons_trajectories_beside_their_points() -> None:
    document = [
        {"instr_id": item, "trajectory": walk["path"]}
        | {key: walk[key] for key in ("obj_heading", "obj_elevation")}
        for item, walk in walks()
    ]
    assert "a trajectory beside its point" in the_problem_of(document, "soon").message
    assert_converted(document, "soon")


def test_soons_trajectories_as_lists_of_poses() -> None:
    document = [{"instr_id": item, "trajectory": walk["path"]} for item, walk in walks()]
    problem = the_problem_of(document, "soon")
    assert "a trajectory that is a list of poses" in problem.message
    assert "convert" not in problem.message


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("obj_heading", "objHeading"),
        ("obj_heading", "heading"),
        ("obj_elevation", "objElevation"),
        ("obj_elevation", "pred_elevation"),
        ("path", "traj"),
        ("path", "trajectory"),
    ],
)
def test_another_spelling_of_soons_fields(old: str, new: str) -> None:
    document = sample("soon")
    for record in document:
        record["trajectory"] = [
            {(new if name == old else name): value for name, value in walk.items()}
            for walk in record["trajectory"]
        ]
    problem = the_problem_of(document, "soon")
    assert f"the field '{new}', which is not read; did you mean {old}?" in problem.message
    assert_converted(document, "soon")


def test_points_that_all_lack_are_one_problem() -> None:
    document = sample("soon")
    for record in document:
        record["trajectory"] = [{"path": walk["path"]} for walk in record["trajectory"]]
    assert the_problem_of(document, "soon").message == "24 records have no obj_heading; add it"


@pytest.mark.parametrize("task", [task for task in BUILT_IN if task != "soon"])
def test_what_is_expected_is_the_tasks_own_form(task: str) -> None:
    (problem,) = problems_of(7, task)
    own = find_task(task)
    assert f'"{own.id_field.name}": ...' in problem.message
    assert ("predObjId" in problem.message) == own.has_targets


def test_no_task_is_advised_for_answers_that_it_does_not_have() -> None:
    """Ids of the real split against the demo world, the object left out."""
    records = [{**record, "instr_id": f"9{row}_0"} for row, record in enumerate(sample("reverie"))]
    assert the_problem_of(records, "reverie").code == "not-the-demo-world"
    for record in records:
        del record["predObjId"]
    assert "R2R" in the_problem_of(records, "reverie").message


# On REVERIE itself.


@pytest.mark.dataset
def test_reveries_ids_without_the_object(published: Path, published_bundles: Path) -> None:
    """1,099 of them are ids of test by chance; 1,328 items are on 315 paths."""
    truth = GroundTruth.load(published_bundles / f"{SPLIT}.npz")
    records = reference_submission(published, f"{SPLIT}.shortest")
    for record in records:
        path, _, index = record["instr_id"].split("_")
        record["instr_id"] = f"{path}_{index}"
    of_test = set(truth.other_splits["test"].tolist())
    assert sum(record["instr_id"] in of_test for record in records) == 1_099
    with pytest.raises(SubmissionError) as rejected:
        validate(records, split=SPLIT, ground_truth=truth)
    (problem,) = rejected.value.problems
    assert problem.message.startswith("3,521 records have an id without the object id, such as ")
    assert "write <path id>_<object id>_<index of the instruction>" in problem.message
    with pytest.raises(SubmissionError):
        convert(records, split=SPLIT, ground_truth=truth)


@pytest.mark.dataset
def test_reveries_splits_in_one_file(published: Path, published_bundles: Path) -> None:
    seen, unseen = (
        reference_submission(published, "val_seen.shortest"),
        reference_submission(published, f"{SPLIT}.shortest"),
    )
    truth = GroundTruth.load(published_bundles / f"{SPLIT}.npz")
    with pytest.raises(SubmissionError) as rejected:
        validate([*seen, *unseen], split=SPLIT, ground_truth=truth)
    (problem,) = rejected.value.problems
    assert problem.message.startswith("1,423 records have an id of val_seen, such as ")
    assert "beside all 3,521 episodes of val_unseen" in problem.message
    converted = convert([*seen, *unseen], split=SPLIT, ground_truth=truth)
    assert converted.records == convert(unseen).records
