"""The metrics one by one: tables worked out by hand, and comparisons with plain loops."""

import math
from collections.abc import Callable
from fractions import Fraction
from typing import TypeAlias

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from reverie_eval.arrays import Array, FloatArray, IntArray
from reverie_eval.metrics import (
    box_iou,
    box_match,
    candidate_match,
    cls,
    dtw,
    jumps,
    navigation_error,
    ndtw,
    oracle_error,
    oracle_success,
    path_length,
    sdtw,
    spl,
    steps,
    success,
)

Box: TypeAlias = tuple[int, int, int, int]
"""Left, top, width, height."""
Table: TypeAlias = list[list[float]]
"""Distances of one episode: a row for every node, a column for every pose."""


# Navigation: one episode per row, its poses in a list.


@pytest.mark.parametrize(
    ("legs", "expected"),
    [
        pytest.param([0.0], 0.0, id="single pose"),
        pytest.param([0.0, 0.0, 0.0], 0.0, id="turns on the spot"),
        pytest.param([0.0, 2.0, 3.5], 5.5, id="two legs"),
        pytest.param([0.0, 2.0, 0.0, 2.0], 4.0, id="there, rest and back"),
        pytest.param([0.0, 0.1, 0.2, 0.3], 0.6000000000000001, id="added from first to last"),
        pytest.param([0.0] + [0.1] * 10, 0.9999999999999999, id="added one by one, not in pairs"),
        pytest.param([0.0, 1e16, 1.0, 1.0], 1e16, id="added without compensation"),
    ],
)
def test_path_length_of_one_episode(legs: list[float], expected: float) -> None:
    assert path_length(np.array(legs), _one_episode(legs)).tolist() == [expected]


@pytest.mark.parametrize(
    ("visible", "expected"),
    [
        pytest.param([True], True, id="single pose that sees the target"),
        pytest.param([False], False, id="single pose that does not"),
        pytest.param([False, False, True], True, id="at the stop"),
        pytest.param([True, False, False], False, id="at the start only"),
        pytest.param([False, True, False], False, id="on the way only"),
    ],
)
def test_success_of_one_episode(*, visible: list[bool], expected: bool) -> None:
    assert success(np.array(visible), _one_episode(visible)).tolist() == [expected]


@pytest.mark.parametrize(
    ("visible", "expected"),
    [
        pytest.param([True], True, id="single pose that sees the target"),
        pytest.param([False], False, id="single pose that does not"),
        pytest.param([False, False, True], True, id="at the stop"),
        pytest.param([True, False, False], True, id="at the start only"),
        pytest.param([False, True, False], True, id="on the way only"),
        pytest.param([False, False, False], False, id="nowhere"),
    ],
)
def test_oracle_success_of_one_episode(*, visible: list[bool], expected: bool) -> None:
    assert oracle_success(np.array(visible), _one_episode(visible)).tolist() == [expected]


@pytest.mark.parametrize(
    ("succeeded", "walked", "shortest", "expected"),
    [
        pytest.param(True, 10.0, 10.0, 1.0, id="shortest route"),
        pytest.param(True, 20.0, 10.0, 0.5, id="twice as long"),
        pytest.param(True, 8.0, 10.0, 1.0, id="shortcut is capped"),
        pytest.param(True, 0.0, 10.0, 1.0, id="right without a step"),
        pytest.param(True, 0.0, 0.0, 1.0, id="already there"),
        pytest.param(True, 5.0, 0.0, 0.0, id="already there but walks"),
        pytest.param(True, 0.004, 0.002, 0.5, id="no floor under a short route"),
        pytest.param(False, 10.0, 10.0, 0.0, id="failure"),
        pytest.param(False, 0.0, 0.0, 0.0, id="failure without a step"),
    ],
)
def test_spl_of_one_episode(
    *, succeeded: bool, walked: float, shortest: float, expected: float
) -> None:
    result = spl(np.array([succeeded]), np.array([walked]), np.array([shortest]))
    assert result.tolist() == [expected]


