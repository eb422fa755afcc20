"""Run R2R's own agents on ``MatterSim``, and score them by R2R's own evaluator and by ours.

They are ``StopAgent``, ``RandomAgent`` and ``ShortestAgent`` of the repository of the simulator, in
their own environment. It has no file of its own: ``scripts/evidence simulator CLONE...`` runs them
for a clone named ``Matterport3DSimulator``. Two things stand in: modules of torch, which only the
learned agent uses, and ``Graph.node``, which networkx has called ``nodes`` since 2.4.
"""

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import networkx as nx  # type: ignore[import-untyped]

from fixtures.published import family_folder, unpack_task
from reverie_eval import GroundTruth, evaluate
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.simulator import MatterSim
from tests.support.writers import Nothing

AGENTS = ("Stop", "Shortest", "Random")
_TORCH = ("torch", "torch.nn", "torch.nn.functional", "torch.distributions", "torch.autograd")
_OURS = {
    "length": "path_length",
    "nav_error": "navigation_error",
    "oracle success_rate": "oracle_success",
    "success_rate": "success",
    "spl": "spl",
}
"""Our metrics by the names that R2R's evaluator gives them."""


def run_agents(clone: Path) -> Iterator[str]:
    """Yield a line for each agent and split; the working directory has the connectivity files."""
    family = family_folder()
    if family is None:
        raise SystemExit("R2R's annotations are not here")
    data, results = Path("tasks/R2R/data"), Path("tasks/R2R/results")
    results.mkdir(parents=True)
    unpack_task(family / "r2r", data)
    sys.modules |= dict.fromkeys(_TORCH, Nothing()) | {"MatterSim": MatterSim}  # type: ignore[arg-type]
    nx.Graph.node = property(lambda graph: graph.nodes)
    sys.path.insert(0, str(clone / "tasks" / "R2R"))
    env, agent, evaluation = map(import_module, ("env", "agent", "eval"))
    for split in ("val_seen", "val_unseen"):
        batch, evaluator = env.R2RBatch(None, 1, splits=[split]), evaluation.Evaluation([split])
        files = DatasetFiles.find(Path(), split=split, annotations=data, task="r2r")
        truth = GroundTruth.from_bundle(compile_split(files, split))
        for name in AGENTS:
            file = results / f"{split}_{name}.json"
            walker = agent.BaseAgent.get_agent(name)(batch, str(file))
            walker.test()
            walker.write_results()
            summary, _ = evaluator.score(str(file))
            scores = evaluate(file, split=split, ground_truth=truth)
            values = ", ".join(f"{key} {summary[key]:.4f}" for key in _OURS)
            off = max(abs(summary[key] - scores[ours]) for key, ours in _OURS.items())
            yield f"{split} {name}: {values}; ours differ by at most {off:.1e}"
