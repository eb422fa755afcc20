"""How well the agent navigated: one value per episode, computed from per-pose arrays.

Per-pose arrays are flat with ``offsets`` (see :mod:`reverie_eval.arrays`); every episode has at
least one pose.
"""

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray, last_of, row_of

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