@pytest.mark.parametrize(
    ("succeeded", "walked", "length", "expected"),
    [
        pytest.param(True, 10.0, 10.0, 1.0, id="no effect on a long route"),
        pytest.param(True, 0.01, 0.01, 1.0, id="just as long as the floor"),
        pytest.param(True, 0.005, 0.005, 0.5, id="half as long as the floor"),
        pytest.param(True, 0.04, 0.005, 0.125, id="short way, long walk"),
        pytest.param(True, 0.0, 0.0, 0.0, id="already there"),
        pytest.param(False, 0.0, 0.0, 0.0, id="failure"),
    ],
)
def test_spl_of_one_episode_with_a_floor(
    *, succeeded: bool, walked: float, length: float, expected: float
) -> None:
    result = spl(np.array([succeeded]), np.array([walked]), np.array([length]), floor=0.01)
    assert result.tolist() == [expected]


@pytest.mark.parametrize(
    ("goal_distances", "expected"),
    [
        pytest.param([0.0], 0.0, id="single pose on the goal"),
        pytest.param([4.5], 4.5, id="single pose away from it"),
        pytest.param([4.5, 2.0, 0.0], 0.0, id="stops on the goal"),
        pytest.param([4.5, 0.0, 2.0], 2.0, id="walks past the goal"),
        pytest.param([2.0, 4.5], 4.5, id="walks away"),
    ],
)
def test_navigation_error_of_one_episode(goal_distances: list[float], expected: float) -> None:
    result = navigation_error(np.array(goal_distances), _one_episode(goal_distances))
    assert result.tolist() == [expected]


@pytest.mark.parametrize(
    ("goal_distances", "expected"),
    [
        pytest.param([0.0], 0.0, id="single pose on the goal"),
        pytest.param([4.5], 4.5, id="single pose away from it"),
        pytest.param([4.5, 2.0, 3.0], 2.0, id="nearest on the way"),
        pytest.param([2.0, 4.5], 2.0, id="nearest at the start"),
        pytest.param([4.5, 3.0], 3.0, id="nearest at the stop"),
    ],
)
def test_oracle_error_of_one_episode(goal_distances: list[float], expected: float) -> None:
    result = oracle_error(np.array(goal_distances), _one_episode(goal_distances))
    assert result.tolist() == [expected]


@pytest.mark.parametrize(
    ("offsets", "expected"),
    [
        pytest.param([0, 1], [0], id="single pose"),
        pytest.param([0, 4], [3], id="four poses"),
        pytest.param([0, 3, 4, 6], [2, 0, 1], id="three episodes"),
    ],
)
def test_steps(offsets: list[int], expected: list[int]) -> None:
    assert steps(np.array(offsets)).tolist() == expected


@pytest.mark.parametrize(
    ("is_jump", "expected"),
    [
        pytest.param([False], 0, id="single pose"),
        pytest.param([False, False, False], 0, id="edge after edge"),
        pytest.param([False, True, False], 1, id="one leg without an edge"),
        pytest.param([False, True, True, True], 3, id="every leg without an edge"),
    ],
)
def test_jumps_of_one_episode(is_jump: list[bool], expected: int) -> None:
    assert jumps(np.array(is_jump), _one_episode(is_jump)).tolist() == [expected]


THREE_EPISODES = np.array([0, 3, 4, 6])
METRES = np.array([0.0, 2.0, 3.0, 1.0, 2.0, 7.0])
FLAGS = np.array([False, True, False, True, False, False])


