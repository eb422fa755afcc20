"""Boxes that were drawn in one camera, carried over to a view of the same panorama.

Both cameras stand at the same place, so a pixel of one is a pixel of the other whatever its
distance, and a box becomes a quadrilateral.
"""

from typing import TYPE_CHECKING

import numpy as np

from reverie_eval.arrays import Array, FloatArray, IntArray
from reverie_eval.geometry._projection import clip_at_depth, pixels_of, rays_of
from reverie_eval.geometry._views import HEIGHT, VIEW_AXES, WIDTH, axes

if TYPE_CHECKING:
    from shapely import Polygon


_ALMOST_SIDEWAYS = 1e-3
"""Depth of a ray, in units of its source's depth, below which it leaves any picture."""


def warp(box_xywh: Array, camera: FloatArray, view: IntArray) -> Array:
    """Carry boxes over from the cameras they were drawn in to views.

    Parameters
    ----------
    box_xywh : float or int array of shape (n, 4)
        Left, top, width and height in pixels of the camera's picture, which has the size and the
        field of view of a view; widths and heights are not negative.
    camera : float array of shape (n, 2)
        Heading and elevation, radians.
    view : int array of shape (n,)
        The views to carry them over to.

    Returns
    -------
    array of shape (n,) of shapely polygons
        In pixels of the views, cut to the picture; empty where nothing of the box is in it.

    References
    ----------
    .. [1] Hartley and Zisserman, "Multiple View Geometry in Computer Vision", 2nd edition, 2004,
       section 8.4: pictures from one place differ by the homography ``K R K^-1``, whatever the
       depth. Here it is applied to corners one by one, for those behind the view to be cut away.
    """
    import shapely

    rays = _corner_rays(box_xywh) @ axes(camera) @ VIEW_AXES[view].transpose(0, 2, 1)
    outlines = [_outline(corners) for corners in rays]
    return np.asarray(shapely.intersection(outlines, shapely.box(0, 0, WIDTH, HEIGHT)))


def polygon_overlap(polygons: Array, target_box_xywh: Array) -> tuple[FloatArray, FloatArray]:
    """Areas that polygons share with boxes of the same view, and both areas added.

    Parameters
    ----------
    polygons : array of shape (n,) of shapely polygons
        As :func:`warp` gives them.
    target_box_xywh : float or int array of shape (n, 4)
        Left, top, width and height in pixels.

    Returns
    -------
    two float arrays of shape (n,)
        Square pixels.
    """
    import shapely

    left, top, width, height = target_box_xywh.T.astype(np.float64)
    boxes = shapely.box(left, top, left + width, top + height)
    shared = shapely.area(shapely.intersection(polygons, boxes))
    return shared, shapely.area(polygons) + width * height


def _corner_rays(box_xywh: Array) -> FloatArray:
    """Shape (n, 4, 3): where each box's corners look, around the box."""
    left, top, width, height = box_xywh.T.astype(np.float64)
    right, bottom = left + width, top + height
    corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    return rays_of(np.array(corners).transpose(2, 0, 1))


def _outline(rays: FloatArray) -> "Polygon":
    from shapely import Polygon

    before_camera = clip_at_depth(rays, _ALMOST_SIDEWAYS)
    return Polygon(pixels_of(before_camera) if len(before_camera) else None)
