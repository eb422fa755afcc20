"""How often the true ranks of all methods are within their intervals, on simulated leaderboards.

``python benchmarks/rank_intervals.py [NUMBER]`` prints the shares and how wide the intervals are,
the same on every machine; by default of 1,000 leaderboards of 10 to 30 methods each. It fails if a
share is significantly below 95 %.
"""

import sys
from pathlib import Path
from typing import get_args

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.ranked_worlds import Skills, simulated_coverage

ROWS = (10, 30)
CLUSTERS = (513, 100)
"""The number of targets in val_unseen, and fewer."""
CONFIDENCE = 0.95


def main(number: int = 1000) -> int:
    """Print the shares; return 1 if one is too low."""
    # As few as chance leaves of 95 %, in one of a hundred runs.
    least = CONFIDENCE - 2.33 * (CONFIDENCE * (1 - CONFIDENCE) / number) ** 0.5
    lowest = 1.0
    print("clusters | methods | open: all true ranks within | ranks wide | in one step | private")
    for clusters in CLUSTERS:
        for skills in get_args(Skills):
            shares = simulated_coverage(number, ROWS, clusters, skills)
            lowest = min(lowest, shares.paired, shares.shown)
            print(
                f"{clusters} | {skills} | {shares.paired:.1%} | {shares.ranks:.2f} | "
                f"{shares.ranks_in_one_step:.2f} | {shares.shown:.1%}",
                flush=True,
            )
    return int(lowest < least)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
