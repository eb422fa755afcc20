"""``reverie-eval run``: from an agent to a table, at the command line."""

import json
import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from reverie_eval import GroundTruth, evaluate
from reverie_eval.agents import BUILT_IN_AGENTS, AgentSource
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle
from reverie_eval.runner import RunPlan, check_agent
from reverie_eval_cli.commands.run import run_agent
from reverie_eval_cli.main import main
from tests.conftest import REPOSITORY, SAMPLES
from tests.support.endpoints import endpoint
from tests.support.flat_world import Run
from tests.support.worlds import SPLIT

PAGE = (REPOSITORY / "docs" / "how-to" / "run.md").read_text("utf-8")
AGENT, BATCH, COSTS, _ = re.findall(r"```python\n(.+?)\n```", PAGE, re.DOTALL)
(TABLE,) = re.findall(r"prints\n\n```\n(.+?)\n```", PAGE, re.DOTALL)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_agent.py").write_text(AGENT)
    return tmp_path


def test_the_agent_of_the_page_runs_and_scores_what_the_page_says(folder: Path, run: Run) -> None:
    (words,) = re.findall(r"^reverie-eval (run .*)$", PAGE, re.MULTILINE)
    status, out, err = run(*words.split())
    assert (status, out.strip()) == (0, TABLE)
    assert len(AGENT.splitlines()) <= 30
    assert "84 ended; 84 attempts" in err
    assert "the agent read instruction, names" in err
    written = {each.name for each in (folder / "runs" / "mine").iterdir()}
    assert written == {"episodes.jsonl", "run.json", "steps.jsonl", "submission.json"}
    assert all(f"`{name}`" in PAGE for name in written)
    again = run(*words.split())
    assert (again.status, again.out) == (0, out)
    assert "nothing was left to run" not in err
    assert "nothing was left to run" in again.err


def test_the_batch_of_the_page_passes_as_an_agent(folder: Path, demo: GroundTruth) -> None:
    (folder / "batch.py").write_text(BATCH)
    assert check_agent(RunPlan(AgentSource("batch.py"), demo), number=40) == set()


MOVING = """
import os
from reverie_eval.simulator import Stop
os.chdir("/")
def Agent(seen):
    os.chdir("/")
    return Stop()
"""


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_an_agent_may_change_the_working_directory(jobs: str, folder: Path, run: Run) -> None:
    """As code does that finds its own files by relative paths: when imported, and when it acts."""
    (folder / "moving.py").write_text(MOVING)
    shutil.copy(DEMO_BUNDLES / "val_unseen.npz", folder / "boxes.npz")
    words = ["run", "moving.py", "--split", SPLIT, "-o", "mine", "--boxes", "boxes.npz"]
    status, out, err = run(*words, "--jobs", jobs)
    assert (status, out.startswith("TL m"), Path.cwd()) == (0, True, folder)
    assert "84 ended; 84 attempts" in err
    assert "nothing was left to run" in run(*words).err


def test_a_run_for_which_there_is_no_space_goes_on_later(tmp_path: Path, run: Run) -> None:
    words = ["run", "nearest-first", "--split", SPLIT, "-o", "mine"]
    stopped = subprocess.run(
        [sys.executable, "-m", "reverie_eval_cli", *words],
        cwd=tmp_path,
        # The largest file that it may write, in bytes: within a line of steps.jsonl.
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000)),
        capture_output=True,
        text=True,
        check=False,
    )
    told = f"reverie-eval: {tmp_path / 'mine'}: File too large\n"
    assert (stopped.returncode, stopped.stderr) == (2, told)
    went_on = run(*words[:-1], str(tmp_path / "mine"))
    whole = run(*words[:-1], str(tmp_path / "whole"))
    assert went_on.out == whole.out
    ours, its = (tmp_path / name / "submission.json" for name in ("mine", "whole"))
    assert ours.read_bytes() == its.read_bytes()


def test_an_edited_agent_does_not_pass_for_the_one_that_ran(folder: Path, run: Run) -> None:
    words = ["run", "my_agent.py", "--split", SPLIT, "-o", "run"]
    run(*words)
    (folder / "my_agent.py").write_text(AGENT.replace("patience=15", "patience=1"))
    edited = run(*words)
    assert (edited.status, edited.out) == (2, "")
    assert "digest of the agent's code: " in edited.err


