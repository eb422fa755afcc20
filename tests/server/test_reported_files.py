"""Tables of results as papers and leaderboards print them: what is read, and every refusal."""

import json
from collections.abc import Mapping, Sequence

import pytest

from reverie_eval.metrics import CATALOGUE, printed_value
from reverie_eval.schemas.organising import NewReported, ReportedChange
from reverie_eval.server.boards.reported_files import as_printed, read_change, read_results
from reverie_eval.server.errors import TableError

LEGACY = """\
team,nav_success,nav_oracle_success,nav_spl,nav_length,rgs,rgspl,date
Blue (Walker),59.64,66.57,38.98,24.66,32.49,21.48,01/2026
Red,7,8.5,6.25,10,5,0.0,11/2022
"""
PAPER = {
    "source": "a table",
    "columns": ["success", "oracle_success", "spl", "length", "reverie_success"],
    "methods": {
        "Walker": {"val_seen": [1, 2, 3, 4, 5], "test": [59.64, 66.57, 38.98, 24.66, 32.49]},
        "Human": {"test": [81.5, None, 53, 21.18, "77.8"]},
        "Seen": {"val_seen": [1, 2, 3, 4, 5]},
    },
}
WALKER = {"success": 0.5964, "oracle_success": 0.6657, "spl": 0.3898, "path_length": 24.66}


def scores_of(text: str, rates: str = "percent") -> Sequence[Mapping[str, float]]:
    """Return the scores of each row, in a file without problems."""
    read = read_results(text, "test", "fraction" if rates == "fraction" else "percent")
    assert list(read.problems) == []
    return [row.scores for row in read.rows]


def test_the_columns_of_the_old_leaderboard() -> None:
    read = read_results(LEGACY, "test", "percent")
    assert [row.where for row in read.rows] == ["line 2", "line 3"]
    assert read.rows[0].about == {"team": "Blue (Walker)", "date": "01/2026"}
    assert read.rows[0].scores == {**WALKER, "rgs": 0.3249, "rgspl": 0.2148}
    assert read.rows[1].scores["rgspl"] == 0  # is a score
    assert (list(read.problems), list(read.unread)) == ([], [])


def test_the_shape_of_the_paper() -> None:
    read = read_results(json.dumps(PAPER), "test", "percent")
    assert [(row.where, row.about) for row in read.rows] == [
        ("methods.Walker.test", {"method": "Walker"}),
        ("methods.Human.test", {"method": "Human"}),
    ]
    assert read.rows[0].scores == {**WALKER, "rgs": 0.3249}
    human = {"success": 0.815, "spl": 0.53, "path_length": 21.18, "rgs": 0.778}
    assert read.rows[1].scores == human
    assert list(read.unread) == ["source"]


TABLES = [
    pytest.param("team,SR,SPL\nBlue,5,2.5", "percent", id="labels"),
    pytest.param("Team,Success,spl\nBlue,5,2.5\n", "percent", id="keys in any case"),
    pytest.param("team,SR %,SPL (%)\nBlue,5 %,2.5%\n", "percent", id="units"),
    pytest.param("Method,Nav Success,nav-spl\nA,5,2.5\n", "percent", id="other separators"),
    pytest.param("team;SR;SPL\nBlue;5;2.5\n", "percent", id="semicolons"),
    pytest.param("team\tSR\tSPL\nBlue\t5\t2.5\n", "percent", id="tabs"),
    pytest.param("\ufeffteam,SR,SPL\r\nBlue,5,2.5\r\n", "percent", id="from a spreadsheet"),
    pytest.param("\nteam,SR,SPL\n\n,,\nBlue,5,2.5\n\n", "percent", id="blank lines"),
    pytest.param('team,SR,SPL\n"Blue, B","5",2.5\n', "percent", id="quotes"),
    pytest.param("team,SR,SPL,RGS,OSR\nBlue,5,2.5,-,\n", "percent", id="no value"),
    pytest.param("team,SR,SPL\nBlue,0.05,0.025\n", "fraction", id="fractions"),
    pytest.param('[{"team": "Blue", "SR": 5, "SPL": "2.5"}]', "percent", id="objects"),
    pytest.param(' [{"team": "B", "SR": 5, "SPL": 2.5, "RGS": null}]', "percent", id="null"),
]


@pytest.mark.parametrize(("text", "rates"), TABLES)
def test_tables_that_say_the_same(text: str, rates: str) -> None:
    assert scores_of(text, rates) == [{"success": 0.05, "spl": 0.025}]


