"""How often the true ranks of all methods are within their intervals, on simulated leaderboards.

``python benchmarks/rank_intervals.py [NUMBER]`` prints the shares, the same on every machine; by
default of 1,000 leaderboards of 10 to 100 equally good methods, where any significant difference is
an error. It fails if a share is below 95 %.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.ranked_worlds import simulated_coverage

ROWS = (10, 100)
CLUSTERS = (513, 100)
"""The number of targets in val_unseen, and fewer."""
CONFIDENCE = 0.95


def main(number: int = 1000) -> int:
    """Print the shares; return 1 if one is too low."""
    lowest = 1.0
    for clusters in CLUSTERS:
        shares = simulated_coverage(number, ROWS, clusters, "equal")
        lowest = min(lowest, shares.paired, shares.shown)
        print(
            f"{clusters} clusters: all true ranks are within their intervals on "
            f"{shares.paired:.1%} of open and {shares.shown:.1%} of private leaderboards"
        )
    return int(lowest < CONFIDENCE)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
