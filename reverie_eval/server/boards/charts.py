"""Charts: one metric against another, results over the years, and ranks over time."""

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from math import isfinite
from typing import Any

import numpy as np

from reverie_eval.analysis import is_on_front
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.history import (
    PastResult,
    ResultKind,
    Timeline,
    rank_over_time,
    rank_svg,
    years_of,
)
from reverie_eval.schemas.service import ScoredSubmission
from reverie_eval.server.boards.entries import Entry, Row
from reverie_eval.server.boards.leaderboard import Ranking
from reverie_eval.server.scoring.boards import Board


def chart_of(ranking: Ranking, rows: Sequence[Row], x: str, y: str) -> Mapping[str, Any]:
    """Return the data of a leaderboard's charts, in columns.

    ``points`` are the results scored here that have both metrics, and ``front`` the indices of
    their Pareto front, the best by ``x`` first; empty if a metric has no better direction.
    ``reported`` are the reported results, and ``lines`` are for comparison: the best human result,
    and the best reported result of a method that is not a reference.
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


def whole_timeline(ranking: Ranking, key: str) -> Timeline | None:
    """Return the :func:`timeline_of` all results, made once a day and whenever one changes."""
    day = _day(ranking)
    known, timeline = ranking.timelines.get(key, ("", None))
    if known != day:
        timeline = timeline_of(ranking, [*ranking.rows, *ranking.apart], key)
        ranking.timelines[key] = day, timeline
    return timeline


def _day(ranking: Ranking) -> str:
    return ranking.now.date().isoformat()


def timeline_of(ranking: Ranking, rows: Sequence[Row], key: str) -> Timeline | None:
    """Return results over the years by a metric; None if no dated result has it.

    Results that are not comparable with those of the ranking have lines of their own.
    """
    metric = CATALOGUE[key]
    shown = [
        PastResult(
            name=row.entry.method["name"],
            date=row.entry.date,
            value=row.entry.scores[key],
            version=_version_of(row.entry, ranking.board),
            kind=_kind_of(row.entry),
        )
        for row in rows
        if key in row.entry.scores and row.entry.standing != "disqualified"
    ]
    if metric.better == "neither" or not any(each.date for each in shown):
        return None
    return Timeline(metric, shown, _day(ranking))


def _version_of(entry: Entry, board: Board) -> str:
    match entry.standing:
        case "other-dataset":
            return entry.dataset
        case "other-rules":
            return "other rules"
        case _:
            return board.truth.header.dataset


def _kind_of(entry: Entry) -> ResultKind:
    if entry.method.get("human"):
        return "human"
    return "reference" if entry.method.get("reference") else "method"


def rank_chart(ranking: Ranking, title: str, is_own: Callable[[Entry], bool]) -> str:
    """Draw the best rank of some results since the first of them; empty if they have none.

    It is computed from the results that are published now.
    """
    metric = CATALOGUE[ranking.metric]
    ranked = [row.entry for row in ranking.rows if row.rank is not None]
    costs = _costs(metric, [entry.scores[metric.key] for entry in ranked])
    dated = [
        ((years_of(entry.date), cost), is_own(entry))
        for entry, cost in zip(ranked, costs, strict=True)
    ]
    own = [each for each, is_theirs in dated if is_theirs]
    ranks = rank_over_time([each for each, _ in dated], own)
    return rank_svg(ranks, years_of(_day(ranking)), title) if ranks else ""


def progress_of(
    submissions: Sequence[ScoredSubmission], metric: Metric, now: datetime
) -> Timeline | None:
    """Return a team's submissions to a split over time; None unless several have the metric."""
    shown = [
        PastResult(
            name=each.method.name,
            date=f"{each.received_at:%Y-%m-%d}",
            value=each.report.scores[metric.key],
            version=each.split,
        )
        for each in submissions
        if metric.key in each.report.scores
    ]
    return Timeline(metric, shown, f"{now:%Y-%m-%d}", height=220) if len(shown) > 1 else None


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


def _axis(metric: Metric) -> Mapping[str, Any]:
    most = float(metric.display(metric.upper_bound)) if isfinite(metric.upper_bound) else None
    return {"heading": metric.heading, "name": metric.name, "most": most}
