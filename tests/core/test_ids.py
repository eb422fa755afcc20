"""Ids of episodes, found all at once."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reverie_eval.ground_truth import InstrIdTable

IDS = st.text("019_#-é\0", max_size=20)


@given(known=st.lists(IDS, unique=True, max_size=20), wanted=st.lists(IDS, max_size=5))
def test_a_table_finds_ids_or_leaves_them_to_a_dictionary(
    known: list[str], wanted: list[str]
) -> None:
    table, row_of = InstrIdTable(known), {each: row for row, each in enumerate(known)}
    for ids in (wanted, known, [*known, *wanted]):
        found = table.find(ids)
        assert found is None or found.tolist() == [row_of.get(each) for each in ids]


@pytest.mark.parametrize(
    "instr_ids",
    [
        pytest.param(["4536_267_0", "99_1_0", "4536_267_0", "0"], id="in another order, and twice"),
        pytest.param([], id="none"),
    ],
)
def test_usual_ids_are_found(instr_ids: list[str]) -> None:
    known = ["0", "4536_267_0", "99_1_0"]
    found = InstrIdTable(known).find(instr_ids)
    assert found is not None
    assert found.tolist() == list(map(known.index, instr_ids))


@pytest.mark.parametrize(
    "instr_id",
    [
        pytest.param("4536_267_1", id="unknown"),
        pytest.param(None, id="not read"),
        pytest.param("é", id="of other letters"),
        pytest.param("4536_267_0\0", id="with a zero behind"),
        pytest.param("4536_267_0\0\0\0\0\0\0\0", id="cut behind zeros"),
        pytest.param("0123456789abcdeffff", id="cut to a known one's length"),
    ],
)
def test_others_are_not_taken_for_known_ones(instr_id: str | None) -> None:
    table = InstrIdTable(["4536_267_0", "0123456789abcdef", "None"])
    assert table.find(["4536_267_0", instr_id]) is None


def test_ids_that_begin_alike() -> None:
    """A dictionary tells them apart."""
    known = ["an id of many letters, 1", "an id of many letters, 2"]
    found = InstrIdTable(known).find(known)
    assert found is None or found.tolist() == [0, 1]
