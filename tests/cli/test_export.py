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
    submission, collection = tmp_path / "submit.json", tmp_path / "collection"
    assert main(["agent", "random", *private, "-o", str(submission)]) == 0
    words = ["export", "every-eval-ever", str(submission), *private, "--model", "a/b"]
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


rdflib_warns = pytest.mark.filterwarnings("ignore:ConjunctiveGraph:DeprecationWarning")  # its own


@pytest.fixture
def clone(demo_world: Path, tmp_path: Path) -> Path:
    """Return a folder like a clone of the published repository."""
    for part in ("tasks", "connectivity"):
        (tmp_path / part).symlink_to(demo_world / part)
    return tmp_path


def described(clone: Path, task: str = "reverie") -> Path:
    """Describe a task's dataset in Croissant, and return the file."""
    description = clone / "croissant.json"
    words = ["export", "croissant", str(clone), "--task", task, "-o", str(description)]
    assert main(words) == 0
    return description


@rdflib_warns
def test_croissant_describes_the_files_as_its_own_library_reads_them(clone: Path) -> None:
    import mlcroissant  # takes half a second

    dataset = mlcroissant.Dataset(described(clone))
    assert not dataset.metadata.issues.errors
    published = json.loads((clone / "tasks/REVERIE/data/REVERIE_val_unseen.json").read_bytes())
    records = list(dataset.records(SPLIT))
    assert [record[f"{SPLIT}/scan"].decode() for record in records] == [
        record["scan"] for record in published
    ]
    assert [text.decode() for text in records[0][f"{SPLIT}/instructions"]] == (
        published[0]["instructions"]
    )
    fields = {field.name for field in dataset.metadata.record_sets[-1].fields}
    assert "objId" not in fields  # the public test file has no answers


@rdflib_warns
@pytest.mark.parametrize(
    ("task", "names"),
    [
        ("r2r", ["scan", "path", "instructions", "path_id"]),
        ("r4r", ["scan", "path", "instructions", "path_id"]),
        ("rxr", ["scan", "instruction_id", "path_id", "path", "instruction", "language"]),
        ("soon", ["scan", "instr_id", "instructions", "path"]),
        ("ndh", ["scan", "inst_idx", "target", "end_panos", "planner_path", "player_path"]),
    ],
)
def test_croissant_describes_the_files_of_every_task(
    task: str, names: list[str], clone: Path
) -> None:
    import mlcroissant

    dataset = mlcroissant.Dataset(described(clone, task))
    assert not dataset.metadata.issues.errors
    record = next(iter(dataset.records(SPLIT)))
    assert list(record) == [f"{SPLIT}/{name}" for name in names]
    assert record[f"{SPLIT}/scan"] == b"DemoMansion"


def test_croissant_says_what_is_submitted_and_scored(clone: Path) -> None:
    """As the draft of Croissant Tasks asks: each problem leaves out what a submission brings."""
    problem = json.loads(described(clone).read_bytes())["subjectOf"]
    assert problem["cr:output"]["@type"] == "cr:OutputSpec"
    fields = problem["cr:output"]["cr:schema"]["cr:field"]
    assert [field["name"] for field in fields] == ["instr_id", "trajectory", "predObjId"]
    evaluation = problem["cr:evaluation"]
    assert (evaluation["@type"], evaluation["name"]) == ("cr:EvaluationSpec", "official-v1")
    assert evaluation["description"].endswith("Submissions are ranked by RGSPL.")
    metrics = [metric["name"] for metric in evaluation["cr:expectedMetric"]]
    assert metrics == ["SR", "OSR", "SPL", "RGS", "RGSPL"]  # not TL, which has no direction
    parts = [(part["@id"], part["cr:input"]["@id"]) for part in problem["cr:subTask"]]
    assert parts == [(f"task/{split}", split) for split in ("val_seen", "val_unseen", "test")]


def test_croissant_says_which_metrics_are_better_lower(clone: Path) -> None:
    problem = json.loads(described(clone, "r2r").read_bytes())["subjectOf"]
    metrics = problem["cr:evaluation"]["cr:expectedMetric"]
    lower = {metric["name"]: metric["cr:lowerIsBetter"] for metric in metrics}
    assert lower == {"NE": True, "OSR": False, "SR": False, "SPL": False}
    assert [metric.get("maxValue") for metric in metrics] == [None, 1.0, 1.0, 1.0]


@rdflib_warns
def test_croissant_leads_to_everything_that_a_task_names(clone: Path) -> None:
    from rdflib import RDF, Graph, Namespace

    terms = Namespace("http://mlcommons.org/croissant/")
    graph = Graph().parse(described(clone), format="json-ld")
    problems = set(graph.subjects(RDF.type, terms.TaskProblem))
    assert len(problems) == 4
    for name, types in {
        "input": {terms.FileSet, terms.RecordSet},
        "output": {terms.OutputSpec},
        "evaluation": {terms.EvaluationSpec},
    }.items():
        found = [graph.value(problem, terms[name]) for problem in problems]
        assert {graph.value(each, RDF.type) for each in found} == types


@rdflib_warns
@pytest.mark.parametrize(
    ("task", "file"), [("reverie", "good.json"), ("r2r", "r2r.json"), ("ndh", "ndh.json")]
)
def test_a_submission_is_as_croissant_says(task: str, file: str, clone: Path) -> None:
    """The library reads a sample by the fields that the task's output has."""
    import mlcroissant

    description = json.loads(described(clone, task).read_bytes())
    schema = description["subjectOf"]["cr:output"]["cr:schema"]
    content = (SAMPLES / file).read_bytes()
    (clone / file).write_bytes(content)
    for field in schema["cr:field"]:
        extract = {"jsonPath": f"$[*].{field['name']}"}
        field["source"] = {"fileObject": {"@id": "file"}, "extract": extract}
    description["recordSet"] = [schema]
    description["distribution"] = [
        description["distribution"][0]
        | {"@id": "file", "contentUrl": file, "sha256": hashlib.sha256(content).hexdigest()}
    ]
    (clone / "other.json").write_text(json.dumps(description))
    records = list(mlcroissant.Dataset(clone / "other.json").records("submission/records"))
    for record, sent in zip(records, json.loads(content), strict=True):
        read = {name.rpartition("/")[2]: value for name, value in record.items()}
        poses = [[str(part).encode() for part in pose] for pose in sent.pop("trajectory")]
        assert read.pop("trajectory") == poses
        assert {
            key: it.decode() if isinstance(it, bytes) else it for key, it in read.items()
        } == sent


def test_a_file_that_is_not_a_dataset_is_refused(
    tmp_path: Path, demo_world: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "REVERIE_val_unseen.json"
    broken.write_text("{}")
    assert main(["export", "croissant", str(demo_world), "--annotations", str(broken)]) != 0
    assert "is not a JSON list of records" in capsys.readouterr().err


def test_the_commands_on_the_page_work(
    demo_world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (REPOSITORY / "docs" / "how-to" / "export-results.md").read_text(encoding="utf-8")
    commands = re.findall(r"^reverie-eval (export .*)$", page, re.MULTILINE)
    assert len(commands) == 4
    monkeypatch.chdir(tmp_path)
    Path("submit.json").write_bytes(Path(GOOD).read_bytes())
    Path("REVERIE").mkdir()
    for part in ("tasks", "connectivity"):
        Path("REVERIE", part).symlink_to(demo_world / part)
    for command in commands:
        assert main(shlex.split(command)) == 0, command
