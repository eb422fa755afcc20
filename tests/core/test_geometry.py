"""Views, projection and warping: known answers, and properties of random cameras."""

import numpy as np
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st

from reverie_eval.geometry import (
    FOCAL_LENGTH,
    HEIGHT,
    N_VIEWS,
    VIEW_AXES,
    WIDTH,
    axes,
    clip_at_depth,
    is_on_grid,
    pixels_of,
    polygon_overlap,
    rays_of,
    snap,
    view_angles,
    warp,
    world_to_camera,
)

ORIGIN = np.zeros(3)
BOX = np.array([[320.0, 240, 240, 100]])
"""From straight ahead to 30 degrees to the right, where level views meet."""

headings = st.floats(-20, 20)
elevations = st.floats(-1.5, 1.5)
cameras = st.tuples(headings, elevations).map(lambda angles: np.array([angles]))
views = st.integers(0, N_VIEWS - 1)


def test_intrinsics() -> None:
    assert pytest.approx(415.6921938, abs=1e-7) == FOCAL_LENGTH
    field_of_view_across = 2 * np.degrees(np.arctan(WIDTH / 2 / FOCAL_LENGTH))
    assert field_of_view_across == pytest.approx(75.1781789, abs=1e-7)


@pytest.mark.parametrize(
    ("heading", "elevation", "view"),
    [
        pytest.param(0, 0, 12, id="north, level"),
        pytest.param(14.999, 0, 12, id="below half a step"),
        pytest.param(15, 0, 13, id="half a step goes up"),
        pytest.param(75, 0, 15, id="half a step goes up from an even number too"),
        pytest.param(105, 0, 16, id="half a step goes up from an odd number"),
        pytest.param(344.999, 0, 23, id="below half a step from north"),
        pytest.param(345, 0, 12, id="the last half step is north"),
        pytest.param(-15, 0, 12, id="half a step left of north"),
        pytest.param(-15.001, 0, 23, id="more than half a step left of north"),
        pytest.param(-0.001, 0, 12, id="just left of north"),
        pytest.param(359.9, 0, 12, id="almost a full turn"),
        pytest.param(360, 0, 12, id="a full turn"),
        pytest.param(720, 0, 12, id="two full turns"),
        pytest.param(0, -90, 0, id="straight down"),
        pytest.param(0, -15.001, 0, id="below the lower limit"),
        pytest.param(0, -15, 12, id="at the lower limit"),
        pytest.param(0, 15, 12, id="at the upper limit"),
        pytest.param(0, 15.001, 24, id="above the upper limit"),
        pytest.param(0, 50, 24, id="farther up than the simulator turns"),
        pytest.param(0, 90, 24, id="straight up"),
        pytest.param(330, -30, 11, id="last of the lower row"),
        pytest.param(330, 30, 35, id="last of the upper row"),
    ],
)
def test_view_of_a_camera(heading: float, elevation: float, view: int) -> None:
    assert snap(np.deg2rad([[heading, elevation]])).tolist() == [view]


@given(views, st.integers(-3, 3), st.tuples(*[st.floats(-0.0009, 0.0009)] * 2))
def test_a_view_snaps_to_itself_after_full_turns(
    view: int, turns: int, off: tuple[float, float]
) -> None:
    camera = view_angles(np.array([view])) + np.array([[2 * np.pi * turns + off[0], off[1]]])
    assert (snap(camera).item(), is_on_grid(camera).item()) == (view, True)


def test_a_camera_at_the_edge_of_the_grid() -> None:
    """A difference of a thousandth of a radian still counts as on the grid."""
    off = [[0.0, 0.001], [0.0, -0.001], [0.001, 0.0]]
    assert is_on_grid(np.array(off)).tolist() == [True, True, True]


@pytest.mark.parametrize(
    "off",
    [[0.0011, 0], [-0.0011, 0], [0, 0.0011], [0, -0.0011]],
    ids=["right", "left", "up", "down"],
)
def test_a_camera_off_the_grid(off: list[float]) -> None:
    camera = view_angles(np.arange(N_VIEWS)) + off
    assert not is_on_grid(camera).any()


@pytest.mark.parametrize("kind", [np.uint8, np.int8, np.int64])
def test_view_indexes_of_any_integer_type(kind: type[np.integer]) -> None:
    """Bundles store them in 8 unsigned bits."""
    view = np.array([0, 12, 35], dtype=kind)
    expected = np.deg2rad([[0, -30], [0, 0], [330, 30]])
    assert view_angles(view) == pytest.approx(expected, abs=1e-12)


@given(cameras)
def test_axes_are_orthogonal_unit_vectors(camera: np.ndarray) -> None:
    right, up, forward = axes(camera)[0]
    assert np.allclose(axes(camera)[0] @ axes(camera)[0].T, np.eye(3), atol=1e-12)
    assert np.allclose(np.cross(right, forward), up, atol=1e-12)


@pytest.mark.parametrize(
    ("view", "expected"),
    [
        pytest.param(0, (320, 0), id="down"),
        pytest.param(1, (42.872, 0), id="down, to the right"),
        pytest.param(11, (597.128, 0), id="down, to the left"),
        pytest.param(12, (320, 240), id="level"),
        pytest.param(13, (80, 240), id="level, to the right"),
        pytest.param(23, (560, 240), id="level, to the left"),
        pytest.param(24, (320, 480), id="up"),
        pytest.param(25, (42.872, 480), id="up, to the right"),
        pytest.param(35, (597.128, 480), id="up, to the left"),
    ],
)
def test_the_horizon_to_the_north(view: int, expected: tuple[float, float]) -> None:
    rays = world_to_camera(np.array([0.0, 7, 0]), ORIGIN, VIEW_AXES[view])
    assert pixels_of(rays) == pytest.approx(expected, abs=1e-3)


