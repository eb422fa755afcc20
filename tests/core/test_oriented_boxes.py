"""Bounding rectangles of oriented boxes in the views, compared with polygons clipped one by one."""

from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from reverie_eval.arrays import FloatArray
from reverie_eval.geometry import (
    HEIGHT,
    N_VIEWS,
    NEAR,
    VIEW_AXES,
    WIDTH,
    OrientedBoxes,
    boxes_in_views,
    pixels_of,
    world_to_camera,
)
from reverie_eval.geometry._framing import bounds_in_views

EYE = np.zeros(3)
WHOLE_PICTURE = (0.0, 0.0, 640.0, 480.0)
Bounds = dict[int, tuple[float, ...]]


def upright(centre: tuple[float, ...], radii: tuple[float, ...], yaw: float = 0.0) -> OrientedBoxes:
    """Return one upright box, turned to the left."""
    turn = np.deg2rad(yaw)
    return OrientedBoxes.along(
        np.array([centre], dtype=float),
        np.array([[np.cos(turn), np.sin(turn), 0.0]]),
        np.array([[-np.sin(turn), np.cos(turn), 0.0]]),
        np.array([radii], dtype=float),
    )


def cube(*centre: float, radius: float = 0.5, yaw: float = 0.0) -> OrientedBoxes:
    return upright(centre, (radius,) * 3, yaw)


BESIDE = upright((0.3, 0, 0.5), (0.1, 1.2, 0.5))
"""To the camera's right, from eye height on upwards; the horizon is the border of other rows."""
BENEATH = upright((0.3, 0, -0.5), (0.1, 1.2, 0.5))


def bounds_of(box: OrientedBoxes, position: FloatArray = EYE) -> Bounds:
    """Return the bounds of the only box by view."""
    seen, view, bounds = bounds_in_views(position, box)
    assert not seen.any()
    return dict(zip(view.tolist(), map(tuple, bounds.tolist()), strict=True))


@pytest.mark.parametrize(
    ("box", "view", "expected"),
    [
        pytest.param(cube(0, 2, 0), 12, (181.436, 101.436, 458.564, 378.564), id="straight ahead"),
        pytest.param(cube(2, 0, 0), 15, (181.436, 101.436, 458.564, 378.564), id="to the east"),
        pytest.param(cube(0, 2, 0), 13, (0, 66.667, 234.935, 413.333), id="cut at the left"),
        pytest.param(cube(0, 2, 0), 23, (405.065, 66.667, 640, 413.333), id="cut at the right"),
        pytest.param(cube(0, 2, 0), 24, (160, 325.065, 480, 480), id="cut below"),
        pytest.param(cube(0, 2, 0), 0, (160, 0, 480, 154.935), id="cut above"),
        pytest.param(
            cube(0, 2, 1, radius=0.2), 12, (273.812, 0, 366.188, 88.839), id="above the horizon"
        ),
        pytest.param(
            cube(0, 2, 0, yaw=45), 12, (173.031, 79.240, 466.969, 400.760), id="edge to the camera"
        ),
        pytest.param(
            upright((1, 1, 0), (0.5, 2, 0.5)), 12, (389.282, 0, 640, 480), id="partly behind"
        ),
        pytest.param(cube(0, -2, 0), 12, None, id="behind"),
        pytest.param(cube(0, 0, 0), 12, WHOLE_PICTURE, id="around the camera"),
        pytest.param(
            upright((0, 2, 0), (0.5, 0, 0.5)), 12, (216.077, 136.077, 423.923, 343.923), id="flat"
        ),
        pytest.param(upright((0, 0.05, 0), (9, 0.04, 9)), 12, None, id="before the picture begins"),
        pytest.param(upright((0, 5, 0), (9, 1, 9)), 12, WHOLE_PICTURE, id="larger than the view"),
        pytest.param(upright((0, 50, 0), (90, 1, 90)), 12, WHOLE_PICTURE, id="and far away"),
        pytest.param(BESIDE, 28, WHOLE_PICTURE, id="bottom at eye height, to the border below"),
        pytest.param(BENEATH, 4, WHOLE_PICTURE, id="top at eye height, to the border above"),
        pytest.param(BESIDE, 4, (0, 0, 640, 0), id="bottom at eye height, only the border"),
    ],
)
def test_a_box_in_a_view(box: OrientedBoxes, view: int, expected: tuple[float, ...] | None) -> None:
    found = bounds_of(box).get(view)
    assert found == (None if expected is None else pytest.approx(expected, abs=5e-4))