@pytest.mark.parametrize(
    ("metric", "poses", "expected"),
    [
        pytest.param(path_length, METRES, [5.0, 1.0, 9.0], id="path length"),
        pytest.param(success, FLAGS, [False, True, False], id="success"),
        pytest.param(oracle_success, FLAGS, [True, True, False], id="oracle success"),
        pytest.param(navigation_error, METRES, [3.0, 1.0, 7.0], id="navigation error"),
        pytest.param(oracle_error, METRES, [0.0, 1.0, 2.0], id="oracle error"),
        pytest.param(jumps, FLAGS, [1, 1, 0], id="jumps"),
    ],
)
def test_episodes_are_independent(
    metric: Callable[[Array, IntArray], Array], poses: Array, expected: list[float]
) -> None:
    assert metric(poses, THREE_EPISODES).tolist() == expected


# Path fidelity: one episode per table.


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        pytest.param([[0.0]], 0.0, id="stays where it should"),
        pytest.param([[2.5]], 2.5, id="one pose, one node"),
        pytest.param([[0.0, 2.0], [2.0, 0.0]], 0.0, id="the path itself"),
        pytest.param([[0.0], [2.0], [5.0]], 7.0, id="never leaves: every node counts"),
        pytest.param([[0.0, 2.0, 5.0]], 7.0, id="should not leave: every pose counts"),
        pytest.param([[2.0, 0.0], [0.0, 2.0]], 4.0, id="there first: order counts"),
        pytest.param([[0.0, 0.0, 2.0], [2.0, 2.0, 0.0]], 0.0, id="turning on the spot is free"),
        pytest.param([[0.0, 2.0, 5.0], [2.0, 0.0, 3.0]], 3.0, id="walks on"),
        pytest.param(
            [[0.0, 1.0, 2.0], [1.0, 0.0, 1.0], [2.0, 1.0, 0.0], [1.0, 2.0, 1.0]],
            1.0,
            id="stops a node early",
        ),
        pytest.param(
            [[0.0, 1.0, 9.0], [9.0, 9.0, 2.0], [9.0, 4.0, 8.0]],
            11.0,
            id="a cheap cell out of order does not count",
        ),
        pytest.param([[1.0, 8.0], [8.0, 1.0]], 2.0, id="diagonal before corners"),
    ],
)
def test_dtw_of_one_episode(table: Table, expected: float) -> None:
    assert dtw(*_laid_out([table])).tolist() == [expected]


def test_dtw_of_unequal_tables_together() -> None:
    tables: list[Table] = [
        [[2.5]],
        [[0.0, 2.0, 5.0], [2.0, 0.0, 3.0]],
        [[0.0], [2.0], [5.0]],
        [[2.0, 0.0], [0.0, 2.0]],
    ]
    assert dtw(*_laid_out(tables)).tolist() == [2.5, 3.0, 7.0, 4.0]


@st.composite
def distance_tables(draw: st.DrawFn) -> Table:
    """Draw a table of up to six nodes and seven poses."""
    n_poses = draw(st.integers(1, 7))
    metres = st.floats(0, 50) | st.integers(0, 3).map(float)
    return draw(
        st.lists(st.lists(metres, min_size=n_poses, max_size=n_poses), min_size=1, max_size=6)
    )


@given(tables=st.lists(distance_tables(), min_size=1, max_size=8))
def test_dtw_agrees_with_two_plain_loops(tables: list[Table]) -> None:
    assert dtw(*_laid_out(tables)).tolist() == [_warped(table) for table in tables]


@given(tables=st.lists(distance_tables(), min_size=1, max_size=8))
def test_dtw_is_symmetric(tables: list[Table]) -> None:
    """Poses may be aligned with nodes or nodes with poses."""
    turned = [[list(column) for column in zip(*table, strict=True)] for table in tables]
    assert dtw(*_laid_out(turned)).tolist() == dtw(*_laid_out(tables)).tolist()


