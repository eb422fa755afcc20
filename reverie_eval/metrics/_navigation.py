"""How well the agent navigated, and followed the annotated path: one value per episode.

Per-pose arrays are flat with ``offsets`` (see :mod:`reverie_eval.arrays`); every episode has at
least one pose. Path fidelity takes one table of distances per episode, with a row for each node of
the annotated path and a column for each pose of the trajectory; tables are stored flat, row by row,
one episode after another.
"""

from itertools import pairwise

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray, last_of, offsets_of, row_of

SUCCESS_DISTANCE = 3.0
"""Metres that count as close to the goal, in protocols that measure a distance; whether exactly 3 m
counts depends on the protocol. Source: Anderson et al., "Vision-and-Language Navigation", CVPR
2018, section 4.2."""


def path_length(leg_length: FloatArray, offsets: IntArray) -> FloatArray:
    """Length of the trajectory, per episode.

    Legs are added in walking order, so the sum equals that of the published loop [1]_ to the bit.

    Parameters
    ----------
    leg_length : float array of shape (n_poses,)
        Metres from the previous pose of the same episode; 0 for an episode's first pose.
    offsets : int array of shape (n_episodes + 1,)
        Where each episode's poses begin and end.

    Returns
    -------
    float array of shape (n_episodes,)
        Metres, at least 0. Neither direction is better by itself.

    References
    ----------
    .. [1] ``eval_release.py`` lines 103-109 of the dataset's repository.

    Examples
    --------
    >>> path_length(np.array([0.0, 2.0, 3.0, 0.0]), np.array([0, 3, 4]))
    array([5., 0.])
    """
    # bincount adds one element after another, as a Python loop does. np.add.reduceat adds in pairs,
    # which changes the last bits, and cannot sum an empty row.
    row, n_episodes = row_of(offsets), len(offsets) - 1
    return np.bincount(row, weights=leg_length, minlength=n_episodes).astype(np.float64)


def success(visible: BoolArray, offsets: IntArray) -> BoolArray:
    """Whether the target is visible where the agent stops, per episode.

    An object is annotated only at viewpoints close to it, so visible implies close [1]_.

    Parameters
    ----------
    visible : bool array of shape (n_poses,)
        Whether the episode's target object is visible from the pose's viewpoint.
    offsets : int array of shape (n_episodes + 1,)
        Where each episode's poses begin and end.

    Returns
    -------
    bool array of shape (n_episodes,)
        True is better.

    References
    ----------
    .. [1] ``eval_release.py`` lines 84-90 of the dataset's repository.
    """
    return visible[last_of(offsets)]


def oracle_success(visible: BoolArray, offsets: IntArray) -> BoolArray:
    """Whether the target is visible from any pose of the trajectory, start and stop included.

    Parameters and range are those of :func:`success`.

    References
    ----------
    .. [1] ``eval_release.py`` lines 93-99 of the dataset's repository.

    Examples
    --------
    >>> oracle_success(np.array([True, False, False]), np.array([0, 2, 3]))
    array([ True, False])
    """
    # reduceat would take an empty row for its next element; reading guarantees a pose in each.
    return np.logical_or.reduceat(visible, offsets[:-1])


def spl(
    success: BoolArray,
    path_length: FloatArray,
    shortest_length: FloatArray,
    floor: float = 0.0,
) -> FloatArray:
    """Success weighted by path length, per episode.

    A failed episode scores 0. A successful one scores the shortest length over the walked
    length, so detours cost and no shortcut can push it above 1 [1]_.

    Parameters
    ----------
    success : bool array of shape (n_episodes,)
        Whether the episode counts: navigation success for SPL, REVERIE success for RGSPL.
    path_length : float array of shape (n_episodes,)
        Metres walked along the navigation graph.
    shortest_length : float array of shape (n_episodes,)
        Metres of the shortest route from the start to the annotated goal, or of the annotated
        path, depending on the protocol.
    floor : float
        Smallest denominator in metres; some evaluators have one.

    Returns
    -------
    float array of shape (n_episodes,)
        In [0, 1], higher is better. An agent that starts on the goal and stays scores 1, or 0 if
        there is a floor.

    References
    ----------
    .. [1] Anderson et al., "On Evaluation of Embodied Navigation Agents", arXiv:1807.06757,
       2018; ``eval_release.py`` lines 165-179 of the dataset's repository.

    Examples
    --------
    >>> success = np.array([True, True, False])
    >>> walked, shortest = np.array([10.0, 20.0, 5.0]), np.array([10.0, 10.0, 5.0])
    >>> spl(success, walked, shortest)
    array([1. , 0.5, 0. ])
    """
    longest = np.maximum(np.maximum(path_length, shortest_length), floor)
    # 0 / 0: the agent was asked to stay and did.
    efficiency = np.divide(shortest_length, longest, out=np.ones_like(longest), where=longest > 0)
    return np.where(success, efficiency, 0.0)


