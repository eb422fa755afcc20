"""One table in every layout, by hand."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from reverie_eval.reporting.tables import MARK, MISSING, Group, Number, Table
from reverie_eval_cli.output import print_table

TABLE = Table(
    headings=["Method", "SR", "OSR", "SR", "OSR"],
    rows=[
        ["a|b", Number("60.00", "bold", "†‡"), "80.00", "5.00", MISSING],
        ["", "", "", "", ""],
        ["c_*", "9.00", f"100.00{MARK}", Number("50", "underlined", "", ("4", "6")), "75.00"],
    ],
    text_columns=frozenset({0}),
    groups=[[Group("Seen", 2), Group("Unseen", 2)], [Group("All", 3), Group("Rest", 1)]],
    caption="Results & all.",
    notes=["split:a|n:3", "", "* differs"],
)
TEXT = """\
Method  Seen SR  Seen OSR    Unseen SR  Unseen OSR
a|b     60.00†‡    80.00          5.00           -

c_*        9.00   100.00*  50 (4 to 6)       75.00

Results & all.
split:a|n:3

* differs"""
MARKDOWN = r"""| Method | Seen SR | Seen OSR | Unseen SR | Unseen OSR |
| :--- | ---: | ---: | ---: | ---: |
| a\|b | **60.00**†‡ | 80.00 | 5.00 | - |
|  |  |  |  |  |
| c\_\* | 9.00 | 100.00\* | <ins>50</ins> (4 to 6) | 75.00 |

Results &amp; all.

split:a|n:3

\* differs"""
LATEX = r"""% split:a|n:3
%
% * differs
\begin{table*}
\centering
\caption{Results \& all.}
\setlength{\tabcolsep}{3pt}
\begin{tabular}{lrrrr}
\toprule
 & \multicolumn{2}{c}{Seen} & \multicolumn{2}{c}{Unseen} \\
\cmidrule(lr){2-3} \cmidrule(lr){4-5}
 & \multicolumn{3}{c}{All} & \multicolumn{1}{c}{Rest} \\
\cmidrule(lr){2-4} \cmidrule(lr){5-5}
Method & SR & OSR & SR & OSR \\
\midrule
a\textbar{}b & \textbf{60.00}\rlap{\textsuperscript{\textdagger{}\textdaggerdbl{}}} & 80.00 & 5.00 & - \\
\midrule
c\_{*} & 9.00 & 100.00{*} & \begin{tabular}[t]{@{}r@{}}\underline{50}\\ \scriptsize (4,\\ \scriptsize 6)\end{tabular} & 75.00 \\
\bottomrule
\end{tabular}
\end{table*}"""  # noqa: E501  # lines of LaTeX
CSV = """\
Method,Seen SR,Seen OSR,Unseen SR,Unseen OSR
a|b,60.00†‡,80.00,5.00,-
c_*,9.00,100.00*,50 (4 to 6),75.00"""
STACKED = """\
Method         a|b
Seen SR      60.00†‡
Seen OSR     80.00
Unseen SR     5.00
Unseen OSR       -

Method         c_*
Seen SR       9.00
Seen OSR   100.00*
Unseen SR    50 (4 to 6)
Unseen OSR   75.00"""


@pytest.mark.parametrize(
    ("layout", "expected"),
    [
        pytest.param(Table.to_text, TEXT, id="text"),
        pytest.param(Table.to_markdown, MARKDOWN, id="markdown"),
        pytest.param(Table._repr_markdown_, MARKDOWN, id="notebook"),
        pytest.param(Table.to_latex, LATEX, id="latex"),
        pytest.param(Table.to_csv, CSV, id="csv"),
    ],
)
def test_a_layout(layout: object, expected: str) -> None:
    assert callable(layout)
    assert layout(TABLE) == expected


@pytest.mark.parametrize(
    ("name", "cell"),
    [
        pytest.param(
            "<script>alert(1)</script>", "&lt;script&gt;alert(1)&lt;/script&gt;", id="tag"
        ),
        pytest.param("A&B &lt;", "A&amp;B &amp;lt;", id="ampersand and entity"),
        pytest.param("a|b", r"a\|b", id="end of a cell"),
        pytest.param("`rm`", r"\`rm\`", id="code"),
        pytest.param("**loud**", r"\*\*loud\*\*", id="emphasis"),
        pytest.param("_x_ val_unseen", r"\_x\_ val_unseen", id="underscores, not inside words"),
        pytest.param("[x](http://a)", r"\[x\](http://a)", id="link"),
        pytest.param("a\\|b", r"a\\\|b", id="backslash before the end of a cell"),
        pytest.param("two\nlines", "two lines", id="lines"),
        pytest.param("IoU>=.5 %, p < 0.001", "IoU>=.5 %, p < 0.001", id="comparisons are no tags"),
    ],
)
def test_names_are_text_in_markdown(name: str, cell: str) -> None:
    table = Table(["n"], [[name]], notes=[name.replace("|", "")])
    _, _, row, _, note = table.to_markdown().splitlines()
    assert row == f"| {cell} |"
    assert note == cell.replace(r"\|", "")


def test_html_escapes_explains_metrics_and_separates_rows() -> None:
    bold = Number("1", "bold", "†", ("0", "2"))
    table = Table(
        ["", "SR %"],
        [["<a>", bold], ["", ""], ["b", Number("2", "underlined")]],
        frozenset({0}),
        [[Group("<g>", 1)]],
    )
    name, value = '<tr><th scope="row" style="text-align: left">', "</th><td>"
    assert table.to_html() == (
        '<table><thead><tr><th></th><th colspan="1">&lt;g&gt;</th></tr><tr><th></th><th title='
        '"success rate: the target object is visible where the agent stops">SR %</th></tr></thead>'
        f"<tbody>{name}&lt;a&gt;{value}<strong>1</strong><sup>†</sup><br><small>(0 to 2)</small>"
        f"</td></tr></tbody><tbody>{name}b{value}<u>2</u></td></tr></tbody></table>"
    )


def test_lines_below_a_table_in_html() -> None:
    html = TABLE.to_html()
    assert ">Results &amp; all.<br>split:a|n:3<br>* differs</caption>" in html
    signed = Table(["n"], [["1"]], notes=["split:a|n:3", "note"]).to_html()
    assert "><code>split:a|n:3</code><br>note</caption>" in signed


def printed(columns: int, table: Table, narrow: Table | None = None) -> str:
    """Return what a terminal of this width shows."""
    screen = io.StringIO()
    print_table(Console(file=screen, width=columns), replace(table, narrow=narrow))
    return screen.getvalue()


def test_a_terminal_gets_the_first_layout_that_fits() -> None:
    narrow = TABLE.stacked()
    wide = printed(80, TABLE, narrow)
    assert "Seen SR   Seen OSR" in wide
    lines = [line.strip() for line in printed(28, TABLE, narrow).splitlines()]
    expected = [line.strip().split() for line in STACKED.splitlines()]
    assert [line.split() for line in lines[: len(expected)]] == expected
    assert lines[len(expected) :] == ["", "Results & all.", "split:a|n:3", "", "* differs"]


def test_text_wraps_before_another_layout_is_taken() -> None:
    table = Table(["text", "n"], [["some words that need more room", "1"]], frozenset({0}))
    shown = printed(24, table, Table(["other"], [["layout"]]))
    assert max(map(len, shown.splitlines())) <= 24
    assert "some words" in shown
    assert "other" not in shown


def test_nothing_is_cut_where_no_layout_fits() -> None:
    assert printed(20, TABLE).startswith(TEXT.partition("\n\n")[0])
