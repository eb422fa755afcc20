"""Ctrl-C and SIGTERM, which a terminal or a cluster sends to all processes of a command."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import SAMPLES
from tests.support.worlds import SPLIT

# Python runs a module of this name before anything else, in each process.
PRESSED = """
import os, signal, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "reverie_eval_cli.main":
            press()

def press():
    try:
        os.mkdir(os.environ["PRESSED"])  # once
    except FileExistsError:
        return
    os.killpg(0, int(os.environ["SENT"]))

if os.environ["WHEN"] == "importing":
    sys.meta_path.insert(0, Finder())
elif "--multiprocessing-fork" in sys.orig_argv or "forkserver" in " ".join(sys.orig_argv):
    press()
"""


def interrupted(
    when: str, words: list[str], folder: Path, sent: signal.Signals = signal.SIGINT
) -> tuple[int, str, str]:
    """Return the status and both outputs of a command that is interrupted at a certain moment."""
    (folder / "sitecustomize.py").write_text(PRESSED)
    pressed = folder / "pressed"
    process = subprocess.run(
        [sys.executable, "-m", "reverie_eval_cli", *words],
        env={
            **os.environ,
            "PYTHONPATH": str(folder),
            "PRESSED": str(pressed),
            "WHEN": when,
            "SENT": str(int(sent)),
        },
        start_new_session=True,  # the group that is interrupted
        capture_output=True,
        text=True,
        check=False,
    )
    assert pressed.exists()
    return process.returncode, process.stdout, process.stderr


def test_while_the_command_is_imported(tmp_path: Path) -> None:
    assert interrupted("importing", ["--version"], tmp_path) == (-2, "", "")


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("words", "notes"),
    [
        pytest.param([str(SAMPLES), "--split", SPLIT, "--jobs", "2"], "", id="many files"),
        pytest.param(
            ["run", "random", "--split", SPLIT, "--jobs", "2", "-o", "{}/run"],
            "note: the same command goes on with this run\n",
            id="a run",
        ),
    ],
)
def test_while_processes_start(
    words: list[str], notes: str, sent: signal.Signals, tmp_path: Path
) -> None:
    words = [each.format(tmp_path) for each in words]
    said = f"{notes}reverie-eval: interrupted\n"
    assert interrupted("starting", words, tmp_path, sent) == (2, "", said)


def test_while_what_scores_for_a_server_starts(folder: Path, tmp_path: Path) -> None:
    """The server may have begun to answer, or not yet; what scores has nothing to say."""
    _, _, said = interrupted("starting", ["serve", str(folder), "--port", "0"], tmp_path)
    logged = [line for line in said.splitlines() if not line.startswith("{")]
    assert logged in ([], ["reverie-eval: interrupted"])
