"""Success against cost: what a budget buys, and which of several runs no other one beats.

Episodes differ in what they cost as they do in how they end, so both are resampled together, by
whole clusters.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from reverie_eval.arrays import ROUNDING, BoolArray, FloatArray
from reverie_eval.errors import ProtocolError, naming_missing_parts
from reverie_eval.logs import COSTS, cost_name
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.scoring import (
    Clustering,
    Interval,
    Intervals,
    Scored,
    Scores,
    clusters_of,
    shared_keys,
)
from reverie_eval.text import count_text, did_you_mean

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from reverie_eval.metrics.engine import IntervalEngine

# More would not be seen in a chart of 400 pixels.
_MOST_BUDGETS = 100
# The cost that is shown if none is chosen: the first that is known and not 0. Seconds are not among
# them, because they are those of a machine.
_CHOSEN = ("money", "input_tokens", "actions")


class CostDifference(NamedTuple):
    """What an episode cost on average, in the first submission and in another one."""

    first: float
    value: float
    mean: float
    """How much more it is than the first."""
    interval: Interval


class FrontPoint(NamedTuple):
    """A run's mean cost and score, and whether no other run is as good in both, better in one."""

    cost: float
    score: float
    is_on_front: bool
    share: float
    """The share of resamples of whole clusters in which the run is on the front."""


@dataclass(frozen=True, eq=False, repr=False)
class Front(Mapping[str, FrontPoint]):
    """The Pareto front of several runs, by their names: what each cost and scored."""

    cost: str
    """A key of :data:`reverie_eval.logs.COSTS`."""
    metric: Metric
    points: Mapping[str, FrontPoint]

    def __getitem__(self, name: str) -> FrontPoint:
        return self.points[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.points)

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        """Say how surely each run is on the front, the surest first."""
        ordered = sorted(self.items(), key=lambda each: -each[1].share)
        shares = (f"{name} in {100 * point.share:.0f} %" for name, point in ordered)
        what = f"{self.metric.label} and {cost_name(self.cost)}"
        return f"on the Pareto front of {what}: {', '.join(shares)} of resamples"


