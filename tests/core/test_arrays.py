"""Rows of different lengths stored end to end, compared with lists of lists."""

from itertools import chain

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reverie_eval.arrays import (
    IntArray,
    KeyTable,
    difference,
    frozen,
    offsets_of,
    row_of,
    take_rows,
)

ragged = st.lists(st.lists(st.integers(0, 99), max_size=4), min_size=1, max_size=6)
"""Rows of numbers, some of them empty."""


@given(rows=ragged, data=st.data())
def test_take_rows_returns_the_chosen_rows_in_order(
    rows: list[list[int]], data: st.DataObject
) -> None:
    chosen = data.draw(st.lists(st.integers(0, len(rows) - 1)))
    values = np.array(list(chain.from_iterable(rows)), dtype=int)
    taken = values[take_rows(np.array(chosen, dtype=int), _offsets(rows))]
    assert taken.tolist() == list(chain.from_iterable(rows[row] for row in chosen))


@given(rows=ragged)
def test_row_of_gives_the_row_of_every_value(rows: list[list[int]]) -> None:
    expected = [number for number, row in enumerate(rows) for _ in row]
    assert row_of(_offsets(rows)).tolist() == expected


@given(
    keys=st.sets(st.integers(0, 2**62) | st.integers(0, 99), max_size=60),
    wanted=st.lists(st.integers(-(2**31), 2**62) | st.integers(0, 99), max_size=60),
)
def test_a_table_finds_its_keys_and_no_others(keys: set[int], wanted: list[int]) -> None:
    """Also where several keys share a slot, as some of sixty do."""
    ascending, wanted = sorted(keys), [*wanted, *keys]
    table = KeyTable(np.array(ascending, dtype=np.int64))
    index, is_found = table.find(np.array(wanted, dtype=np.int64))
    assert is_found.tolist() == [each in keys for each in wanted]
    found = [at for at, is_one in zip(index.tolist(), is_found.tolist(), strict=True) if is_one]
    assert [ascending[at] for at in found] == [each for each in wanted if each in keys]


def test_a_frozen_array_is_read_only() -> None:
    array = frozen(np.zeros(2))
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 1


@pytest.mark.parametrize(
    ("value", "other", "expected"),
    [
        pytest.param(0.5, 0.25, 0.25, id="a difference"),
        pytest.param(0.25, 0.5, -0.25, id="in the other direction"),
        pytest.param(9.1 + 0.1, 0.1 + 9.1 + 1e-14, 0.0, id="the last bits"),
        pytest.param(1.0, 1.0 - 2**-30, 0.0, id="just below 1e-9"),
        pytest.param(1.0, 1.0 - 2**-29, 2**-29, id="just above 1e-9"),
        pytest.param(2.0**20, 2.0**20 - 2**-10, 0.0, id="just below 1e-9 of a large value"),
        pytest.param(2.0**20, 2.0**20 - 2**-9, 2**-9, id="just above it"),
        pytest.param(0.0, 1e-17, 0.0, id="almost zero"),
    ],
)
def test_a_difference_that_rounding_explains_is_zero(
    value: float, other: float, expected: float
) -> None:
    """2^-30 is 0.93e-9, and 2^-29 is 1.86e-9."""
    assert difference(np.array([value]), np.array([other])).tolist() == [expected]


def _offsets(rows: list[list[int]]) -> IntArray:
    return offsets_of(np.array([len(row) for row in rows]))
