"""How long a run takes beside what its agent does: for each step, and for each episode.

``python benchmarks/running.py`` runs an agent that takes a step without looking, 200 times in each
of some episodes, in the environment alone, and in a run. What an
episode costs is mostly the disk's, which confirms that it is there.
"""

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.bars import judge
from reverie_eval import GroundTruth
from reverie_eval.agents import AgentSource
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.runner import Limits, RunPlan, run
from reverie_eval.simulator import Action, Environment, Observation, Turn

STEPS = 200
EPISODES = 20
BAR = 1.0
"""Milliseconds a step, at most."""


def turn(_: Observation) -> Action:
    """Look ahead, for ever."""
    return Turn(0.0)


def main() -> int:
    """Print every figure; exit with 1 if one misses its bar."""
    truth = GroundTruth.load(DEMO_BUNDLES / "val_unseen.npz")
    truth = truth.subset(truth.episodes.instr_ids[:EPISODES])
    alone = min(walk(truth) for _ in range(3))
    steps = min(time_run(truth, STEPS) for _ in range(3))
    episodes = min(time_run(truth, 1) for _ in range(3))
    each = 1000 / (EPISODES * STEPS)
    over = (steps - episodes) * EPISODES * STEPS / (EPISODES * (STEPS - 1)) - alone
    print(f"a step in the environment alone: {alone * each:.3f} ms")
    print(f"an episode of one step: {1000 * episodes / EPISODES:.2f} ms")
    return judge([("ms that a run adds to a step", over * each, BAR)])


def walk(truth: GroundTruth) -> float:
    """Return the seconds of all steps in the environment alone."""
    environment = Environment(truth)
    began = time.perf_counter()
    for episode in environment.episodes:
        seen = environment.reset(episode)
        for _ in range(STEPS):
            seen = environment.step(turn(seen))
    return time.perf_counter() - began


def time_run(truth: GroundTruth, steps: int) -> float:
    """Return the seconds of a run."""
    agent = AgentSource(f"{__file__}:turn")
    with TemporaryDirectory() as folder:
        began = time.perf_counter()
        run(RunPlan(agent, truth, limits=Limits(steps=steps)), Path(folder, "run"))
        return time.perf_counter() - began


if __name__ == "__main__":
    sys.exit(main())