def test_why_episodes_were_stopped_is_said(folder: Path, run: Run) -> None:
    code = "from reverie_eval.simulator import Go\n\ndef lost(seen):\n    return Go('nowhere')\n"
    (folder / "lost.py").write_text(code)
    status, _, err = run("run", "lost.py:lost", "--split", SPLIT, "-o", "lost")
    assert status == 0
    assert re.search(r"\d+ of the 84 cut off: ActionError: 'nowhere' is not a neighbour of", err)


def test_who_interrupts_a_run_is_told_how_it_goes_on(folder: Path, run: Run) -> None:
    code = "def agent(seen):\n    raise KeyboardInterrupt\n"
    (folder / "agent.py").write_text(code)
    status, _, err = run("run", "agent.py:agent", "--split", SPLIT, "-o", "cut")
    assert status == 2
    assert "note: the same command goes on with this run" in err


def test_the_submission_scores_as_every_other(folder: Path, run: Run) -> None:
    ran = run("run", "random", "--split", SPLIT, "-o", "random")
    scored = run("random/submission.json", "--split", SPLIT)
    assert (scored.status, scored.err) == (0, "")
    assert scored.out.startswith(f"{ran.out}note: cost per episode: ")


def test_the_steps_are_read_in_one_line(folder: Path, run: Run) -> None:
    import pandas as pd

    run("run", "my_agent.py", "--split", SPLIT, "-o", "runs/mine")
    (call,) = re.findall(r"`pandas\.(read_json\(.*?\))`", PAGE)
    steps = eval(f"pd.{call}", {"pd": pd})
    assert set(steps["action"]) >= {"Go", "Answer"}
    assert steps["notes"].str["new"].max() > 0


@pytest.mark.usefixtures("folder")
def test_the_costs_are_read_as_the_page_says(run: Run) -> None:
    for name, patience in (("mine", 15), ("other", 3)):
        options = ["-o", f"runs/{name}", "--option", f"patience={patience}"]
        assert run("run", "my_agent.py", "--split", SPLIT, *options).status == 0
    names: dict[str, Any] = {}
    exec(COSTS, names)
    assert names["comparison"].costs["other"]["actions"].mean < 0
    assert all(f"`{cost}`" in PAGE for cost in names["scores"].costs)