@pytest.mark.parametrize(
    ("metres", "n_nodes", "expected"),
    [
        pytest.param(0.0, 5, 1.0, id="the path itself"),
        pytest.param(3.0, 1, 0.36787944117144233, id="3 m from a single node"),
        pytest.param(15.0, 5, 0.36787944117144233, id="3 m a node"),
        pytest.param(6.0, 1, 0.1353352832366127, id="6 m from a single node"),
        pytest.param(1.5461700564, 5, 0.902056606930051, id="the sample in RxR's README: 0.90206"),
    ],
)
def test_ndtw_of_one_episode(metres: float, n_nodes: int, expected: float) -> None:
    result = ndtw(np.array([metres]), np.array([n_nodes]))
    assert result.tolist() == pytest.approx([expected], abs=1e-15, rel=0)


def test_sdtw_is_ndtw_of_successes_only() -> None:
    result = sdtw(np.array([0.9, 0.9, 1.0]), np.array([True, False, False]))
    assert result.tolist() == [0.9, 0.0, 0.0]


ONE_OFF = 0.36787944117144233
"""exp(-1), the nearness at 3 m."""


@pytest.mark.parametrize(
    ("table", "walked", "annotated", "expected"),
    [
        pytest.param([[0.0]], 0.0, 0.0, 1.0, id="neither moves"),
        pytest.param([[0.0, 4.0], [4.0, 0.0]], 4.0, 4.0, 1.0, id="the path itself"),
        pytest.param([[0.0, 4.0, 0.0]], 8.0, 0.0, 0.0, id="moves and should not"),
        # Covers both nodes, so 4 m are expected: 4 / (4 + |4 - 12|).
        pytest.param(
            [[0.0, 4.0, 0.0, 4.0], [4.0, 0.0, 4.0, 0.0]], 12.0, 4.0, 1 / 3, id="to and fro"
        ),
        # Coverage 1, so 4 m are expected: 4 / (4 + |4 - 2|), as if the way were shorter.
        pytest.param([[0.0, 4.0], [4.0, 0.0]], 2.0, 4.0, 2 / 3, id="shorter than expected"),
        pytest.param([[0.0, 0.4], [0.4, 0.0]], 0.2, 0.4, 2 / 3, id="all within a metre"),
        # Coverage c = (1 + e^-1) / 2, 3c m expected, none walked: c 3c / (3c + 3c) = c / 2.
        pytest.param([[0.0], [3.0]], 0.0, 3.0, (1 + ONE_OFF) / 4, id="stays at the start"),
        # 3 m away from both nodes: c = e^-1, and c 5 m are expected and walked.
        pytest.param([[3.0, 3.0], [3.0, 3.0]], 5 * ONE_OFF, 5.0, ONE_OFF, id="3 m away from it"),
    ],
)
def test_cls_of_one_episode(table: Table, walked: float, annotated: float, expected: float) -> None:
    result = cls(*_laid_out([table]), np.array([walked]), np.array([annotated]))
    assert result.tolist() == pytest.approx([expected], abs=1e-15, rel=0)


def test_cls_of_unequal_tables_together() -> None:
    tables: list[Table] = [[[0.0, 4.0, 0.0]], [[0.0]], [[0.0, 4.0], [4.0, 0.0]]]
    walked, annotated = np.array([8.0, 0.0, 2.0]), np.array([0.0, 0.0, 4.0])
    result = cls(*_laid_out(tables), walked, annotated)
    assert result.tolist() == pytest.approx([0.0, 1.0, 2 / 3], abs=1e-15, rel=0)


# Grounding.


@pytest.mark.parametrize(
    ("predicted", "target", "expected"),
    [
        pytest.param(7, 7, True, id="the target"),
        pytest.param(8, 7, False, id="another object"),
        pytest.param(0, 0, True, id="the target has id 0"),
        pytest.param(0, 7, False, id="0 is an object, not a wildcard"),
        pytest.param(-1, 7, False, id="abstains"),
        pytest.param(-1, 0, False, id="abstains where the target has id 0"),
    ],
)
def test_candidate_match_of_one_episode(*, predicted: int, target: int, expected: bool) -> None:
    assert candidate_match(np.array([predicted]), np.array([target])).tolist() == [expected]


# Boxes.