def test_a_point_seen_from_a_camera_away_from_the_origin() -> None:
    # From (1, 2, 3), 2 m to the right, 1 m down and 4 m ahead of someone who looks east.
    rays = world_to_camera(np.array([5.0, 0, 2]), np.array([1.0, 2, 3]), VIEW_AXES[15])
    assert rays == pytest.approx([2, -1, 4])
    assert pixels_of(rays) == pytest.approx([320 + FOCAL_LENGTH / 2, 240 + FOCAL_LENGTH / 4])


@given(st.tuples(st.floats(-1000, 2000), st.floats(-1000, 2000)))
def test_pixels_and_rays_are_inverse(pixel: tuple[float, float]) -> None:
    assert pixels_of(rays_of(np.array([pixel]))) == pytest.approx(np.array([pixel]), abs=1e-9)


@pytest.mark.parametrize(
    ("depths", "expected"),
    [
        pytest.param([1, 1, 1, 1], 4, id="before the plane"),
        pytest.param([-1, -1, -1, -1], 0, id="behind the plane"),
        pytest.param([1, 1, -1, -1], 4, id="two corners behind"),
        pytest.param([1, 1, 1, -1], 5, id="one corner behind"),
        pytest.param([1, -1, -1, -1], 3, id="three corners behind"),
        pytest.param([0, 0, 0, 0], 4, id="in the plane"),
    ],
)
def test_corners_after_clipping(depths: list[float], expected: int) -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    square[:, 2] = depths
    clipped = clip_at_depth(square, 0.0)
    assert len(clipped) == expected
    assert (clipped[:, 2] >= 0).all()


def test_a_box_in_the_next_view() -> None:
    polygon = warp(BOX, view_angles(np.array([12])), np.array([13])).item()
    # What lay straight ahead is 240 pixels to the left, and what lay to the right is ahead; below
    # the horizon pixels stretch by the ratio of the cosines of the headings.
    expected = [(80, 240), (80, 240 + 200 / 3**0.5), (320, 240), (320, 240 + 50 * 3**0.5)]
    rounded = sorted((round(x, 6), round(y, 6)) for x, y in polygon.exterior.coords[:-1])
    assert rounded == [pytest.approx(corner, abs=1e-6) for corner in expected]


def test_a_box_in_its_own_view() -> None:
    polygon = warp(BOX, view_angles(np.array([14])), np.array([14])).item()
    assert polygon.bounds == pytest.approx((320, 240, 560, 340), abs=1e-9)
    shared, total = polygon_overlap(np.array([polygon]), BOX)
    assert (shared.item(), total.item()) == pytest.approx((24000, 48000))


@pytest.mark.parametrize("kind", [np.int16, np.uint16])
def test_16_bit_boxes_keep_their_area(kind: type[np.integer]) -> None:
    picture = np.array([[0, 0, WIDTH, HEIGHT]], dtype=kind)
    level = np.array([12], dtype=np.uint8)
    shared, total = polygon_overlap(warp(picture, view_angles(level), level), picture)
    assert (shared.item(), total.item()) == pytest.approx((307_200, 614_400))


def test_upper_views_show_nothing_below_the_horizon() -> None:
    below = np.array([[200.0, 10, 200, 400]])
    polygons = warp(below, view_angles(np.array([3])), np.array([27]))
    assert shapely.area(polygons).tolist() == [0.0]


def test_nothing_behind_the_view_is_mirrored_into_it() -> None:
    # The camera looks straight up, the view to the horizon: the half of the box at the back of
    # the head is behind the view, the half before the forehead too high for it.
    box = np.array([[300.0, 230, 40, 20]])
    polygons = warp(box, np.array([[0.0, np.pi / 2]]), np.array([12]))
    assert shapely.area(polygons).tolist() == [0.0]


@given(cameras, st.tuples(*[st.floats(0, 600)] * 2), st.tuples(*[st.floats(0.01, 40)] * 2))
def test_a_warped_box_contains_the_warped_points_of_the_box(
    camera: np.ndarray, corner: tuple[float, float], size: tuple[float, float]
) -> None:
    middle = np.array([[corner[0] + size[0] / 2, corner[1] + size[1] / 2]])
    view = snap(camera)
    ray = rays_of(middle) @ axes(camera)[0] @ VIEW_AXES[view[0]].T
    assume(ray[0, 2] > 0.01)
    pixel = pixels_of(ray)[0]
    assume((pixel > 1).all() and (pixel < [WIDTH - 1, HEIGHT - 1]).all())
    polygon = warp(np.array([[*corner, *size]]), camera, view).item()
    assert polygon.distance(shapely.Point(pixel)) < 1e-6


@given(views, st.integers(1, 11), st.tuples(*[st.floats(0, 600)] * 2))
def test_turning_the_world_changes_nothing(
    view: int, steps: int, corner: tuple[float, float]
) -> None:
    box = np.array([[*corner, 30.0, 20.0]])
    camera = view_angles(np.array([view])) + np.array([0.2, 0.1])
    turned = camera + np.array([steps * np.pi / 6, 0])
    next_view = np.array([view - view % 12 + (view + steps) % 12])
    here = warp(box, camera, np.array([view])).item()
    there = warp(box, turned, next_view).item()
    assert here.symmetric_difference(there).area < 1e-6