def test_options_are_of_a_file_and_of_the_command(folder: Path, run: Run) -> None:
    (folder / "agent.py").write_text(
        "class Agent:\n"
        "    def __init__(self, a, b, c): print(repr((a, b, c)))\n"
        "    def start(self, episode): pass\n"
        "    def act(self, seen):\n"
        "        from reverie_eval.simulator import Stop\n"
        "        return Stop()\n"
    )
    (folder / "options.toml").write_text('a = 1\nb = [2, "x"]\n')
    options = ["--options-from", "options.toml", "--option", "a=0.5", "--option", "c=so be it"]
    outcome = run("run", "agent.py", "--split", SPLIT, "-o", "run", *options)
    assert "(0.5, [2, 'x'], 'so be it')" in outcome.err
    assert outcome.out.startswith("TL m")
    identity = json.loads((folder / "run" / "run.json").read_text())["identity"]
    assert identity["options"] == {"a": 0.5, "b": [2, "x"], "c": "so be it"}


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        pytest.param(["--option", "a"], 2, "--option a: expected NAME=VALUE", id="no value"),
        pytest.param(["--option", "a=1"], 2, "its options: patience", id="unknown option"),
        pytest.param(["--options-from", "my_agent.py"], 2, "my_agent.py: ", id="not TOML"),
        pytest.param(["--max-steps", "0"], 2, "0 is not in the range x>=1", id="no step"),
        pytest.param(["--boxes", "my_agent.py"], 2, "my_agent.py: Expecting", id="no boxes"),
        pytest.param(["--boxes", ".", "--jobs", "2"], 2, "no file of a", id="folder without boxes"),
        pytest.param(["--boxes", "none"], 2, "/none", id="no file"),
        pytest.param(["--pictures", "none"], 2, "none: there is no such folder", id="no folder"),
        pytest.param(["--episodes-from", "none"], 2, "none: No such file", id="no list"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_run(
    words: list[str], status: int, message: str, folder: Path, run: Run
) -> None:
    outcome = run("run", "my_agent.py", "--split", SPLIT, "-o", "run", *words)
    assert outcome.status == status
    assert message in outcome.err
    assert not (folder / "run").exists()


def test_some_episodes_can_be_chosen(folder: Path, run: Run) -> None:
    run("subset", "--split", SPLIT, "--n", "7", "-o", "list")
    outcome = run(
        "run", "stop", "--split", SPLIT, "--episodes-from", "list", "-o", "run", "--max-steps", "1"
    )
    assert "|subset:" in outcome.out
    submission = json.loads((folder / "run" / "submission.json").read_text())
    assert {it["instr_id"] for it in submission} == set((folder / "list").read_text().split())


def test_a_public_bundle_ends_at_the_submission(folder: Path, run: Run) -> None:
    Bundle.load(DEMO_BUNDLES / f"{SPLIT}.npz").public().save(Path("public.npz"))
    words = ["--split", SPLIT, "--ground-truth", "public.npz"]
    outcome = run("run", "nearest-first", *words, "-o", "run")
    assert outcome[:2] == (0, "run/submission.json\n")
    assert run("validate", "run/submission.json", *words).status == 0
    refused = run("run", "shortest", *words, "-o", "other")
    assert "is a public bundle" in refused.err
    assert refused.status == 2
    assert not Path("other").exists()


def test_a_failed_episode_is_filled_on_request_and_the_table_says_so(
    folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("reverie_eval.runner._run.WAITS", (0.0,))
    (folder / "agent.py").write_text(
        "from reverie_eval.agents import StopAgent\n"
        "from reverie_eval.runner import TransientError\n"
        "class Agent(StopAgent):\n"
        "    begun = 0\n"
        "    def start(self, episode):\n"
        "        Agent.begun += 1\n"
        "        if Agent.begun in (3, 4): raise TransientError('busy')\n"
    )
    words = ["run", "agent.py", "--split", SPLIT, "-o", "run"]
    failed = run(*words)
    assert (failed.status, failed.out) == (2, "")
    assert re.search(
        r"note: \w+: TransientError: busy \(agent.py, line 7\); again in 0 s", failed.err
    )
    assert "1 episode of 84 failed" in failed.err
    filled = run(*words, "--fill-missing")
    assert filled.status == 0
    assert "83 ended, 1 failed; 85 attempts" in filled.err
    hint = "1 episode without an answer of the agent, filled with a stop at the start"
    assert f"note: {hint}" in filled.out
    assert run(*words)[:2] == (0, filled.out.replace(f"note: {hint}\n", ""))  # it was tried again


def test_the_help_lists_our_agents() -> None:
    assert all(name in (run_agent.help or "") for name in BUILT_IN_AGENTS)
    assert all(f"`{name}`" in PAGE for name in BUILT_IN_AGENTS)


def test_a_language_model_runs_by_options_of_its_own(
    folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "prices.toml").write_text("date = 2026-11-26\n[m]\ninput=1\ncached=1\noutput=1\n")
    (folder / "list").write_text("1308_18_0\n1308_18_1\n")
    monkeypatch.setenv("MY_KEY", "sk-1")
    words = ["run", "chat", "--split", SPLIT, "--episodes-from", "list", "-o", "run"]
    words += ["--model", "m", "--key-from", "MY_KEY", "--observe", "objects", "--history", "map"]
    words += ["--prices", "prices.toml", "--max-cost", "1", "--option", "moves=1"]
    with endpoint("sk-1") as served:
        outcome = run(*words, "--endpoint", served.url)
        again = run(*words, "--endpoint", served.url, "--cache", "elsewhere")
    assert (outcome.status, again.out) == (0, outcome.out)
    assert "cost $0.00" in outcome.err
    assert "annotators' labels: perfect perception" in outcome.err
    assert (folder / "run" / "replies.jsonl").read_text().count("\n") == len(served.requests)
    assert {request["model"] for request in served.requests} == {"m"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        pytest.param([], "chat needs model, endpoint, observe; its options: ", id="nothing"),
        pytest.param(["--observe", "all"], "choose one of: geometry, objects, views", id="class"),
        pytest.param(
            ["--observe", "views"], "--observe views needs --pictures FOLDER", id="no pictures"
        ),
        pytest.param(
            [
                "--model",
                "m",
                "--endpoint",
                "http://h/v1",
                "--observe",
                "objects",
                "--max-cost",
                "1",
            ],
            "a limit of the cost needs prices",
            id="no prices",
        ),
    ],
)
def test_what_a_language_model_lacks_is_said(
    words: list[str], message: str, folder: Path, run: Run
) -> None:
    outcome = run("run", "chat", "--split", SPLIT, "-o", "run", *words)
    assert outcome.status == 2
    assert message in outcome.err
    assert not (folder / "run").exists()


def test_a_terminal_shows_progress(
    folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("reverie_eval_cli.output._is_rich", lambda _: True)
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    outcome = run("run", "stop", "--split", SPLIT, "-o", "run")
    assert "84/84" in outcome.err
    assert "a second" in outcome.err


def test_the_folder_of_a_run_is_a_result(folder: Path, run: Run) -> None:
    split = ["--split", SPLIT]
    for name in ("stop", "random"):
        run("run", name, *split, "-o", f"runs/{name}")
    of_file = run("runs/stop/submission.json", *split)
    assert run("runs/stop", *split) == of_file
    assert run("validate", "runs/stop", *split).status == 0
    ranked = run("runs", *split)
    assert [line.split()[1] for line in ranked.out.splitlines()[1:3]] == ["random", "stop"]
    both = ["compare", "runs/stop", "runs/random", *split]
    assert (
        run(*both).out == run(*both[:1], *(f"{it}/submission.json" for it in both[1:3]), *split).out
    )
    assert dict(evaluate("runs/stop", split=SPLIT)) == dict(
        evaluate("runs/stop/submission.json", split=SPLIT)
    )


def test_the_folder_of_a_run_that_did_not_end_says_how_it_goes_on(folder: Path, run: Run) -> None:
    (folder / "agent.py").write_text(
        "class Agent:\n"
        "    begun = 0\n"
        "    def start(self, episode): self.begun += 1\n"
        "    def act(self, seen):\n"
        "        from reverie_eval.simulator import Stop\n"
        "        return Stop() if self.begun < 8 else self.missing\n"
    )
    run("run", "agent.py", "--split", SPLIT, "-o", "runs/x")
    says = (
        "runs/x: this run has no submission yet: 7 episodes ended, and 1 failed, such as "
        "AttributeError: 'Agent' object has no attribute 'missing' (agent.py, line 6); the "
        "`reverie-eval run` that began it goes on, and with --fill-missing"
    )
    for words in (["runs/x"], ["validate", "runs/x"], ["compare", "runs/x", "runs/x"]):
        outcome = run(*words, "--split", SPLIT)
        assert outcome.status == 2
        assert says in outcome.err
    assert says in run("runs", str(SAMPLES / "good.json"), "--split", SPLIT).err


def test_what_an_agent_prints_is_no_result(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (folder / "loud.py").write_text("def Agent(seen): print('loud')\n")
    for jobs in ("1", "2"):
        assert main(["run", "loud.py", "--split", SPLIT, "-o", f"x{jobs}", "--jobs", jobs]) == 2
        out, err = capfd.readouterr()
        assert (out, "loud" in err) == ("", True)


CLOSING = """
import sys
from reverie_eval.simulator import Stop

def Agent(seen):
    sys.{stream}.close()
    return Stop()
"""


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_an_agent_may_close_what_it_prints_to(
    stream: str, folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (folder / "closing.py").write_text(CLOSING.format(stream=stream))
    assert main(["run", "closing.py", "--split", SPLIT, "-o", "closed"]) == 0
    out, err = capfd.readouterr()
    assert ("ground truth: " in out, " ended; " in err) == (True, True)


def test_an_agent_without_objects_is_told(folder: Path, run: Run) -> None:
    Bundle.load(DEMO_BUNDLES / f"{SPLIT}.npz").public().save(Path("public.npz"))
    words = ["run", "word-match", "--split", SPLIT, "--ground-truth", "public.npz", "-o", "x"]
    assert "the agent is shown no objects: the bundle is public" in run(*words).err


def test_a_file_is_no_folder_for_a_run(folder: Path, run: Run) -> None:
    for more in ([], ["--fill-missing"]):
        outcome = run("run", "stop", "--split", SPLIT, "-o", "my_agent.py", *more)
        assert outcome.status == 2
        assert "my_agent.py" in outcome.err
        assert "Not a directory" not in outcome.err
