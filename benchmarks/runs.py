"""How often intervals over several runs of a method contain the truth, in simulated worlds.

``python benchmarks/runs.py`` prints the shares, the same on every machine, in about two minutes.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.clustered_worlds import simulated_runs

WORLDS = 1000
TARGETS = 513
"""The number of targets in val_unseen."""
SCANS = 10
"""And of its scans."""


def main() -> None:
    """Print the shares."""
    for clusters in (TARGETS, SCANS):
        for runs in (3, 5, 10):
            for run_spread in (0.0, 0.05, 0.2):
                shares = simulated_runs(WORLDS, runs, clusters, run_spread)
                print(
                    f"{clusters} clusters, {runs} runs, log odds differ by {run_spread} between "
                    f"runs: 95 % intervals of means hold in {shares.held:.1%}, of differences in "
                    f"{shares.held_difference:.1%}"
                )


if __name__ == "__main__":
    main()
