"""Tasks: what each has to say of itself, and how another package adds one."""

import gzip
import json
import re
import shutil
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import reverie_eval
from reverie_eval import (
    Evaluator,
    GroundTruth,
    GroundTruthError,
    ProtocolError,
    Scores,
    SubmissionError,
    compare,
    diagnose,
    evaluate,
    evaluate_many,
    evaluate_protocols,
    validate,
)
from reverie_eval.ground_truth import DEMO_BUNDLES, find_ground_truth
from reverie_eval.metrics import CATALOGUE
from reverie_eval.runner import run_agent
from reverie_eval.scoring._evaluation import check_first_of_hop
from reverie_eval.server.scoring.boards import load_board
from reverie_eval.server.settings import BoardRules, Split
from reverie_eval.submissions import convert
from reverie_eval.tasks import BUILT_IN, DEFAULT_PROTOCOL, Task, find_task, task_names
from tests.conftest import REPOSITORY
from tests.support.flat_world import Outcome, Run

every_task = pytest.mark.parametrize("name", BUILT_IN)
every_protocol_of_samples = pytest.mark.parametrize(
    ("name", "protocol"),
    [
        pytest.param(name, rules.name, id=f"{name}, {rules.name}")
        for name in BUILT_IN
        if name != "reverie"
        for rules in find_task(name).protocols
    ],
)
SAMPLES = REPOSITORY / "fixtures" / "submissions"
MODULES = REPOSITORY / "reverie_eval" / "tasks"


@every_task
def test_a_task_says_everything_about_itself(name: str) -> None:
    task = find_task(name)
    assert task.name == name
    for text in (task.title, task.citation, task.source, task.licence, task.id_form):
        assert text
    assert task.protocols[0].name == DEFAULT_PROTOCOL
    assert all(rules.summary and rules.source for rules in task.protocols)
    assert {*task.headline, *task.ranking} <= CATALOGUE.keys()
    assert set(task.aliases.values()) <= {rules.name for rules in task.protocols}
    assert re.fullmatch(task.id_pattern, task.id_example)


@every_task
def test_ids_tell_a_task_from_reverie(name: str) -> None:
    patterns = {each: find_task(each).id_pattern for each in ("reverie", name)}
    alike = [it for it, pattern in patterns.items() if re.fullmatch(pattern, "4774_267_1")]
    assert alike == ["reverie"]


@every_task
def test_a_module_is_short(name: str) -> None:
    assert len((MODULES / f"{name}.py").read_text().splitlines()) <= 180


@every_task
def test_the_demo_world_has_every_split(name: str) -> None:
    for split in ("train", "val_seen", "val_unseen"):
        truth = find_ground_truth(None, split, name)
        scores = evaluate(run_agent("shortest", truth), split=split, task=name)
        assert scores["success"] == 1.0


def test_the_page_shows_what_is_printed(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)
    page = (REPOSITORY / "docs" / "reference" / "tasks.md").read_text()
    command = r"```sh\nreverie-eval (fixtures/[^\n]*)\n```"
    shown = re.findall(rf"{command}\n\n```\n(.*?)```", page, re.DOTALL)
    assert len(shown) == len(BUILT_IN) - 1
    for words, printed in shown:
        assert run(*words.split()).out == printed


@every_protocol_of_samples
def test_batches_saved_scores_and_parts_give_the_scores_of_the_file(
    name: str, protocol: str, tmp_path: Path
) -> None:
    sample = SAMPLES / f"{name}.json"
    whole = evaluate(sample, split="val_unseen", task=name, protocol=protocol)
    evaluator = Evaluator(split="val_unseen", task=name, protocol=protocol)
    records = json.loads(sample.read_bytes())
    for begin in range(0, len(records), 20):
        evaluator.update(records[begin : begin + 20])
    whole.save(tmp_path / "scores.npz")
    ids = whole.instr_ids
    parts = [whole.subset(ids[7:]), whole.subset(ids[:7])]
    for other in (
        evaluator.compute(),
        Scores.load(tmp_path / "scores.npz"),
        Scores.concatenate(parts),
    ):
        assert other.signature == whole.signature
        assert dict(other) == dict(whole)


def test_a_task_is_validated_and_diagnosed() -> None:
    sample = SAMPLES / "r2r.json"
    expected = evaluate(sample, split="val_unseen", task="r2r")
    assert len(validate(sample, split="val_unseen", task="r2r").jumps) == len(expected.instr_ids)
    scored = evaluate_protocols(sample, split="val_unseen", task="r2r")
    assert {*scored} == {"official-v1", "duet"}
    assert scored["official-v1"] == expected
    for scores in diagnose(sample, split="val_unseen", task="r2r", protocol="hamt"):
        assert scores["success"] == expected["success"]
    rigid = replace(find_task("r2r"), aliases={})
    with pytest.raises(ProtocolError, match=r"are those of none of its protocols$"):
        check_first_of_hop("duet", rigid)


