"""A challenge on EvalAI: its configuration, and what EvalAI's own worker shows of a file."""

import gzip
import io
import re
import shutil
from collections.abc import Callable, Mapping
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest
import yaml

import reverie_eval as rv
from reverie_eval.server.platforms.evalai import evaluate
from reverie_eval.server.run import JsonLines
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import SETTINGS_FILE
from tests.conftest import REPOSITORY
from tests.support.flat_world import Run
from tests.support.serving import (
    GOOD,
    OPEN,
    PRIVATE,
    broken_private,
    private_truth,
    submission_for,
    submission_without_answers,
)

LABELS = ("TL", "SR", "OSR", "SPL", "RGS", "RGSPL")
HELD_BACK = """
phases = [{ name = "challenge", opens = 2027-01-01T12:00:00+01:00, closes = 2027-06-01 },
          { name = "earlier", closes = 2020-01-31 }]
release_scores = "phase-end"
"""

Scored = Callable[[bytes], Mapping[str, Any]]


@pytest.fixture(scope="module")
def lab(made_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a server's folder with small limits."""
    folder = Path(shutil.copytree(made_folder, tmp_path_factory.mktemp("evalai") / "lab"))
    change(folder, "unpacked_mebibytes = 64", "unpacked_mebibytes = 2")
    return folder


@pytest.fixture
def holding_back(lab: Path, tmp_path: Path) -> Path:
    """Return a server's folder whose private split shows no scores before its phase ends."""
    folder = Path(shutil.copytree(lab, tmp_path / "lab"))
    change(folder, '\nphases = [{ name = "always" }]\n', HELD_BACK)
    return folder


def change(folder: Path, found: str, instead: str) -> None:
    settings = folder / SETTINGS_FILE
    text = settings.read_text()
    assert found in text
    settings.write_text(text.replace(found, instead, 1))


def result_of(
    folder: Path, file: Path, content: bytes, phase: str = f"{PRIVATE}-1"
) -> Mapping[str, Any]:
    """Return the only result that EvalAI gets for a file."""
    file.write_bytes(content)
    (result,) = evaluate(folder, file, phase)["result"]
    return dict(result)


@cache
def expected(split: str) -> Mapping[str, float]:
    """Return what the leaderboard has to show: the package's scores to two decimals."""
    truth = private_truth() if split == PRIVATE else None
    scores = rv.evaluate(submission_for(split), split=split, ground_truth=truth)
    keys = ("path_length", "success", "oracle_success", "spl", "rgs", "rgspl")
    percent = [100 * scores[key] for key in keys[1:]]
    values = [scores[keys[0]], *percent]
    return {label: round(value, 2) for label, value in zip(LABELS, values, strict=True)}


@pytest.mark.parametrize("split", [PRIVATE, OPEN])
def test_each_phase_of_the_challenge_is_scored_as_on_the_server(
    split: str, lab: Path, run: Run, tmp_path: Path
) -> None:
    config = yaml.safe_load(run("server", "export", "evalai", str(lab)).out)
    (phase,) = (
        each["codename"]
        for each in config["challenge_phases"]
        if each["name"].startswith(f"{split}:")
    )
    assert result_of(lab, tmp_path / "sent", submission_for(split), phase) == {
        "split": split,
        "show_to_participant": True,
        "accuracies": expected(split),
    }


def test_scores_that_are_held_back_are_not_shown(holding_back: Path, tmp_path: Path) -> None:
    result = result_of(holding_back, tmp_path / "sent", submission_for(PRIVATE))
    assert result["show_to_participant"] is False
    assert result["accuracies"] == expected(PRIVATE)


def packed(name: str = "submit.json", *others: str) -> bytes:
    """Return a submission in a zip archive."""
    archive = io.BytesIO()
    with ZipFile(archive, "w") as file:
        for each in (name, *others):
            file.writestr(each, submission_for(PRIVATE))
    return archive.getvalue()


@pytest.mark.parametrize("pack", [gzip.compress, lambda _: packed()], ids=["gzip", "zip"])
def test_a_file_may_be_packed(pack: Callable[[bytes], bytes], lab: Path, tmp_path: Path) -> None:
    result = result_of(lab, tmp_path / "sent", pack(submission_for(PRIVATE)))
    assert result["accuracies"] == expected(PRIVATE)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        pytest.param(broken_private(), "episode 240_0 has no prediction", id="problems"),
        pytest.param(submission_without_answers(), "no record has an answer", id="navigation only"),
        pytest.param(b"<html>Log in</html>", "JSON", id="not JSON"),
        pytest.param(b"", "empty", id="empty"),
        pytest.param(
            packed("a.json", "b.json"), "with 2 files: 'a.json', 'b.json'", id="two files"
        ),
        pytest.param(gzip.compress(b" " * (3 << 20)), "larger than 2 MiB unpacked", id="bomb"),
        pytest.param(GOOD, "val_unseen", id="another split's"),
    ],
)
def test_what_cannot_be_scored_fails_with_a_reason(
    content: bytes, reason: str, lab: Path, tmp_path: Path
) -> None:
    with pytest.raises(rv.SubmissionError) as caught:
        result_of(lab, tmp_path / "sent", content)
    assert reason in str(caught.value)
    assert str(caught.value).startswith("submission rejected, ")
    assert str(lab) not in str(caught.value)