@dataclass(frozen=True, eq=False)
class BudgetCurve:
    """The share of episodes that were solved within a budget; arrays of shape (n_budgets,)."""

    cost: str
    """A key of :data:`reverie_eval.logs.COSTS`."""
    metric: Metric
    """What a solved episode is."""
    budget: FloatArray
    """Ascending, in the unit of the cost: at each the share rises, or every episode has ended."""
    share: FloatArray
    """The share of all episodes that were solved at a cost of at most the budget."""
    low: FloatArray
    """The lower end of its confidence interval, which is one of this budget alone."""
    high: FloatArray
    label: str
    """The confidence: ``95 %``."""

    def to_pandas(self) -> "pd.DataFrame":
        """Return a row per budget with the share and the ends of its interval."""
        with naming_missing_parts():
            import pandas as pd

        columns = {"share": self.share, "low": self.low, "high": self.high}
        return pd.DataFrame(columns, index=pd.Index(self.budget, name=self.cost))

    # A convenience by what is above this package; the import contract lists it.

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the curve; :func:`reverie_eval.reporting.plot_budgets` draws several."""
        from reverie_eval.reporting.figures import plot_budgets

        return plot_budgets({"": self}, ax)


def success_within(
    scores: Scores,
    cost: str | None = None,
    metric: str | None = None,
    cluster: Clustering = "target",
    *,
    confidence: float | None = None,
) -> BudgetCurve:
    """Return what share of the episodes is solved in a budget; see :meth:`Scores.success_within`.

    An episode that is solved at exactly the budget is within it.
    """
    # Importing scipy would double the start-up time of commands that show no intervals.
    from reverie_eval.metrics.engine import IntervalEngine

    key, solving = _shared_cost(logged({"": scores}), cost), _solving({"": scores}, metric)
    Intervals.check_possible(scores.ground_truth, cluster)
    spent, is_solved = scores.costs[key], scores.episodes[solving.key] > 0
    levels = np.unique(spent[is_solved])
    if len(levels) > _MOST_BUDGETS:
        levels = np.quantile(levels, np.linspace(0, 1, _MOST_BUDGETS), method="nearest")
    budget = np.unique([*levels, spent.max()])
    within = (is_solved[:, None] & (spent[:, None] <= budget)).astype(np.float64)
    engine = IntervalEngine.of(confidence)
    bounds = np.repeat([[0.0], [1.0]], len(budget), axis=1)
    ends, _ = engine.of_means(within, clusters_of(scores.ground_truth, cluster), bounds)
    label = f"{100 * engine.confidence:g} %"
    low, high = ends
    return BudgetCurve(key, solving, budget, within.mean(axis=0), low, high, label)


def pareto_front(
    scores: Mapping[str, Scored],
    cost: str | None,
    metric: str | None,
    cluster: Clustering,
    engine: "IntervalEngine",
) -> Front:
    """Return each run's cost and score, and how surely it is on the Pareto front of all of them.

    Parameters are those of :meth:`Comparison.front`.
    """
    from reverie_eval.metrics.uncertainty import bootstrap_means

    runs = logged(scores)
    key, solving = _shared_cost(runs, cost), _solving(runs, metric)
    spent = np.column_stack([each.costs[key] for each in runs.values()])
    # Lower is better in both.
    missed = np.column_stack([-each.episodes[solving.key] for each in runs.values()])
    row_cluster = clusters_of(next(iter(runs.values())).ground_truth, cluster)
    resampled = bootstrap_means(
        np.hstack([spent, missed]), row_cluster, resamples=engine.resamples, seed=engine.seed
    )
    shares = is_on_front(*np.split(resampled, 2, axis=1)).mean(axis=0)
    means = spent.mean(axis=0), missed.mean(axis=0)
    rows = zip(runs, *means, is_on_front(*means), shares, strict=True)
    points = {
        name: FrontPoint(float(mean), -float(miss), bool(is_on), float(share))
        for name, mean, miss, is_on, share in rows
    }
    return Front(key, solving, points)


def is_on_front(x: FloatArray, y: FloatArray) -> BoolArray:
    """Return whether no other point is as good in both and better in one; lower is better.

    Parameters
    ----------
    x, y : arrays, shape (..., n_points)

    Examples
    --------
    >>> is_on_front(np.array([1, 2, 3, 3]), np.array([5, 2, 4, 1])).tolist()
    [True, True, False, True]
    """
    slack_x, slack_y = (ROUNDING * np.abs(each).max(initial=0) for each in (x, y))
    is_beaten = np.zeros(x.shape, bool)
    for other in range(x.shape[-1]):
        saved, gained = x - x[..., other, None], y - y[..., other, None]
        is_as_good = (saved >= -slack_x) & (gained >= -slack_y)
        is_beaten |= is_as_good & ((saved > slack_x) | (gained > slack_y))
    return ~is_beaten


def cost_differences(
    scores: Mapping[str, Scored], cluster: Clustering, engine: "IntervalEngine"
) -> Mapping[str, Mapping[str, CostDifference]]:
    """Return how the costs of submissions differ from the first's, by name and cost.

    Those that are unknown for an episode of either are left out, and so are several runs.
    """
    baseline, *_ = scores
    runs = logged(scores)
    if baseline not in runs:
        return {}
    first = runs[baseline]
    changes = {
        (name, key): run.costs[key] - first.costs[key]
        for name, run in runs.items()
        if name != baseline
        for key in COSTS
    }
    known = {at: change for at, change in changes.items() if not np.isnan(change).any()}
    if not known:
        return {}
    table = np.column_stack(list(known.values()))
    bounds = np.repeat([[-np.inf], [np.inf]], len(known), axis=1)
    ends, _ = engine.of_means(table, clusters_of(first.ground_truth, cluster), bounds)
    found: dict[str, dict[str, CostDifference]] = {}
    rows = zip(known, table.mean(axis=0).tolist(), map(Interval, *ends.tolist()), strict=True)
    for (name, key), mean, interval in rows:
        before, after = (float(run.costs[key].mean()) for run in (first, runs[name]))
        found.setdefault(name, {})[key] = CostDifference(before, after, mean, interval)
    return found


def logged(scores: Mapping[str, Scored]) -> Mapping[str, Scores]:
    """Return the single runs that have a log."""
    return {name: each for name, each in scores.items() if isinstance(each, Scores) and each.costs}


def _shared_cost(runs: Mapping[str, Scores], cost: str | None) -> str:
    """Return the cost to compare runs by, which is known for all of their episodes."""
    if not runs:
        raise ProtocolError("no log of a run says what this cost; scores.with_run(FOLDER) reads it")
    if cost not in (None, *COSTS):
        raise ProtocolError(f"there is no cost {cost!r}{did_you_mean(str(cost), COSTS)}")
    every = {key: np.concatenate([each.costs[key] for each in runs.values()]) for key in COSTS}
    usable = [key for key in _CHOSEN if np.nan_to_num(every[key]).any()]
    known = [key for key in usable if not np.isnan(every[key]).any()]
    chosen = cost or [*known, "actions"][0]
    if missing := int(np.isnan(every[chosen]).sum()):
        episodes = count_text(missing, "episode")
        raise ProtocolError(f"{cost_name(chosen)}: unknown for {episodes}; choose another cost")
    return chosen


def _solving(runs: Mapping[str, Scores], metric: str | None) -> Metric:
    """Return the metric of solved episodes: the given one, or else success, or RGS."""
    binary = [key for key in shared_keys(runs.values()) if CATALOGUE[key].is_binary]
    if metric is None:
        return CATALOGUE[binary[0]]
    if metric not in binary:
        known = did_you_mean(metric, binary)
        raise ProtocolError(f"{metric!r} is not yes or no for each episode{known}")
    return CATALOGUE[metric]
