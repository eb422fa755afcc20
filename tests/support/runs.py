"""Runs of a scripted agent in a small house, in a folder of the test."""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from reverie_eval import GroundTruth
from reverie_eval.agents import AgentSource
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.runner import Attempt, AttemptEnd, RunCard, RunPlan, Totals, read_attempts, run
from reverie_eval.simulator import Answer, Go, Observation, Stop
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.worlds import ground_truth_of

WORLD = World(
    {
        "house": Scan(
            {
                "hall": Viewpoint((0.0, 0.0, 1.5), views={8: [12]}),
                "north": Viewpoint((0.0, 2.0, 1.5), views={5: [0]}),
                "far": Viewpoint((0.0, 9.0, 1.5), views={5: [12], 6: [1]}),
            },
            frozenset({("hall", "north"), ("north", "far")}),
        )
    },
    [Item("7_5", "house", ["hall", "north", "far"], 5, instructions=4)],
)
EPISODES = ["7_5_0", "7_5_1", "7_5_2", "7_5_3"]
STAYED = {"trajectory": [["hall", 0.0, 0.0]], "predObjId": -1}

Act = Callable[[Observation, "Scripted"], Any]


class Scripted:
    """An agent whose every action is a function's, of what it sees and of how often it acted."""

    version = "1"
    act_like: Act
    begun: list[Any]

    def start(self, episode: Any) -> None:
        """Note the episode."""
        self.begun.append(episode)
        self.episode = episode
        self.acted = 0

    def act(self, seen: Observation) -> Any:
        """Act as the function says."""
        self.acted += 1
        return type(self).act_like(seen, self)


class Home:
    """Where runs are tried: a folder, a split, and an agent that can be given any behaviour."""

    def __init__(self, folder: Path, script: type[Scripted]) -> None:
        self.folder = folder / "run"
        self.script = script
        self.plan = RunPlan(AgentSource("scripted:Agent"), ground_truth_of(WORLD))
        self.ends: list[AttemptEnd] = []

    def run(self, act: Act, **changes: Any) -> Totals:
        """Run an agent that acts like this."""
        self.script.act_like = staticmethod(act)
        how = {name: changes.pop(name) for name in ("fill_missing",) if name in changes}
        plan = replace(self.plan, **changes)
        return run(plan, self.folder, on_attempt=self.ends.append, **how)

    @property
    def attempts(self) -> list[Attempt]:
        """All attempts, in order."""
        return list(read_attempts(self.folder))

    @property
    def submission(self) -> dict[str, Any]:
        """The records of the submission by their episodes."""
        records = json.loads((self.folder / "submission.json").read_text())
        return {record.pop("instr_id"): record for record in records}

    @property
    def card(self) -> RunCard:
        """The run's card."""
        return msgspec.json.decode((self.folder / "run.json").read_bytes(), type=RunCard)


def scripted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    """Return a home whose agent is ``scripted:Agent``, and whose runs wait for nothing."""
    script = type("Agent", (Scripted,), {"begun": []})
    module = type(sys)("scripted")
    module.Agent = script  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "scripted", module)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr("reverie_eval.runner._run.WAITS", (0.0, 0.0))
    return Home(folder, script)


def some(number: int) -> GroundTruth:
    """Return the first episodes of the demo world."""
    truth = GroundTruth.load(DEMO_BUNDLES / "val_unseen.npz")
    return truth.subset(truth.episodes.instr_ids[:number])


def stop(seen: Observation, agent: Scripted) -> Any:
    """Stop at once."""
    return Stop()


def to_the_end(seen: Observation, agent: Scripted) -> Any:
    """Walk the annotated path and answer: three steps."""
    return [Go("north"), Go("far"), Answer(5)][agent.acted - 1]


def forget_end(folder: Path) -> None:
    """Make the card of a run that ended what it was while the run went on."""
    card = json.loads((folder / "run.json").read_bytes())
    (folder / "run.json").write_text(json.dumps({**card, "totals": None}))
