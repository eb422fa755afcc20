"""How well ``reverie-eval plan`` predicts which differences are found significant.

``python benchmarks/power.py`` prints the predicted power beside that of simulated comparisons, the
same on every machine, in about two minutes of processor time.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.clustered_worlds import simulated_power, simulated_power_of_runs

WORLDS = 4000
TARGETS = 513
"""The number of targets in val_unseen."""


def main() -> None:
    """Print predicted and simulated power."""
    for effect, discordance, correlation in (
        (0.035, 0.5, 0.0),
        (0.02, 0.2, 0.0),
        (0.02, 0.2, 0.1),
        (0.03, 0.2, 0.1),
    ):
        predicted, simulated = simulated_power(WORLDS, TARGETS, effect, discordance, correlation)
        print(
            f"effect {effect:.1%}, discordance {discordance:.0%}, correlation {correlation}: "
            f"predicted {predicted:.1%}, simulated {simulated:.1%}"
        )
    for effect, n_runs in ((0.03, 3), (0.025, 5), (0.025, 10)):
        predicted, simulated = simulated_power_of_runs(WORLDS, TARGETS, effect, n_runs)
        print(
            f"effect {effect:.1%}, {n_runs} runs: predicted {predicted:.1%}, "
            f"simulated {simulated:.1%}"
        )


if __name__ == "__main__":
    main()
