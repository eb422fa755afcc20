"""Tasks: what each has to say of itself, and how another package adds one."""

import json
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from reverie_eval import (
    Evaluator,
    GroundTruth,
    GroundTruthError,
    ProtocolError,
    Scores,
    compare,
    evaluate,
    evaluate_many,
)
from reverie_eval.agents import run_agent
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.metrics import METRICS
from reverie_eval.server.service.boards import load_board
from reverie_eval.server.settings import Also, Split
from reverie_eval.tasks import BUILT_IN, DEFAULT_PROTOCOL, Task, find_task, task_names
from tests.conftest import REPOSITORY
from tests.support.flat import Run

every_task = pytest.mark.parametrize("name", BUILT_IN)
every_protocol_of_samples = pytest.mark.parametrize(
    ("name", "protocol"),
    [
        pytest.param(name, rules.name, id=f"{name}, {rules.name}")
        for name in ("r2r", "r4r", "ndh")
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
    assert {*task.headline, *task.ranking} <= METRICS.keys()
    assert set(task.aliases.values()) <= {rules.name for rules in task.protocols}
    assert re.fullmatch(task.id_pattern, task.id_example)


@every_task
def test_ids_tell_a_task_from_reverie(name: str) -> None:
    patterns = {each: find_task(each).id_pattern for each in ("reverie", name)}
    alike = [it for it, pattern in patterns.items() if re.fullmatch(pattern, "4774_267_1")]
    assert alike == ["reverie"]


@every_task
def test_a_module_is_short(name: str) -> None:
    assert len((MODULES / f"{name}.py").read_text().splitlines()) <= 150


@every_task
def test_the_demo_world_has_every_split(name: str, run: Run) -> None:
    for split in ("train", "val_seen", "val_unseen"):
        agent = run("agent", "shortest", "--task", name, "--split", split)
        scores = evaluate(json.loads(agent.out), split=split, task=name)
        assert scores["success"] == 1.0


def test_the_page_shows_what_is_printed(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)
    page = (REPOSITORY / "docs" / "tasks.md").read_text()
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


def test_scores_of_two_tasks_are_not_concatenated() -> None:
    scores = [
        evaluate(SAMPLES / f"{name}.json", split="val_unseen", task=name) for name in ("r2r", "r4r")
    ]
    with pytest.raises(ProtocolError, match="not of one split under one protocol: task:r2r"):
        Scores.concatenate(scores)


@pytest.mark.parametrize("by", ["category", "visibility"])
def test_a_breakdown_by_targets_needs_targets(by: str) -> None:
    scores = evaluate(SAMPLES / "r2r.json", split="val_unseen", task="r2r")
    with pytest.raises(ProtocolError, match="R2R has no target objects"):
        scores.breakdown(by=by)


@every_task
def test_the_page_names_every_task(name: str) -> None:
    assert f"| `{name}` |" in (REPOSITORY / "docs" / "tasks.md").read_text()


@pytest.mark.parametrize(
    ("name", "task", "told"),
    [
        ("val_unseen", "reverie", 'the ground truth of R2R, .* is of REVERIE; set task = "r2r"'),
        ("r4r-val_unseen", "r4r", "the ground truth of R2R, and the split is of R4R"),
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
    also = {"duet": Also(protocol="hamt")}
    split = Split(visibility="open", bundle=place, task="r2r", also=also)
    board = load_board("r2r-val_seen", split, place)
    content = json.dumps(run_agent("shortest", GroundTruth.load(place))).encode()
    reports = board.reports(content, board.read(content))
    assert {name: report.episodes for name, report in reports.items()} == {"": 34, "duet": 35}
    assert all(each.measures_as(reports[each.further]) for each in board.all)


def test_an_unknown_task() -> None:
    with pytest.raises(ProtocolError, match="unknown task 'r2'; did you mean r2r"):
        evaluate([], split="val_unseen", task="r2")


def test_unknown_fields_are_refused() -> None:
    with pytest.raises(TypeError, match="unexpected keyword argument 'goals'"):
        Task(name="mine", goals=3)  # type: ignore[call-arg]


# A task of another package.

SIXTH = """
from dataclasses import replace

from reverie_eval.tasks import Annotation, Path
from reverie_eval.tasks.r2r import TASK as R2R


class Walk(Annotation, frozen=True, kw_only=True):
    walk: str
    route: Path
    text: str

    @property
    def name(self):
        return self.walk

    @property
    def instr_ids(self):
        return [self.walk]

    @property
    def texts(self):
        return [self.text]

    @property
    def reference(self):
        return self.route


TASK = replace(
    R2R,
    name="sixth",
    title="Sixth",
    annotation=Walk,
    file_name="walks-{split}.json",
    folder="walks",
    id_pattern=r"walk-\\d+",
    id_form="walk-<number>",
    id_example="walk-12",
    protocols=[replace(rules, scored_instructions=None) for rules in R2R.protocols],
    headline=("ndtw", "success"),
    ranking=("ndtw",),
)
"""


@pytest.fixture
def sixth(tmp_path: Path, demo_world: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Install a task of another package, and write the demo world in its layout."""
    site = tmp_path / "site"
    metadata = site / "sixth_task-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: sixth-task\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[reverie_eval.tasks]\nsixth = sixth_task:TASK\n")
    (site / "sixth_task.py").write_text(SIXTH)
    monkeypatch.syspath_prepend(site)
    world = tmp_path / "world"
    (world / "walks").mkdir(parents=True)
    shutil.copytree(demo_world / "connectivity", world / "connectivity")
    records = json.loads((demo_world / "tasks/R2R/data/R2R_val_unseen.json").read_text())
    walks = [
        {
            "scan": record["scan"],
            "walk": f"walk-{record['path_id']}",
            "route": record["path"],
            "text": record["instructions"][0],
        }
        for record in records
    ]
    (world / "walks" / "walks-val_unseen.json").write_text(json.dumps(walks))
    yield world
    sys.modules.pop("sixth_task", None)


def test_another_package_adds_a_task(sixth: Path, tmp_path: Path, run: Run) -> None:
    """It is compiled, walked and scored by the same commands."""
    assert task_names()[-1] == "sixth"
    bundle, submission = tmp_path / "val_unseen.npz", tmp_path / "submit.json"
    of_task = ("--task", "sixth", "--split", "val_unseen")
    assert run("compile", str(sixth), *of_task, "-o", str(bundle)).status == 0
    truth = ("--ground-truth", str(bundle))
    assert run("agent", "shortest", *of_task, *truth, "-o", str(submission)).status == 0
    done = run(str(submission), "--split", "val_unseen", *truth)
    assert done.out.splitlines()[0].split() == ["nDTW", "%", "SR", "%"]
    assert "task:sixth|split:val_unseen|protocol:official-v1|" in done.out
    assert run("lint", str(sixth), "--task", "sixth").status == 0


def test_a_bundle_of_a_task_that_is_not_installed(
    sixth: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle = str(tmp_path / "val_unseen.npz")
    run("compile", str(sixth), "--task", "sixth", "--split", "val_unseen", "-o", bundle)
    monkeypatch.undo()
    find_task.__globals__["_installed_task"].cache_clear()
    done = run("agent", "stop", "--split", "val_unseen", "--ground-truth", bundle)
    assert done.status == 2
    assert "is the ground truth of a task that is not installed: unknown task 'sixth'" in done.err
