"""Evidence that helps an organiser to judge submissions: numbers, never a verdict.

All are functions of codes: one integer per file and episode, equal if and only if two files predict
the same there. Episodes with the same target depend on each other, so standard errors are over
clusters of episodes.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import FloatArray, IntArray

MOST_CHANGED = 0.5
"""The largest share of episodes in which a file that counts for :func:`spread_of_changes` differs
from the most frequent predictions. Others are another method, not a small change."""
FEWEST_FILES = 15
"""Files that :func:`spread_of_changes` needs."""
HONEST_SPREAD = 1.5
"""The smallest spread of changes that is assumed of a team that does not probe."""
SAMPLED_EPISODES = 512
"""Episodes in which all files are compared to find the most similar pairs."""

# Groups of files that the jackknife leaves out one by one.
_GROUPS = 10
_ALMOST = 1e-6
# The step of the numerical derivative of the usual variance, as a share of the mean's excess over
# 1.
_STEP = 1e-3


class ChangeSpread(NamedTuple):
    """How unevenly a team's changes are spread over the episodes that changed."""

    files: int
    """Files that were compared."""
    value: float
    """Variance of the number of changes of an episode, relative to changes at random."""
    standard_error: float
    p_value: float
    """Probability of a value as low as this, if the true one is at least ``HONEST_SPREAD``."""


class Estimate(NamedTuple):
    """A value with its standard error."""

    value: float
    standard_error: float


class Pair(NamedTuple):
    """Two files, by their rows."""

    first: int
    second: int
    equal: float
    """Share of the compared episodes with equal predictions."""


class Likeness(NamedTuple):
    """The most similar pairs of files from different groups, and the usual similarity."""

    pairs: Sequence[Pair]
    """The most similar files of two groups, at most one pair for each two groups, the most similar
    first."""
    median: float
    """The median of the most similar pairs over all pairs of groups."""


def most_frequent(codes: IntArray) -> IntArray:
    """Return the most frequent code of each episode, a column; the smallest of several.

    >>> most_frequent(np.array([[3, 1], [2, 1], [3, 0], [2, 4]]))
    array([2, 1])
    """
    ordered = np.sort(codes, axis=0)
    found: IntArray = ordered[0].copy()
    run = np.ones(codes.shape[1], dtype=np.int64)
    longest = run.copy()
    for previous, row in pairwise(ordered):
        run = np.where(row == previous, run + 1, 1)
        is_longer = run > longest
        longest[is_longer], found[is_longer] = run[is_longer], row[is_longer]
    return found


def nearest_earlier(codes: IntArray) -> tuple[IntArray, IntArray]:
    """Return the earlier file that each file differs least from, and in how many episodes.

    Parameters
    ----------
    codes : int array of shape (n_files, n_episodes)
        The earliest file first.

    Returns
    -------
    tuple of int arrays of shape (n_files,)
        Rows, the earliest of several, and numbers of episodes; -1 for the first file.

    >>> nearest_earlier(np.array([[1, 1, 1], [2, 2, 2], [2, 2, 1]]))
    (array([-1,  0,  1]), array([-1,  3,  1]))
    """
    nearest, changed = np.full(len(codes), -1), np.full(len(codes), -1)
    for row in range(1, len(codes)):
        differing = np.count_nonzero(codes[:row] != codes[row], axis=1)
        # argmin takes the first of several, which is the earliest file.
        nearest[row] = np.argmin(differing)
        changed[row] = differing[nearest[row]]
    return nearest, changed


def spread_of_changes(codes: IntArray, cluster: IntArray) -> ChangeSpread | None:
    """Test whether a team's changes return to the same episodes, as those of a method do.

    Between the files of one method, predictions change where the method is uncertain: the same
    episodes change again and again, others never. Someone who probes a leaderboard changes episodes
    regardless of that, at random or in turn. So we count in how many files each episode differs
    from the team's most frequent prediction. Among the episodes that ever differ, the variance of
    these counts is compared with the variance expected if every file changed each of them with the
    same probability: the index of dispersion.

    The standard error is over clusters of episodes, and over files by a jackknife in ten groups.

    Parameters
    ----------
    codes : int array of shape (n_files, n_episodes)
        The earliest file first.
    cluster : int array of shape (n_episodes,)

    Returns
    -------
    ChangeSpread or None
        None with fewer than ``FEWEST_FILES`` files that differ from the most frequent predictions
        in at most ``MOST_CHANGED`` of the episodes, or without any change.

    References
    ----------
    Cox and Lewis, "The Statistical Analysis of Series of Events", 1966, on the index of dispersion.
    """
    from scipy.stats import norm

    share = (codes != most_frequent(codes)).mean(axis=1)
    codes = codes[share <= MOST_CHANGED]
    files = len(codes)
    whole = _dispersion(codes, cluster) if files >= FEWEST_FILES else None
    if whole is None:
        return None
    parts = []
    for group in range(_GROUPS):
        # Every tenth file, so that each group spans the whole history.
        kept = np.arange(files) % _GROUPS != group
        part = _dispersion(codes[kept], cluster)
        if part is not None:
            # Dispersion beyond 1 grows with the number of files.
            parts.append(1 + (part.value - 1) * (files - 1) / (kept.sum() - 1))
    # The jackknife's variance: (g - 1) / g times the sum of squares.
    over_files = np.sqrt((len(parts) - 1) * np.var(parts)) if parts else 0.0
    error = float(np.hypot(whole.standard_error, over_files))
    return ChangeSpread(
        files, whole.value, error, float(norm.cdf((whole.value - HONEST_SPREAD) / error))
    )


