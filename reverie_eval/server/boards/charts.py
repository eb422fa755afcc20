"""Data of charts: one metric against another, and the best result over time."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from math import isfinite
from operator import itemgetter
from typing import Any

import numpy as np

from reverie_eval.analysis import is_on_front
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.schemas.service import SubmissionReport
from reverie_eval.server.boards.entries import Row
from reverie_eval.server.boards.leaderboard import Ranking


def chart_of(ranking: Ranking, rows: Sequence[Row], x: str, y: str) -> Mapping[str, Any]:
    """Return the data of a leaderboard's charts, in columns.

    ``points`` are the results scored here that have both metrics, and ``front`` the indices of
    their Pareto front, the best by ``x`` first; empty if a metric has no better direction.
    ``reported`` are the reported results, and ``lines`` are for comparison: the best human result,
    and the best reported result of a method that is not a reference. ``progress`` contains the
    results that were better than all earlier ones by the metric of the ranking, in the order of
    publication.
    """
    scored = [row for row in rows if row.entry.is_ranked]
    reported = [row for row in rows if row.entry.standing == "reported"]
    points = _points(ranking, scored, x, y)
    is_ordered = "neither" not in {CATALOGUE[key].better for key in (x, y)}
    return {
        "x": _axis(CATALOGUE[x]),
        "y": _axis(CATALOGUE[y]),
        "points": points,
        "front": _front(points, x, y) if is_ordered else [],
        "reported": _points(ranking, reported, x, y),
        "lines": _lines(scored, reported, CATALOGUE[y]),
        "progress": _progress(ranking, scored),
    }


def _points(ranking: Ranking, rows: Sequence[Row], x: str, y: str) -> Mapping[str, Any]:
    """Return the rows that have both metrics."""
    shown = [row for row in rows if x in row.entry.scores and y in row.entry.scores]
    across, up = (_displayed(CATALOGUE[key], [row.entry.scores for row in shown]) for key in (x, y))
    return {"x": across, "y": up, **_about(ranking, shown)}


def _front(points: Mapping[str, Any], x: str, y: str) -> Sequence[int]:
    return front(_costs(CATALOGUE[x], points["x"]), _costs(CATALOGUE[y], points["y"]))


def _lines(
    scored: Sequence[Row], reported: Sequence[Row], metric: Metric
) -> Sequence[Mapping[str, Any]]:
    """Return values to compare with: the best human result, and the best reported one."""
    if metric.better == "neither":
        return []
    people = [row for row in (*scored, *reported) if row.entry.method.get("human")]
    marked = ("human", "reference")
    methods = [row for row in reported if not any(map(row.entry.method.get, marked))]
    lines = []
    for name, rows in (("Human", people), ("Best reported", methods)):
        scores = [row.entry.scores for row in rows if metric.key in row.entry.scores]
        values = _displayed(metric, scores)
        if values:
            best = max(values) if metric.better == "higher" else min(values)
            lines.append({"name": name, "y": best})
    return lines


def _progress(ranking: Ranking, rows: Sequence[Row]) -> Mapping[str, Any]:
    metric = CATALOGUE[ranking.metric]
    scored = [row for row in rows if metric.key in row.entry.scores]
    published = [row.entry.published_at for row in scored]
    values = _displayed(metric, [row.entry.scores for row in scored])
    best = records(published, _costs(metric, values))
    rows = [scored[place] for place in best]
    return {
        "y": _axis(metric),
        "points": {
            "y": [values[place] for place in best],
            "at": [_milliseconds(published[place]) for place in best],
            **_about(ranking, rows),
        },
        "best": [*range(len(rows))],
        "until": _milliseconds(ranking.now),
    }


def progress_of(
    submissions: Sequence[SubmissionReport], metric: Metric, now: datetime
) -> Mapping[str, Any]:
    """Return the data of a chart of the submissions that have the metric, in columns.

    ``best`` are the indices of those that were better than all received before them.
    """
    shown = [each for each in submissions if metric.key in each.report.scores]
    values = _displayed(metric, [each.report.scores for each in shown])
    received = [each.received_at for each in shown]
    return {
        "y": _axis(metric),
        "points": {
            "y": values,
            "at": [_milliseconds(at) for at in received],
            "method": [each.method.name for each in shown],
            "submission": [each.id for each in shown],
        },
        "best": records(received, _costs(metric, values)),
        "until": _milliseconds(now),
    }


def front(x: Sequence[float], y: Sequence[float]) -> Sequence[int]:
    """Return the indices of the Pareto front: no other point is as good in both and better in one.

    Parameters
    ----------
    x, y : sequences of float
        Costs: lower is better.

    Examples
    --------
    >>> front([1, 2, 3, 3], [5, 2, 4, 1])
    [0, 1, 3]
    """
    is_on = is_on_front(np.array(x, float), np.array(y, float))
    return sorted(np.flatnonzero(is_on).tolist(), key=lambda place: (x[place], y[place]))


def records(at: Sequence[Any], costs: Sequence[float]) -> Sequence[int]:
    """Return the indices of values that were better than all earlier ones, by time.

    >>> records([3, 1, 2, 4], [1, 5, 7, 0])
    [1, 0, 3]
    """
    chosen: list[int] = []
    for place, _ in sorted(enumerate(zip(at, costs, strict=True)), key=itemgetter(1)):
        if not chosen or costs[place] < costs[chosen[-1]]:
            chosen.append(place)
    return chosen


def _costs(metric: Metric, values: Sequence[float]) -> Sequence[float]:
    """Negate values if higher is better."""
    return [-value for value in values] if metric.better == "higher" else values


def _about(ranking: Ranking, rows: Sequence[Row]) -> Mapping[str, Any]:
    return {
        "rank": [row.rank for row in rows],
        "method": [row.entry.method["name"] for row in rows],
        "team": [ranking.team(row.entry) or "anonymous" for row in rows],
        "submission": [row.entry.submission_id for row in rows],
    }


def _displayed(metric: Metric, scores: Sequence[Mapping[str, float]]) -> Sequence[float]:
    return [float(metric.display(each[metric.key])) for each in scores]


def _milliseconds(at: datetime) -> int:
    return int(1000 * at.timestamp())


def _axis(metric: Metric) -> Mapping[str, Any]:
    most = float(metric.display(metric.upper_bound)) if isfinite(metric.upper_bound) else None
    return {"heading": metric.heading, "name": metric.name, "most": most}
