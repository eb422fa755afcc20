"""What `pip install reverie-eval` installs, and what commands say that need more."""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import click
import pytest

from reverie_eval_cli.main import program
from tests.conftest import SAMPLES
from tests.support.flat_world import Run
from tests.support.parts import blocked, installed_with, run_alone

MOST_PACKAGES = 12
GOOD, MEDIOCRE = str(SAMPLES / "good.json"), str(SAMPLES / "mediocre.json")
SCORED = (GOOD, "--split", "val_unseen")
SERVER = ("--server", "http://127.0.0.1:1")

CHAT = ("run", "chat", "--model", "m", "--endpoint", "http://127.0.0.1:1", "--observe", "objects")

Words: TypeAlias = tuple[str, ...]
Outcomes: TypeAlias = Mapping[Words, tuple[int, str, str]]
"""The status of each command, its output and what it says to standard error."""

WORKING: Sequence[Words] = [
    ("--help",),
    ("score", *SCORED),
    ("score", *SCORED, "--format", "json"),
    ("score", *SCORED, "--protocol", "all"),
    ("score", *SCORED, "--episodes", "episodes.csv"),
    ("score", MEDIOCRE, *SCORED),
    ("validate", *SCORED),
    ("protocol", "DUET"),
    ("subset", "--split", "val_unseen", "--n", "10"),
    ("convert", *SCORED, "-o", "converted.json"),
    ("run", "word-match", "--split", "val_unseen", "-o", "run"),
    ("simulator", "--path"),
    ("compile", "DATASET", "--split", "val_unseen", "-o", "bundle.npz"),
    ("lint", "DATASET"),
    ("describe", "DATASET"),
    ("boxes", "--help"),
    ("demo",),
    ("schema", "score-report"),
    ("completion", "bash"),
    ("server", "--help"),
]
STATISTICS = "intervals, comparisons and plans need: pip install 'reverie-eval[analysis]'"
CALLS = "calling a server needs: pip install 'reverie-eval[client]'"
THE_SERVER = (
    "the server needs: pip install 'reverie-eval[server]'"
    if sys.version_info >= (3, 11)
    else "the server needs Python 3.11 or newer"
)
MISSING: Mapping[Words, str] = {
    ("score", *SCORED, "--ci"): STATISTICS,
    ("compare", MEDIOCRE, *SCORED): STATISTICS,
    ("plan", "--split", "val_unseen"): STATISTICS,
    ("table", MEDIOCRE, *SCORED): STATISTICS,
    ("check-table", "paper.tex", *SCORED): (
        "tables in LaTeX need: pip install 'reverie-eval[analysis]'"
    ),
    ("report", *SCORED, "-o", "report.html"): (
        "an HTML report needs: pip install 'reverie-eval[report]'"
    ),
    ("describe", "DATASET", "--figures", "figures"): (
        "figures need: pip install 'reverie-eval[report]'"
    ),
    ("export", "model-card", *SCORED, "--model", "a/b"): (
        "metadata in YAML need: pip install 'reverie-eval[report]'"
    ),
    ("figure", GOOD, "1196_0_0", *SCORED[1:], "-o", "figure.pdf"): (
        "figures of episodes as PDF or PNG need: pip install 'reverie-eval[report]'"
    ),
    ("login", *SERVER): CALLS,
    (*CHAT, "--split", "val_unseen", "-o", "chat"): CALLS,
    ("submit", *SCORED, "--method", "Ours", *SERVER): CALLS,
    ("leaderboard", *SERVER): CALLS,
    ("verify", GOOD): "receipts need: pip install 'reverie-eval[client]'",
    ("train", "mattnet", "--data", "DATASET", "-o", "model"): (
        "trained agents need: pip install 'reverie-eval[agents]'"
    ),
    ("serve",): THE_SERVER,
    ("server", "init", "lab"): THE_SERVER,
    ("server", "doctor", "--quick", "lab"): THE_SERVER,
}
IN_PYTHON = {
    "scores.to_pandas()": "a data frame needs: pip install 'reverie-eval[report]'",
    "scores.breakdown('scan')": "a data frame needs: pip install 'reverie-eval[report]'",
    "scores.plot.funnel()": "figures need: pip install 'reverie-eval[report]'",
    "scores.with_intervals()": STATISTICS,
    "rv.compare(scores, scores)": STATISTICS,
    "import reverie_eval.client": CALLS,
    "import reverie_eval.receipts": "receipts need: pip install 'reverie-eval[client]'",
    "import reverie_eval.server": THE_SERVER,
    "scores.episode(scores.instr_ids[0]).save('episode.svg')": "",
    "scores._repr_html_()": "",
    "scores.episode(scores.instr_ids[0])._repr_html_()": "",  # without photographs
}
PYTHON = """
import json, sys
blocked, file, calls = json.loads(sys.argv[1])
sys.modules.update((name, None) for name in blocked if name not in sys.modules)
import reverie_eval as rv
scores = rv.evaluate(file, split="val_unseen")
for call in calls:
    try:
        exec(call)
        print()
    except rv.ReverieEvalError as error:
        print(error)
"""


BASE = frozenset(installed_with("reverie-eval"))


@pytest.fixture(scope="module")
def outcomes(demo_world: Path, tmp_path_factory: pytest.TempPathFactory) -> Outcomes:
    """Run all commands in a process that can import nothing else."""
    every = [*WORKING, *MISSING]
    commands = [[str(demo_world) if word == "DATASET" else word for word in each] for each in every]
    folder = tmp_path_factory.mktemp("base")
    (folder / "paper.tex").touch()
    return dict(zip(every, run_alone(commands, folder), strict=True))


def _named(words: Words) -> str:
    return " ".join(Path(word).name for word in words)


def test_few_packages_are_installed() -> None:
    others = BASE - {"reverie-eval", "editables"}  # which a clone needs
    assert len(others) <= MOST_PACKAGES, sorted(others)


@pytest.mark.parametrize("words", WORKING, ids=_named)
def test_a_command_that_needs_no_part(outcomes: Outcomes, words: Words) -> None:
    status, out, err = outcomes[words]
    assert status == 0, err
    assert "pip install" not in out + err


@pytest.mark.parametrize("words", MISSING, ids=_named)
def test_a_missing_part_is_a_line(outcomes: Outcomes, words: Words) -> None:
    assert outcomes[words] == (2, "", f"reverie-eval: {MISSING[words]}\n")


def test_python_says_what_is_missing_too(tmp_path: Path) -> None:
    given = json.dumps([blocked(), GOOD, list(IN_PYTHON)])
    program = [sys.executable, "-c", PYTHON, given]
    said = subprocess.check_output(program, text=True, cwd=tmp_path)
    assert said.splitlines() == list(IN_PYTHON.values())


def test_a_file_is_scored_without_what_takes_long_to_import() -> None:
    """Importing takes most of the command's time."""
    others = ["reverie_eval.analysis", "pydantic", "scipy", "difflib", "importlib.metadata"]
    program = "import sys; from reverie_eval_cli.main import main; main(); print(*sys.modules)"
    said = subprocess.check_output([sys.executable, "-c", program, "score", *SCORED], text=True)
    assert not set(others).intersection(said.splitlines()[-1].split())


def test_every_command_is_run() -> None:
    run = {words[0] for words in (*WORKING, *MISSING)}
    assert run >= set(program.list_commands(click.Context(program)))


def test_a_terminal_shows_plain_text_where_nothing_draws_on_it(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = run("score", *SCORED)
    monkeypatch.setitem(sys.modules, "rich", None)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert run("score", *SCORED) == plain
