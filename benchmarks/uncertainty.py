"""How often intervals contain the truth, and tests give false alarms, in simulated worlds.

``python benchmarks/uncertainty.py`` prints the shares, the same on every machine.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.clustered_worlds import TRUTH, simulated_coverage, simulated_false_alarms

TARGETS = 513
"""The number of targets in val_unseen."""


def main() -> None:
    """Print the shares."""
    for clusters in (100, 10, 5, 4, 3, 2):
        print_coverage(clusters, TRUTH)
    for truth in (0.05, 0.01, 0.005):
        print_coverage(TARGETS, truth)
    alarms = simulated_false_alarms(4000, 100)
    print(
        f"false alarms at 5 %, 4,000 worlds of 100 clusters: {alarms.clustered:.1%}; "
        f"McNemar's test: {alarms.naive:.1%}"
    )


def print_coverage(clusters: int, truth: float) -> None:
    """Print how often intervals contain the truth, with and without regard to clusters."""
    coverage = simulated_coverage(1000, clusters, truth)
    print(
        f"95 % intervals that contain the truth, {truth:.1%} of episodes, in 1,000 worlds of "
        f"{clusters} clusters: {coverage.clustered:.1%}; "
        f"mean +- 1.96 standard errors: {coverage.naive:.1%}"
    )


if __name__ == "__main__":
    main()