def test_a_camera_inside_a_box_sees_it_in_every_view() -> None:
    """The box of a shelf can surround a camera in front of it; the published files agree."""
    assert bounds_of(cube(0, 0, 0)) == dict.fromkeys(range(N_VIEWS), WHOLE_PICTURE)


def test_a_point_on_the_horizon_is_on_the_edge_of_upper_and_lower_views() -> None:
    """Points on the edge belong to the image, however their last bit was rounded."""
    found = bounds_of(cube(0, 7, 0, radius=0))
    expected = {0: (320, 0), 1: (42.872, 0), 11: (597.128, 0), 12: (320, 240), 13: (80, 240)}
    expected |= {23: (560, 240), 24: (320, 480), 25: (42.872, 480), 35: (597.128, 480)}
    assert found == {
        view: pytest.approx((*pixel, *pixel), abs=1e-3) for view, pixel in expected.items()
    }


@pytest.mark.parametrize("height", [0.5, -0.5])
def test_a_box_that_only_touches_the_edge_covers_no_pixel(height: float) -> None:
    """A box that begins at eye height is only in the rows of views on its side of the horizon."""
    box = upright((0.3, 1, height), (0.1, 0.2, 0.5))
    rows = set((boxes_in_views(EYE, box).view // 12).tolist())
    assert rows == {1, 2 if height > 0 else 0}


def test_moving_the_camera_and_the_boxes_changes_nothing() -> None:
    away = np.array([3.0, -2.0, 1.5])
    assert bounds_of(cube(3, 0, 1.5), away) == bounds_of(cube(0, 2, 0))


@pytest.mark.parametrize(
    ("half_width", "expected"),
    [
        pytest.param(10.5, [309, 229, 22, 22], id="edges on the pixels' centres take them in"),
        pytest.param(10.5 - 1e-5, [310, 230, 20, 20], id="a little less does not"),
        pytest.param(10.5 - 1e-7, [309, 229, 22, 22], id="rounding comes first"),
        pytest.param(0.5 - 1e-5, None, id="no pixel's centre"),
        pytest.param(0.5, [319, 239, 2, 2], id="four pixels' centres"),
    ],
)
def test_whole_pixels(half_width: float, expected: list[int] | None) -> None:
    """A flat square two metres ahead, so many pixels to either side of the picture's centre."""
    radius = half_width * 2 / (240 * np.sqrt(3))
    seen = boxes_in_views(EYE, upright((0, 2, 0), (radius, 0, radius)))
    found = dict(zip(seen.view.tolist(), seen.box_xywh.tolist(), strict=True))
    assert found.get(12) == expected


def test_the_whole_image_is_640_by_480_pixels() -> None:
    seen = boxes_in_views(EYE, cube(0, 0, 0))
    assert seen.box_xywh.tolist() == [[0, 0, 640, 480]] * N_VIEWS


def test_no_boxes_give_no_rectangles() -> None:
    seen = boxes_in_views(EYE, cube(0, 2, 0)[np.zeros(0, dtype=np.int64)])
    assert [len(column) for column in seen] == [0, 0, 0]


def test_axes_are_made_orthogonal_unit_vectors() -> None:
    """Files give them with a few digits."""
    box = OrientedBoxes.along(
        np.zeros((1, 3)), np.array([[0.0, 3.0, 0.0]]), np.array([[2.0, 0.5, 0.0]]), np.ones((1, 3))
    )
    assert box.axes[0].tolist() == [[0, 1, 0], [1, 0, 0], [0, 0, -1]]


# The oracle: faces clipped at the near plane one by one, then shapely's hull and intersection.

CLOSE = 1e-4
"""Pixels; where an edge is all but parallel to the near plane, two ways of cutting it differ."""
CORNER_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
FACES = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
PICTURE = shapely.box(0, 0, WIDTH, HEIGHT)
SHOWN = NEAR - 1e-9
"""Metres from which on a point is shown: one in the near plane is, however its last bit fell."""


def clipped(face: FloatArray) -> list[FloatArray]:
    """Cut a polygon in a camera's frame at the near plane (Sutherland and Hodgman)."""
    kept: list[FloatArray] = []
    for start, end in pairwise([*face, face[0]]):
        if start[2] >= SHOWN:
            kept.append(start)
        if (start[2] >= SHOWN) != (end[2] >= SHOWN):
            kept.append(start + (end - start) * (NEAR - start[2]) / (end[2] - start[2]))
    return kept


def slow_bounds(box: OrientedBoxes, position: FloatArray, view: int) -> tuple[float, ...] | None:
    corners = box.centre[0] + (CORNER_SIGNS * box.radii[0]) @ box.axes[0]
    seen = world_to_camera(corners, position, VIEW_AXES[view])
    points = [point for face in FACES for point in clipped(seen[face])]
    if not points:
        return None
    hull = shapely.MultiPoint(pixels_of(np.array(points))).convex_hull
    shown = shapely.intersection(hull, PICTURE)
    return None if shown.is_empty else tuple(shown.bounds)


def tall(bounds: tuple[float, ...] | None) -> bool:
    """Whether bounds do more than touch the edge of the image."""
    return bounds is not None and bounds[2] - bounds[0] > CLOSE and bounds[3] - bounds[1] > CLOSE


coordinate = st.floats(-2.5, 2.5)
direction = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)


@st.composite
def askew(draw: st.DrawFn) -> OrientedBoxes:
    """Draw a box of any orientation near the origin, or around it."""
    first = draw(direction.filter(lambda axis: np.linalg.norm(axis) > 0.1))
    second = draw(direction.filter(lambda axis: np.linalg.norm(np.cross(first, axis)) > 0.1))
    centre = np.array([draw(st.tuples(*[coordinate] * 3))])
    radii = np.array([draw(st.tuples(*[st.floats(0.01, 1.5)] * 3))])
    return OrientedBoxes.along(centre, first[None], second[None], radii)


@st.composite
def furnished(draw: st.DrawFn) -> OrientedBoxes:
    """Draw a box as people place them: upright, in decimetres, often with a face at eye height."""
    x, y, z = (draw(st.integers(-25, 25)) / 10 for _ in "xyz")
    radii = tuple(draw(st.integers(1, 15)) / 10 for _ in "xyz")
    height = draw(st.sampled_from([z, radii[2], -radii[2]]))
    return upright((x, y, height), radii, yaw=draw(st.sampled_from([0, 15, 30, 45, 90])))


oriented = st.one_of(askew(), furnished())


@given(oriented)
def test_bounds_equal_those_of_clipped_polygons(box: OrientedBoxes) -> None:
    found = bounds_of(box)
    for view in range(N_VIEWS):
        expected = slow_bounds(box, EYE, view)
        if tall(expected) or tall(found.get(view)):
            assert found.get(view) == pytest.approx(expected, abs=CLOSE)


@given(oriented)
def test_bounds_are_inside_the_image(box: OrientedBoxes) -> None:
    _, _, bounds = bounds_in_views(EYE, box)
    assert (bounds >= 0).all()
    assert (bounds[:, 2:] <= (WIDTH, HEIGHT)).all()
    assert (bounds[:, :2] <= bounds[:, 2:]).all()


@given(oriented)
def test_whole_pixels_are_within_half_a_pixel_of_the_bounds(box: OrientedBoxes) -> None:
    exact = bounds_of(box)
    _, views, boxes = boxes_in_views(EYE, box)
    for view, (left, top, width, height) in zip(views.tolist(), boxes.tolist(), strict=True):
        assert 0 <= left < left + width <= WIDTH
        assert 0 <= top < top + height <= HEIGHT
        whole = (left, top, left + width, top + height)
        assert np.abs(np.subtract(whole, exact[view])).max() <= 0.5 + 1e-6


@given(oriented)
def test_a_visible_centre_is_inside_the_bounds(box: OrientedBoxes) -> None:
    found = bounds_of(box)
    for view in range(N_VIEWS):
        seen = world_to_camera(box.centre[0], EYE, VIEW_AXES[view])
        if seen[2] > NEAR:
            x, y = pixels_of(seen)
            if 0 <= x <= WIDTH and 0 <= y <= HEIGHT:
                left, top, right, bottom = found[view]
                assert left - 1e-6 <= x <= right + 1e-6
                assert top - 1e-6 <= y <= bottom + 1e-6


@given(oriented)
def test_turning_the_world_by_30_degrees_moves_the_box_to_the_next_view(box: OrientedBoxes) -> None:
    """Headings turn right, so the world turns clockwise."""
    turn = np.deg2rad(30)
    clockwise = np.array(
        [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    turned = OrientedBoxes(box.centre @ clockwise.T, box.axes @ clockwise.T, box.radii)
    before, after = bounds_of(box), bounds_of(turned)
    for view in range(N_VIEWS):
        following = 12 * (view // 12) + (view + 1) % 12
        if tall(before.get(view)) or tall(after.get(following)):
            assert after[following] == pytest.approx(before[view], abs=1e-6)


@given(oriented)
def test_bounds_contain_every_visible_point_of_the_surface(box: OrientedBoxes) -> None:
    """Except for points exactly on the edge of the image, where the last bit decides."""
    found = bounds_of(box)
    share = np.linspace(-1, 1, 15)
    across, along = (grid.ravel() for grid in np.meshgrid(share, share))
    sides = [
        np.insert(np.stack([across, along], axis=1), axis, side, axis=1)
        for axis in range(3)
        for side in (-1, 1)
    ]
    surface = box.centre[0] + (np.concatenate(sides) * box.radii[0]) @ box.axes[0]
    for view in range(N_VIEWS):
        seen = world_to_camera(surface, EYE, VIEW_AXES[view])
        pixels = pixels_of(seen[seen[:, 2] > NEAR])
        shown = pixels[(np.abs(pixels / (WIDTH, HEIGHT) - 0.5) < 0.5 - 1e-9).all(axis=1)]
        if len(shown):
            left, top, right, bottom = found[view]
            assert (shown >= (left - 1e-6, top - 1e-6)).all()
            assert (shown <= (right + 1e-6, bottom + 1e-6)).all()


@given(st.lists(oriented, min_size=2, max_size=5))
def test_boxes_are_independent(boxes: list[OrientedBoxes]) -> None:
    together = OrientedBoxes(
        np.concatenate([box.centre for box in boxes]),
        np.concatenate([box.axes for box in boxes]),
        np.concatenate([box.radii for box in boxes]),
    )
    box, view, bounds = bounds_in_views(EYE, together)
    assert list(zip(box, view, strict=True)) == sorted(zip(box, view, strict=True))
    for row, alone in enumerate(boxes):
        mine = box == row
        assert dict(zip(view[mine].tolist(), map(tuple, bounds[mine].tolist()), strict=True)) == {
            key: pytest.approx(value, abs=1e-9) for key, value in bounds_of(alone).items()
        }
