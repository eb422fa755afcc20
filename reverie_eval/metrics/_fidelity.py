"""How closely the trajectory follows the annotated path: one value per episode.

The functions take one table of distances per episode, with a row for each node of the annotated
path and a column for each pose of the trajectory. Tables are stored flat, row by row, one episode
after another.
"""

from itertools import pairwise

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray, offsets_of, row_of

FIDELITY_DISTANCE = 3.0
"""Metres at which path fidelity drops to 1/e. Source: arXiv:1907.05446, arXiv:1905.12255."""


def dtw(distance: FloatArray, n_poses: IntArray, n_nodes: IntArray) -> FloatArray:
    """Dynamic time warping: the smallest total distance of an in-order alignment, per episode.

    One dynamic programme runs for all episodes at once.

    Parameters
    ----------
    distance : float array of shape (n_cells,)
        Metres along the navigation graph from pose to node, table after table.
    n_poses, n_nodes : int arrays of shape (n_episodes,)
        Columns and rows of each episode's table, at least 1.

    Returns
    -------
    float array of shape (n_episodes,)
        Metres, at least 0, lower is better.

    References
    ----------
    .. [1] Ilharco et al., "General Evaluation for Instruction Conditioned Navigation using
       Dynamic Time Warping", arXiv:1907.05446, 2019; ``r4r/dtw.py`` of google-research.

    Examples
    --------
    >>> dtw(np.array([0.0, 2.0, 5.0, 2.0, 0.0, 3.0]), np.array([3]), np.array([2]))
    array([3.])
    """
    # Longest trajectories first: the episodes that still have poses are then always a prefix.
    order = np.argsort(-n_poses, kind="stable")
    poses, nodes = n_poses[order], n_nodes[order]
    begin = offsets_of(n_poses * n_nodes)[:-1][order]
    # First cell of each row. A shorter table repeats its last row: those cells are computed, but
    # never read, because a path's nodes only depend on the nodes before them.
    row = np.minimum(np.arange(nodes.max())[:, np.newaxis], nodes - 1) * poses + begin
    total = np.full((nodes.max() + 1, len(order)), np.inf)
    total[0] = 0.0
    result = np.empty(len(order))
    active = np.searchsorted(-poses, -np.arange(poses.max() + 1), side="left")
    for column, (now, later) in enumerate(pairwise(active.tolist())):
        total = _next_column(total[:, :now], distance[row[:, :now] + column])
        ending = np.arange(later, now)
        result[order[ending]] = total[nodes[ending], ending]
    return result


def _next_column(total: FloatArray, distance: FloatArray) -> FloatArray:
    """Advance the programme by one pose; row 0 is before the first node."""
    advanced = np.empty_like(total)
    # An alignment starts with the first pose; no later pose may start it again.
    advanced[0] = np.inf
    # Steps from the previous pose need no loop; those along this column depend on each other.
    np.minimum(total[1:], total[:-1], out=advanced[1:])
    for node, cost in enumerate(distance, start=1):
        advanced[node] = cost + np.minimum(advanced[node], advanced[node - 1])
    return advanced


def ndtw(dtw: FloatArray, n_nodes: IntArray) -> FloatArray:
    """Normalised dynamic time warping, per episode.

    Parameters
    ----------
    dtw : float array of shape (n_episodes,)
        Metres.
    n_nodes : int array of shape (n_episodes,)
        Nodes of the annotated path.

    Returns
    -------
    float array of shape (n_episodes,)
        In [0, 1], higher is better; 1 for the annotated path itself.

    References
    ----------
    .. [1] As for :func:`dtw`: exp(-DTW / (3 m x nodes)).

    Examples
    --------
    >>> ndtw(np.array([0.0, 6.0]), np.array([4, 2])).round(4)
    array([1.    , 0.3679])
    """
    return np.exp(-dtw / (FIDELITY_DISTANCE * n_nodes))


def sdtw(ndtw: FloatArray, success: BoolArray) -> FloatArray:
    """Normalised dynamic time warping of successful episodes, 0 for others.

    The protocol defines success. Range and source are those of :func:`ndtw`.
    """
    return np.where(success, ndtw, 0.0)


def cls(
    distance: FloatArray,
    n_poses: IntArray,
    n_nodes: IntArray,
    path_length: FloatArray,
    annotated_length: FloatArray,
) -> FloatArray:
    """Coverage weighted by length score, per episode.

    Coverage is how close the trajectory comes to each node of the annotated path. The length score
    compares the trajectory's length with the length expected for this coverage.

    Parameters
    ----------
    distance, n_poses, n_nodes
        As for :func:`dtw`.
    path_length, annotated_length : float arrays of shape (n_episodes,)
        Metres of the trajectory and of the annotated path.

    Returns
    -------
    float array of shape (n_episodes,)
        In [0, 1], higher is better. 1 if neither has any length, as in google-research/valan.

    References
    ----------
    .. [1] Jain et al., "Stay on the Path: Instruction Fidelity in Vision-and-Language Navigation",
       arXiv:1905.12255, 2019; ``r4r/cls.py`` of google-research.

    Examples
    --------
    >>> cls(np.zeros(1), np.array([1]), np.array([1]), np.array([0.0]), np.array([0.0]))
    array([1.])
    """
    episode = row_of(offsets_of(n_nodes))
    rows = offsets_of(n_poses[episode])[:-1]
    nearness = np.exp(-np.minimum.reduceat(distance, rows) / FIDELITY_DISTANCE)
    # bincount adds up node by node, as the published loop does; see `path_length`.
    coverage = np.bincount(episode, weights=nearness) / n_nodes
    expected = coverage * annotated_length
    spread = expected + np.abs(expected - path_length)
    length_score = np.divide(expected, spread, out=np.ones_like(spread), where=spread > 0)
    return coverage * length_score
