"""How often intervals over several runs of a method contain the truth, in simulated worlds.

``python benchmarks/runs.py`` prints the shares, the same on every machine, in about ten minutes. It
fails if a share of the intervals of means is not 93 to 97 %, give or take a point.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.clustered_worlds import simulated_runs

WORLDS = 2000
CLUSTERS = (513, 100)
"""The number of targets in val_unseen, and fewer."""
RUN_SPREADS = (0.0, 0.05, 0.2)
"""How much the log odds of success differ between runs: by 0, 0.8 and 3.3 points of the rate."""
LOG_ODDS = {"58 %": 0.5, "7 %": -3.5}
"""By the rate of success to which they lead."""
ALLOWED = (0.93, 0.97)
CHANCE = 0.01
"""How far a share of so many worlds may be off by chance."""


def main() -> int:
    """Print the shares; return 1 if one is outside of the allowed range."""
    print("rate | clusters | runs | log odds differ by | means | differences | width in points")
    are_allowed = []
    for rate, log_odds in LOG_ODDS.items():
        for clusters in CLUSTERS:
            for runs in (2, 3, 5, 10):
                for run_spread in RUN_SPREADS:
                    shares = simulated_runs(WORLDS, runs, clusters, run_spread, log_odds)
                    print(
                        f"{rate} | {clusters} | {runs} | {run_spread} | {shares.held:.1%} | "
                        f"{shares.held_difference:.1%} | {100 * shares.width:.1f}",
                        flush=True,
                    )
                    is_allowed = ALLOWED[0] - CHANCE <= shares.held <= ALLOWED[1] + CHANCE
                    are_allowed.append(is_allowed)
    return int(not all(are_allowed))


if __name__ == "__main__":
    sys.exit(main())
