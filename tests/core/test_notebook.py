"""Use in a notebook: `rv.evaluate(...)`, scores, tables, DataFrames and reports."""

import json
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.submissions import Submission
from reverie_eval.tasks import find_task
from tests.conftest import SAMPLES
from tests.support.metrics import BOX_METRICS

GOOD = SAMPLES / "good.json"
SPLIT = "val_unseen"
SCORED = [key for key in find_task("reverie").metrics if key not in BOX_METRICS]
"""The metrics that are scored without boxes."""


@pytest.fixture(scope="module")
def scores() -> rv.Scores:
    """Score the good sample."""
    return rv.evaluate(GOOD, split=SPLIT)


# What can be given.


@pytest.mark.parametrize(
    "submission",
    [
        pytest.param(lambda: str(GOOD), id="path as text"),
        pytest.param(GOOD.read_bytes, id="bytes"),
        pytest.param(lambda: json.loads(GOOD.read_text()), id="list"),
        pytest.param(lambda: tuple(json.loads(GOOD.read_text())), id="tuple"),
    ],
)
def test_every_type_of_submission(submission: Callable[[], Submission], scores: rv.Scores) -> None:
    assert rv.evaluate(submission(), split=SPLIT) == scores


def test_an_open_file(scores: rv.Scores) -> None:
    with GOOD.open("rb") as file:
        assert rv.evaluate(file, split=SPLIT) == scores


@pytest.mark.parametrize(
    "ground_truth",
    [
        pytest.param(lambda: DEMO_BUNDLES / "val_unseen.npz", id="bundle"),
        pytest.param(lambda: str(DEMO_BUNDLES), id="folder"),
        pytest.param(lambda: rv.GroundTruth.load(DEMO_BUNDLES / "val_unseen.npz"), id="loaded"),
    ],
)
def test_every_type_of_ground_truth(
    ground_truth: Callable[[], str | Path | rv.GroundTruth], scores: rv.Scores
) -> None:
    assert rv.evaluate(GOOD, split=SPLIT, ground_truth=ground_truth()) == scores


def test_an_unknown_protocol() -> None:
    with pytest.raises(rv.ProtocolError, match="unknown protocol 'mine'"):
        rv.evaluate(GOOD, split=SPLIT, protocol="mine")


def test_every_error_has_the_same_base() -> None:
    errors = (rv.SubmissionError, rv.DatasetError, rv.GroundTruthError, rv.ProtocolError)
    assert all(issubclass(error, rv.ReverieEvalError) for error in errors)


def test_a_rejection_lists_its_problems() -> None:
    with pytest.raises(rv.SubmissionError) as rejected:
        rv.evaluate([], split=SPLIT)
    (problem,) = rejected.value.problems
    assert (problem.code, problem.where) == ("missing-episode", "file")
    assert str(rejected.value) == f"submission rejected, 1 problem\nfile: {problem.message}"


# Numbers.


def test_scores_are_a_mapping_in_the_order_of_the_catalogue(scores: rv.Scores) -> None:
    assert list(scores) == SCORED
    assert len(scores) == len(SCORED)
    assert dict(scores) == {key: scores[key] for key in SCORED}
    assert "rgspl" in scores
    assert "RGSPL" not in scores


@pytest.mark.parametrize("key", SCORED)
def test_a_score_is_the_mean_over_the_episodes(key: str, scores: rv.Scores) -> None:
    column = scores.episodes[key]
    assert type(scores[key]) is float
    assert scores[key] == column.mean()
    assert column.shape == (len(scores.instr_ids),)


def test_a_metric_that_is_not_scored(scores: rv.Scores) -> None:
    with pytest.raises(KeyError) as error:
        scores["iou"]
    says = f"iou is not scored; the scored metrics are {', '.join(scores)}"
    assert error.value.args == (says,)


def test_episode_values_are_read_only(scores: rv.Scores) -> None:
    with pytest.raises(ValueError, match="read-only"):
        scores.episodes["spl"][0] = 1.0
    with pytest.raises(TypeError):
        scores.episodes["spl"] = np.ones(1)  # type: ignore[index]