@pytest.mark.parametrize(
    ("predicted", "target", "expected"),
    [
        pytest.param((3, 4, 5, 6), (3, 4, 5, 6), 1.0, id="identical"),
        pytest.param((0, 0, 2, 2), (1, 0, 2, 2), 1 / 3, id="shifted by half a width"),
        pytest.param((0, 0, 3, 1), (1, 0, 3, 1), 1 / 2, id="shifted by a third"),
        pytest.param((0, 0, 1, 1), (0, 0, 2, 2), 1 / 4, id="one pixel of four"),
        pytest.param((1, 1, 1, 1), (0, 0, 3, 3), 1 / 9, id="inside"),
        pytest.param((0, 0, 2, 2), (2, 0, 2, 2), 0.0, id="touching at a side"),
        pytest.param((0, 0, 2, 2), (2, 2, 2, 2), 0.0, id="touching at a corner"),
        pytest.param((0, 0, 2, 2), (5, 7, 2, 2), 0.0, id="apart both ways"),
        pytest.param((0, 0, 2, 2), (0, 7, 2, 2), 0.0, id="apart one way"),
        pytest.param((0, 0, 640, 480), (0, 0, 640, 240), 1 / 2, id="the view and its upper half"),
    ],
)
def test_box_iou_of_one_pair(predicted: Box, target: Box, expected: float) -> None:
    assert _iou(predicted, target) == expected


@pytest.mark.parametrize(
    ("predicted", "target", "expected"),
    [
        pytest.param((3, 4, 5, 6), (3, 4, 5, 6), True, id="identical"),
        pytest.param((0, 0, 3, 1), (1, 0, 3, 1), True, id="exactly one half"),
        pytest.param((0, 0, 300, 1), (100, 0, 300, 1), True, id="exactly one half, in 400 pixels"),
        pytest.param((0, 0, 300, 1), (99, 0, 300, 1), True, id="a pixel above"),
        pytest.param((0, 0, 300, 1), (101, 0, 300, 1), False, id="a pixel below"),
        pytest.param((0, 0, 640, 480), (0, 0, 640, 240), True, id="half of the view"),
        pytest.param((0, 0, 640, 480), (0, 0, 640, 239), False, id="a row less than half of it"),
        pytest.param((0, 0, 2, 2), (1, 0, 2, 2), False, id="one third"),
        pytest.param((0, 0, 2, 2), (2, 0, 2, 2), False, id="touching"),
    ],
)
def test_box_match_of_one_pair(*, predicted: Box, target: Box, expected: bool) -> None:
    assert _matches(predicted, target) is expected


@pytest.mark.parametrize("kind", [np.int16, np.uint16, np.int64, np.float32])
def test_boxes_of_any_number_type(kind: type[np.generic]) -> None:
    """Bundles store boxes in 16 bits, which the area of an image would overflow."""
    picture, below = np.array([[[0, 0, 640, 480]], [[0, 120, 640, 360]]], dtype=kind)
    assert box_iou(picture, picture).tolist() == [1.0]
    assert box_iou(below, picture).tolist() == [0.75]
    assert box_match(picture, below, threshold=0.75).tolist() == [True]


def test_box_match_at_another_threshold() -> None:
    boxes = np.array([[0.0, 0, 1, 1], [0, 0, 1, 1]]), np.array([[0.0, 0, 2, 2], [0, 0, 5, 1]])
    assert box_match(*boxes, threshold=0.25).tolist() == [True, False]


def test_boxes_are_compared_pair_by_pair() -> None:
    predicted = np.array([[0.0, 0, 2, 2], [5, 5, 1, 1]])
    target = np.array([[5.0, 5, 1, 1], [5, 5, 1, 1]])
    assert box_iou(predicted, target).tolist() == [0.0, 1.0]


