"""The 36 views of a panorama: their directions, their pinhole camera, and snapping to them.

View ``v`` looks 30 degrees times ``v % 12`` to the right of north (+y) and 30 degrees times
``v // 12 - 1`` up: 0-11 look down, 12-23 are level, 24-35 look up. The world is metric with z up.
Headings are radians from +y towards +x, elevations radians upwards. A camera's frame is right, up
and forward, in metres.

References
----------
.. [1] ``MatterSim.cpp`` (``setHeadingElevation``) and ``MatterSim.hpp`` of
   peteanderson80/Matterport3DSimulator; the README of YuankaiQi/REVERIE takes views from there.
"""

from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray, frozen

N_VIEWS = 36
N_HEADINGS = 12
STEP = np.pi / 6
"""Radians between neighbouring views, in heading and in elevation."""

WIDTH, HEIGHT = 640, 480
"""Pixels of a view."""
FIELD_OF_VIEW = np.pi / 3
"""Vertical, radians."""
FOCAL_LENGTH = HEIGHT / 2 / np.tan(FIELD_OF_VIEW / 2)
"""Pixels, the same horizontally and vertically: 415.692."""
CENTRE = np.array([WIDTH / 2, HEIGHT / 2])
"""The optical axis, in pixels from the left and upper edges."""
NEAR = 0.1
"""Metres from the camera to the simulator's near plane; closer things are not shown."""

ON_GRID = 1e-3
"""Radians by which a camera's angles may differ from a view's and still count as that view. At the
centre this is less than half a pixel; it is more than rounding to three decimals changes."""

FAR_OFF = 15.0
"""Degrees between a camera and its view beyond which warping makes many exact boxes miss."""


def view_angles(view: IntArray) -> FloatArray:
    """Heading and elevation of views.

    Parameters
    ----------
    view : int array of shape (n,)
        View indexes, 0 to 35.

    Returns
    -------
    float array of shape (n, 2)
        Radians; headings in [0, 2 pi), elevations -pi/6, 0 or pi/6.

    Examples
    --------
    >>> np.rad2deg(view_angles(np.array([0, 12, 35]))).round().tolist()
    [[0.0, -30.0], [0.0, 0.0], [330.0, 30.0]]
    """
    # Bundles hold views in 8 unsigned bits, in which `row - 1` would wrap around.
    row, column = np.divmod(view.astype(np.int64), N_HEADINGS)
    return np.stack([column * STEP, (row - 1) * STEP], axis=-1)


def snap(camera: FloatArray) -> IntArray:
    """Return the view that the simulator shows for a camera's angles.

    Headings are wrapped to [0, 2 pi) and rounded to the nearest multiple of 30 degrees, halves up.
    Elevations above 15 or below -15 degrees snap to the upper or lower row; exactly 15 stays level
    [1]_.

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
    # np.round would round halves to even. From 345 degrees on the nearest heading is 360, view 0.
    column = np.floor(heading / STEP + 0.5).astype(np.int64) % N_HEADINGS
    row = 1 + (elevation > STEP / 2) - (elevation < -STEP / 2).astype(np.int64)
    return np.asarray(column + N_HEADINGS * row)


def level_view(heading: float) -> int:
    """Return the index of the level view that is nearest to a heading, radians.

    Examples
    --------
    >>> level_view(np.deg2rad(44.0)), level_view(np.deg2rad(46.0))
    (13, 14)
    """
    return int(snap(np.array([[heading, 0.0]]))[0])


def is_on_grid(camera: FloatArray) -> BoolArray:
    """Whether a camera's angles equal those of the view that they snap to, up to ``ON_GRID``.

    Parameters are those of :func:`snap`.

    Examples
    --------
    >>> is_on_grid(np.deg2rad([[359.99, 0.0], [29.0, 0.0]]))
    array([ True, False])
    """
    heading_off, elevation_off = (camera - VIEW_ANGLES.take(snap(camera), axis=0)).T
    # A heading just below a full turn is close to view 0: wrap differences to [-pi, pi).
    heading_off = np.mod(heading_off + np.pi, 2 * np.pi) - np.pi
    off = np.maximum(np.abs(heading_off), np.abs(elevation_off))
    return np.asarray(off <= ON_GRID)


def degrees_off(camera: FloatArray) -> FloatArray:
    """Degrees between a camera's direction and that of the view that it snaps to.

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
    return degrees_between(axes(camera)[:, 2], VIEW_AXES[snap(camera), 2])


