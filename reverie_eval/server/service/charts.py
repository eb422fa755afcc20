"""What charts draw: one metric against another, and the best over time."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from operator import itemgetter
from typing import Any

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.schemas.service import SubmissionReport
from reverie_eval.server.service.leaderboard import Ranking
from reverie_eval.server.service.standings import Row


def chart_of(ranking: Ranking, rows: Sequence[Row], x: str, y: str) -> Mapping[str, Any]:
    """Return a column per thing that is drawn of the rows that have both metrics.

    ``front`` are the places of rows that no other is better than, from left to right; ``best`` of
    those that were better in ``y`` than all before them, in the order of their publication.
    """
    shown = [row for row in rows if x in row.entry.scores and y in row.entry.scores]
    across, up = ([_displayed(CATALOGUE[key], row.entry.scores) for row in shown] for key in (x, y))
    published = [row.entry.published_at for row in shown]
    return {
        "x": _axis(CATALOGUE[x]),
        "y": _axis(CATALOGUE[y]),
        "points": {
            "x": across,
            "y": up,
            "rank": [row.rank for row in shown],
            "method": [row.entry.method["name"] for row in shown],
            "team": [ranking.team(row.entry) or "anonymous" for row in shown],
            "submission": [row.entry.submission_id for row in shown],
            "at": [_milliseconds(at) for at in published],
        },
        "front": front(_costs(CATALOGUE[x], across), _costs(CATALOGUE[y], up)),
        "best": records(published, _costs(CATALOGUE[y], up)),
    }


def progress_of(submissions: Sequence[SubmissionReport], y: str) -> Mapping[str, Any]:
    """Return a column per thing that is drawn of the submissions that have the metric.

    ``best`` are the places of those that were better than all before them, as they were received.
    """
    shown = [each for each in submissions if y in each.report.scores]
    values = [_displayed(CATALOGUE[y], each.report.scores) for each in shown]
    received = [each.received_at for each in shown]
    return {
        "y": _axis(CATALOGUE[y]),
        "points": {
            "y": values,
            "method": [each.method.name for each in shown],
            "submission": [each.id for each in shown],
            "at": [_milliseconds(at) for at in received],
        },
        "best": records(received, _costs(CATALOGUE[y], values)),
    }


def front(x: Sequence[float], y: Sequence[float]) -> Sequence[int]:
    """Return the Pareto front: what nothing else is at least as good as in both, and better in one.

    Parameters
    ----------
    x, y : sequences of float
        Costs: less is better.

    Examples
    --------
    >>> front([1, 2, 3, 3], [5, 2, 4, 1])
    [0, 1, 3]
    """
    found: list[int] = []
    least = float("inf")
    for place in sorted(range(len(x)), key=lambda place: (x[place], y[place])):
        is_equal = bool(found) and (x[found[-1]], y[found[-1]]) == (x[place], y[place])
        if y[place] < least or is_equal:
            found.append(place)
            least = y[place]
    return found


def records(at: Sequence[Any], costs: Sequence[float]) -> Sequence[int]:
    """Return what was better than all before it, by time.

    >>> records([3, 1, 2, 4], [1, 5, 7, 0])
    [1, 0, 3]
    """
    found: list[int] = []
    for place, _ in sorted(enumerate(zip(at, costs, strict=True)), key=itemgetter(1)):
        if not found or costs[place] < costs[found[-1]]:
            found.append(place)
    return found


def _costs(metric: Metric, values: Sequence[float]) -> Sequence[float]:
    """Turn values so that less is better; where neither is, less took less."""
    return [-value for value in values] if metric.better == "higher" else values


def _displayed(metric: Metric, scores: Mapping[str, float]) -> float:
    return float(metric.display(scores[metric.key]))


def _milliseconds(at: datetime) -> int:
    return int(1000 * at.timestamp())


def _axis(metric: Metric) -> Mapping[str, str]:
    return {"key": metric.key, "heading": metric.heading, "name": metric.name}
