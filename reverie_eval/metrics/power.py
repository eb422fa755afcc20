"""The power of a comparison: the probability that a true difference is found significant.

Two methods answer the same episodes. Their difference in an episode is 1, 0 or -1, as for SR and
RGS, and differences of episodes in one cluster are correlated.

With many clusters, power follows from a formula. With few, it is that of simulated comparisons,
judged as :class:`reverie_eval.analysis.Comparison` judges: by the interval and the test together.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.errors import ProtocolError, naming_missing_parts
from reverie_eval.metrics.engine import CrossedMeans, IntervalEngine, score_interval
from reverie_eval.metrics.uncertainty import CONFIDENCE, RESAMPLES, SEED, randomisation_p

with naming_missing_parts():
    from scipy.optimize import brentq
    from scipy.special import gammaincinv, ndtr, stdtrit

SIGNIFICANCE = 1 - CONFIDENCE
"""The significance level of the two-sided test."""
POWER = 0.8
"""The required power."""
SIMULATED_BELOW = 400
"""The number of clusters below which comparisons are simulated, not computed."""
WORLDS = 10_000
"""Simulated comparisons: in 19 of 20 plans, the share of significant ones is exact to a point."""

# Simulated comparisons in memory at once.
_SIDE_BY_SIDE = 200
# A simulated comparison has at least so many resamples. A real one has 10,000, with which power is
# the same to 0.3 points, unless clusters are so few that p-values are far apart.
_FEWEST_RESAMPLES = 1_000
# A simulated comparison draws about so many clusters, if that gives more resamples; so designs of
# any size take about as long.
_DRAWN_CLUSTERS = 200_000
# Where the distribution of an estimated variance is looked at.
_QUANTILES = (np.arange(20) + 0.5) / 20
_BOUNDS = np.array([[-1.0], [1.0]])
# How far inside its bounds a rate of 0 or 1 is taken to be.
_INSIDE = 1e-9
_RATES = np.array([[0.0, 0.0], [1.0, 1.0]])
_MOST_EPISODES = 10_000_000
_MOST_RUNS = 1_000
# Simulated comparisons where an answer by formula is corrected.
_FEWER_WORLDS = 2_000
_CORRECTIONS = 2
# A difference that is too small to be found.
_EXACT = 1e-6


@dataclass(frozen=True, eq=False)
class Design:
    """What the power of a comparison depends on; rates and effects are fractions.

    Raises
    ------
    ProtocolError
        If something is out of range, infinite or NaN; lists everything that is.
    """

    sizes: IntArray
    """Shape (n_clusters,): the number of episodes in each cluster."""
    discordance: float
    """Share of episodes that one method gets right and the other wrong."""
    correlation: float = 0.0
    """Correlation between the differences of two episodes in a cluster."""
    n_runs: int = 1
    """Runs of each method, whose means are compared. With one, files are compared."""
    run_deviation: float = 0.0
    """Standard deviation of a method's rate between runs; only counts with several."""

    def __post_init__(self) -> None:
        # Every condition is false for NaN.
        wrong = [
            f"{name} is {value:g}, expected {expected}"
            for name, value, is_right, expected in (
                ("the number of clusters", len(self.sizes), len(self.sizes) >= 2, "2 or more"),
                (
                    "the size of a cluster",
                    min(self.sizes, default=1),
                    min(self.sizes, default=1) >= 1,
                    "1 or more",
                ),
                (
                    "discordance",
                    self.discordance,
                    0 < self.discordance <= 1,
                    "more than 0, and at most 1",
                ),
                ("correlation", self.correlation, 0 <= self.correlation <= 1, "0 to 1"),
                ("n_runs", self.n_runs, 1 <= self.n_runs < np.inf, "1 or more"),
                ("run_deviation", self.run_deviation, 0 <= self.run_deviation <= 1, "0 to 1"),
            )
            if not is_right
        ]
        if wrong:
            raise ProtocolError(f"no comparison to plan: {'; '.join(wrong)}")

    @classmethod
    def of(cls, cluster: IntArray, discordance: float, correlation: float = 0.0) -> "Design":
        """Return the design of a split, given the cluster of each episode."""
        _, sizes = np.unique(cluster, return_counts=True)
        return cls(sizes, discordance, correlation)

    @property
    def n_episodes(self) -> int:
        """The number of episodes."""
        return int(self.sizes.sum())

    @property
    def n_clusters(self) -> int:
        """The number of clusters."""
        return len(self.sizes)

    @property
    def size_of_own_cluster(self) -> float:
        """Mean over episodes of the number of episodes in their cluster."""
        return _size_of_own(self.sizes)

    def power(self, effect: float, worlds: int | None = None) -> float:
        """Return the probability that a true difference is significant, in its direction.

        With few clusters, this is its share of simulated worlds, by default ``WORLDS``.

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
        if self.n_clusters >= SIMULATED_BELOW:
            return self.power_by_formula(effect)
        return self._simulate(effect, worlds or WORLDS)

    def smallest_effect(self) -> float | None:
        """Return the smallest difference with ``POWER``; None if no difference has it."""
        largest = self.discordance
        if self.power(largest, _FEWER_WORLDS) < POWER:
            return None
        by_formula = effect = self._effect_of(POWER)
        for _ in range(_CORRECTIONS):
            effect = min(by_formula / self.efficiency(effect), largest)
        return effect

    def episodes_needed(self, effect: float) -> int | None:
        """Return how many such episodes give ``POWER``; None if ten million do not."""
        # Fewer episodes could all be in one cluster, which no test can compare.
        first = int(self.sizes.max()) + 1  # in two clusters, or more

        def find(useful: float) -> int | None:
            return _fewest(range(first, _MOST_EPISODES), partial(self.power_by_formula, useful))

        number = find(effect)
        for _ in range(_CORRECTIONS):
            if number is not None:
                number = find(effect * self.with_episodes(number).efficiency(effect))
        return number

    def runs_needed(self, effect: float) -> int | None:
        """Return how many runs of each method give ``POWER``; None if a thousand do not."""

        def with_runs(number: int) -> Design:
            return replace(self, n_runs=number)

        def find(useful: float) -> int | None:
            tried = range(2, _MOST_RUNS)
            return _fewest(tried, lambda number: with_runs(number).power_by_formula(useful))

        number = find(effect)
        for _ in range(_CORRECTIONS):
            if number is not None:
                number = find(effect * with_runs(number).efficiency(effect))
        return number

    def with_episodes(self, number: int) -> "Design":
        """Return the design of another number of such episodes, with clusters of the same sizes."""
        # Shuffled, so that a design of fewer episodes has a random part of the clusters.
        shuffled = np.random.default_rng(SEED).permutation(self.sizes)
        ends = np.cumsum(np.tile(shuffled, -(-number // self.n_episodes)))
        ends = np.append(ends[ends < number], number)
        return replace(self, sizes=np.diff(ends, prepend=0))

    def efficiency(self, effect: float) -> float:
        """Return the share of an effect whose power by formula is the simulated power of all of it.

        It is 1 where nothing is simulated.
        """
        if self.n_clusters >= SIMULATED_BELOW:
            return 1.0
        return self._effect_of(self._simulate(effect, _FEWER_WORLDS)) / effect

    def _effect_of(self, power: float) -> float:
        """Return the effect that has a power by formula, or the closest."""
        least, largest = _EXACT, self.discordance
        if not self.power_by_formula(least) < power < self.power_by_formula(largest):
            return least if power <= self.power_by_formula(least) else largest
        return float(brentq(lambda effect: self.power_by_formula(effect) - power, least, largest))

    def power_by_formula(self, effect: float, n_episodes: int | None = None) -> float:
        """Return the power by a formula, of this or another number of such episodes.

        The variance of a difference in one episode is ``discordance - effect**2`` [1]_, and that of
        the mean of clustered ones is larger by the design effect [2]_. More runs reduce the
        variance between runs only, which is cautious: they also even out chance within episodes.

        References
        ----------
        .. [1] Connor, "Sample size for testing differences in proportions for the paired-sample
           design", Biometrics 43(1), 1987.
        .. [2] Kish, "Survey Sampling", Wiley 1965, section 5.4.
        """
        own, n_episodes = self.size_of_own_cluster, n_episodes or self.n_episodes
        n_clusters = max(self.n_clusters * n_episodes / self.n_episodes, 2.0)
        design_effect = 1 + self.correlation * (own - 1)
        clusters = (self.discordance - effect**2) * design_effect / n_episodes
        if self.n_runs == 1:
            # Swaps also swap the effect itself, so the test allows for more than this variance.
            allowed = np.sqrt(clusters + effect**2 * own / n_episodes)
            reach = np.asarray(stdtrit(n_clusters - 1, 1 - SIGNIFICANCE / 2) * allowed)
            return _share_above(reach, effect, clusters)
        runs = self.run_deviation**2 / self.n_runs
        # The variance of each method's runs is estimated when methods are compared.
        quantiles = runs * _quantiles_of_variance(self.n_runs - 1)
        estimated = np.stack(np.meshgrid(quantiles, quantiles)).reshape(2, -1)
        compared = CrossedMeans(
            mean=np.full(estimated.shape[1], effect),
            run_variance=estimated,
            run_freedom=np.full((2, 1), self.n_runs - 1.0),
            deviation=np.full((2, estimated.shape[1]), np.sqrt(clusters)),
            cluster_freedom=n_episodes / own - 1,
            noise=np.zeros(estimated.shape[1]),
        )
        reach = compared.critical(SIGNIFICANCE / 2) * np.sqrt(compared.variance)
        return _share_above(reach, effect, clusters + 2 * runs)

    def _simulate(self, effect: float, worlds: int) -> float:
        """Return the share of simulated comparisons in which the difference is significant."""
        rng = np.random.default_rng(SEED)
        cluster = np.repeat(np.arange(self.n_clusters), self.sizes)
        bounds = _BOUNDS.repeat(_SIDE_BY_SIDE, axis=1)
        resamples = _DRAWN_CLUSTERS // self.n_clusters
        resamples = min(max(resamples, _FEWEST_RESAMPLES), RESAMPLES)
        significant = 0
        for seed in range(worlds // _SIDE_BY_SIDE):
            difference = self._draw(effect, rng)[cluster]
            if self.n_runs == 1:
                engine = IntervalEngine(resamples=resamples, seed=seed)
                low, _ = engine.of_means(difference, cluster, bounds).ends
                p_value = randomisation_p(difference, cluster, resamples=resamples, seed=seed)
                is_better = low > 0
            else:
                compared = self._add_runs(CrossedMeans.of(difference[None], cluster), rng)
                p_value, is_better = compared.p_value(bounds), compared.mean > 0
            significant += int((is_better & (p_value < SIGNIFICANCE)).sum())
        return significant / worlds

    def _draw(self, effect: float, rng: np.random.Generator) -> FloatArray:
        """Draw how much methods differ in each cluster, shape (n_clusters, _SIDE_BY_SIDE)."""
        win, loss = (self.discordance + effect) / 2, (self.discordance - effect) / 2
        chances = [win, loss, max(1 - win - loss, 0.0)]
        shape = (_SIDE_BY_SIDE, self.n_clusters)
        # Two episodes of a cluster both take what is shared as often as they are correlated.
        shared = rng.multinomial(1, chances, shape)
        n_shared = rng.binomial(self.sizes, np.sqrt(self.correlation), shape)
        outcomes = rng.multinomial(self.sizes - n_shared, chances) + n_shared[..., None] * shared
        difference: FloatArray = (outcomes[..., 0] - outcomes[..., 1]) / self.sizes
        return difference.T

    def _add_runs(self, compared: CrossedMeans, rng: np.random.Generator) -> CrossedMeans:
        """Add several runs of each method to differences of methods."""
        shape = (2, self.n_runs, len(compared.mean))
        runs = rng.normal(0, self.run_deviation, shape)
        first, other = runs.mean(axis=1)
        return replace(
            compared,
            mean=compared.mean + first - other,
            run_variance=runs.var(axis=1, ddof=1) / self.n_runs,
            run_freedom=np.full((2, 1), self.n_runs - 1.0),
        )


@dataclass(frozen=True, eq=False)
class PublishedDesign:
    """What the power of a comparison with a published rate depends on; all rates are fractions.

    The published rate is over all episodes of a split, and its results are not known, so that they
    cannot be paired; see :mod:`reverie_eval.metrics.published`.

    Raises
    ------
    ProtocolError
        If the published rate or the correlation is out of range, or NaN.
    """

    sizes: IntArray
    """Shape (n_clusters,): the number of our episodes in each cluster."""
    of_split: IntArray
    """Shape (n_clusters_of_split,): the number of the split's episodes in each cluster."""
    published: float
    correlation: float
    """Correlation between the results of two episodes in a cluster."""

    def __post_init__(self) -> None:
        for name, value in (("rate", self.published), ("correlation", self.correlation)):
            if not 0 <= value <= 1:
                raise ProtocolError(f"the {name} is {value:g}, expected 0 to 1")

    @property
    def n_episodes(self) -> int:
        """The number of our episodes."""
        return int(self.sizes.sum())

    @property
    def n_clusters(self) -> int:
        """The number of clusters of our episodes."""
        return len(self.sizes)

    def power(self, effect: float, n_episodes: int | None = None) -> float:
        """Return the probability that a rate higher by a true difference is significantly higher.

        ``n_episodes`` plans another number of such episodes. Both rates vary by chance: their
        variances are ``p (1 - p) / n`` times the design effect of their clusters.

        Raises
        ------
        ProtocolError
            If no rate is higher than the published one by so much.
        """
        if not 0 < effect <= 1 - self.published:
            raise ProtocolError(
                f"an effect of {effect:g} is impossible: no rate is higher than "
                f"{self.published:g} by so much"
            )
        # Of ours and theirs. At a bound, a rate would not vary at all.
        rates = np.clip([self.published + effect, self.published], _INSIDE, 1 - _INSIDE)
        n_split = int(self.of_split.sum())
        variance = np.array(
            [
                self._variance(self.sizes, rates[0], n_episodes or self.n_episodes),
                self._variance(self.of_split, rates[1], n_split),
            ]
        )
        freedom = np.maximum([self.n_clusters - 1, len(self.of_split) - 1], 1)
        half = stdtrit(freedom, 1 - SIGNIFICANCE / 2) * np.sqrt(variance)
        low, high = score_interval(rates, half, _RATES)
        reach = np.hypot(rates[0] - low[0], high[1] - rates[1])
        return _share_above(reach, effect, float(variance.sum()))

    def smallest_effect(self) -> float | None:
        """Return the smallest difference with ``POWER``; None if no difference has it."""
        least, largest = _EXACT, 1 - self.published
        if largest <= least or self.power(largest) < POWER:
            return None
        return float(brentq(lambda effect: self.power(effect) - POWER, least, largest))

    def episodes_needed(self, effect: float) -> int | None:
        """Return how many such episodes give ``POWER``; None if ten million do not."""
        return _fewest(range(2, _MOST_EPISODES), partial(self.power, effect))

    def _variance(self, sizes: IntArray, rate: float, n_episodes: int) -> float:
        design_effect = 1 + self.correlation * (_size_of_own(sizes) - 1)
        return rate * (1 - rate) * design_effect / n_episodes


def _size_of_own(sizes: IntArray) -> float:
    """Return the mean over episodes of the number of episodes in their cluster."""
    return float((sizes.astype(np.float64) ** 2).sum() / sizes.sum())


def _fewest(tried: range, power: Callable[[int], float]) -> int | None:
    """Return the first number with ``POWER``; None if none has it."""
    index = bisect_left(tried, POWER, key=power)
    return tried[index] if index < len(tried) else None


def _share_above(reach: FloatArray, effect: float, variance: float) -> float:
    """Return how often a normal estimate of the effect is beyond the reach of chance."""
    if variance == 0:
        return 1.0
    return float(ndtr((effect - reach) / np.sqrt(variance)).mean())


def _quantiles_of_variance(freedom: float) -> FloatArray:
    """Return how estimates of a variance of 1 are distributed: chi-squared over its freedom."""
    return np.asarray(2 * gammaincinv(freedom / 2, _QUANTILES) / freedom)
