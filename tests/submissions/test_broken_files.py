"""Mistakes that people make are found, explained in a few lines, and corrected where possible."""

import json
from pathlib import Path

import pytest

from reverie_eval import GroundTruth, SubmissionError, evaluate
from reverie_eval.submissions import convert
from tests.conftest import SAMPLES
from tests.support.broken_files import MISTAKES, broken, message_about, table
from tests.support.worlds import SPLIT

PAGE = Path("docs/broken-files.md")
SCREEN = 25
"""Lines, of which none is so long that it fills many."""

every_mistake = pytest.mark.parametrize("mistake", MISTAKES)


@every_mistake
def test_no_broken_file_is_accepted(mistake: str, demo: GroundTruth) -> None:
    title, *lines = message_about(mistake, demo).splitlines()
    assert title.startswith("submission rejected, ")
    assert 1 <= len(lines) < SCREEN
    assert max(map(len, lines)) < 250


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
        "object ids as decimals",
        "instructions counted from 1",
        "the prefix r2r_",
        "a space after every id",
        "every record twice",
        "the last batch twice",
        "poses as objects",
        "angles as text",
        "viewpoints with their scan",
        "viewpoints with spaces",
        "JSON Lines",
        "printed by Python",
        '{"results": [...]}',
        "a mail signature after the JSON",
    ],
)
def test_the_converted_file_scores_as_the_good_one(mistake: str, demo: GroundTruth) -> None:
    """To the last bit: the mistake tells what was meant."""
    conversion = convert(broken(mistake), split=SPLIT, ground_truth=demo)
    (fixed,) = conversion.fixed
    assert f"fixed: {fixed}" in conversion.notes
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
        "only the tasks' ids",
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
    assert conversion.notes[-1] == (
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