def test_lines_are_those_of_an_editor() -> None:
    read = read_results('\nteam,SR\n"a\nb",5\n\nc,6\n', "test", "percent")
    assert [row.where for row in read.rows] == ["line 3", "line 6"]


def test_values_of_objects_stay_as_they_are_written() -> None:
    text = '[{"team": 7, "date": 1.50, "source": NaN, "SR": 5}, {"team": "b", "SR": Infinity}]'
    read = read_results(text, "test", "percent")
    about = {"team": "7", "date": "1.50", "source": "NaN"}
    assert [(row.where, row.about) for row in read.rows] == [("[0]", about), ("[1]", {"team": "b"})]
    assert list(map(str, read.problems)) == ["[1]: SR %: Infinity is not from 0 to 100"]


def test_objects_may_leave_columns_out() -> None:
    assert scores_of('[{"team": "a", "SR": 5}, {"method": "b", "TL": 9.5}]') == [
        {"success": 0.05},
        {"path_length": 9.5},
    ]


NEITHER = (
    'the file: expected a list of objects, or {"columns": [...], "methods": {NAME: {SPLIT: [...]}}}'
)
UNREADABLE = [
    pytest.param(
        "",
        "unreadable",
        ["the file: has no rows below a line with the names of the columns"],
        id="empty",
    ),
    pytest.param(
        "team,SR\n",
        "unreadable",
        ["the file: has no rows below a line with the names of the columns"],
        id="no row",
    ),
    pytest.param(
        "tem,SR,SPLL\na,1,2",
        "unknown-column",
        ["column 'tem': unknown; did you mean team?", "column 'SPLL': unknown; did you mean spl?"],
        id="all unknown columns",
    ),
    pytest.param(
        "team,SR,nav_success\na,1,2",
        "repeated-column",
        ["column 'nav_success': means the same as column 'SR'; remove one"],
        id="a column twice",
    ),
    pytest.param(
        "SR,SPL\n1,2",
        "no-column",
        ["columns: expected one for the team or the method"],
        id="nobody",
    ),
    pytest.param(
        'team,SR\na,1\n"b,2',
        "unreadable",
        ["line 3: cannot be read as CSV: unexpected end of data"],
        id="an open quote",
    ),
    pytest.param(
        '{"columns":\n [',
        "unreadable",
        ["line 2: invalid JSON at column 3: Expecting value"],
        id="broken JSON",
    ),
    pytest.param("[" * 100_000, "unreadable", ["the file: is nested too deeply"], id="deep JSON"),
    pytest.param("[1, 2]", "unreadable", [NEITHER], id="other JSON"),
    pytest.param('{"methods": {}}', "unreadable", [NEITHER], id="no columns"),
    pytest.param(
        '{"columns": ["SR"], "methods": {"a": {"val_seen": [1], "train": [2]}, "b": 3}}',
        "unreadable",
        ["methods: there are no results of test; there are results of: val_seen, train"],
        id="other splits",
    ),
    pytest.param(
        '{"columns": ["SR"], "methods": {}}',
        "unreadable",
        ["methods: there are no results of test; there are results of: no split"],
        id="no split",
    ),
]


@pytest.mark.parametrize(("text", "code", "told"), UNREADABLE)
def test_files_that_are_no_table(text: str, code: str, told: Sequence[str]) -> None:
    with pytest.raises(TableError) as raised:
        read_results(text, "test", "percent")
    problems = list(map(str, raised.value.problems))
    assert {each.code for each in raised.value.problems} == {code}
    assert len(problems) == len(told)
    for problem, expected in zip(problems, told, strict=True):
        assert problem.partition(" Choose one of: ")[0] == expected


def test_all_wrong_rows_are_reported() -> None:
    text = "team,SR,TL m\na,100.1,5\nb,x,-1\nc,1\nd,,\ne,nan,1e999\nf,1,0\n"
    problems = read_results(text, "test", "percent").problems
    assert [problem.position for problem in problems] == [(0,), (1,), (1,), (2,), (3,), (4,), (4,)]
    assert {problem.code for problem in problems} == {"wrong-value"}
    assert list(map(str, problems)) == [
        "line 2: SR %: 100.1 is not from 0 to 100",
        "line 3: TL m: -1 is not 0 or more",
        "line 3: SR: 'x' is not a number",
        "line 4: has 2 values for 3 columns: team, SR, TL m",
        "line 5: has no score",
        "line 6: TL m: 1e999 is not 0 or more",
        "line 6: SR %: nan is not from 0 to 100",
    ]


