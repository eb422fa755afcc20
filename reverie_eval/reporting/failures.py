"""Which episodes a report shows: those that came nearest to being right."""

from collections.abc import Sequence

import numpy as np

from reverie_eval.anatomy import OUTCOMES
from reverie_eval.arrays import Array
from reverie_eval.metrics import PRIMARY_METRIC
from reverie_eval.scores import Scores

SHOWN = 3
"""Episodes of each kind, on different ways."""

_FAILURES = tuple(outcome for outcome in OUTCOMES if outcome != "right")


def near_misses(scores: Scores) -> dict[str, Sequence[str]]:
    """Choose episodes of every outcome but the right one, the nearest to being right first.

    Nearest are: of those that never came near, the ones that came nearest to the path's end; of
    those that passed by, or were right from afar, the ones that stopped nearest to it; of wrong
    objects, the ones whose box overlaps most, and then those that walked least in vain.

    Returns
    -------
    dict of list of str
        By outcome; the same scores give the same episodes.
    """
    outcome = np.array(scores.outcomes)
    chosen = {}
    for kind in _FAILURES:
        rows = np.flatnonzero(outcome == kind)
        order = np.lexsort([column[rows] for column in reversed(_distances(scores, kind))])
        chosen[kind] = _on_different_ways(scores, rows[order])
    return chosen


def won(first: Scores, other: Scores) -> Sequence[str]:
    """List the episodes that the other has right and the first has not, the clearest first."""
    better = other.episodes["rgs"] > first.episodes["rgs"]
    change = other.episodes[PRIMARY_METRIC] - first.episodes[PRIMARY_METRIC]
    rows = np.flatnonzero(better)
    ordered = rows[np.argsort(-change[rows], kind="stable")]
    return [first.instr_ids[row] for row in ordered.tolist()]


def on_different_ways(scores: Scores, instr_ids: Sequence[str]) -> Sequence[str]:
    """Take the first few episodes that differ in start or goal."""
    index = scores.ground_truth.episodes.index
    return _on_different_ways(scores, np.array([index[each] for each in instr_ids], dtype=int))


def _distances(scores: Scores, outcome: str) -> Sequence[Array]:
    """Say how far each episode is from being right, in the order of what counts most."""
    episodes = scores.episodes
    if outcome == "never near":
        return [episodes["oracle_error"]]
    if outcome == "wrong object":
        overlap = [-episodes["iou"]] if "iou" in episodes else []
        return [*overlap, -episodes["spl"]]
    return [episodes["navigation_error"]]


def _on_different_ways(scores: Scores, rows: Array) -> Sequence[str]:
    truth = scores.ground_truth
    ways = np.column_stack([truth.episodes.start[rows], truth.secret.goal[rows]])
    _, first_of_way = np.unique(ways, axis=0, return_index=True)
    return [truth.episodes.instr_ids[row] for row in rows[np.sort(first_of_way)][:SHOWN].tolist()]