def test_several_files_of_a_task(tmp_path: Path) -> None:
    """They are compared and ranked, by the metric that ranks in the task."""
    good, worse = SAMPLES / "ndh.json", tmp_path / "worse.json"
    records = json.loads(good.read_bytes())
    records[0]["trajectory"] = records[0]["trajectory"][:1]
    worse.write_text(json.dumps(records))
    comparison = compare(worse, good, split="val_unseen", task="ndh")
    assert comparison.primary("ndh").key == "goal_progress"
    assert comparison["ndh"]["goal_progress"].mean > 0
    scored = evaluate_many([worse, good], split="val_unseen", task="ndh")
    assert scored.ranks == {str(good): 1, str(worse): 2}


@pytest.mark.parametrize("given", BUILT_IN)
def test_a_file_of_another_task_is_named(given: str) -> None:
    """Each of the tasks recognises the samples of all others."""
    sample = SAMPLES / ("good.json" if given == "reverie" else f"{given}.json")
    for name in BUILT_IN:
        if name != given:
            with pytest.raises(SubmissionError) as refused:
                evaluate(sample, split="val_unseen", task=name)
            (problem,) = refused.value.problems
            assert problem.code == "other-task"
            assert problem.message.endswith(f"score the file with --task {given}"), name
            has_paths = "their trajectories are objects with a path" in problem.message
            assert has_paths == (given == "soon")


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "reverie"])
def test_a_file_is_converted_as_one_of_its_task(name: str) -> None:
    """The ground truth tells which task that is."""
    sample = SAMPLES / f"{name}.json"
    truth = GroundTruth.load(DEMO_BUNDLES / name / "val_unseen.npz")
    records = json.loads(sample.read_bytes())
    noted = [{**record, "note": 3} for record in records]
    conversion = convert(noted, split="val_unseen", ground_truth=truth)
    assert conversion.notes[-1].startswith("dropped: note, in ")
    assert not conversion.fixed
    given, converted = (
        evaluate(each, split="val_unseen", task=name) for each in (sample, conversion.records)
    )
    assert dict(converted) == dict(given)
    lines = "\n".join(map(json.dumps, records)).encode()
    assert convert(lines, task=name).records == json.loads(sample.read_bytes())
    assert not convert(lines, task=name).fixed


def test_scores_of_two_tasks_are_not_concatenated() -> None:
    scores = [
        evaluate(SAMPLES / f"{name}.json", split="val_unseen", task=name) for name in ("r2r", "r4r")
    ]
    with pytest.raises(ProtocolError, match="not of one split under one protocol: task:r2r"):
        Scores.concatenate(scores)


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "reverie"])
def test_metrics_are_explained_by_the_goal_of_the_task(name: str) -> None:
    task = find_task(name)
    scores = evaluate(SAMPLES / f"{name}.json", split="val_unseen", task=name)
    shown = {metric.key: metric.definition for metric in task.table_metrics(scores)}
    assert shown["success"] == f"{task.goal} where the agent stops"
    assert not any("target object" in definition for definition in shown.values())
    assert f'title="success rate: {escape(task.goal)} where' in scores._repr_html_()


def test_outcomes_have_a_remedy_where_there_are_no_objects() -> None:
    scores = evaluate(SAMPLES / "r2r.json", split="val_unseen", task="r2r")
    for find in (scores.gallery, lambda: scores.failure_modes, lambda: scores.outcomes):
        with pytest.raises(
            ProtocolError, match=r"R2R has no target objects.* to find failures, so"
        ):
            find()
    worst = str(scores.to_pandas()["navigation_error"].idxmax())
    assert scores.episode(worst).instr_id == worst


def test_reports_and_figures_have_the_metric_that_ranks(run: Run, tmp_path: Path) -> None:
    """Goal progress is in metres, and can be negative."""
    page, sample = tmp_path / "report.html", str(SAMPLES / "ndh.json")
    of_task = ("--task", "ndh", "--split", "val_unseen")
    assert run("report", sample, *of_task, "-o", str(page)).status == 0
    text = page.read_text()
    assert '<p class="small">By GP m.' in text
    widths = re.findall(r'<rect class="mark[^"]*" width="([-\d.]+)%"', text)
    assert widths
    assert max(map(float, widths)) == 100.0
    axes = evaluate(sample, split="val_unseen", task="ndh").plot.breakdown("length")
    assert axes.get_xlabel() == "m"
    assert set(axes.get_legend_handles_labels()[1]) == {"GP", "95 % interval"}


