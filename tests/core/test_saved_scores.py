"""Scores are saved, loaded, cut into parts and put together again, digit for digit."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.scoring import Track
from tests.conftest import SAMPLES
from tests.support.forms import FORMS

SPLIT = "val_unseen"
GOOD, DRAWN = SAMPLES / "good.json", SAMPLES / "drawn.json"
NAVIGATION_ONLY = next(form for name, form in FORMS.items() if "NavGPT" in name)


@pytest.fixture(scope="module")
def drawn() -> rv.Scores:
    """Score the sample that mixes boxes and objects."""
    return rv.evaluate(DRAWN, split=SPLIT)


def everything(scores: rv.Scores) -> Sequence[object]:
    """Return all that a reader of scores can see."""
    values: Mapping[str, Sequence[float]] = {
        key: column.tolist() for key, column in scores.episodes.items()
    }
    intervals = scores.intervals and (dict(scores.intervals), scores.intervals.caption)
    boxes = scores.box_outcomes, scores.boxes and scores.boxes.mean_iou
    return scores.signature, scores.instr_ids, values, list(scores.notes), boxes, intervals


# Save and load.


@pytest.mark.parametrize(
    ("submission", "protocol", "track", "subset"),
    [
        pytest.param(GOOD, "official-v1", "full", None, id="objects"),
        pytest.param(DRAWN, "paper", "full", None, id="boxes, another protocol"),
        pytest.param(GOOD, "official-v1", "grounding", None, id="grounding"),
        pytest.param(DRAWN, "official-v1", "full", slice(3, 40), id="subset"),
        pytest.param(NAVIGATION_ONLY.bytes(), "r2r-style", "full", None, id="navigation only"),
    ],
)
def test_loaded_scores_are_those_that_were_saved(
    submission: Path | bytes, protocol: str, track: Track, subset: slice | None, tmp_path: Path
) -> None:
    ids = subset and rv.evaluate(GOOD, split=SPLIT).instr_ids[subset]
    scores = rv.evaluate(submission, split=SPLIT, protocol=protocol, track=track, subset=ids)
    scores.save(tmp_path / "scores.npz")
    assert everything(rv.Scores.load(tmp_path / "scores.npz")) == everything(scores)


def test_intervals_are_computed_as_before(drawn: rv.Scores, tmp_path: Path) -> None:
    scores = drawn.with_intervals("scan", confidence=0.9, resamples=200, seed=7)
    scores.save(tmp_path / "scores.npz")
    assert everything(rv.Scores.load(tmp_path / "scores.npz")) == everything(scores)


def test_a_saved_file_has_no_answers(drawn: rv.Scores, tmp_path: Path) -> None:
    """Its columns are the submission's, in the ground truth's numbers."""
    drawn.save(tmp_path / "scores.npz")
    with np.load(tmp_path / "scores.npz") as archive:
        assert {name for name in archive.files if "/" not in name} == {
            *("header", "viewpoint", "offsets", "predicted_object", "answer_is_text"),
            "has_leading_zeros",
        }


def test_other_ground_truth(drawn: rv.Scores, tmp_path: Path) -> None:
    drawn.save(tmp_path / "scores.npz")
    truth = drawn.ground_truth
    other = replace(truth, header=replace(truth.header, fingerprint="0" * 64))
    says = rf"ground truth {truth.fingerprint[:12]}, but .* is 000000000000; pass ground_truth="
    with pytest.raises(rv.GroundTruthError, match=says):
        rv.Scores.load(tmp_path / "scores.npz", ground_truth=other)


def test_a_file_of_another_kind(drawn: rv.Scores, tmp_path: Path) -> None:
    cut = tmp_path / "cut.npz"
    drawn.save(cut)
    cut.write_bytes(cut.read_bytes()[:-100])
    for file in (GOOD, DEMO_BUNDLES / f"{SPLIT}.npz", cut):
        with pytest.raises(rv.ReverieEvalError) as refused:
            rv.Scores.load(file)
        assert str(refused.value) == (
            f"{file} has no saved scores, or is damaged; `Scores.save` writes such files, and "
            "`rv.evaluate` scores a result file"
        )
    with pytest.raises(FileNotFoundError):
        rv.Scores.load(tmp_path / "none.npz")


def test_scores_without_answers(tmp_path: Path) -> None:
    walks = rv.evaluate(NAVIGATION_ONLY.bytes(), split=SPLIT)
    walks.save(tmp_path / "scores.npz")
    loaded = rv.Scores.load(tmp_path / "scores.npz")
    assert loaded.require_submission().is_navigation_only is True
    assert "rgs" not in loaded


def test_a_damaged_file(drawn: rv.Scores, tmp_path: Path) -> None:
    """Whichever byte is another one, the scores are the same or none."""
    file = tmp_path / "scores.npz"
    drawn.save(file)
    content = file.read_bytes()
    for place in range(0, len(content), len(content) // 40):
        file.write_bytes(content[:place] + bytes([content[place] ^ 0x55]) + content[place + 1 :])
        with suppress(rv.ReverieEvalError):
            assert rv.Scores.load(file) == drawn


def test_a_file_of_a_later_version(
    drawn: rv.Scores, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn.save(tmp_path / "scores.npz")
    monkeypatch.setattr("reverie_eval.scoring._saved.FORMAT_VERSION", 0)
    with pytest.raises(rv.ReverieEvalError, match="has format 1 of saved scores"):
        rv.Scores.load(tmp_path / "scores.npz")


# Parts.


@pytest.mark.parametrize("step", [1, 2, 5])
def test_parts_together_are_the_whole(step: int, drawn: rv.Scores) -> None:
    """In any order; scored as parts, or cut from the scores of all."""
    ids = drawn.instr_ids
    parts = [rv.evaluate(DRAWN, split=SPLIT, subset=ids[start::step]) for start in range(step)]
    for listed in (parts[::-1], [drawn.subset(part.instr_ids) for part in parts]):
        together = rv.Scores.concatenate(listed)
        assert everything(together) == everything(drawn)


def test_some_parts_are_a_declared_subset(drawn: rv.Scores) -> None:
    ids = drawn.instr_ids
    parts = [rv.evaluate(DRAWN, split=SPLIT, subset=ids[begin : begin + 9]) for begin in (40, 10)]
    expected = rv.evaluate(DRAWN, split=SPLIT, subset=[*ids[10:19], *ids[40:49]])
    assert everything(rv.Scores.concatenate(parts)) == everything(expected)


def test_a_part_of_a_part(drawn: rv.Scores) -> None:
    few = drawn.subset(drawn.instr_ids[10:30]).subset(drawn.instr_ids[12:15])
    expected = rv.evaluate(DRAWN, split=SPLIT, subset=drawn.instr_ids[12:15])
    assert everything(few) == everything(expected)


def test_parts_that_do_not_fit(drawn: rv.Scores) -> None:
    ids = drawn.instr_ids
    first = drawn.subset(ids[:20])
    others: Mapping[str, Sequence[rv.Scores]] = {
        "there are no scores": [],
        "6 episodes in several parts, such as": [first, drawn.subset(ids[14:])],
        "not of one split under one protocol: .*official-v1.*paper": [
            first,
            rv.evaluate(DRAWN, split=SPLIT, protocol="paper", subset=ids[20:]),
        ],
        "some of these scores have answers": [
            first,
            rv.evaluate(NAVIGATION_ONLY.bytes(), split=SPLIT, subset=ids[20:]),
        ],
    }
    for says, parts in others.items():
        with pytest.raises(rv.ProtocolError, match=says):
            rv.Scores.concatenate(parts)


def test_unknown_episodes_of_a_part(drawn: rv.Scores) -> None:
    with pytest.raises(rv.SubsetError, match="'1_2_3' is not an episode of val_unseen"):
        drawn.subset(["1_2_3"])
