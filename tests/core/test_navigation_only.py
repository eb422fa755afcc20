"""Files without answers: what they do not say is "-", and nobody calls them worse for it."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from reverie_eval import GroundTruth, SubmissionError, compare, evaluate
from reverie_eval.reporting.comparisons import comparison_table
from reverie_eval.reporting.report import report_html
from reverie_eval.reporting.scores import scores_printout
from tests.conftest import SAMPLES
from tests.support.flat_world import Run
from tests.support.worlds import SPLIT


@pytest.fixture
def silent() -> list[dict[str, Any]]:
    """Return the good file without its answers."""
    records = json.loads((SAMPLES / "good.json").read_bytes())
    return [{key: record[key] for key in ("instr_id", "trajectory")} for record in records]


@pytest.mark.parametrize(
    ("layout", "row"),
    [
        pytest.param("table", "9.84  80.95  88.10  72.88      -        -", id="table"),
        pytest.param("markdown", "| 9.84 | 80.95 | 88.10 | 72.88 | - | - |", id="markdown"),
        pytest.param("latex", r"9.84 & 80.95 & 88.10 & 72.88 & - & - \\", id="latex"),
    ],
)
def test_answers_that_are_not_there_are_not_scored(
    layout: str, row: str, silent: list[dict[str, Any]], demo: GroundTruth
) -> None:
    scores = evaluate(silent, split=SPLIT, ground_truth=demo)
    assert "rgs" not in scores
    assert "rgspl" not in scores
    assert row in scores_printout([scores]).text(layout).splitlines()


def test_json_and_csv_have_no_scores_for_answers(
    silent: list[dict[str, Any]], demo: GroundTruth
) -> None:
    scores = evaluate(silent, split=SPLIT, ground_truth=demo)
    assert "rgs" not in json.loads(scores_printout([scores]).text("json"))["scores"]
    heading, row = (line.split(",") for line in scores_printout([scores]).text("csv").splitlines())
    assert row[heading.index("rgspl")] == ""


def test_a_comparison_is_about_what_both_say(
    silent: list[dict[str, Any]], demo: GroundTruth
) -> None:
    """The third submission is compared in its answers all the same, as if the second were not."""
    good, mediocre = SAMPLES / "good.json", SAMPLES / "mediocre.json"
    here = partial(compare, split=SPLIT, ground_truth=demo)
    compared = here(good, silent, mediocre, names=["good", "silent", "other"])
    alone = here(good, mediocre, names=["good", "other"])
    assert compared.sentence("silent") == "silent and good navigate the same in every episode"
    assert "rgspl" not in compared["silent"]
    assert compared["other"]["rgspl"].mean == alone["other"]["rgspl"].mean
    assert compared["other"]["rgspl"].p_value == alone["other"]["rgspl"].p_value
    assert "is worse than good by 22.70 RGSPL" in compared.sentence("other")
    rows = {row[0]: row for row in comparison_table(compared).rows}
    assert rows["silent"][-7:] == ["-"] * 7
    pair = comparison_table(here(good, silent, names=["good", "silent"]))
    rows = {row[0]: row for row in pair.rows}
    assert rows["silent"][-2:] == rows["silent - good"][-2:] == ["-", "-"]


@pytest.mark.parametrize("order", [[0], [0, 1], [1, 0]], ids=["alone", "first", "second"])
def test_a_report_leaves_out_what_takes_answers(
    order: list[int], silent: list[dict[str, Any]], demo: GroundTruth
) -> None:
    scores = {
        "silent": evaluate(silent, split=SPLIT, ground_truth=demo),
        "good": evaluate(SAMPLES / "good.json", split=SPLIT, ground_truth=demo),
    }
    names = [list(scores)[index] for index in order]
    page = report_html({name: scores[name] for name in names})
    assert 'id="outcomes"' not in page
    assert 'id="distributions"' in page
    if names[0] == "silent":
        assert "68 of 84 episodes (81.0 %) stopped at the goal; answers are not scored." in (
            page.replace("\xa0", " ")
        )


def test_the_grounding_track_needs_answers(silent: list[dict[str, Any]], demo: GroundTruth) -> None:
    with pytest.raises(SubmissionError) as rejected:
        evaluate(silent, split=SPLIT, ground_truth=demo, track="grounding")
    (problem,) = rejected.value.problems
    assert problem.message == "no record has an answer, and the grounding track scores nothing else"


def test_a_protocol_without_answers_is_reported_too(tmp_path: Path, run: Run) -> None:
    page = tmp_path / "report.html"
    files = [str(SAMPLES / name) for name in ("good.json", "mediocre.json")]
    options = ["--split", SPLIT, "--protocol", "r2r-style", "-o", str(page)]
    assert run("report", *files, *options)[:2] == (0, "")
    assert "that only good got right" in page.read_text()