@pytest.mark.parametrize("by", ["category", "visibility"])
def test_a_breakdown_by_targets_needs_targets(by: str) -> None:
    scores = evaluate(SAMPLES / "r2r.json", split="val_unseen", task="r2r")
    with pytest.raises(ProtocolError, match="R2R has no target objects"):
        scores.breakdown(by=by)


@pytest.mark.parametrize(
    ("name", "task", "told"),
    [
        ("val_unseen", "reverie", 'the ground truth of R2R, .* is of REVERIE; set task = "r2r"'),
        ("r4r-val_unseen", "r4r", "the ground truth of R2R, but the split is of R4R"),
        ("val_unseen", "r2r", "the ground truth of r2r-val_unseen, not of val_unseen"),
        ("r2r-test", "r2r", "the ground truth of r2r-val_unseen, not of r2r-test"),
    ],
)
def test_a_server_refuses_the_bundle_of_another_split(name: str, task: str, told: str) -> None:
    place = DEMO_BUNDLES / "r2r" / "val_unseen.npz"
    split = Split(visibility="open", bundle=place, task=task)
    with pytest.raises(GroundTruthError, match=told):
        load_board(name, split, place)


def test_one_upload_is_scored_on_the_episodes_of_each_protocol() -> None:
    """R2R's own script never scores a path's fourth instruction, and DUET's does."""
    place = DEMO_BUNDLES / "r2r" / "val_seen.npz"
    others = {"duet": BoardRules(protocol="hamt")}
    split = Split(visibility="open", bundle=place, task="r2r", boards=others)
    board = load_board("r2r-val_seen", split, place)
    content = json.dumps(run_agent("shortest", GroundTruth.load(place))).encode()
    reports = board.reports(content, board.read(content))
    assert {name: report.episodes for name, report in reports.items()} == {"": 34, "duet": 35}
    assert all(each.measures_as(reports[each.name]) for each in board.all)


def test_an_unknown_task() -> None:
    with pytest.raises(ProtocolError, match="unknown task 'r2'; did you mean r2r"):
        evaluate([], split="val_unseen", task="r2")


def test_unknown_fields_are_refused() -> None:
    with pytest.raises(TypeError, match="unexpected keyword argument 'goals'"):
        Task(name="mine", goals=3)  # type: ignore[call-arg]


# A task of another package, made as docs/reference/tasks.md says.

TASKS = (REPOSITORY / "docs" / "reference" / "tasks.md").read_text()
HOUR = TASKS.partition("## Add a task in an hour")[2]


def block(language: str) -> str:
    """Return the first block of a language in that section."""
    _, _, rest = HOUR.partition(f"```{language}\n")
    return rest.partition("```")[0]


