"""Which ranks published results may have, and which of them form a group.

On an open split, results are compared on the same episodes: for this, the sums of each result over
clusters of episodes are stored when it is published. On a private split, only the shown means are
used, and the number of tasks, which is known from the public instructions.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import NamedTuple, TypeAlias

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.analysis import covariance_of_means, rank_intervals
from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.metrics import METRICS, Metric
from reverie_eval.scoring import Scores, clusters_of
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.entries import Row
from reverie_eval.server.store.tables import ClusterSums

MOST_COMPARED = 100
"""Results of a leaderboard, at most; if there are more, none are compared."""
_FEWEST_COMPARED = 2
"""Results, and clusters that they are compared on, at least."""
_DIGITS = 6
"""Digits of the stored sums after the decimal point."""
Sums: TypeAlias = dict[str, list[float]]
"""Sums of a result over each cluster of episodes, by metric."""


@dataclass(frozen=True, slots=True)
class RankInterval:
    """The ranks that a result may have, and its group."""

    best: int
    worst: int
    group: int
    """The group's number, from 1. A group is a first result and those that follow it and are not
    significantly worse than it."""


class _Compared(NamedTuple):
    """Results of a leaderboard that are compared by a metric."""

    board: Board
    metric: Metric
    values: Sequence[tuple[str, float]]
    """By submission; empty if they are not compared."""

    @property
    def key(self) -> tuple[str, str]:
        return self.board.path, self.metric.key


def cluster_sums(scores: Scores) -> Sums:
    """Return the sums of a result over clusters of episodes, as they are stored."""
    _, cluster = np.unique(clusters_of(scores.ground_truth, "target"), return_inverse=True)
    return {
        metric.key: np.bincount(cluster, weights=scores.episodes[metric.key])
        .round(_DIGITS)
        .tolist()
        for metric in scores.headline
        if metric.better != "neither"
    }


def store_sums(session: Session, submission_id: str, sums: Mapping[str, Sums]) -> None:
    """Store the sums by which a published result is compared, by the names of leaderboards."""
    if not sums:
        return
    chosen = select(ClusterSums).where(ClusterSums.submission_id == submission_id)
    with session.no_autoflush:  # what else was changed is written with them
        known = {row.board: row for row in session.scalars(chosen)}
    for further, of_board in sums.items():
        if further in known:
            known[further].sums = of_board
        else:
            row = ClusterSums(submission_id=submission_id, board=further, sums=of_board)
            session.add(row)


@dataclass(frozen=True)
class RankIntervals:
    """The rank intervals of all results, computed again only when the results have changed."""

    _values: dict[tuple[str, str], Sequence[tuple[str, float]]] = field(default_factory=dict)
    """By leaderboard and metric: the values that were compared."""
    _found: dict[tuple[str, str], Mapping[str, RankInterval]] = field(default_factory=dict)
    """The intervals that they have."""
    _lock: Lock = field(default_factory=Lock)
    """Makes concurrent requests compute them only once."""

    def compute(
        self, session: Session, rankings: Iterable[tuple[Board, str, Iterable[Row]]]
    ) -> Sequence[Mapping[str, RankInterval]]:
        """Return the intervals of the ranked results of leaderboards, each ranked by a metric.

        They are by the ids of the results; empty if these are not compared. A result without
        stored sums has none, and may have any rank. One statement reads the sums of all.
        """
        wanted = [_compared(*ranking) for ranking in rankings]
        with self._lock:
            changed = [
                each for each in wanted if each.values and self._values.get(each.key) != each.values
            ]
            sums = _stored_sums(session, [each for each in changed if not each.board.is_private])
            for each in changed:
                self._found[each.key] = _computed(each, sums)
                self._values[each.key] = each.values
            return [self._found[each.key] if each.values else {} for each in wanted]


def _compared(board: Board, metric: str, rows: Iterable[Row]) -> _Compared:
    """Return what is compared of a leaderboard."""
    ranked = [
        (row.entry.submission_id, row.entry.scores[metric])
        for row in rows
        if row.rank is not None and row.entry.submission_id is not None
    ]
    is_compared = _is_compared(board, METRICS[metric])
    is_compared &= _FEWEST_COMPARED <= len(ranked) <= MOST_COMPARED
    return _Compared(board, METRICS[metric], ranked if is_compared else ())


def _is_compared(board: Board, metric: Metric) -> bool:
    """Whether results are compared by a metric.

    On a private split, only by rates: a mean in metres does not show how much its values vary.
    """
    return (
        metric.key in board.task.headline
        and metric.better != "neither"
        and (metric.unit == "fraction" or not board.is_private)
    )


def _stored_sums(
    session: Session, compared: Sequence[_Compared]
) -> Mapping[tuple[str, str], Mapping[str, Sequence[float]]]:
    """Return stored sums by submission and name of the leaderboard."""
    if not compared:
        return {}
    names = [name for each in compared for name, _ in each.values]
    chosen = select(ClusterSums).where(
        ClusterSums.submission_id.in_(names),
        ClusterSums.board.in_({each.board.further for each in compared}),
    )
    return {(row.submission_id, row.board): row.sums for row in session.scalars(chosen)}


def _computed(
    compared: _Compared, stored: Mapping[tuple[str, str], Mapping[str, Sequence[float]]]
) -> Mapping[str, RankInterval]:
    board, metric, ranked = compared
    means = dict(ranked)
    if board.is_private:
        covariance, n_clusters = _of_shown_means(board, np.array([*means.values()])), np.inf
    else:
        sums = {
            name: own[metric.key]
            for name in means
            if metric.key in (own := stored.get((name, board.further), {}))
        }
        means = {name: mean for name, mean in means.items() if name in sums}
        _, sizes = np.unique(clusters_of(board.truth, "target"), return_counts=True)
        n_clusters = len(sizes)
        if len(means) < _FEWEST_COMPARED or n_clusters < _FEWEST_COMPARED:
            return {}
        table = np.column_stack([sums[name] for name in means])
        covariance = covariance_of_means(table, sizes.astype(np.float64))
    values = np.array([*means.values()])
    found = rank_intervals(-values if metric.better == "higher" else values, covariance, n_clusters)
    others = len(ranked) - len(means)
    columns: tuple[IntArray, ...] = (found.low, found.high + others, found.group)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return {name: RankInterval(*row) for name, row in zip(means, rows, strict=True)}


def _of_shown_means(board: Board, means: FloatArray) -> FloatArray:
    """Bound the covariance of means between 0 and 1 by what everyone can see.

    A mean of values between 0 and 1 varies at most as much as a rate with the same mean. The
    instructions of a task count as one, as if all had the same outcome, and results count as
    independent: in fact, results on the same episodes tend to succeed and fail together, which
    makes differences more certain.
    """
    n_tasks = len(np.unique(board.truth.episodes.task))
    return np.diag(means * (1 - means) / n_tasks)
