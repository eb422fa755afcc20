"""How many honest teams the evidence of probing points to, and how many that probe it misses.

``python benchmarks/evidence_of_probing.py [HISTORIES]`` draws histories of 30 submissions, of each
kind as many, on the items and instructions of REVERIE's splits; without the published files, on
those of the demo world. After each third submission from the fifteenth on, the organiser looks at
the p-value. An honest team is a false alarm if it is ever below 0.001; a team that probes is missed
if it never is.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.bars import Figure, judge
from fixtures.answer_histories import HONEST, PROBING
from fixtures.published import published_folder, unpack_dataset
from reverie_eval.analysis import spread_of_changes
from reverie_eval.arrays import IntArray
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle
from reverie_eval.processes import map_in_processes

HISTORIES = 100
SUBMISSIONS = 30
LOOKS = range(15, SUBMISSIONS + 1, 3)
ALARM = 0.001
BARS = {"honest": 1.0, "probing": 10.0}
"""Percent of the histories that may be false alarms; that may be missed."""


def main() -> int:
    """Print the share of wrong ones for each kind of history; return 1 if a bar is missed."""
    histories = int(sys.argv[1]) if len(sys.argv) > 1 else HISTORIES
    figures: list[Figure] = []
    for split, item in episodes_by_split().items():
        for name in (*HONEST, *PROBING):
            jobs = [(name, item, seed) for seed in range(histories)]
            found = list(map_in_processes(is_found, jobs, 2))
            share = 100 * float(np.mean(found))
            if name in HONEST:
                figures.append((f"{split}, {name}: false alarms, %", share, BARS["honest"]))
            else:
                figures.append((f"{split}, {name}: missed, %", 100 - share, BARS["probing"]))
    return judge(figures)


def is_found(job: tuple[str, IntArray, int]) -> bool:
    """Whether the evidence points to a team at any look."""
    name, item, seed = job
    history = {**HONEST, **PROBING}[name]
    answers = history(item, SUBMISSIONS, np.random.default_rng(seed))
    spreads = (spread_of_changes(answers[:look], item) for look in LOOKS)
    return any(spread is not None and spread.p_value < ALARM for spread in spreads)


def episodes_by_split() -> dict[str, IntArray]:
    """Return the item of each episode, by split."""
    published = published_folder()
    if published is None:
        bundle = Bundle.load(DEMO_BUNDLES / "val_unseen.npz")
        return {"demo": bundle.arrays["episode_task"]}
    found = {}
    with TemporaryDirectory() as folder:
        unpack_dataset(published, Path(folder))
        for split in ("val_unseen", "test"):
            files = DatasetFiles.find(Path(folder) / "reverie-v1", split=split)
            found[split] = compile_split(files, split).arrays["episode_task"]
    return found


if __name__ == "__main__":
    sys.exit(main())
