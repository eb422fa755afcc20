"""How well ``reverie-eval plan`` predicts which differences are found significant.

``python benchmarks/power.py`` prints the planned power beside that of 4,000 simulated comparisons,
the same on every machine, in about half an hour. It fails if they differ by more than two points.

``python benchmarks/power.py BUNDLE FILE FILE`` prints what two results have for a plan: how many
episodes they disagree in, and the correlations of results, and of differences, within targets.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import reverie_eval as rv
from fixtures.clustered_worlds import (
    simulated_power,
    simulated_power_against,
    simulated_power_of_runs,
)
from reverie_eval.arrays import FloatArray
from reverie_eval.metrics.published import ResultSpread
from reverie_eval.scoring import clusters_of

WORLDS = 4000
DESIGNS = (
    # clusters, episodes in the largest, effect, discordance, correlation
    (30, 6, 0.16, 0.4, 0.0),
    (60, 6, 0.1, 0.3, 0.1),
    (170, 2, 0.1, 0.3, 0.0),
    (230, 3, 0.07, 0.3, 0.1),
    (300, 8, 0.036, 0.3, 0.0),
    (300, 8, 0.04, 0.3, 0.1),
    (513, 12, 0.035, 0.5, 0.0),
    (513, 12, 0.02, 0.2, 0.0),
    (513, 12, 0.02, 0.2, 0.1),
    (513, 12, 0.03, 0.2, 0.1),
)
"""From a few clusters to the targets of val_unseen."""
DESIGNS_OF_RUNS = (
    (100, 0.06, 3),
    (100, 0.06, 5),
    (513, 0.03, 3),
    (513, 0.025, 5),
    (513, 0.025, 10),
)
"""Clusters, effect, runs of each method."""
DESIGNS_AGAINST = (
    (100, 0.4, 0.15, 0.3),
    (500, 0.4, 0.06, 0.1),
    (500, 0.1, 0.05, 0.3),
)
"""Clusters of the split, published rate, effect, correlation."""
ALLOWED = 0.02


def print_spread(bundle: str, files: list[str]) -> None:
    """Print what results have for a plan, of SR and RGS."""
    truth = rv.GroundTruth.load(bundle)
    first, other = (rv.evaluate(file, split=truth.split, ground_truth=truth) for file in files)
    cluster = clusters_of(truth, "target")

    def correlation(values: FloatArray) -> float:
        spread = ResultSpread.of(
            values[None, :, None], cluster, np.unique(cluster, return_counts=True)[1]
        )
        return float(spread.correlation[0])

    for key in ("success", "rgs"):
        one, two = (each.episodes[key].astype(np.float64) for each in (first, other))
        print(
            f"{key}: discordance {(one != two).mean():.1%}, correlation of differences "
            f"{correlation(one - two):.2f}, of results {correlation(one):.2f} and "
            f"{correlation(two):.2f}"
        )


def main() -> int:
    """Print planned and simulated power; return 1 if they differ by too much."""
    if len(sys.argv) > 1:
        print_spread(sys.argv[1], sys.argv[2:])
        return 0
    print("clusters | episodes in one | effect | discordance | correlation | planned | simulated")
    worst = 0.0
    for clusters, largest, effect, discordance, correlation in DESIGNS:
        planned, simulated = simulated_power(
            WORLDS, clusters, effect, discordance, correlation, largest=largest
        )
        worst = max(worst, abs(planned - simulated))
        print(
            f"{clusters} | 1 to {largest} | {effect:.1%} | {discordance:.0%} | {correlation} | "
            f"{planned:.1%} | {simulated:.1%}",
            flush=True,
        )
    print("clusters | effect | runs | planned | simulated")
    for clusters, effect, n_runs in DESIGNS_OF_RUNS:
        planned, simulated = simulated_power_of_runs(WORLDS, clusters, effect, n_runs)
        worst = max(worst, abs(planned - simulated))
        print(f"{clusters} | {effect:.1%} | {n_runs} | {planned:.1%} | {simulated:.1%}", flush=True)
    print("clusters | published | effect | correlation | planned | simulated")
    for clusters, published, effect, correlation in DESIGNS_AGAINST:
        planned, simulated = simulated_power_against(
            WORLDS, clusters, published, effect, correlation
        )
        worst = max(worst, abs(planned - simulated))
        print(
            f"{clusters} | {published:.0%} | {effect:.1%} | {correlation} | {planned:.1%} | "
            f"{simulated:.1%}",
            flush=True,
        )
    return int(worst > ALLOWED)


if __name__ == "__main__":
    sys.exit(main())