def boxes_within(width: int, height: int) -> st.SearchStrategy[Box]:
    """Draw a box of whole pixels inside a view of this size."""
    left_and_top = st.tuples(st.integers(0, width - 1), st.integers(0, height - 1))
    return left_and_top.flatmap(
        lambda at: st.tuples(
            st.just(at[0]),
            st.just(at[1]),
            st.integers(1, width - at[0]),
            st.integers(1, height - at[1]),
        )
    )


views = boxes_within(640, 480)
crops = boxes_within(4, 3)
"""So few pixels that boxes often match, and often by exactly one half."""
pairs = st.one_of(st.tuples(views, views), st.tuples(crops, crops))


@given(pair=pairs)
def test_box_iou_agrees_with_shapely(pair: tuple[Box, Box]) -> None:
    predicted, target = (shapely.box(x, y, x + w, y + h) for x, y, w, h in pair)
    expected = predicted.intersection(target).area / predicted.union(target).area
    assert _iou(*pair) == pytest.approx(expected, rel=1e-12)


@given(pair=pairs)
def test_box_match_agrees_with_exact_arithmetic(pair: tuple[Box, Box]) -> None:
    assert _matches(*pair) is (_exact_iou(*pair) >= Fraction(1, 2))


@given(pair=pairs)
def test_box_iou_is_symmetric(pair: tuple[Box, Box]) -> None:
    predicted, target = pair
    assert _iou(predicted, target) == _iou(target, predicted)


@given(pair=pairs, right=st.integers(-640, 640), down=st.integers(-480, 480))
def test_moving_both_boxes_does_not_change_the_iou(
    pair: tuple[Box, Box], right: int, down: int
) -> None:
    predicted, target = ((x + right, y + down, w, h) for x, y, w, h in pair)
    assert _iou(predicted, target) == _iou(*pair)


@given(pair=pairs, across=st.integers(1, 9), along=st.integers(1, 9))
def test_scaling_both_boxes_does_not_change_the_iou(
    pair: tuple[Box, Box], across: int, along: int
) -> None:
    predicted, target = ((across * x, along * y, across * w, along * h) for x, y, w, h in pair)
    assert _iou(predicted, target) == _iou(*pair)


def _one_episode(poses: list[float] | list[bool]) -> IntArray:
    return np.array([0, len(poses)])


def _laid_out(tables: list[Table]) -> tuple[FloatArray, IntArray, IntArray]:
    """Return all cells, row by row and table by table, and the tables' columns and rows."""
    cells = [metres for table in tables for row in table for metres in row]
    n_poses, n_nodes = [len(table[0]) for table in tables], [len(table) for table in tables]
    return np.array(cells), np.array(n_poses), np.array(n_nodes)


def _warped(table: Table) -> float:
    """Fill the table of smallest total distances cell by cell."""
    n_nodes, n_poses = len(table), len(table[0])
    total = [[math.inf] * (n_poses + 1) for _ in range(n_nodes + 1)]
    total[0][0] = 0.0
    for i in range(1, n_nodes + 1):
        for j in range(1, n_poses + 1):
            before = min(total[i - 1][j], total[i][j - 1], total[i - 1][j - 1])
            total[i][j] = table[i - 1][j - 1] + before
    return total[n_nodes][n_poses]


def _iou(predicted: Box, target: Box) -> float:
    return box_iou(_as_row(predicted), _as_row(target)).item()


def _matches(predicted: Box, target: Box) -> bool:
    return box_match(_as_row(predicted), _as_row(target)).item()


def _as_row(box: Box) -> FloatArray:
    return np.array([box], dtype=np.float64)


def _exact_iou(first: Box, second: Box) -> Fraction:
    """Divide the number of pixels in both boxes by the number of pixels in either."""
    across = set(_columns(first)) & set(_columns(second))
    along = set(_rows(first)) & set(_rows(second))
    both = len(across) * len(along)
    total = first[2] * first[3] + second[2] * second[3]
    return Fraction(both, total - both)


def _columns(box: Box) -> range:
    return range(box[0], box[0] + box[2])


def _rows(box: Box) -> range:
    return range(box[1], box[1] + box[3])
