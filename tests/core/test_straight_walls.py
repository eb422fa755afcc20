"""Which walls are moved so that they have fewer corners, and which openings they have.

What a move costs, in square metres, is worked out by hand.
"""

import numpy as np
import pytest

from reverie_eval.geometry._plans import Border, Plan, openings
from reverie_eval.geometry._straightening import straighten


def straightened(
    rooms: list[str], wide: list[float], high: list[float], *, held: str = "", walked: str = ""
) -> list[str]:
    """Straighten rooms, drawn as letters from the south to the north; "." is outside.

    Some rooms may not change hands at all, others may not become outside.
    """
    beside = "." * len(rooms[0])
    letters = np.array([list(f".{row}.") for row in (beside, *rooms, beside)]).T
    names, index = np.unique(letters, return_inverse=True)
    room = index.reshape(letters.shape) - 1
    area = np.outer([0.0, *wide, 0.0], [0.0, *high, 0.0])
    area[np.isin(letters, list(held))] = np.inf
    as_outside = np.where(np.isin(letters, list(walked)), np.inf, area)
    straighten(room, (np.cumsum([0.0, *wide]), np.cumsum([0.0, *high])), area, as_outside)
    return ["".join(names[row + 1]) for row in room.T[1:-1, 1:-1]]


@pytest.mark.parametrize(
    ("rooms", "wide", "high", "expected"),
    [
        pytest.param(["aaa", "a.a"], [3, 2.9, 3], [3, 4], ["aaa", "aaa"], id="a notch: 4 for 11.6"),
        pytest.param(["aaa", "a.a"], [4, 3, 4], [3, 4], ["aaa", "a.a"], id="4 corners for 12"),
        pytest.param(["aaa", "a.a"], [3, 3.1, 3], [3, 3.1], ["aaa", "a.a"], id="3.1 m are too far"),
        pytest.param(["aaa", ".a."], [3, 2.9, 3], [3, 2], ["aaa", "..."], id="a tooth: 4 for 5.8"),
        pytest.param(["a.", "aa"], [4, 3], [1.9, 3], ["aa", "aa"], id="an offset: 2 for 5.7"),
        pytest.param(["a.", "aa"], [4, 3], [2, 3], ["a.", "aa"], id="2 corners for 6"),
        pytest.param(["ab", "aa"], [4, 1], [1, 4], ["aa", "aa"], id="a nook of another room"),
    ],
)
def test_a_corner_is_worth_three_square_metres(
    rooms: list[str], wide: list[float], high: list[float], expected: list[str]
) -> None:
    assert straightened(rooms, wide, high) == expected


def test_what_is_held_stays() -> None:
    """A nook with a camera is not taken, and a tooth with a way through it is not cut off."""
    nook, tooth = ["ab", "aa"], ["aaa", ".b."]
    assert straightened(nook, [4, 1], [1, 4], held="b") == nook
    assert straightened(tooth, [6, 1, 6], [3, 1]) == ["aaa", "..."]
    assert straightened(tooth, [6, 1, 6], [3, 1], walked="b") == tooth


def test_cameras_and_ways_hold_floor() -> None:
    """A tooth of 2 by 1 m on a room of 8 by 3: with a camera it stays, and a way is not outside."""
    boxes = np.array([[(0, 0), (8, 3)], [(3, 3), (5, 4)]], dtype=float)
    nothing, camera = np.zeros((0, 2)), np.array([(4.0, 3.5)])
    way = np.array([[(4.0, 1.5), (4.0, 3.5)]])

    def area(cameras: np.ndarray, legs: np.ndarray) -> float:
        plan = Plan.of(boxes, [(nothing, nothing), (nothing, cameras)], legs)
        return sum(map(plan.area, range(plan.n_rooms)))

    assert area(nothing, way[:0]) == pytest.approx(24)
    assert area(camera, way[:0]) == pytest.approx(26)
    assert area(nothing, way) >= 26


@pytest.mark.parametrize(
    ("passed", "length", "expected"),
    [
        pytest.param([], 8, [], id="no way"),
        pytest.param([4], 8, [(3.55, 4.45)], id="a door"),
        pytest.param([4, 4.7], 8, [(3.55, 4.45)], id="two ways through it"),
        pytest.param([2, 4.1], 8, [(1.55, 4.55)], id="1.2 m between two doors are no wall"),
        pytest.param([2, 4.3], 8, [(1.55, 2.45), (3.85, 4.75)], id="1.4 m are"),
        pytest.param([0.1], 8, [(0, 0.9)], id="within its wall"),
        pytest.param([1, 3], 5.8, [(0, 5.8)], id="half of a wall"),
        pytest.param([1, 3], 5.9, [(0.55, 3.45)], id="less than half"),
        pytest.param([0.7], 1.4, [(0, 1.4)], id="a door leaves 0.5 m"),
        pytest.param([0.8], 1.6, [(0.35, 1.25)], id="a door leaves 0.7 m"),
    ],
)
def test_openings_in_a_wall(
    passed: list[float], length: float, expected: list[tuple[float, float]]
) -> None:
    """Between two rooms, along y = 3; a wall to the outside is never open altogether."""
    wall = Border(1, 3.0, 0.0, length, is_inner=True)
    sides = [Border(0, x, 0.0, 9.0, is_inner=False) for x in (0.0, length)]
    legs = np.array([[(x, 0.0), (x, 6.0)] for x in passed]).reshape(-1, 2, 2)
    found = [*openings([*sides, wall], legs)]
    assert [tuple(ends[:, 0].round(9)) for ends in found] == expected
    assert all((ends[:, 1] == 3).all() for ends in found)
    outer = [*openings([*sides, wall._replace(is_inner=False)], legs)]
    assert (0, length) not in [tuple(ends[:, 0]) for ends in outer]


def test_what_stands_free_is_open() -> None:
    """A piece of 1.2 m between two open walls on its line, unless a wall across it ends there."""
    lines = [(0.0, 2.0), (2.0, 3.2), (3.2, 5.2)]
    walls = [Border(1, 0.0, low, high, is_inner=True) for low, high in lines]
    legs = np.array([[(x, -1.0), (x, 1.0)] for x in (0.5, 1.5, 3.7, 4.7)])
    assert [ends[:, 0].tolist() for ends in openings(walls, legs)] == [[0, 2], [3.2, 5.2], [2, 3.2]]
    across = Border(0, 2.0, 0.0, 4.0, is_inner=True)
    assert len([*openings([across, *walls], legs)]) == 2
