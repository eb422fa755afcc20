"""Whether neighbouring level views show the same edges in the same directions."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reverie_eval.dataset._agreement_rules import (
    VIEW_RULES,
    edge_differences,
    neighbours,
)
from reverie_eval.dataset._boxes import Boxes, Entry
from reverie_eval.dataset._graphs import Graphs
from reverie_eval.dataset._reader import ObjectRecord, ViewpointKey
from tests.support.broken_datasets import BOX

FOCAL = 240 / np.tan(np.pi / 6)


def _shown(view: int, left: float, right: float) -> list[int]:
    """Return the box, in a level view, of what lies between two azimuths in degrees."""
    edges = [
        round(320 + FOCAL * np.tan(np.deg2rad(azimuth - 30 * (view - 12))))
        for azimuth in (left, right)
    ]
    return [edges[0], 200, edges[1] - edges[0], 40]


def _object(views: Sequence[int], boxes: Sequence[Sequence[int]]) -> Boxes:
    return _objects(views, [boxes])


def _objects(views: Sequence[int], objects: Sequence[Sequence[Sequence[int]]]) -> Boxes:
    records = [
        ObjectRecord(list(views), [(a, b, c, d) for a, b, c, d in boxes]) for boxes in objects
    ]
    entries = [Entry(0, object_id, record) for object_id, record in enumerate(records)]
    return Boxes([ViewpointKey("flat", "bath")], entries, Graphs({}, [], frozenset()))


@given(st.integers(12, 22), st.floats(-5, 20), st.floats(2, 10))
def test_edges_in_neighbouring_views_agree_up_to_a_pixel(
    view: int, azimuth: float, width: float
) -> None:
    left = azimuth + 30 * (view - 12)
    boxes = _object([view, view + 1], [_shown(v, left, left + width) for v in (view, view + 1)])
    pairs = neighbours(boxes)
    assert pairs.tolist() == [[0, 1]]
    assert (edge_differences(boxes, pairs) < 0.14).all()


@pytest.mark.parametrize(
    ("views", "boxes", "pairs"),
    [
        pytest.param([12, 13], [BOX, BOX], [[0, 1]], id="neighbours"),
        pytest.param([12, 23], [BOX, BOX], [[1, 0]], id="round to the first"),
        pytest.param([13, 12], [BOX, BOX], [[1, 0]], id="in any order"),
        pytest.param([12, 14], [BOX, BOX], [], id="not next to each other"),
        pytest.param([0, 1], [BOX, BOX], [], id="not level"),
        pytest.param([11, 12], [BOX, BOX], [], id="one of them not level"),
        pytest.param([12, 13], [BOX, [0, 2, 30, 40]], [], id="cut at the left"),
        pytest.param([12, 13], [[610, 2, 30, 40], BOX], [], id="cut at the right"),
        pytest.param([12, 13], [BOX, [1, 0, 30, 40]], [], id="cut above"),
        pytest.param([12, 13], [[1, 440, 30, 40], BOX], [], id="cut below"),
    ],
)
def test_neighbours_are_level_and_not_cut(
    views: list[int], boxes: list[list[int]], pairs: list[list[int]]
) -> None:
    assert neighbours(_object(views, boxes)).tolist() == pairs


@pytest.mark.parametrize(
    ("apart", "agreeing", "errors"),
    [
        pytest.param(20, 0, 20, id="all of enough"),
        pytest.param(19, 0, 0, id="too few to tell"),
        pytest.param(10, 10, 0, id="half"),
        pytest.param(11, 9, 11, id="one more than half"),
    ],
)
def test_views_disagree_if_most_objects_are_elsewhere(
    apart: int, agreeing: int, errors: int
) -> None:
    same, other = ([_shown(12, 10, 15), _shown(13, left, left + 5)] for left in (10, 12))
    boxes = _objects([12, 13], [other] * apart + [same] * agreeing)
    warning, error = (rule.find(boxes).number for rule in VIEW_RULES)
    assert (warning, error) == (apart, errors)
