"""Whether the agent pointed at the right object: one value per episode."""

import numpy as np

from reverie_eval.arrays import BoolArray, IntArray

ABSTAINED = -1
"""Stands for an answer that names no object; a target's id is never negative."""


def candidate_match(predicted_object: IntArray, target_object: IntArray) -> BoolArray:
    """Whether the object that was named is the target, per episode.

    Parameters
    ----------
    predicted_object : int array of shape (n_episodes,)
        Object id within the scan, or -1 for an agent that named none.
    target_object : int array of shape (n_episodes,)
        Object id within the scan, at least 0.

    Returns
    -------
    bool array of shape (n_episodes,)
        True is better. An abstention is never right.

    References
    ----------
    .. [1] ``eval_release.py`` lines 77-81 of the dataset's repository: the two ids are compared
       as text, and where the agent stopped plays no part.

    Examples
    --------
    >>> candidate_match(np.array([7, 7, -1]), np.array([7, 8, 9]))
    array([ True, False, False])
    """
    return np.equal(predicted_object, target_object)
