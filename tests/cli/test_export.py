"""``export``: each format is read by the validator or the schema of those who define it."""

import hashlib
import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml
from huggingface_hub import parse_eval_result_entries
from huggingface_hub.repocard_data import model_index_to_eval_results
from jsonschema import Draft7Validator

import reverie_eval as rv
from reverie_eval_cli.main import main
from tests.conftest import REPOSITORY, SAMPLES

GOOD = str(SAMPLES / "good.json")
SCHEMAS = Path(__file__).parents[1] / "support" / "every_eval_ever"
SPLIT = "val_unseen"


@pytest.fixture(scope="module")
def scores() -> rv.Scores:
    return rv.evaluate(GOOD, split=SPLIT)


def conforms(document: Any, schema: str) -> bool:
    validator = Draft7Validator(json.loads((SCHEMAS / schema).read_text(encoding="utf-8")))
    problems = [error.message for error in validator.iter_errors(document)]
    assert problems == []
    return not problems


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("collection")
    words = ["export", "every-eval-ever", GOOD, "--split", SPLIT, "--instances", "-o", str(root)]
    assert main([*words, "--model", "example-lab/walker"]) == 0
    return root


def aggregate_in(root: Path) -> dict[str, Any]:
    (path,) = root.glob("data/demo/example-lab/walker/*.json")
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return document


def test_an_aggregate_for_every_eval_ever_has_scores_and_intervals(
    collected: Path, scores: rv.Scores
) -> None:
    aggregate = aggregate_in(collected)
    assert conforms(aggregate, "eval.schema.json")
    intervals = scores.with_intervals().intervals
    assert intervals is not None
    results = {
        result["metric_config"]["metric_id"]: result["score_details"]
        for result in aggregate["evaluation_results"]
    }
    keys = ["success", "oracle_success", "spl", "rgs", "rgspl"]  # not TL, which has no direction
    assert list(results) == [f"reverie.{key}" for key in keys]
    for key, details in zip(keys, results.values(), strict=True):
        interval = details["uncertainty"]["confidence_interval"]
        assert details["score"] == scores[key]
        assert (interval["lower"], interval["upper"]) == (intervals[key].low, intervals[key].high)
        assert interval["confidence_level"] == 0.95


def test_every_metric_is_an_evaluation_of_its_own(collected: Path) -> None:
    names = [each["evaluation_name"] for each in aggregate_in(collected)["evaluation_results"]]
    assert names == [f"demo val_unseen {label}" for label in ("SR", "OSR", "SPL", "RGS", "RGSPL")]


def test_instances_are_the_episodes_of_each_result_that_is_right_or_wrong(
    collected: Path, scores: rv.Scores
) -> None:
    """The schema wants `is_correct` of every instance, which a detour's SPL of 0.4 is not."""
    aggregate = aggregate_in(collected)
    details = aggregate["detailed_evaluation_results"]
    content = (collected / details["file_path"]).read_bytes()
    assert details["checksum"] == hashlib.sha256(content).hexdigest()
    rows = [json.loads(line) for line in content.splitlines()]
    assert len(rows) == details["total_rows"] == 3 * 84
    results = {
        each["evaluation_name"]: each["evaluation_result_id"]
        for each in aggregate["evaluation_results"]
    }
    labels = {"SR": "success", "OSR": "oracle_success", "RGS": "rgs"}
    for label, key in labels.items():
        of_metric = [row for row in rows if row["evaluation_name"] == f"demo val_unseen {label}"]
        of_result = {row["evaluation_result_id"] for row in of_metric}
        assert of_result == {results[f"demo val_unseen {label}"]}
        values = scores.episodes[key].tolist()
        assert [row["evaluation"] for row in of_metric] == [
            {"score": value, "is_correct": value == 1.0} for value in values
        ]
    assert conforms(rows[0], "instance_level_eval.schema.json")
    sent = {each["instr_id"]: each for each in json.loads(Path(GOOD).read_bytes())}
    walked = json.loads(rows[0]["output"]["raw"][0])
    assert walked["trajectory"] == sent[rows[0]["sample_id"]]["trajectory"]


def test_of_a_private_split_only_rounded_means_are_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    demo = Path(rv.__file__).parent / "ground_truth" / "demo"
    private = ["--split", "test", "--ground-truth", str(demo / "private" / "test.npz")]
    run, collection = tmp_path / "run", tmp_path / "collection"
    assert main(["run", "random", *private, "-o", str(run)]) == 0
    words = ["export", "every-eval-ever", str(run / "submission.json"), *private, "--model", "a/b"]
    assert main([*words, "--instances", "-o", str(collection)]) == 2
    assert "values of single episodes of test are never released" in capsys.readouterr().err
    assert not list(collection.glob("**/*.json*"))
    assert main([*words, "-o", str(collection)]) == 0
    (path,) = collection.glob("**/*.json")
    for result in json.loads(path.read_bytes())["evaluation_results"]:
        details = result["score_details"]
        assert details["score"] == round(details["score"], 4)
        assert details["uncertainty"] == {"num_samples": 91}


def test_the_block_of_a_model_card_is_read_by_the_hub(
    scores: rv.Scores, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "model-card", GOOD, "--split", SPLIT, "--model", "Walker"]) == 0
    block = yaml.safe_load(capsys.readouterr().out.strip("-\n"))
    model, results = model_index_to_eval_results(block["model-index"])
    values = {result.metric_type: result.metric_value for result in results}
    assert values["rgspl"] == pytest.approx(100 * scores["rgspl"], abs=0.005)
    assert {result.metric_args["signature"] for result in results if result.metric_args} == {
        scores.signature
    }
    assert model == "Walker"


def test_a_result_for_a_benchmark_is_read_by_the_hub(
    scores: rv.Scores, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["export", "eval-results", GOOD, "--split", SPLIT]
    assert main([*words, "--benchmark", "lab/reverie", "--task-id", SPLIT]) == 0
    (entry,) = parse_eval_result_entries(yaml.safe_load(capsys.readouterr().out))
    assert (entry.dataset_id, entry.task_id, entry.value) == ("lab/reverie", SPLIT, 57.22)
    assert scores.signature in str(entry.notes)


@pytest.mark.parametrize("option", ["--model", "--benchmark"])
def test_a_name_without_an_owner_is_refused(
    option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = {
        "--model": ["every-eval-ever", GOOD, "-o", "there", "--model", "walker"],
        "--benchmark": ["eval-results", GOOD, "--task-id", "x", "--benchmark", "a/b/c"],
    }[option]
    assert main(["export", *words, "--split", SPLIT]) == 2
    assert "is not OWNER/NAME" in capsys.readouterr().err


def test_the_commands_on_the_page_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (REPOSITORY / "docs" / "how-to" / "export-results.md").read_text(encoding="utf-8")
    commands = re.findall(r"^reverie-eval (export .*)$", page, re.MULTILINE)
    assert len(commands) == 3
    monkeypatch.chdir(tmp_path)
    Path("submit.json").write_bytes(Path(GOOD).read_bytes())
    for command in commands:
        assert main(shlex.split(command)) == 0, command