def navigation_error(goal_distance: FloatArray, offsets: IntArray) -> FloatArray:
    """Distance from the stop to the annotated goal, per episode.

    Parameters
    ----------
    goal_distance : float array of shape (n_poses,)
        Metres along the navigation graph from the pose's viewpoint to the end of the episode's
        annotated path.
    offsets : int array of shape (n_episodes + 1,)
        Where each episode's poses begin and end.

    Returns
    -------
    float array of shape (n_episodes,)
        Metres, at least 0, lower is better.

    References
    ----------
    .. [1] Anderson et al., "Vision-and-Language Navigation", CVPR 2018, section 4.2.
    """
    return goal_distance[last_of(offsets)]


def oracle_error(goal_distance: FloatArray, offsets: IntArray) -> FloatArray:
    """Distance to the annotated goal from the trajectory's closest pose, per episode.

    Parameters, range and source are those of :func:`navigation_error`.

    Examples
    --------
    >>> oracle_error(np.array([4.0, 1.0, 2.0, 3.0]), np.array([0, 3, 4]))
    array([1., 3.])
    """
    return np.minimum.reduceat(goal_distance, offsets[:-1])


def oracle_path_success(planner_distance: FloatArray, offsets: IntArray) -> BoolArray:
    """Whether any pose is less than 3 m from the end of the planner's path, per episode.

    Parameters
    ----------
    planner_distance : float array of shape (n_poses,)
        Metres along the navigation graph from the pose to the end of the planner's path.
    offsets : int array of shape (n_episodes + 1,)
        Where each episode's poses begin and end.

    Returns
    -------
    bool array of shape (n_episodes,)
        True is better.

    References
    ----------
    .. [1] ``tasks/NDH/eval.py`` of mmurray/cvdn at 97a4ae9.

    Examples
    --------
    >>> oracle_path_success(np.array([4.0, 2.9, 5.0, 3.0]), np.array([0, 3, 4]))
    array([ True, False])
    """
    return np.less(np.minimum.reduceat(planner_distance, offsets[:-1]), SUCCESS_DISTANCE)


def steps(offsets: IntArray) -> IntArray:
    """Poses after the first, per episode; turning on the spot counts as a step.

    Examples
    --------
    >>> steps(np.array([0, 3, 4]))
    array([2, 0])
    """
    return np.diff(offsets) - 1


def jumps(is_jump: BoolArray, offsets: IntArray) -> IntArray:
    """Legs between two different viewpoints without an edge, per episode.

    Every published evaluator counts a jump at the shortest distance between its ends and does not
    report it; we report the number.

    Parameters
    ----------
    is_jump : bool array of shape (n_poses,)
        Whether the leg from the previous pose is a jump; False for an episode's first pose.
    offsets : int array of shape (n_episodes + 1,)
        Where each episode's poses begin and end.

    Returns
    -------
    int array of shape (n_episodes,)
        At least 0.

    Examples
    --------
    >>> jumps(np.array([False, True, True, False]), np.array([0, 3, 4]))
    array([2, 0])
    """
    return np.add.reduceat(is_jump, offsets[:-1], dtype=np.int64)


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
    # A trajectory that covers little of the path is expected to be short, so length alone earns
    # nothing.
    expected = coverage * annotated_length
    spread = expected + np.abs(expected - path_length)
    length_score = np.divide(expected, spread, out=np.ones_like(spread), where=spread > 0)
    return coverage * length_score