def degrees_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles between vectors, row by row."""
    # arctan2 instead of arccos, which loses half of the digits of small angles.
    across = np.linalg.norm(np.cross(first, second), axis=-1)
    return np.asarray(np.rad2deg(np.arctan2(across, (first * second).sum(axis=-1))))


def axes(camera: FloatArray) -> FloatArray:
    """Return the axes of cameras in the world.

    Parameters are those of :func:`snap`.

    Returns
    -------
    float array of shape (n, 3, 3)
        Rows of unit vectors: right, up, forward.

    Examples
    --------
    >>> axes(np.array([[np.pi / 2, 0.0]])).round(6)[0].tolist()
    [[0.0, -1.0, 0.0], [-0.0, -0.0, 1.0], [1.0, 0.0, 0.0]]
    """
    # Headings turn clockwise from +y, as a compass does and mathematics does not.
    sin_heading, sin_elevation = np.sin(camera).T
    cos_heading, cos_elevation = np.cos(camera).T
    zero = np.zeros(len(camera))
    rows = (
        (cos_heading, -sin_heading, zero),
        (-sin_heading * sin_elevation, -cos_heading * sin_elevation, cos_elevation),
        (sin_heading * cos_elevation, cos_heading * cos_elevation, sin_elevation),
    )
    return np.array(rows).transpose(2, 0, 1)


VIEW_ANGLES: FloatArray = frozen(view_angles(np.arange(N_VIEWS)))
"""Shape (36, 2): heading and elevation of every view, radians."""

VIEW_AXES: FloatArray = frozen(axes(VIEW_ANGLES))
"""Shape (36, 3, 3): right, up and forward of every view."""


class Picture(NamedTuple):
    """What a picture shows: a part of the plane of a view, in its pixels. By default, the view."""

    view: int
    left: float = 0.0
    top: float = 0.0
    width: float = WIDTH
    height: float = HEIGHT


def world_to_camera(points: FloatArray, position: FloatArray, axes: FloatArray) -> FloatArray:
    """Transform points from the world to a camera's frame.

    Parameters
    ----------
    points : float array of shape (..., 3)
        Metres in the world.
    position : float array of shape (3,)
        The camera's position in the world, metres.
    axes : float array of shape (3, 3)
        The camera's axes, as :func:`axes` returns them.

    Returns
    -------
    float array of shape (..., 3)
        Metres to the right, upwards and forward (the depth).
    """
    return np.asarray((points - position) @ axes.T)


def pixels_of(points: FloatArray) -> FloatArray:
    """Project points from a camera's frame to pixels.

    Parameters
    ----------
    points : float array of shape (..., 3)
        Right, up and forward; forward is positive.

    Returns
    -------
    float array of shape (..., 2)
        Pixels to the right and down from the upper left corner; they may lie outside the image.

    Examples
    --------
    >>> pixels_of(np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 1.0]])).round(3).tolist()
    [[320.0, 240.0], [735.692, 240.0]]
    """
    # Pixels count downwards, and the frame's second axis points up.
    return np.asarray(CENTRE + FOCAL_LENGTH * points[..., :2] * (1, -1) / points[..., 2:])


def rays_of(pixels: FloatArray) -> FloatArray:
    """Return the direction in a camera's frame that each pixel shows.

    The inverse of :func:`pixels_of`, with forward 1.

    Examples
    --------
    >>> rays_of(np.array([[320.0, 0.0]])).round(4).tolist()
    [[0.0, 0.5774, 1.0]]
    """
    right_and_up = (pixels - CENTRE) / FOCAL_LENGTH * (1, -1)
    return np.concatenate([right_and_up, np.ones_like(right_and_up[..., :1])], axis=-1)
