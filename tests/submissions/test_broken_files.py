"""Mistakes that people make are found, explained in a few lines, and corrected where possible."""

import json
from collections.abc import Mapping
from pathlib import Path

import pytest

from reverie_eval import GroundTruth, SubmissionError, evaluate
from reverie_eval.submissions import convert
from tests.conftest import SAMPLES
from tests.support.broken_files import (
    MISTAKES,
    MISTAKES_OF_TASKS,
    broken,
    message_about,
    message_about_task,
    table,
)
from tests.support.forms import OFFICIAL
from tests.support.worlds import SPLIT

PAGE = Path("docs/reference/broken-files.md")
SCREEN = 25
"""Lines, of which none is so long that it fills many."""

every_mistake = pytest.mark.parametrize("mistake", MISTAKES)


@every_mistake
def test_no_broken_file_is_accepted(mistake: str, demo: GroundTruth) -> None:
    title, *lines = message_about(mistake, demo).splitlines()
    assert title.startswith("submission rejected, ")
    assert 1 <= len(lines) < SCREEN
    assert max(map(len, lines)) < 250


@pytest.mark.parametrize("mistake", MISTAKES_OF_TASKS)
def test_a_broken_file_of_another_task_has_one_problem(mistake: str) -> None:
    title, line = message_about_task(mistake).splitlines()
    assert title == "submission rejected, 1 problem"
    assert "--task" not in line


def test_the_page_lists_every_mistake(demo: GroundTruth) -> None:
    assert len(MISTAKES) >= 60
    assert table(demo) in PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "mistake",
    [
        "predObjId written predObjID",
        "predObjId written objId",
        "trajectory written path",
        "instr_id written instruction_id",
        "predObjId null, answers under predObjid",
        "object ids as decimals",
        "instructions counted from 1",
        "object ids printed by PyTorch",
        "object ids with a line end",
        "object ids in lists",
        "a prefix of two parts",
        "object ids with several zeros after the point",
        "object ids within quotes",
        "viewpoints in capitals",
        "viewpoints with the number of a view",
        "angles that are null",
        "trajectory written pred_path beside path",
        '{"val_unseen": {"results": [...], "scores": {...}}}',
        '{"1196_0_0": [{...}]}',
        "something after every id",
        "ids with other marks",
        "ids of padded numbers",
        "ids as lists of numbers",
        "ids with the object first",
        "the last batch twice, without angles",
        "val_seen and val_unseen",
        '{"val_seen": [...], "val_unseen": [...]}',
        "trajectories in objects, as in SOON",
        "the prefix r2r_",
        "a space after every id",
        "every record twice",
        "the last batch twice",
        "poses as objects",
        "angles as text",
        "viewpoints with their scan",
        "viewpoints with spaces",
        "printed by Python",
        '{"results": [...]}',
        "a mail signature after the JSON",
        "records as text",
        "records with commas between them alone",
    ],
)
def test_the_converted_file_scores_as_the_good_one(mistake: str, demo: GroundTruth) -> None:
    """To the last bit: the mistake tells what was meant."""
    conversion = convert(broken(mistake), split=SPLIT, ground_truth=demo)
    assert conversion.fixed
    assert all(f"fixed: {fixed}" in conversion.notes for fixed in conversion.fixed)
    scores, expected = (
        evaluate(file, split=SPLIT, ground_truth=demo)
        for file in (conversion.records, SAMPLES / "good.json")
    )
    assert dict(scores) == dict(expected)
    assert "convert" in message_about(mistake, demo)


@pytest.mark.parametrize(
    "mistake",
    [
        "different answers under two keys",
        "different answers under two spellings",
        "only the items' ids",
        "ids without the object",
        "positions of VLN-CE",
        "several trajectories, as in SOON",
        "viewpoints as numbers",
        "two answers for an episode",
    ],
)
def test_what_does_not_tell_what_was_meant_is_not_offered_to_be_corrected(
    mistake: str, demo: GroundTruth
) -> None:
    assert "convert" not in message_about(mistake, demo)


def test_what_stays_wrong_is_said(demo: GroundTruth) -> None:
    records = json.loads(broken("object ids as decimals"))
    conversion = convert(records[:-1], split=SPLIT, ground_truth=demo)
    missing = records[-1]["instr_id"]
    assert conversion.notes[-1].startswith(
        "still rejected, 1 problem, which `reverie-eval validate` lists; the first: file: episode "
        f"{missing} has no prediction; every episode of val_unseen needs one"
    )
    assert convert(records, split=SPLIT, ground_truth=demo).remaining == ()


def test_a_file_with_several_mistakes_has_them_all_corrected(demo: GroundTruth) -> None:
    content = broken('{"results": [...]}').replace(b'"predObjId"', b'"pred_obj"')
    with pytest.raises(SubmissionError) as rejected:
        evaluate(content, split=SPLIT, ground_truth=demo)
    assert [problem.code for problem in rejected.value.problems] == ["not-a-list", "misspelt-field"]
    assert len(convert(content).fixed) == 2


def message_about_ids(instr_ids: Mapping[int, str], demo: GroundTruth) -> str:
    """Return what is said of a file with other instr_ids in some rows."""
    records = [
        {**record, "instr_id": instr_ids.get(row, record["instr_id"])}
        for row, record in enumerate(OFFICIAL)
    ]
    with pytest.raises(SubmissionError) as rejected:
        evaluate(json.dumps(records).encode(), split=SPLIT, ground_truth=demo)
    return str(rejected.value)


def test_a_mistake_that_explains_half_of_the_unknown_ids_is_named(demo: GroundTruth) -> None:
    prefixed = f"r2r_{OFFICIAL[0]['instr_id']}"
    assert "has a prefix before the id" in message_about_ids({0: prefixed, 1: "?"}, demo)


def test_a_mistake_that_explains_fewer_is_not_named(demo: GroundTruth) -> None:
    prefixed = f"r2r_{OFFICIAL[0]['instr_id']}"
    message = message_about_ids({0: prefixed, 1: "?", 2: "??"}, demo)
    assert "prefix" not in message
    assert f"'{prefixed}' is not an episode" in message


def test_a_mistake_in_few_ids_is_named_though_the_others_are_right(demo: GroundTruth) -> None:
    row, task = next(
        (row, record["instr_id"].removesuffix("_0"))
        for row, record in enumerate(OFFICIAL)
        if record["instr_id"].endswith("_0")
    )
    assert "has an id without the index of the instruction" in message_about_ids({row: task}, demo)


def test_a_scan_before_viewpoint_ids_may_have_underscores(demo: GroundTruth) -> None:
    scanned = [
        {**record, "trajectory": [[f"two_parts_{pose[0]}", 0, 0] for pose in record["trajectory"]]}
        for record in OFFICIAL
    ]
    with pytest.raises(SubmissionError, match="have the scan before viewpoint ids"):
        evaluate(json.dumps(scanned).encode(), split=SPLIT, ground_truth=demo)


def test_a_mistake_in_all_poses_of_a_later_record_is_one_of_one_record() -> None:
    records = [dict(record) for record in OFFICIAL]
    viewpoint_id = records[3]["trajectory"][0][0]
    records[3]["trajectory"] = [[viewpoint_id, "0.5", "0"]] * 3
    (fixed,) = convert(json.dumps(records).encode()).fixed
    shown = f"['{viewpoint_id}', '0.5', '0']"
    assert fixed == f"angles written as text, such as {shown}, in 1 record"