def _dispersion(codes: IntArray, cluster: IntArray) -> Estimate | None:
    """Return the index of dispersion of the changes; None if there is no change."""
    changes = codes != most_frequent(codes)
    is_changed = changes.any(axis=0)
    if not is_changed.any():
        return None
    changes, of = changes[:, is_changed], cluster[is_changed]
    count, share = changes.sum(axis=0), changes.mean(axis=1)
    clusters, index = np.unique(of, return_inverse=True)
    # The standard error is never less than that of counts without any structure: few changes would
    # otherwise look certain.
    least = float(np.sqrt(2 / len(clusters)))  # of independent counts
    mean = float(count.mean())
    if mean < 1 + _ALMOST:  # no episode has changed twice
        return Estimate(1.0, least)
    usual = _usual_variance(share)
    if usual < _ALMOST:  # files change all of these episodes or none
        return None
    step = _STEP * (mean - 1) / mean
    more, fewer = (_usual_variance(share * scale) for scale in (1, 1 - step))
    slope = (more - fewer) / (step * mean)
    value = count.var() / usual
    # The delta method: what an episode adds to the variance, and by the mean to the usual one.
    influence = ((count - mean) ** 2 - count.var() - value * slope * (count - mean)) / usual
    error = np.sqrt((np.bincount(index, influence) ** 2).sum()) / len(count)
    return Estimate(float(value), max(float(error), least))


def _usual_variance(share: FloatArray) -> float:
    """Return the variance of the number of changes if files change episodes independently.

    Each file changes an episode with a probability of its own; episodes that no file changes are
    not counted. ``share`` has the share of the others that each file changes.
    """
    from scipy.optimize import brentq

    def surplus(counted: float) -> float:
        """Return how much more is changed than counted, if that is the share that is counted."""
        return float(1 - np.prod(1 - counted * share) - counted)

    # Episodes that no file changed are not counted, so the shares refer to the others; the share of
    # episodes that are counted solves an equation with itself.
    counted = 1.0 if surplus(1.0) >= 0 else float(brentq(surplus, 1e-9, 1.0))
    probability = counted * share
    square = (probability * (1 - probability)).sum() + probability.sum() ** 2
    return float(square / counted - share.sum() ** 2)


def most_similar(codes: IntArray, group: IntArray, number: int) -> Likeness | None:
    """Find the most similar files of different groups.

    Parameters
    ----------
    codes : int array of shape (n_files, n_episodes)
    group : int array of shape (n_files,)
        Who sent each file, ascending.
    number : int
        The largest number of pairs to return.

    Returns
    -------
    Likeness or None
        None with fewer than two groups.

    >>> most_similar(np.array([[1, 1], [1, 2], [1, 2], [3, 2]]), np.array([0, 0, 1, 2]), 1)
    Likeness(pairs=[Pair(first=1, second=2, equal=1.0)], median=0.5)
    """
    groups, first = np.unique(group, return_index=True)
    ends = np.append(first[1:], len(group))
    best = []
    for own, (begin, end) in enumerate(zip(first, ends, strict=True)):
        later = ends[own]
        if later == len(codes):
            break
        highest = np.full(len(groups), -1.0)
        row_of, column_of = np.zeros(len(groups), int), np.zeros(len(groups), int)
        for row in range(begin, end):
            equal = np.count_nonzero(codes[later:] == codes[row], axis=1) / codes.shape[1]
            # The files of a group follow one another, so one call finds the best of each group.
            in_group = np.maximum.reduceat(equal, first[own + 1 :] - later)
            is_better = in_group > highest[own + 1 :]
            for other in np.flatnonzero(is_better) + own + 1:
                highest[other], row_of[other] = in_group[other - own - 1], row
                part = slice(first[other] - later, ends[other] - later)
                column_of[other] = first[other] + np.argmax(equal[part])
        best += [
            Pair(int(row_of[other]), int(column_of[other]), float(highest[other]))
            for other in range(own + 1, len(groups))
        ]
    if not best:
        return None
    ordered = sorted(best, key=lambda pair: -pair.equal)
    return Likeness(ordered[:number], float(np.median([pair.equal for pair in best])))