def test_a_column_is_computed_once(scores: rv.Scores) -> None:
    assert scores.episodes["dtw"] is scores.episodes["dtw"]


def test_a_data_frame(scores: rv.Scores) -> None:
    frame = scores.to_pandas()
    assert list(frame.columns) == [*SCORED, "outcome", "scan", "category", "instruction"]
    assert frame.index.name == "instr_id"
    assert list(frame.index) == list(scores.instr_ids)
    assert frame[SCORED].mean().to_dict() == pytest.approx(dict(scores), rel=1e-12)
    assert frame.attrs["units"] == {key: rv.CATALOGUE[key].unit for key in SCORED}


def test_the_texts_of_an_episode(scores: rv.Scores) -> None:
    row = scores.to_pandas().loc["1196_0_0"]
    episode = scores.episode("1196_0_0")
    assert row["scan"] == episode.scan
    assert row["category"] == episode.target_category
    assert row["instruction"] == episode.instruction
    assert row["outcome"] == episode.outcome


def test_texts_that_are_not_there_are_left_out() -> None:
    """No outcomes without answers."""
    navigated = rv.evaluate(GOOD, split=SPLIT, protocol="r2r-style")
    assert list(navigated.texts) == ["scan", "category", "instruction"]


# What the numbers depend on.


def test_the_signature(scores: rv.Scores) -> None:
    truth = scores.ground_truth
    assert scores.signature == (
        f"split:val_unseen|protocol:official-v1|data:{truth.fingerprint[:12]}"
        f"|n:{len(scores.instr_ids)}|version:{rv.__version__}"
    )


def test_the_representation(scores: rv.Scores) -> None:
    assert repr(scores) == (
        f"<Scores TL m {scores['path_length']:.2f}, SR % {100 * scores['success']:.2f}, "
        f"OSR % {100 * scores['oracle_success']:.2f}, SPL % {100 * scores['spl']:.2f}, "
        f"RGS % {100 * scores['rgs']:.2f}, RGSPL % {100 * scores['rgspl']:.2f}; {scores.signature}>"
    )


def test_the_report_survives_json(scores: rv.Scores) -> None:
    report = scores.to_report()
    assert ScoreReport.model_validate_json(report.model_dump_json()) == report
    assert report.scores == dict(scores)
    assert report.signature == scores.signature
    assert report.episodes == len(scores.instr_ids)


# The table that a notebook shows.


class Elements(HTMLParser):
    """The elements of a page and their texts; fails if they are not closed in order."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.texts: dict[str, list[str]] = {}
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: Any) -> None:  # noqa: ARG002  # the parser's call
        """Record an element, and remember to expect its end tag if it needs one."""
        self.seen.append(tag)
        if tag != "br":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Close the innermost element; fail for any other."""
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        """Record the text of the innermost element."""
        self.texts.setdefault(self.open[-1], []).append(data)


def test_the_html_table(scores: rv.Scores) -> None:
    texts = Elements(scores._repr_html_()).texts  # what Jupyter calls
    assert texts["th"] == ["TL m", "SR %", "OSR %", "SPL %", "RGS %", "RGSPL %"]
    assert texts["td"] == [f"{scores['path_length']:.2f}"] + [
        f"{100 * scores[key]:.2f}" for key in ("success", "oracle_success", "spl", "rgs", "rgspl")
    ]
    assert texts["code"] == [scores.signature]
    assert texts["caption"] == [f"ground truth: {scores.ground_truth.provenance}"]


MARKUP = '<script src="x">&amp;'


def test_the_html_table_escapes_text_from_files(scores: rv.Scores) -> None:
    header = replace(scores.ground_truth.header, dataset=MARKUP, split=MARKUP)
    truth = replace(scores.ground_truth, header=header, origin=f"/{MARKUP}.npz")
    elements = Elements(replace(scores, ground_truth=truth)._repr_html_())
    assert "script" not in elements.seen
    assert elements.texts["caption"] == [f"ground truth: /{MARKUP}.npz ({MARKUP})"]


def test_the_representation_of_a_ground_truth(demo: rv.GroundTruth) -> None:
    assert repr(demo) == f"<GroundTruth of val_unseen, 84 episodes, from {demo.origin}>"
