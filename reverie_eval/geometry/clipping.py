"""Cutting away what lies behind a camera, before it is projected.

A point behind the camera would be mirrored into the picture.
"""

import numpy as np

from reverie_eval.arrays import FloatArray


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
