"""CSV as spreadsheets write it, and for them: no cell is a formula."""

import pytest

from reverie_eval.server.csv_files import CsvRow, CsvTable, read_csv, spreadsheet_cell
from reverie_eval.server.errors import TableError


@pytest.mark.parametrize(
    ("text", "row"),
    [
        pytest.param(
            "\n\nteam;SR\nBlue;5", CsvRow("line 4", ["Blue", "5"]), id="blank lines first"
        ),
        pytest.param("team,SR\na;b;c;d,5\n", CsvRow("line 2", ["a;b;c;d", "5"]), id="; in a cell"),
        pytest.param("team,SR\rBlue,5\r", CsvRow("line 2", ["Blue", "5"]), id="old line ends"),
        pytest.param(
            'team,SR\r\n"a\r\nb",5', CsvRow("line 2", ["a\r\nb", "5"]), id="lines in a cell"
        ),
    ],
)
def test_a_table_is_read(text: str, row: CsvRow) -> None:
    assert read_csv(text) == CsvTable(["team", "SR"], [row])


def test_a_first_line_may_be_unreadable() -> None:
    with pytest.raises(TableError) as refused:
        read_csv('"team,SR\n')
    assert [(each.code, str(each)) for each in refused.value.problems] == [
        ("unreadable", "line 1: cannot be read as CSV: unexpected end of data")
    ]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        pytest.param("Walker", "Walker", id="text"),
        pytest.param("a=1", "a=1", id="a sign later"),
        pytest.param("", "", id="nothing"),
        pytest.param("=1", "'=1", id="formula"),
        pytest.param("\t=1", "'\t=1", id="tab"),
        pytest.param("\uff0b1", "'\uff0b1", id="full width"),
        pytest.param("=\u0338", "'=\u0338", id="a sign that is struck through"),
        pytest.param(-1, -1, id="negative number"),
        pytest.param(True, "true", id="true"),
        pytest.param(False, "false", id="false"),
        pytest.param(None, None, id="no value"),
    ],
)
def test_no_cell_is_a_formula(value: str | int | None, expected: str | int | None) -> None:
    assert spreadsheet_cell(value) == expected
