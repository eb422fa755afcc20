"""A run that can be killed: its agent notes in a file whatever it does, as an endpoint would."""

import os
import time
from pathlib import Path

from reverie_eval import GroundTruth
from reverie_eval.agents import AgentSource, Episode, RandomAgent
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.runner import RunPlan, run
from reverie_eval.simulator import Action, Observation

PAUSE_VARIABLE = "REVERIE_LEDGER_PAUSE"
"""The environment variable with the seconds for each action, so that there is time to be killed."""


class Agent(RandomAgent):
    """Walks at random, and appends a line to a file for each action that it is asked for."""

    version = "1"

    def __init__(self, ledger: str) -> None:
        self._ledger = Path(ledger)

    def start(self, episode: Episode) -> None:
        """Begin at random."""
        super().start(episode)
        self._episode = episode

    def act(self, seen: Observation) -> Action:
        """Write a line, and go on at random."""
        with self._ledger.open("a") as file:
            file.write(f"{os.getpid()}\n")
        self._episode.log(input_tokens=3, output_tokens=1, money=0.25)
        time.sleep(float(os.environ.get(PAUSE_VARIABLE, "0")))
        return super().act(seen)


def run_with_ledger(ledger: Path, folder: Path, episodes: int, jobs: int = 1) -> None:
    """Run some episodes of the longest split of the demo world."""
    agent = AgentSource("tests.support.ledgers:Agent", {"ledger": str(ledger)})
    run(_plan(agent, "r4r/train", episodes), folder, jobs=jobs)


def run_chat(url: str, folder: str, episodes: int, jobs: int = 1) -> None:
    """Let a language model walk some episodes of the demo world."""
    options = {"model": "m", "endpoint": url, "observe": "objects", "moves": 3, "cache": folder}
    plan = _plan(AgentSource("chat", options), "val_unseen", episodes)
    run(plan, Path(folder), jobs=jobs, threads=True)


def _plan(agent: AgentSource, split: str, episodes: int) -> RunPlan:
    truth = GroundTruth.load(DEMO_BUNDLES / f"{split}.npz")
    return RunPlan(agent, truth.subset(truth.episodes.instr_ids[:episodes]))
