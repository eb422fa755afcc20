"""From points in the world to pixels and back, by the pinhole camera of the views."""

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.geometry._views import FOCAL_LENGTH, HEIGHT, WIDTH

CENTRE = np.array([WIDTH / 2, HEIGHT / 2])
"""Pixels from the left and the upper edge to the optical axis."""


def into_camera(points: FloatArray, position: FloatArray, axes: FloatArray) -> FloatArray:
    """Turn points of the world into a camera's own frame.

    Parameters
    ----------
    points : float array of shape (..., 3)
        Metres in the world.
    position : float array of shape (3,)
        The camera's place in the world, metres.
    axes : float array of shape (3, 3)
        The camera's axes, as :func:`reverie_eval.geometry.axes` gives them.

    Returns
    -------
    float array of shape (..., 3)
        Metres to the right, upwards, and forward (the depth).
    """
    return np.asarray((points - position) @ axes.T)


def pixels_of(rays: FloatArray) -> FloatArray:
    """Return where the picture shows points of the camera's frame.

    Parameters
    ----------
    rays : float array of shape (..., 3)
        Right, up and forward; forward is positive.

    Returns
    -------
    float array of shape (..., 2)
        Pixels to the right and down from the upper left corner, not cut to the picture.

    Examples
    --------
    >>> pixels_of(np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 1.0]])).round(3).tolist()
    [[320.0, 240.0], [735.692, 240.0]]
    """
    return np.asarray(CENTRE + FOCAL_LENGTH * rays[..., :2] * (1, -1) / rays[..., 2:])


def rays_of(pixels: FloatArray) -> FloatArray:
    """Return the directions, in the camera's frame, in which pixels look.

    The inverse of :func:`pixels_of`, with forward 1.

    Examples
    --------
    >>> rays_of(np.array([[320.0, 0.0]])).round(4).tolist()
    [[0.0, 0.5774, 1.0]]
    """
    sideways = (pixels - CENTRE) / FOCAL_LENGTH * (1, -1)
    return np.concatenate([sideways, np.ones_like(sideways[..., :1])], axis=-1)


def clip_at_depth(polygon: FloatArray, depth: float) -> FloatArray:
    """Cut a flat polygon at a plane before the camera.

    Parameters
    ----------
    polygon : float array of shape (n, 3)
        Corners in the camera's frame, in order around a convex polygon: right, up, forward.
    depth : float
        Where the plane is; what is nearer, or behind the camera, is cut away.

    Returns
    -------
    float array of shape (m, 3)
        Corners of what is left, in order; none if nothing is.

    References
    ----------
    .. [1] Sutherland and Hodgman, "Reentrant Polygon Clipping", CACM 17(1), 1974.

    Examples
    --------
    >>> triangle = np.array([[0.0, 0.0, -1.0], [2.0, 0.0, 1.0], [-2.0, 0.0, 1.0]])
    >>> clip_at_depth(triangle, 0.0)
    array([[ 1.,  0.,  0.],
           [ 2.,  0.,  1.],
           [-2.,  0.,  1.],
           [-1.,  0.,  0.]])
    """
    corners = []
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if start[2] >= depth:
            corners.append(start)
        if (start[2] >= depth) != (end[2] >= depth):
            corners.append(start + (end - start) * (depth - start[2]) / (end[2] - start[2]))
    return np.array(corners).reshape(-1, 3)
