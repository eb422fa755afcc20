"""Training by the command, interrupted or not, and runs of what was trained, in the demo world."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from reverie_eval.agents import DEMO_AGENT, AgentSource
from reverie_eval.agents.trained import RECIPES, Epoch, TrainingPlan, read_model_card, train
from reverie_eval.agents.trained import _recipes as recipes
from reverie_eval.agents.trained import _training as training
from reverie_eval.agents.trained._agent import WalkingAgent
from reverie_eval.dataset import DatasetFiles
from reverie_eval.errors import ReverieEvalError, RunError
from reverie_eval.ground_truth import find_ground_truth
from reverie_eval.runner import RunPlan, read_steps
from reverie_eval.runner import run as run_plan
from tests.support.flat_world import Run
from tests.support.runs import some

SOURCES = Path(__file__).parents[2] / "reverie_eval"


@pytest.fixture(scope="module", autouse=True)
def few_epochs() -> Iterator[None]:
    """Train each agent for three epochs, which take seconds."""
    short = {name: replace(recipe, epochs=3) for name, recipe in RECIPES.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recipes, "RECIPES", short)
        yield


@pytest.fixture(scope="module")
def files(demo_world: Path) -> DatasetFiles:
    return DatasetFiles.find(demo_world, split="train")


@pytest.fixture(scope="module")
def pointer(files: DatasetFiles, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pointer")
    train(TrainingPlan("mattnet", files), folder)
    return folder


@pytest.fixture(scope="module")
def navigator(files: DatasetFiles, pointer: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("navigator")
    train(TrainingPlan("interactive", files, pointer=pointer), folder)
    return folder


def test_an_interrupted_training_ends_in_the_same_bytes(
    files: DatasetFiles, pointer: Path, tmp_path: Path
) -> None:
    def interrupt(number: int, _: Epoch) -> None:
        if number == 2:
            raise KeyboardInterrupt

    plan, folder = TrainingPlan("mattnet", files), tmp_path / "model"
    with pytest.raises(KeyboardInterrupt):
        train(plan, folder, interrupt)
    card = train(plan, folder)
    assert {each.name for each in folder.iterdir()} == {"model.safetensors", "card.json"}
    for each in folder.iterdir():
        assert each.read_bytes() == (pointer / each.name).read_bytes()
    assert train(plan, folder) == card  # nothing is left to do
    with pytest.raises(ReverieEvalError, match=r"another training \(seed: 0, now 1\); go on"):
        train(TrainingPlan("mattnet", files, seed=1), folder)


def test_one_process_at_a_time_trains_in_a_folder(files: DatasetFiles, tmp_path: Path) -> None:
    def train_again(*_: object) -> None:
        with pytest.raises(RunError, match="model: another process is running there"):
            train(plan, folder)

    plan, folder = TrainingPlan("mattnet", files), tmp_path / "model"
    train(plan, folder, train_again)
    train(plan, folder)


def test_a_file_in_place_of_the_folder_is_refused(files: DatasetFiles, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.touch()
    with pytest.raises(
        ReverieEvalError, match="is a file; a model needs a folder, such as models/mine"
    ):
        train(TrainingPlan("mattnet", files), file)


def test_an_interruption_in_the_first_epoch_leaves_folders_as_they_were(
    files: DatasetFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(torch.optim.Adam, "step", interrupt)
    with pytest.raises(KeyboardInterrupt):
        train(TrainingPlan("mattnet", files), tmp_path / "models" / "new")
    assert not any(tmp_path.iterdir())
    with pytest.raises(KeyboardInterrupt):
        train(TrainingPlan("mattnet", files), tmp_path)
    assert tmp_path.exists()


@pytest.mark.parametrize(
    ("seen", "first", "best"),
    [
        pytest.param([0.2, 0.5, 0.4], 1, 2, id="the best"),
        pytest.param([0.2, 0.5, 0.5], 1, 2, id="the earliest of equals"),
        pytest.param([0.5, 0.2, 0.3], 2, 3, id="none that only prepares"),
        pytest.param([0.5, 0.2], 5, 2, id="the last, while all prepare"),
    ],
)
def test_the_best_epoch_is_chosen(seen: list[float], first: int, best: int) -> None:
    curve = [Epoch(loss=0.0, seen=each, unseen=0.1) for each in seen]
    assert training.best_epoch(curve, first) == best


def test_training_ends_six_epochs_after_the_best(
    files: DatasetFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rates = iter([0.1, 0.1, 0.3, 0.2, *[0.2, 0.2, 0.1, 0.3, 0.3, 0.1] * 2])
    monkeypatch.setattr(training, "_rate_of", lambda *_: lambda _: next(rates))
    monkeypatch.setattr(recipes, "RECIPES", RECIPES)
    card = train(TrainingPlan("name-rnn", files), tmp_path / "model")
    sums = [each.seen + each.unseen for each in card.curve]
    assert sums == pytest.approx([0.2, 0.5, *[0.4] * 6])
    assert card.best == 2


@pytest.mark.parametrize(
    ("name", "option", "message"),
    [
        pytest.param("r2r-tff", {}, "no agent 'r2r-tff' to train; did you mean r2r-tf", id="name"),
        pytest.param("r2r-tf", {"name": True}, "no option 'name'; did you mean names", id="option"),
        pytest.param("r2r-tf", {"names": 3}, "names must be true or false, got 3", id="value"),
        pytest.param(
            "mattnet", {"names": True}, "no option 'names'; choose one of: size", id="a pointer's"
        ),
        pytest.param(
            "mattnet", {"size": 7}, "size must be an even number, at least 2, got 7", id="size"
        ),
        pytest.param("interactive", {}, "interactive asks a pointer: train one", id="pointer"),
    ],
)
def test_what_cannot_be_trained_is_refused(
    name: str, option: dict[str, object], message: str, files: DatasetFiles, tmp_path: Path
) -> None:
    with pytest.raises(ReverieEvalError, match=re.escape(message)):
        train(TrainingPlan(name, files, options=option), tmp_path / "model")
    assert not (tmp_path / "model").exists()


def test_a_folder_with_something_else_is_refused(files: DatasetFiles, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("")
    with pytest.raises(ReverieEvalError, match="is not empty; choose a new folder"):
        train(TrainingPlan("name-rnn", files), tmp_path)


def test_a_navigator_does_not_change_its_pointer(
    files: DatasetFiles, navigator: Path, pointer: Path, tmp_path: Path
) -> None:
    other = tmp_path / "model.safetensors"
    content = (pointer / other.name).read_bytes()
    other.write_bytes(content.replace(rb'"seed\":0', rb'"seed\":7'))
    with pytest.raises(
        ReverieEvalError, match=r"another training \(pointer: \w{12}, now \w{12}\); go on"
    ):
        train(TrainingPlan("interactive", files, pointer=tmp_path), navigator)


# Runs of models.


def test_a_pointer_is_led_to_the_goal(run: Run, pointer: Path, tmp_path: Path) -> None:
    out = run("run", str(pointer), "--split", "val_seen", "-o", str(tmp_path / "run"))
    assert "the agent read boxes, geometry, instruction, names, solution" in out.err
    assert out.out.splitlines()[1].split()[1:3] == ["100.00", "100.00"]  # SR and OSR


def test_a_navigator_walks_greedily_and_by_the_queue(
    run: Run, navigator: Path, tmp_path: Path
) -> None:
    words = ["run", str(navigator), "--split", "val_seen", "--option"]
    for walk in "greedy", "fast", "likeliest":
        out = run(*words, f"walk={walk}", "-o", str(tmp_path / walk))
        assert "the agent read boxes, geometry, instruction, names; " in out.err
        assert "cut off" not in out.err  # every walk ended by itself
    card = json.loads((tmp_path / "fast" / "run.json").read_text())["identity"]
    assert (card["agent"], card["options"]) == (navigator.name, {"walk": "fast"})
    assert re.fullmatch(r"[0-9a-f]{12}\+[0-9a-f]{12}", card["agent_version"])
    assert (
        "walk is greedy, fast, likeliest, not 'far'"
        in run(*words, "walk=far", "-o", str(tmp_path / "far")).err
    )


def test_company_in_a_batch_changes_no_score(
    navigator: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    walked = []
    for size in 1, 512:
        monkeypatch.setattr(WalkingAgent, "batch_size", size)
        run_plan(RunPlan(AgentSource(str(navigator)), some(40)), folder := tmp_path / str(size))
        walked.append(
            {
                (each.episode, each.step): (each.viewpoint_id, each.action, each.notes)
                for each in read_steps(folder)
            }
        )
    alone, together = walked
    assert alone == together
    assert any("logits" in notes for *_, notes in alone.values())


def test_directions_alone_read_no_names(run: Run, demo_world: Path, tmp_path: Path) -> None:
    model = str(tmp_path / "model")
    trained = run("train", "fast-lan-only", "--data", str(demo_world), "-o", model)
    assert "reads: geometry, instruction\n" in trained.out
    assert "note: epoch 1: loss " in trained.err
    out = run("run", model, "--split", "val_seen", "-o", str(tmp_path / "run"))
    assert "the agent read geometry, instruction\n" in out.err


def test_a_wrong_name_is_said_before_wrong_files(run: Run, tmp_path: Path) -> None:
    wrong = run("train", "matnet", "--data", str(tmp_path / "no"), "-o", str(tmp_path / "model"))
    assert wrong.status == 2
    message = (
        "reverie-eval: there is no agent 'matnet' to train; did you mean mattnet? Choose one of: "
    )
    assert wrong.err == f"{message}{', '.join(RECIPES)}\n"


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_a_seed_that_numpy_or_torch_refuses(seed: int, run: Run, tmp_path: Path) -> None:
    wrong = run("train", "mattnet", "--seed", str(seed), "-o", str(tmp_path / "model"))
    assert wrong.status == 2
    assert f"Invalid value for '--seed': {seed} is not in the range" in wrong.err


def test_a_navigator_is_trained_on_another_task(demo_world: Path, tmp_path: Path) -> None:
    files = DatasetFiles.find(demo_world, split="val_seen", task="r2r")
    card = train(TrainingPlan("r2r-tf", files, "val_seen"), tmp_path / "model")
    assert (card.task, [*card.input_class]) == ("r2r", ["geometry", "instruction"])
    with pytest.raises(ReverieEvalError, match="R2R has no target objects to point at"):
        train(TrainingPlan("mattnet", files, "val_seen"), tmp_path / "pointer")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        pytest.param("again", "has no metadata 'reverie_eval', without which", id="no metadata"),
        pytest.param("text", "is not a safetensors file", id="not safetensors"),
        pytest.param("version", "has version 2 of the form, and this is version 1", id="version"),
        pytest.param("words", "its words are not those that it learned", id="words"),
        pytest.param("missing", "there is no file", id="missing"),
    ],
)
def test_a_file_that_is_not_a_model_is_refused(
    damage: str, message: str, pointer: Path, tmp_path: Path
) -> None:
    file = Path(shutil.copy(pointer / "model.safetensors", tmp_path))
    content = file.read_bytes()
    if damage == "again":
        save_file(load_file(file), file)
    elif damage == "missing":
        file.unlink()
    else:
        file.write_bytes(
            {
                "text": b"weights",
                "version": content.replace(rb'"format_version\":1', rb'"format_version\":2'),
                "words": re.sub(rb'(\\"words\\":\[\\").', rb"\1~", content),
            }[damage]
        )
    with pytest.raises(ReverieEvalError, match=re.escape(message)):
        read_model_card(file)


def test_the_agent_of_the_demo_walks_as_its_submission_says(tmp_path: Path) -> None:
    run_plan(RunPlan(AgentSource(str(DEMO_AGENT)), find_ground_truth(None, "val_seen")), tmp_path)
    walked = (tmp_path / "submission.json").read_bytes()
    assert walked == (DEMO_AGENT / "val_seen.json").read_bytes()
    assert sum(each.stat().st_size for each in DEMO_AGENT.glob("*.safetensors")) < 300_000


def test_nothing_else_imports_torch() -> None:
    importing = re.compile(r"^\s*(?:import|from) (?:torch|safetensors)\b", re.MULTILINE)
    found = {
        path.parent.relative_to(SOURCES).as_posix()
        for path in SOURCES.rglob("*.py")
        if importing.search(path.read_text("utf-8"))
    }
    assert found == {"agents/trained"}
    code = "import sys, reverie_eval.agents, reverie_eval.runner; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
