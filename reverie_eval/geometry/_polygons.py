"""Polygons: points in them, exactly, and boxes of any camera warped to a view of the panorama.

Both cameras of a warped box are at the same position, so a pixel of one corresponds to a pixel of
the other at any depth, and a box becomes a quadrilateral.
"""

import numpy as np

from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray
from reverie_eval.geometry._views import HEIGHT, VIEW_AXES, WIDTH, axes, pixels_of, rays_of

# Share of its terms within which rounding may change the sign of an orientation: three times the
# bound of Shewchuk, "Adaptive Precision Floating-Point Arithmetic", 1997, section 4.2.
_UNSURE = 1e-15


def are_inside(point: FloatArray, corners: FloatArray) -> BoolArray:
    """Whether each point is strictly inside its polygon; on the border is outside.

    Where the border crosses itself, what it winds around twice is outside. Signs are exact, so no
    rounding decides on which side of an edge a point is.

    Parameters
    ----------
    point : float array of shape (n, 2)
        NaN is outside.
    corners : float array of shape (n, n_corners, 2)
        In the order of the border; the last is joined with the first.

    Returns
    -------
    bool array of shape (n,)

    Examples
    --------
    >>> square = np.array([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]] * 3)
    >>> are_inside(np.array([[0.5, 0.5], [1.0, 0.5], [0.5, 1.5]]), square)
    array([ True, False, False])
    """
    inside = np.zeros(len(point), dtype=np.bool_)
    on_border = np.zeros(len(point), dtype=np.bool_)
    height = point[:, 1]
    for index in range(corners.shape[1]):
        begin, end = corners[:, index - 1], corners[:, index]
        side = _side(point, begin, end)
        low, high = np.minimum(begin, end), np.maximum(begin, end)
        on_border |= (side == 0) & ((low <= point) & (point <= high)).all(axis=1)
        # A ray to the right meets an edge that goes up and has the point on its left, or down and
        # on its right. The lower end of an edge belongs to it, and the upper end does not.
        goes_up = begin[:, 1] < end[:, 1]
        spans = (low[:, 1] <= height) & (height < high[:, 1])
        inside ^= spans & np.where(goes_up, side > 0, side < 0)
    return inside & ~on_border


def _side(point: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Return 1 for points to the left of the way from begin to end, -1 for the right, else 0."""
    edge, to_point = end - begin, point - begin
    first, second = edge[:, 0] * to_point[:, 1], edge[:, 1] * to_point[:, 0]
    side = np.sign(first - second)
    # Fractions are slow, but hardly any point is so close to an edge.
    unsure = np.abs(first - second) <= _UNSURE * (np.abs(first) + np.abs(second))
    for row in np.flatnonzero(unsure).tolist():
        side[row] = _exact_side(*point[row], *begin[row], *end[row])
    return side


def _exact_side(*coordinates: float) -> int:
    from fractions import Fraction  # slow to import, and hardly ever needed

    x, y, x0, y0, x1, y1 = map(Fraction, coordinates)
    area = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
    return (area > 0) - (area < 0)


# Depth of a ray in a view, as a share of its depth in the camera, below which no image shows it.
# Cutting there, and not at 0, keeps the division of the projection finite.
_MIN_DEPTH = 1e-3


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
    import shapely  # a third of the start-up time, and boxes in views do not need it

    left, top, width, height = box_xywh.T.astype(np.float64)
    right, bottom = left + width, top + height
    # In order around the box, which clipping needs.
    corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
    rays = rays_of(corners.transpose(2, 0, 1)) @ axes(camera) @ VIEW_AXES[view].transpose(0, 2, 1)
    outlines = np.empty(len(rays), dtype=object)
    is_in_front = (rays[..., 2] >= _MIN_DEPTH).all(axis=1)
    outlines[is_in_front] = shapely.polygons(pixels_of(rays[is_in_front]))
    # The homography is applied to corner rays, not pixels, so that those behind the view can be
    # cut away instead of being mirrored into its image.
    for row in np.flatnonzero(~is_in_front):
        kept = clip_at_depth(rays[row], _MIN_DEPTH)
        outlines[row] = shapely.Polygon(pixels_of(kept) if len(kept) else None)
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
    # One call for all pairs: shapely's loop is in C.
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
    is_kept = polygon[:, 2] >= depth
    if is_kept.all() or not is_kept.any():
        return polygon[is_kept]
    corners = []
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if start[2] >= depth:
            corners.append(start)
        if (start[2] >= depth) != (end[2] >= depth):
            corners.append(start + (end - start) * (depth - start[2]) / (end[2] - start[2]))
    return np.array(corners).reshape(-1, 3)
