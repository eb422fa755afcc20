"""Where rooms are cut into parts; the worth of cuts in square metres is worked out by hand."""

import numpy as np
import pytest

from reverie_eval.geometry._room_parts import RoomParts

NOTHING = np.zeros((0, 2))


def parts(
    cameras: np.ndarray, edges: np.ndarray, objects: np.ndarray = NOTHING, *, whole: bool = False
) -> RoomParts:
    return RoomParts.of([objects], cameras, edges, np.zeros(len(cameras), dtype=np.int64), [whole])


def in_a_row(first: int, count: int) -> list[tuple[int, int]]:
    return [(row, row + 1) for row in range(first, first + count - 1)]


@pytest.mark.parametrize(
    ("columns", "ways", "expected"),
    [
        pytest.param(7, 1, 1, id="six pairs are worth 12, a door and a cut 13"),
        pytest.param(8, 1, 2, id="seven are worth 14"),
        pytest.param(10, 2, 1, id="two ways, two doors: eight are worth 16"),
        pytest.param(11, 2, 2, id="nine are worth 18"),
        pytest.param(8, 8, 1, id="no pair without a way"),
    ],
)
def test_walls_are_where_ways_should_be(columns: int, ways: int, expected: int) -> None:
    """Two rows of cameras, 2 m apart in both directions, with ways from some to the other row."""
    cameras = np.array([(2.0 * x, 2.0 * y) for y in (0, 1) for x in range(columns)])
    across = [(row, row + columns) for row in range(ways)]
    edges = np.array([*in_a_row(0, columns), *in_a_row(columns, columns), *across])
    found = parts(cameras, edges)
    assert len(found.room) == expected
    if expected == 2:
        assert len({*found.home[:columns]}) == len({*found.home[columns:]}) == 1


def around_a_corner() -> tuple[np.ndarray, np.ndarray]:
    """Return cameras 2 m apart: five to a corner, and the corner with four behind it."""
    cameras = np.array([*((2.0 * x, 0.0) for x in range(5)), *((10.0, 2.0 * y) for y in range(5))])
    return cameras, np.array(in_a_row(0, 10))


def test_empty_floor_is_in_no_part() -> None:
    """The rectangle around all is 11.4 by 9.4 m; those around two ways take up 30 square metres."""
    found = parts(*around_a_corner())
    assert sorted(np.bincount(found.home).tolist()) == [5, 5]
    assert found.home[:5].tolist() == [found.home[0]] * 5


def test_parts_meet_at_a_cut() -> None:
    """Half way between two rows of cameras, 2 m apart; not between those 10 m apart."""
    rows = np.array([(2.0 * x, y) for y in (0.0, 2.0, 12.0) for x in range(8)])
    ways = [*in_a_row(0, 8), *in_a_row(8, 8), *in_a_row(16, 8), (0, 8), (8, 16)]
    found = parts(rows, np.array(ways))
    low, middle, high = found.boxes[found.home[[0, 8, 16]]]
    assert [box[:, 1].tolist() for box in (low, middle, high)] == [
        pytest.approx(ends) for ends in ([-0.7, 1], [1, 2.7], [11.3, 12.7])
    ]


def test_what_is_seen_is_no_empty_floor() -> None:
    """An object in the opposite corner: no cut saves floor."""
    assert len(parts(*around_a_corner(), np.array([(0.0, 8.0)])).room) == 1


def test_some_rooms_are_left_whole() -> None:
    assert len(parts(*around_a_corner(), whole=True).room) == 1


def test_objects_belong_to_the_nearest_part_of_their_room() -> None:
    """The second of two rooms is far away, a rectangle. Main parts have most of the objects."""
    cameras, edges = around_a_corner()
    objects = np.array([(1.0, 0.5), (10.5, 6.0), (10.5, 7.0)])
    far = np.array([(30.0, 0.0), (31.0, 1.0)])
    home = np.array([0] * len(cameras) + [1])
    found = RoomParts.of([objects, far], np.vstack([cameras, far[:1]]), edges, home, [False] * 2)
    west, north, other = found.home[[0, 9, 10]].tolist()
    points = np.array([(-3.0, 0.0), (10.0, 20.0), (29.0, 0.0), (29.0, 0.0)])
    nearest = found.nearest(points, np.array([0, 0, 0, 1]))
    assert nearest.tolist() == [west, north, north, other]
    assert found.main == {north, other}
