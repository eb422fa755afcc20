"""The 36 views of a panorama: where each looks, and which one a camera's angles mean.

View ``v`` looks 30 degrees times ``v % 12`` to the right of north (+y) and 30 degrees times
``v // 12 - 1`` up: 0-11 look down, 12-23 are level, 24-35 look up. The world is metric with z up.
Headings are radians from +y towards +x, elevations radians upwards.

References
----------
.. [1] ``MatterSim.cpp`` (``setHeadingElevation``) and ``MatterSim.hpp`` of
   peteanderson80/Matterport3DSimulator; the README of YuankaiQi/REVERIE takes views from there.
"""

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray, frozen

N_VIEWS = 36
N_HEADINGS = 12
STEP = np.pi / 6
"""Radians between neighbouring views, in heading and in elevation."""

WIDTH, HEIGHT = 640, 480
"""Pixels of a view."""
FIELD_OF_VIEW = np.pi / 3
"""Radians from the bottom of a view to its top."""
FOCAL_LENGTH = HEIGHT / 2 / np.tan(FIELD_OF_VIEW / 2)
"""Pixels, across and down alike: 415.692. Pixels are square and the centre is (320, 240)."""
NEAR = 0.1
"""Metres before the camera where the picture begins, as in the simulator."""

ON_GRID = 1e-3
"""Radians by which a camera's angles may differ from a view's and be that view's: less than half
a pixel at the centre, more than three decimals round away."""

FAR_OFF = 15.0
"""Degrees from a camera to its view beyond which carrying a box over costs many an exact one."""


def view_angles(view: IntArray) -> FloatArray:
    """Heading and elevation of views.

    Parameters
    ----------
    view : int array of shape (n,)
        View indexes, 0 to 35; of any size, the 8 bits of a bundle too.

    Returns
    -------
    float array of shape (n, 2)
        Radians; headings in [0, 2 pi), elevations -pi/6, 0 or pi/6.

    Examples
    --------
    >>> np.rad2deg(view_angles(np.array([0, 12, 35]))).round().tolist()
    [[0.0, -30.0], [0.0, 0.0], [330.0, 30.0]]
    """
    row, column = np.divmod(view.astype(np.int64), N_HEADINGS)
    return np.stack([column * STEP, (row - 1) * STEP], axis=-1)


def snap(camera: FloatArray) -> IntArray:
    """Return the view that the simulator shows for a camera's angles.

    Headings go to the nearest multiple of 30 degrees, halves away from zero after wrapping to a
    full turn; elevations beyond 15 degrees to the upper or lower row, exactly 15 stays level [1]_.

    Parameters
    ----------
    camera : float array of shape (n, 2)
        Heading and elevation, finite radians.

    Returns
    -------
    int array of shape (n,)
        View indexes, 0 to 35.

    References
    ----------
    .. [1] ``MatterSim.cpp``, ``setHeadingElevation``, as in the module's docstring.

    Examples
    --------
    >>> snap(np.deg2rad([[345.0, 0.0], [14.9, 15.1], [-15.1, -90.0]])).tolist()
    [12, 24, 11]
    """
    heading, elevation = np.mod(camera[:, 0], 2 * np.pi), camera[:, 1]
    column = np.floor(heading / STEP + 0.5).astype(np.int64) % N_HEADINGS
    row = 1 + np.sign(elevation).astype(np.int64) * (np.abs(elevation) > STEP / 2)
    return np.asarray(column + N_HEADINGS * row)


def is_on_grid(camera: FloatArray) -> BoolArray:
    """Whether a camera's angles are those of the view that they snap to, up to ``ON_GRID``.

    Parameters are those of :func:`snap`.

    Examples
    --------
    >>> is_on_grid(np.deg2rad([[359.99, 0.0], [29.0, 0.0]]))
    array([ True, False])
    """
    heading_off, elevation_off = (camera - view_angles(snap(camera))).T
    heading_off = np.mod(heading_off + np.pi, 2 * np.pi) - np.pi
    off = np.maximum(np.abs(heading_off), np.abs(elevation_off))
    return np.asarray(off <= ON_GRID)


def degrees_off(camera: FloatArray) -> FloatArray:
    """Degrees between where a camera looks and where the view does that it snaps to.

    Parameters are those of :func:`snap`.

    Returns
    -------
    float array of shape (n,)
        The angle between the optical axes.

    Examples
    --------
    >>> degrees_off(np.deg2rad([[10.0, 0.0], [60.0, 45.0], [0.0, 90.0]])).round(6).tolist()
    [10.0, 15.0, 60.0]
    """
    looks, view_looks = axes(camera)[:, 2], VIEW_AXES[snap(camera), 2]
    apart = np.linalg.norm(np.cross(looks, view_looks), axis=1)
    return np.asarray(np.rad2deg(np.arctan2(apart, (looks * view_looks).sum(axis=1))))


def axes(camera: FloatArray) -> FloatArray:
    """Return the directions to the right of, above and into a picture.

    Parameters are those of :func:`snap`.

    Returns
    -------
    float array of shape (n, 3, 3)
        Rows of unit vectors in the world: right, up, forward.

    Examples
    --------
    >>> axes(np.array([[np.pi / 2, 0.0]])).round(6)[0].tolist()
    [[0.0, -1.0, 0.0], [-0.0, -0.0, 1.0], [1.0, 0.0, 0.0]]
    """
    (turn_sine, rise_sine), (turn, rise) = np.sin(camera).T, np.cos(camera).T
    level = np.zeros(len(camera))
    rows = (
        (turn, -turn_sine, level),
        (-turn_sine * rise_sine, -turn * rise_sine, rise),
        (turn_sine * rise, turn * rise, rise_sine),
    )
    return np.array(rows).transpose(2, 0, 1)


VIEW_AXES: FloatArray = frozen(axes(view_angles(np.arange(N_VIEWS))))
"""Shape (36, 3, 3): right, up and forward of every view."""