def test_a_fault_of_ours_fails_without_telling_secrets(
    lab: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("the target is 1999999937")

    monkeypatch.setattr(Board, "scored", fail)
    with pytest.raises(rv.ReverieEvalError, match="the evaluation failed, but not because"):
        result_of(lab, tmp_path / "sent", submission_for(PRIVATE))
    logged = [JsonLines().format(record) for record in caplog.records]
    assert any("submission to EvalAI could not be scored" in line for line in logged)
    assert "1999999937" not in "".join(logged)


@pytest.mark.parametrize("phase", ["tset-1", "test", ""])
def test_a_phase_of_no_split_is_our_fault(phase: str, lab: Path, tmp_path: Path) -> None:
    with pytest.raises(rv.ReverieEvalError, match="not because of the file"):
        result_of(lab, tmp_path / "sent", submission_for(PRIVATE), phase)


def test_the_function_in_the_guide_scores(lab: Path, tmp_path: Path) -> None:
    guide = (REPOSITORY / "docs" / "how-to" / "organising" / "platforms.md").read_text()
    (source,) = re.findall(r"```python\n(.*?)```", guide, re.DOTALL)
    names: dict[str, Any] = {}
    exec(source.replace("/srv/lab", str(lab)), names)
    file = tmp_path / "sent"
    file.write_bytes(submission_for(PRIVATE))
    (result,) = names["evaluate"](str(file), f"{PRIVATE}-1")["result"]
    assert result["accuracies"] == expected(PRIVATE)


def test_the_challenge_has_a_place_for_every_result(lab: Path, run: Run) -> None:
    outcome = run("server", "export", "evalai", str(lab))
    assert outcome.status == 0
    assert f"{PRIVATE}: quotas for any 24 hours, 30 and 365 days" in outcome.err
    config = yaml.safe_load(outcome.out)
    assert config["remote_evaluation"] is True
    boards = {board["id"]: board["schema"] for board in config["leaderboard"]}
    splits = {split["id"]: split["codename"] for split in config["dataset_splits"]}
    phases = {phase["id"]: phase for phase in config["challenge_phases"]}
    assert len({phase["codename"] for phase in phases.values()}) == len(phases)
    for place in config["challenge_phase_splits"]:
        schema, split = boards[place["leaderboard_id"]], splits[place["dataset_split_id"]]
        assert (schema["labels"], schema["default_order_by"]) == (list(LABELS), "RGSPL")
        assert schema["metadata"]["TL"]["sort_ascending"] is True
        assert schema["metadata"]["RGSPL"]["sort_ascending"] is False
        assert phases[place["challenge_phase_id"]]["name"] == f"{split}: always"
        assert (place["visibility"], place["leaderboard_decimal_precision"]) == (3, 2)
        assert place["is_leaderboard_order_descending"] is True
    assert sorted(splits.values()) == ["test", "val_seen", "val_unseen"]
    test = next(phase for phase in phases.values() if phase["name"] == "test: always")
    quota = [test[f"max_submissions{per}"] for per in ("_per_day", "_per_month", "")]
    assert quota == [2, 10, 40]
    assert test["end_date"] == datetime(2099, 12, 31, 23, 59, 59)  # noqa: DTZ001  # as in YAML


def test_a_challenge_hides_scores_that_are_held_back(holding_back: Path, run: Run) -> None:
    outcome = run("server", "export", "evalai", str(holding_back))
    assert outcome.status == 0, outcome.err
    assert f"{PRIVATE}: the date from which scores are shown" in outcome.err
    config = yaml.safe_load(outcome.out)
    (phase, earlier), place = config["challenge_phases"][:2], config["challenge_phase_splits"][0]
    assert earlier["start_date"] == earlier["end_date"]
    assert phase["start_date"] == datetime(2027, 1, 1, 11)  # noqa: DTZ001  # in UTC
    assert phase["end_date"] == datetime(2027, 6, 1, 23, 59, 59)  # noqa: DTZ001
    assert (phase["leaderboard_public"], place["visibility"]) == (False, 1)
    assert place["show_scores_on_leaderboard"] is False
