"""Boxes predicted in the image of any camera, warped to a view of the same panorama.

Both cameras are at the same position, so a pixel of one corresponds to a pixel of the other at any
depth, and a box becomes a quadrilateral.
"""

import numpy as np

from reverie_eval.arrays import Array, FloatArray, IntArray
from reverie_eval.geometry._views import HEIGHT, VIEW_AXES, WIDTH, axes, pixels_of, rays_of

_MIN_DEPTH = 1e-3
"""Depth of a ray in a view, as a share of its depth in the camera, below which no image shows it.
Cutting there, and not at 0, keeps the division of the projection finite."""


def warp(box_xywh: Array, camera: FloatArray, view: IntArray) -> Array:
    """Warp boxes from the cameras in which they were predicted to views.

    Parameters
    ----------
    box_xywh : float or int array of shape (n, 4)
        Left, top, width and height in pixels of the camera's image, which has the size and the
        field of view of a view; widths and heights are not negative.
    camera : float array of shape (n, 2)
        Heading and elevation, radians.
    view : int array of shape (n,)
        The views to warp them to.

    Returns
    -------
    array of shape (n,) of shapely polygons
        In pixels of the views, cut to the image; empty if the image shows nothing of the box.

    References
    ----------
    .. [1] Hartley and Zisserman, "Multiple View Geometry in Computer Vision", 2nd edition, 2004,
       section 8.4: images from one position differ by the homography ``K R K^-1`` at any depth.
    """
    import shapely

    left, top, width, height = box_xywh.T.astype(np.float64)
    right, bottom = left + width, top + height
    corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
    rays = rays_of(corners.transpose(2, 0, 1)) @ axes(camera) @ VIEW_AXES[view].transpose(0, 2, 1)
    # The homography is applied to corner rays, not pixels, so that those behind the view can be
    # cut away instead of being mirrored into its image.
    in_front = [clip_at_depth(box_rays, _MIN_DEPTH) for box_rays in rays]
    outlines = [shapely.Polygon(pixels_of(each) if len(each) else None) for each in in_front]
    return np.asarray(shapely.intersection(outlines, shapely.box(0, 0, WIDTH, HEIGHT)))


def polygon_overlap(polygons: Array, target_box_xywh: Array) -> tuple[FloatArray, FloatArray]:
    """Return the areas of the intersections of polygons and boxes, and the sums of both areas.

    Parameters
    ----------
    polygons : array, shape (n,)
        As :func:`warp` returns them.
    target_box_xywh : array, shape (n, 4)
        Left, top, width and height, in pixels of the same view.

    Returns
    -------
    tuple of two float arrays, shape (n,)
        Square pixels.
    """
    import shapely

    left, top, width, height = target_box_xywh.T.astype(np.float64)
    boxes = shapely.box(left, top, left + width, top + height)
    shared = shapely.area(shapely.intersection(polygons, boxes))
    return shared, shapely.area(polygons) + width * height


def clip_at_depth(polygon: FloatArray, depth: float) -> FloatArray:
    """Clip a flat polygon at a plane in front of the camera; return the corners of what remains.

    Anything closer than ``depth``, or behind the camera, is cut away. Corners, shape (n, 3), are in
    the camera's frame (right, up, forward), in order around a convex polygon.

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
