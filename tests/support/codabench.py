"""Codabench's compute worker as a competition meets it, in processes that may be killed.

What it does is taken from Codabench c7dbc756, ``compute_worker/compute_worker.py``: each run has
folders of its own; scores are sent if the program ends well; a task that was not acknowledged is
given to a worker again (``task_acks_late`` in ``celery_config.py``). What Codabench is told is a
line of JSON in a file.
"""

import json
import os
import runpy
import shlex
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from zipfile import ZipFile

import yaml

import reverie_eval as rv
from tests.support.forking import Forked, Surroundings
from tests.support.killing import Step, die_at


class Task(NamedTuple):
    """A submission that a worker has to score."""

    competition: Path
    """The unpacked bundle."""
    archive: Path
    """What the participant sent."""
    told: Path
    """The file with what Codabench was told."""

    def events(self) -> list[dict[str, Any]]:
        """Return what Codabench was told."""
        return [json.loads(line) for line in self.told.read_text().splitlines()]

    def scores(self) -> list[Any]:
        """Return the scores that Codabench was sent, each time."""
        return [event["scores"] for event in self.events() if "scores" in event]

    def is_acknowledged(self) -> bool:
        """Whether it is not given to a worker again."""
        return {"acknowledged": True} in self.events()


def compute(task: Task, kill: str | None = None) -> int:
    """Let a worker run a task, until it is killed, as in `KILLS`; return how its process ended."""
    log = task.told.with_name("log")
    surroundings = Surroundings(task.told.parent, dict(os.environ), log, log)
    with Forked(_compute, surroundings, task, kill) as process:
        return process.wait()


def _compute(task: Task, kill: str | None) -> None:
    if kill is not None:
        die_at(KILLS[kill], 1)
    root = Path(tempfile.mkdtemp(prefix="run-", dir=task.told.parent))
    (root / "input").mkdir()
    (root / "output").mkdir()
    (root / "input" / "ref").symlink_to(task.competition / "reference_data")
    with ZipFile(task.archive) as file:
        file.extractall(root / "input" / "res")
    tell(task, status="Running")
    if run_program(task.competition / "scoring_program", root) == 0:
        tell(task, status="Finished")
        send_scores(task, root)
    else:
        tell(task, status="Failed")
    tell(task, acknowledged=True)


def run_program(program: Path, root: Path) -> int:
    """Run the command of a scoring program, and return how it ended."""
    with (program / "metadata.yaml").open() as file:
        _, *words = shlex.split(yaml.safe_load(file)["command"])
    places = {"/app/program": program, "/app/input": root / "input", "/app/output": root / "output"}
    script, *arguments = (_mounted(word, places) for word in words)
    sys.argv = [script, *arguments]
    try:
        runpy.run_path(script, run_name="__main__")
    except SystemExit as end:
        sys.stderr.write(f"{end.code}\n")
        return end.code if isinstance(end.code, int) else 1
    return 0


def _mounted(word: str, places: dict[str, Path]) -> str:
    for mounted, place in places.items():
        if word.startswith(f"{mounted}/"):
            return str(place) + word.removeprefix(mounted)
    raise AssertionError(word)


def send_scores(task: Task, root: Path) -> None:
    """Send what the program wrote."""
    with (root / "output" / "scores.json").open() as file:
        tell(task, scores=json.load(file))


def tell(task: Task, **event: Any) -> None:
    """Tell Codabench something."""
    with task.told.open("a") as file:
        file.write(json.dumps(event) + "\n")


KILLS: Mapping[str, Step] = MappingProxyType(
    {
        "the program begins": Step(sys.modules[__name__], "run_program"),
        "the rules are read": Step(Path, "read_bytes", "after"),
        "the file is scored": Step(rv, "evaluate", "after"),
        "the scores are written": Step(Path, "write_text", "after"),
        "the scores are named": Step(Path, "replace", "after"),
        "the program has ended": Step(sys.modules[__name__], "send_scores"),
        "the scores are sent": Step(sys.modules[__name__], "send_scores", "after"),
    }
)
"""Where a worker is killed, together with the program that it runs; in their order."""
