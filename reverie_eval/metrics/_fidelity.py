"""How closely the trajectory follows the annotated path: one value per episode.

All of them look at a table of distances per episode, with a row for every node of the annotated
path and a column for every pose of the trajectory. The tables are stored flat, row by row, episode
after episode.
"""

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray, offsets_of, row_of

FIDELITY_DISTANCE = 3.0
"""Metres at which path fidelity has fallen to 1/e. Source: arXiv:1907.05446, arXiv:1905.12255."""


def dtw(distance: FloatArray, n_poses: IntArray, n_nodes: IntArray) -> FloatArray:
    """Dynamic time warping: the least total distance of an alignment in order, per episode.

    All episodes share one dynamic programme, the longest first, so that those still under way
    are a prefix. Cells beyond an episode's own table are computed and never read.

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
    order = np.argsort(-n_poses, kind="stable")
    poses, nodes = n_poses[order], n_nodes[order]
    begin = offsets_of(n_poses * n_nodes)[:-1][order]
    # First cell of each row; rows that an episode does not have repeat its last one.
    row = np.minimum(np.arange(nodes.max())[:, np.newaxis], nodes - 1) * poses + begin
    total = np.full((nodes.max() + 1, len(order)), np.inf)
    total[0] = 0.0
    result = np.empty(len(order))
    for column in range(poses.max()):
        under_way = int(np.searchsorted(-poses, -column, side="left"))
        total = _next_column(total[:, :under_way], distance[row[:, :under_way] + column])
        ending = np.flatnonzero(poses[:under_way] == column + 1)
        result[order[ending]] = total[nodes[ending], ending]
    return result


def _next_column(total: FloatArray, distance: FloatArray) -> FloatArray:
    """Advance the programme by one pose; row 0 stands before the first node."""
    advanced = np.empty_like(total)
    advanced[0] = np.inf
    reached = np.minimum(total[1:], total[:-1])
    for node, cost in enumerate(distance, start=1):
        advanced[node] = cost + np.minimum(reached[node - 1], advanced[node - 1])
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
    """Normalised dynamic time warping of successful episodes, 0 of others.

    What success is, the protocol says. Range and source are those of :func:`ndtw`.
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

    Coverage is how near the trajectory comes to each node of the annotated path; the length score
    compares the trajectory's length with the one that this coverage would need.

    Parameters
    ----------
    distance, n_poses, n_nodes
        As for :func:`dtw`.
    path_length, annotated_length : float arrays of shape (n_episodes,)
        Metres of the trajectory and of the annotated path.

    Returns
    -------
    float array of shape (n_episodes,)
        In [0, 1], higher is better. 1 where neither moves, as in google-research/valan.

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
    coverage = np.bincount(episode, weights=nearness) / n_nodes
    expected = coverage * annotated_length
    spread = expected + np.abs(expected - path_length)
    length_score = np.divide(expected, spread, out=np.ones_like(spread), where=spread > 0)
    return coverage * length_score
