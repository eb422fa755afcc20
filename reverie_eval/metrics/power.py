"""The power of a comparison: the probability that a true difference is found significant.

Two methods answer the same episodes. Their difference in an episode is 1, 0 or -1, as for SR and
RGS, and differences of episodes in one cluster are correlated.
"""

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaincinv, ndtr, stdtrit

from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.errors import ProtocolError

SIGNIFICANCE = 0.05
"""The significance level of the two-sided test."""
POWER = 0.8
"""The required power."""

_QUANTILES = (np.arange(20) + 0.5) / 20
"""Where the distribution of an estimated variance is looked at."""
_MOST_EPISODES = 10_000_000
_MOST_RUNS = 1_000


@dataclass(frozen=True)
class Design:
    """What the power of a comparison depends on; rates and effects are fractions.

    Raises
    ------
    ProtocolError
        If something is out of range, infinite or NaN; lists everything that is.
    """

    n_episodes: float
    n_clusters: float
    size_of_own_cluster: float
    """Mean over episodes of the number of episodes in their cluster."""
    discordance: float
    """Share of episodes that one method gets right and the other wrong."""
    correlation: float = 0.0
    """Correlation between the differences of two episodes in a cluster."""
    n_runs: int = 1
    """Runs of each method, whose means are compared."""
    run_deviation: float = 0.0
    """Standard deviation of a method's rate between runs."""

    def __post_init__(self) -> None:
        # Every condition is false for NaN.
        wrong = [
            f"{name} is {getattr(self, name):g}, expected {expected}"
            for name, is_right, expected in (
                ("n_episodes", 2 <= self.n_episodes < np.inf, "2 or more"),
                ("n_clusters", 2 <= self.n_clusters < np.inf, "2 or more"),
                ("size_of_own_cluster", 1 <= self.size_of_own_cluster < np.inf, "1 or more"),
                ("discordance", 0 < self.discordance <= 1, "more than 0, and at most 1"),
                ("correlation", 0 <= self.correlation <= 1, "0 to 1"),
                ("n_runs", 1 <= self.n_runs < np.inf, "1 or more"),
                ("run_deviation", 0 <= self.run_deviation <= 1, "0 to 1"),
            )
            if not is_right
        ]
        if wrong:
            raise ProtocolError(f"no comparison to plan: {'; '.join(wrong)}")

    @classmethod
    def of(cls, cluster: IntArray, discordance: float, correlation: float = 0.0) -> "Design":
        """Return the design of a split, given the cluster of each episode."""
        _, sizes = np.unique(cluster, return_counts=True)
        own = float((sizes**2).sum() / sizes.sum())
        return cls(len(cluster), len(sizes), own, discordance, correlation)

    def power(self, effect: float) -> float:
        """Return the probability that a true difference is significant, in its direction.

        Student's t with Satterthwaite's degrees of freedom. The variance of a difference in one
        episode is ``discordance - effect**2`` [1]_, and that of the mean of clustered ones is
        larger by the design effect [2]_. More runs reduce the variance between runs only, which
        is cautious: they also even out chance within episodes.

        References
        ----------
        .. [1] Connor, "Sample size for testing differences in proportions for the paired-sample
           design", Biometrics 43(1), 1987.
        .. [2] Kish, "Survey Sampling", Wiley 1965, section 5.4.

        Raises
        ------
        ProtocolError
            If the effect is larger than the discordance, which no difference can be, or NaN.
        """
        if not abs(effect) <= self.discordance:
            raise ProtocolError(
                f"an effect of {effect:g} is impossible: methods that disagree in "
                f"{self.discordance:g} of the episodes cannot differ by more"
            )
        design_effect = 1 + self.correlation * (self.size_of_own_cluster - 1)
        clusters = (self.discordance - effect**2) * design_effect / self.n_episodes
        runs = self.run_deviation**2 / self.n_runs
        variance = clusters + 2 * runs
        if variance == 0:
            return 1.0
        # Variances are estimated when methods are compared: each of the three has its own chance.
        parts = [(clusters, self.n_clusters - 1)]
        if runs:
            parts += [(runs, self.n_runs - 1.0)] * 2
        estimates = np.meshgrid(*(part * _quantiles_of_variance(free) for part, free in parts))
        found = sum(estimates)
        squares = sum(part**2 / free for part, (_, free) in zip(estimates, parts, strict=True))
        critical = stdtrit(np.square(found) / squares, 1 - SIGNIFICANCE / 2)
        return float(ndtr((effect - critical * np.sqrt(found)) / np.sqrt(variance)).mean())

    def smallest_effect(self) -> float | None:
        """Return the smallest difference with ``POWER``; None if no difference has it."""
        largest = self.discordance
        if self.power(largest) < POWER:
            return None
        return float(brentq(lambda effect: self.power(effect) - POWER, 0.0, largest))

    def episodes_needed(self, effect: float) -> int | None:
        """Return how many such episodes give ``POWER``; None if ten million do not."""

        def power(n_episodes: int) -> float:
            n_clusters = max(n_episodes * self.n_clusters / self.n_episodes, 2.0)
            return replace(self, n_episodes=n_episodes, n_clusters=n_clusters).power(effect)

        number = bisect_left(range(2, _MOST_EPISODES), POWER, key=power)
        return None if number == _MOST_EPISODES - 2 else number + 2

    def runs_needed(self, effect: float) -> int | None:
        """Return how many runs of each method give ``POWER``; None if a thousand do not."""
        tried = range(2, _MOST_RUNS)
        number = bisect_left(tried, POWER, key=lambda n: replace(self, n_runs=n).power(effect))
        return None if number == len(tried) else tried[number]


def _quantiles_of_variance(freedom: float) -> FloatArray:
    """Return how estimates of a variance of 1 are distributed: chi-squared over its freedom."""
    return np.asarray(2 * gammaincinv(freedom / 2, _QUANTILES) / freedom)