@pytest.mark.parametrize(
    ("rates", "value", "is_refused"),
    [
        pytest.param("percent", "0.5964", True, id="fractions that are said to be percent"),
        pytest.param("percent", "1.01", False, id="one per cent"),
        pytest.param("percent", "0", False, id="nothing was reached"),
        pytest.param("fraction", "0.5964", False, id="fractions"),
        pytest.param("fraction", "59.64", True, id="percent that are said to be fractions"),
    ],
)
def test_percent_and_fractions_are_told_apart(rates: str, value: str, *, is_refused: bool) -> None:
    text = f"team,SR\na,{value}\n"
    read = read_results(text, "test", "fraction" if rates == "fraction" else "percent")
    assert bool(read.problems) == is_refused


def test_fractions_are_at_most_1() -> None:
    (problem,) = read_results("team,SR\na,1.5\nb,1\n", "test", "fraction").problems
    assert str(problem) == "line 2: SR %: 1.5 is not from 0 to 1"


def test_a_file_may_have_no_rates() -> None:
    assert scores_of("team,TL\na,0.5\n") == [{"path_length": 0.5}]


def test_rates_that_look_like_fractions_are_one_problem_of_the_file() -> None:
    (problem,) = read_results("team,SR,TL\na,1,5\nb,0.5,7\n", "test", "percent").problems
    assert (problem.code, str(problem)) == (
        "fractions",
        "all rates: no rate is above 1 %; if they are fractions, set rates to fraction",
    )


def test_a_metric_that_the_task_does_not_have_is_refused() -> None:
    text = '[{"team": "a", "SPL": 5, "NDTW": 9}]'
    with pytest.raises(TableError) as raised:
        read_results(text, "test", "percent", ["spl"])
    (problem,) = raised.value.problems
    told = "column 'NDTW': not a metric of this split; choose one of: team, method, date, source, "
    assert (problem.code, str(problem).startswith(told)) == ("unknown-column", True)


def test_a_change_is_read_as_a_file_is() -> None:
    cells = {"team": "T", "date": "", "method": "M", "Paper": "", "ensemble": "no", "TL": "9.5"}
    only = read_change(ReportedChange, {"RGS": "32.49"})
    assert only.model_dump(exclude_unset=True) == {"method": {}, "scores": {"rgs": 0.3249}}
    several = {**cells, "SR (%)": "", "source": "x", "description": ""}
    assert read_change(ReportedChange, several).model_dump(exclude_unset=True) == {
        "team": "T",
        "date": None,
        "source": "x",
        "method": {"name": "M", "paper": None, "ensemble": False, "description": ""},
        "scores": {"path_length": 9.5, "success": None},
    }


def test_a_new_result_lacks_the_scores_that_a_table_has_no_value_of() -> None:
    cells = {"method": "M", "team": "T", "source": "x", "SR": "-", "SPL": "", "RGS": "32.49"}
    assert read_change(NewReported, cells, split="test").scores == {"rgs": 0.3249}


def test_everything_that_is_wrong_with_a_change_is_told_at_once() -> None:
    cells = {"SR": "x", "TL": "-1", "method": "M", "team": "", "source": "x", "date": "soon"}
    with pytest.raises(TableError) as raised:
        read_change(NewReported, cells, split="test")
    assert [(each.code, str(each).partition(";")[0]) for each in raised.value.problems] == [
        ("wrong-value", "values: TL m: -1 is not 0 or more"),
        ("wrong-value", "values: SR: 'x' is not a number"),
        ("wrong-value", "team: must have 1 or more characters"),
        (
            "wrong-value",
            "date: must be a day, a month or a year: 2026-01-15, 2026-01, 01/2026 or 2026",
        ),
    ]


def test_a_method_may_have_one_value_and_other_splits() -> None:
    methods = {"A": {"test": 5.5, "val_seen": [1]}, "B": {"val_seen": [2]}}
    text = json.dumps({"columns": ["SR"], "methods": methods, "note": "x", "year": 1})
    read = read_results(text, "test", "percent")
    (row,) = read.rows
    assert (row.place, row.about, row.scores) == (0, {"method": "A"}, {"success": 0.055})
    assert list(read.unread) == ["note", "year"]


@pytest.mark.parametrize("text", ["0", "7", "59.64", "0.07", "33.333333333", "100"])
def test_a_value_is_printed_as_it_was(text: str) -> None:
    for key in ("success", "path_length"):
        assert as_printed(CATALOGUE[key], printed_value(CATALOGUE[key], text)) == text
