"""How well the agent pointed at the target from its stop: one value per episode.

Points and outlines are headings and elevations in turns, as SOON's agents submit them: heading /
2 pi, and (elevation + pi) / 2 pi. They are compared as plain numbers, as its evaluators do: a point
a whole turn away is another one, and an outline across heading 0 is not the one that is seen.
"""

from typing import Literal

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.geometry import are_inside


def detection_success(point: FloatArray, outline: FloatArray) -> BoolArray:
    """Whether the point is inside the target's outline as seen from the stop, per episode.

    Parameters
    ----------
    point : float array of shape (n_episodes, 2)
        NaN where the agent predicts no point.
    outline : float array of shape (n_episodes, 5, 2)
        Centre and corners; NaN where the target is not seen. On the border is outside.

    Returns
    -------
    bool array of shape (n_episodes,)
        True is better.

    References
    ----------
    .. [1] ``evaluation_script/main.py`` lines 96-121 of ZhuFengdaaa/SOON-EvalAI-Starters at
       66f5e37; the comparison is that of ``shapely.Polygon.contains``.
    """
    return are_inside(point, outline[:, 1:])


def heading_error(point: FloatArray, outline: FloatArray) -> FloatArray:
    """Difference in heading from the target's centre, per episode.

    Parameters and source are those of :func:`detection_success`.

    Returns
    -------
    float array of shape (n_episodes,)
        Turns, at least 0, lower is better; NaN where there is no point, or the target is not seen.
    """
    return np.abs(outline[:, 0, 0] - point[:, 0])


def elevation_error(point: FloatArray, outline: FloatArray) -> FloatArray:
    """Difference in elevation from the target's centre; otherwise as :func:`heading_error`."""
    return np.abs(outline[:, 0, 1] - point[:, 1])


def point_error(
    heading_error: FloatArray,
    elevation_error: FloatArray,
    detected: BoolArray,
    point_errors: Literal["detections", "where the target is seen"],
) -> FloatArray:
    """Distance of the point from the target's centre, per episode.

    Parameters
    ----------
    heading_error, elevation_error : float arrays of shape (n_episodes,)
        Turns; NaN where there are none.
    detected : bool array of shape (n_episodes,)
        Whether the point is inside the outline.
    point_errors : "detections" or "where the target is seen"
        Which episodes have one; the official script takes detections.

    Returns
    -------
    float array of shape (n_episodes,)
        Turns, at least 0, lower is better; NaN for episodes that have none.

    Examples
    --------
    >>> errors = np.array([0.3, 0.3]), np.array([0.4, 0.4]), np.array([True, False])
    >>> point_error(*errors, "detections")
    array([0.5, nan])
    """
    error = np.hypot(heading_error, elevation_error)
    return np.where(detected, error, np.nan) if point_errors == "detections" else error