@pytest.fixture
def walks(tmp_path: Path, demo_world: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Install the task of the page, and work beside a dataset in its layout."""
    site = tmp_path / "site"
    project = tomllib.loads(block("toml"))["project"]
    metadata = site / "walks_task-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n")
    ((group, points),) = project["entry-points"].items()
    listed = "".join(f"{name} = {value}\n" for name, value in points.items())
    (metadata / "entry_points.txt").write_text(f"[{group}]\n{listed}")
    (site / "walks_task.py").write_text(block("python"))
    monkeypatch.syspath_prepend(site)
    monkeypatch.chdir(tmp_path)
    world = tmp_path / "dataset"
    (world / "walks").mkdir(parents=True)
    shutil.copytree(demo_world / "connectivity", world / "connectivity")
    records = json.loads((demo_world / "tasks/R2R/data/R2R_val_unseen.json").read_text())
    written = [
        {
            "scan": record["scan"],
            "walk": record["path_id"],
            "route": record["path"],
            "text": record["instructions"][0],
        }
        for record in records
    ]
    (world / "walks" / "walks-val_unseen.json").write_text(json.dumps(written))
    yield tmp_path
    sys.modules.pop("walks_task", None)


def follow(run: Run, last: int) -> Iterator[Outcome]:
    """Run the first commands of the page."""
    for line in block("sh").splitlines()[:last]:
        yield run(*line.split()[1:])


def test_another_package_adds_a_task_in_an_hour(walks: Path, run: Run) -> None:
    """It is compiled, walked and scored by the same commands."""
    assert task_names()[-1] == "walks"
    *others, scored = follow(run, 3)
    assert [each.status for each in (*others, scored)] == [0] * 3
    assert scored.out.splitlines()[0].split() == ["nDTW", "%", "SR", "%", "SPL", "%"]
    assert scored.out.splitlines()[1].split()[1:] == ["100.00", "100.00"]
    assert "task:walks|split:val_unseen|protocol:official-v1|" in scored.out
    alone = run("shortest/submission.json", "--task", "walks", "--split", "val_unseen")
    assert (alone.status, "the demo world has no Walks; `reverie-eval" in alone.err) == (2, True)
    (values,) = re.findall(r"```python\n(scores = .*?)```", HOUR, re.DOTALL)
    theirs = pd.Series(1.0, index=[f"walk-{walk['walk']}" for walk in records_of(walks)])
    script = values.replace("result.json", "shortest/submission.json").replace(
        "print", "assert 0 =="
    )
    exec(script, {"rv": reverie_eval, "theirs": theirs})


def records_of(walks: Path) -> list[dict[str, Any]]:
    """Return the annotations of the task."""
    records: list[dict[str, Any]] = json.loads(
        (walks / "dataset/walks/walks-val_unseen.json").read_text()
    )
    return records


@pytest.mark.usefixtures("walks")
def test_a_bundle_of_a_task_that_is_not_installed(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    list(follow(run, 2))
    monkeypatch.undo()
    find_task.__globals__["_installed_task"].cache_clear()
    bundle = str(tmp_path / "bundles" / "walks" / "val_unseen.npz")
    done = run("run", "stop", "--split", "val_unseen", "--ground-truth", bundle, "-o", "run")
    assert done.status == 2
    assert "is the ground truth of a task that is not installed: unknown task 'walks'" in done.err


WITHOUT_ANSWER: Mapping[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "reverie": lambda record: {"objId": None, "path": record["path"][:1]},
    "r2r": lambda record: {"path": record["path"][:1]},
    "r4r": lambda record: {"path": record["path"][:1]},
    "rxr": lambda record: {"path": record["path"][:1]},
    "ndh": lambda _: {"end_panos": None, "planner_path": None, "player_path": None},
    "soon": lambda record: {
        "scan": record["bboxes"][0]["scan"],
        "bboxes": [],
        "path": [path[:1] for path in record["path"]],
    },
}
"""What a record has instead of its answer in the public file of a private split."""


def annotated(demo_world: Path, name: str, split: str) -> list[dict[str, Any]]:
    """Return the records of an annotation file of the demo world."""
    task = find_task(name)
    content = (demo_world / task.folder / task.file_name.format(split=split)).read_bytes()
    if ".jsonl" not in task.file_name:
        records: list[dict[str, Any]] = json.loads(content)
        return records
    return [json.loads(line) for line in gzip.decompress(content).splitlines()]


@every_task
def test_items_without_an_answer_among_others_stop_the_compiler(
    name: str, demo_world: Path, run: Run, tmp_path: Path
) -> None:
    """They would be scored as if the start were the goal; lint counts them too."""
    records = annotated(demo_world, name, "val_unseen")
    for record in records[:3]:
        record.update(WITHOUT_ANSWER[name](record))
    file = tmp_path / "in.json"
    file.write_text(json.dumps(records))
    given = (*(str(demo_world), "--task", name), *("--annotations", str(file)))
    number = sum(map(len, (record["path"] for record in records[:3]))) if name == "soon" else 3
    compiled = run("compile", *given, "--split", "val_unseen", "-o", str(tmp_path / "it.npz"))
    assert compiled.status == 1
    assert f"{number} of " in compiled.err
    assert " items without a solution in a file where others have one: " in compiled.err
    checked = run("lint", *given)
    assert checked.status == 1
    (row,) = re.findall(r"^error +missing-solution .*$", checked.out, re.MULTILINE)
    assert row.split()[2] == str(number)


def test_a_path_that_stays_at_its_start_is_no_answer(
    demo_world: Path, run: Run, tmp_path: Path
) -> None:
    records = annotated(demo_world, "r2r", "val_unseen")
    for record in records[1:]:
        record["path"] = record["path"][:1] * 3
    file = tmp_path / "in.json"
    file.write_text(json.dumps(records))
    given = (*(str(demo_world), "--task", "r2r"), *("--annotations", str(file)))
    compiled = run("compile", *given, "--split", "val_unseen", "-o", str(tmp_path / "it.npz"))
    assert compiled.status == 1
    count = len(records) - 1
    assert f"{count} of {len(records)} items without a solution" in compiled.err
    # Of many, only some are kept by name, but all are counted.
    assert f" and {count - 3} more. Give every item its solution" in compiled.err


@every_task
def test_a_file_without_any_answer_is_public(
    name: str, demo_world: Path, run: Run, tmp_path: Path
) -> None:
    records = annotated(demo_world, name, "val_unseen")
    file = tmp_path / "in.json"
    file.write_text(json.dumps([record | WITHOUT_ANSWER[name](record) for record in records]))
    given = (*(str(demo_world), "--task", name), *("--annotations", str(file)))
    compiled = run("compile", *given, "--split", "val_unseen", "-o", str(tmp_path / "it.npz"))
    assert compiled.status == 0, compiled.err
