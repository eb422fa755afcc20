"""How often intervals contain the truth, and tests give false alarms, in simulated worlds.

``python benchmarks/uncertainty.py`` prints the shares, the same on every machine.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.clustered_worlds import (
    TRUTH,
    simulated_against,
    simulated_coverage,
    simulated_false_alarms,
)

TARGETS = 513
"""The number of targets in val_unseen."""
SPLIT = 3521
"""The number of its episodes."""


def main() -> None:
    """Print the shares."""
    for clusters in (100, 10, 5, 4, 3, 2):
        print_coverage(clusters, TRUTH)
    for truth in (0.05, 0.01, 0.005):
        print_coverage(TARGETS, truth)
    for part, published_part in ((216, 3521), (500, 3521), (500, 500), (3521, 500), (3521, 3521)):
        print_against(part, published_part)
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


def print_against(episodes: int, published: int) -> None:
    """Print how often intervals of a difference from a published mean contain the true one."""
    for name, rate in (("unrelated", 0.5), ("unrelated, 10 %", 0.1), ("related", None)):
        shares = simulated_against(1000, TARGETS, episodes / SPLIT, published / SPLIT, rate)
        on_split = "" if episodes == published == SPLIT else f"; {shares.on_split:.1%} on the split"
        print(
            f"95 % intervals that contain the difference of {episodes:,} episodes from a mean over "
            f"{published:,} of a method that is {name}: {shares.beyond:.1%}{on_split}"
        )


if __name__ == "__main__":
    main()
