"""Which ranks published results may have, and which of them form a group.

On an open split, results are compared on the same episodes: for this, the sums of each result over
clusters of episodes are stored when it is published. On a private split, only the shown means are
used, and the number of items, which is known from the public instructions.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import TypeAlias

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.analysis import covariance_of_means, rank_intervals
from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.scoring import Scores, clusters_of
from reverie_eval.server.boards.entries import Row
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.store.tables import ClusterSums

MOST_COMPARED = 100
"""Results of a leaderboard, at most; if there are more, none are compared."""
_FEWEST_COMPARED = 2
"""Results, and clusters that they are compared on, at least."""
_DIGITS = 6
"""Digits of the stored sums after the decimal point."""
_Means: TypeAlias = Mapping[str, float]
"""The values of results, by submission."""
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
    for name, of_board in sums.items():
        if name in known:
            known[name].sums = of_board
        else:
            row = ClusterSums(submission_id=submission_id, board=name, sums=of_board)
            session.add(row)


@dataclass(frozen=True)
class RankIntervals:
    """The rank intervals of all results, computed again only when the results have changed."""

    _found: dict[tuple[str, str, str], tuple[_Means, Mapping[str, RankInterval]]] = field(
        default_factory=dict
    )
    """By signature, leaderboard and metric: the values that were compared, and their intervals."""
    _lock: Lock = field(default_factory=Lock)
    """Makes concurrent requests compute them only once."""

    def compute(
        self, session: Session, board: Board, metric: str, rows: Iterable[Row]
    ) -> Mapping[str, RankInterval]:
        """Return the intervals of the ranked results of a leaderboard that is ranked by a metric.

        They are by the ids of the results; empty if these are not compared. A result without
        stored sums has none, and may have any rank.
        """
        means = {
            row.entry.submission_id: row.entry.scores[metric]
            for row in rows
            if row.rank is not None and row.entry.submission_id is not None
        }
        if not _is_compared(board, CATALOGUE[metric], len(means)):
            return {}
        with self._lock:
            compared, found = self._found.get((board.signature, board.path, metric), ({}, {}))
            if [*compared.items()] != [*means.items()]:  # in the same order, too
                found = _computed(session, board, CATALOGUE[metric], means)
                self._found[board.signature, board.path, metric] = means, found
            return found


def _is_compared(board: Board, metric: Metric, results: int) -> bool:
    """Whether this number of results is compared by a metric.

    On a private split, only by rates: a mean in metres does not show how much its values vary.
    """
    return (
        metric.key in board.task.headline
        and metric.better != "neither"
        and (metric.unit == "fraction" or not board.is_private)
        and _FEWEST_COMPARED <= results <= MOST_COMPARED
    )


def _stored_sums(
    session: Session, board: Board, metric: Metric, means: _Means
) -> Mapping[str, Sequence[float]]:
    """Return stored sums of a metric, by submission in the order of their values."""
    chosen = select(ClusterSums).where(
        ClusterSums.submission_id.in_(means), ClusterSums.board == board.name
    )
    stored = {row.submission_id: row.sums for row in session.scalars(chosen)}
    return {name: stored[name][metric.key] for name in means if metric.key in stored.get(name, {})}


def _computed(
    session: Session, board: Board, metric: Metric, ranked: _Means
) -> Mapping[str, RankInterval]:
    means = ranked
    if board.is_private:
        covariance, n_clusters = _of_shown_means(board, np.array([*means.values()])), np.inf
    else:
        sums = _stored_sums(session, board, metric, ranked)
        means = {name: ranked[name] for name in sums}
        _, sizes = np.unique(clusters_of(board.truth, "target"), return_counts=True)
        n_clusters = len(sizes)
        if len(means) < _FEWEST_COMPARED or n_clusters < _FEWEST_COMPARED:
            return {}
        table = np.column_stack([*sums.values()])
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
    instructions of an item count as one, as if all had the same outcome, and results count as
    independent: in fact, results on the same episodes tend to succeed and fail together, which
    makes differences more certain.
    """
    n_items = len(np.unique(board.truth.episodes.item))
    return np.diag(means * (1 - means) / n_items)
