"""How often intervals hold the truth and tests are alarmed for nothing, in simulated worlds.

``python benchmarks/uncertainty.py`` prints the shares, the same on every machine.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.clustered_worlds import simulated_coverage, simulated_false_alarms


def main() -> None:
    """Print the shares."""
    for clusters in (100, 10):
        coverage = simulated_coverage(1000, clusters)
        print(
            f"95 % intervals that hold the truth, 1,000 worlds of {clusters} clusters: "
            f"{coverage.clustered:.1%}; mean +- 1.96 standard errors: {coverage.naive:.1%}"
        )
    alarms = simulated_false_alarms(4000, 100)
    print(
        f"false alarms at 5 %, 4,000 worlds of 100 clusters: {alarms.clustered:.1%}; "
        f"McNemar's test: {alarms.naive:.1%}"
    )


if __name__ == "__main__":
    main()
