"""Checking printed tables: how they are read, and whether exactly the planted errors are found."""

import json
import re
from collections.abc import Mapping, Sequence
from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Decimal
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest

from reverie_eval import CATALOGUE, ProtocolError, Scores, compare, evaluate, evaluate_protocols
from reverie_eval.reporting.printed import PrintedCell, metric_in, number_in, read_tables, split_in
from reverie_eval.reporting.table_check import TableCheck, check_tables
from tests.conftest import REPOSITORY, SAMPLES
from tests.support.flat_world import Run

SPLIT, PROTOCOL = "val_unseen", "official-v1"
Layout = Literal["tex", "md", "csv"]

# Reading.

LATEX = r"""\documentclass{article}
\newcommand{\best}[1]{\textbf{#1}}
\newcommand{\ours}{Our Walker}
% \begin{tabular} 1 & 2 \\ \end{tabular}
\begin{table*}[t]
\caption{Results on REVERIE.}
\resizebox{\textwidth}{!}{
\begin{tabular}{l|cc|c@{\hskip 3pt}c}
\toprule
\multirow{2}{*}{Methods} & \multicolumn{2}{c|}{Val Seen} & \multicolumn{2}{c}{Val Unseen} \\ \cmidrule(lr){2-3}
 & SR$\uparrow$ & \textbf{RGS} & SR & RGS\\[2pt]
\midrule
DUET~\cite{chen2022} & {\bf 71.75} & $57.41$ & \underline{46.98} & \best{32.15}$^\dagger$ \\ % end
\rowcolor{gray!20} \ours & $\mathbf{72.0}_{\pm 0.1}$ & 57.4\%
    & -- & \textcolor{red}{3.1} \\ \hline
\bottomrule
\end{tabular}}
\end{table*}
"""  # noqa: E501  # a line of LaTeX
MARKDOWN = """
Some text | with a bar.

| Methods | Val Seen SR | RGS |
| :--- | ---: | ---: |
| DUET \\[1\\] | **71.75** | <ins>57.41</ins> |
| a\\|b | 72.0 &plusmn; 0.1 | - |
"""


def shown(cell: PrintedCell) -> str:
    """Return a cell as its line, looks and text."""
    return f"{cell.line}{''.join(f' {look}' for look in sorted(cell.looks))}: {cell.text}"


def test_a_table_in_latex() -> None:
    (table,) = read_tables(LATEX, "paper.tex")
    assert table.caption == "Results on REVERIE."
    assert [[shown(cell) for cell in row] for row in table.rows] == [
        ["10: Methods", *["10: Val Seen"] * 2, *["10: Val Unseen"] * 2],
        ["10: Methods", "11: SR", "11: RGS", "11: SR", "11: RGS"],
        ["13: DUET", "13 bold: 71.75", "13: 57.41", "13 underlined: 46.98", "13 bold: 32.15^"],
        ["14: Our Walker", "14 bold: 72.0_±0.1", "14: 57.4%", "15: --", "15: 3.1"],
    ]
    assert len(set(table.blocks[2:])) == 1 != len(set(table.blocks))


@pytest.mark.parametrize(
    "text",
    [
        r"\newcommand",
        r"\begin{tabular}{l} 1 & \multicolumn \end{tabular}",
        r"\begin{tabular}{l} \multirow \\ {2 & \end{tabular}",
        r"\newcommand{\a}{\a\a} \begin{tabular}{l} \a & } \end{tabular}",
        r"\begin{tabular",
    ],
)
def test_broken_latex_is_read_as_far_as_it_goes(text: str) -> None:
    assert len(read_tables(text, "paper.tex")) == text.count(r"\end{tabular}")


def test_a_table_in_markdown() -> None:
    (table,) = read_tables(MARKDOWN, "paper.md")
    assert [[shown(cell) for cell in row] for row in table.rows] == [
        ["4: Methods", "4: Val Seen SR", "4: RGS"],
        ["6: DUET [1]", "6 bold: 71.75", "6 underlined: 57.41"],
        ["7: a|b", "7: 72.0 ± 0.1", "7: -"],
    ]


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_a_table_that_a_reviewer_typed(delimiter: str) -> None:
    (table,) = read_tables(f"Method{delimiter}SR\nDUET{delimiter}**46.98**\n", "typed.csv")
    assert [[shown(cell) for cell in row] for row in table.rows] == [
        ["1: Method", "1: SR"],
        ["2: DUET", "2 bold: 46.98"],
    ]


@pytest.mark.parametrize(
    ("headings", "label"),
    [
        (["SR"], "SR"),
        (["Val Unseen", "SR (%) ↑"], "SR"),
        (["Navigation", "Oracle Succ."], "OSR"),
        (["Nav. Acc.", "Succ."], "SR"),
        (["Trajectory Length [m]"], "TL"),
        (["REVERIE Val Seen RGSPL"], "RGSPL"),
        (["SPL", ""], "SPL"),
        (["Method"], None),
        ([], None),
    ],
)
def test_the_metric_of_a_heading(headings: Sequence[str], label: str | None) -> None:
    metric = metric_in(headings)
    assert (None if metric is None else metric.label) == label


@pytest.mark.parametrize(
    ("text", "split"),
    [
        ("Val Seen", "val_seen"),
        ("val_unseen RGS", "val_unseen"),
        ("Validation-Unseen", "val_unseen"),
        ("Seen", "val_seen"),
        ("Test (Unseen)", "test"),
        ("Seen Unseen", None),
        ("Results on the validation unseen split, by a paired test", "val_unseen"),
        ("The best results that we have seen in a test so far", None),
    ],
)
def test_the_split_of_a_heading(text: str, split: str | None) -> None:
    assert split_in(text) == split


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("52.50±0.1", "52.50"),
        ("-0.1", "-0.1"),
        ("\N{MINUS SIGN}0.1", "-0.1"),
        (".52", "0.52"),
        ("7", "7"),
        *dict.fromkeys(("R2R", "3D", "-", "", "†52")).items(),
    ],
)
def test_the_number_of_a_cell(text: str, number: str | None) -> None:
    assert str(number_in(text)) == str(number)


# Planted errors.

KEYS = ("success", "oracle_success", "spl", "rgs", "rgspl")


class Planted(NamedTuple):
    """A table with three errors."""

    text: str
    rounding: tuple[str, str]
    protocol: tuple[str, str]
    bold: tuple[str, str]


@pytest.fixture(scope="module")
def methods() -> Mapping[str, Mapping[str, Scores]]:
    """Score six methods by all protocols: episodes of two samples at random, some cut short."""
    good, mediocre = (
        json.loads((SAMPLES / f"{name}.json").read_bytes()) for name in ("good", "mediocre")
    )
    scored = {}
    for seed in range(6):
        rng = np.random.default_rng(seed)
        records = []
        for pair in zip(good, mediocre, strict=True):
            record: dict[str, Any] = dict(pair[int(rng.random() < seed / 8)])
            if rng.random() < 0.3:
                keep = int(rng.integers(1, len(record["trajectory"]) + 1))
                record["trajectory"] = record["trajectory"][:keep]
            records.append(record)
        scored[f"Walker-{'ABCDEF'[seed]}"] = evaluate_protocols(records, split=SPLIT)
    return scored


def rounded(value: float, decimals: int, how: str = ROUND_HALF_EVEN) -> str:
    """Return a fraction in percent."""
    return str((100 * Decimal(value)).quantize(Decimal(1).scaleb(-decimals), how))


def plant(seed: int, methods: Mapping[str, Mapping[str, Scores]]) -> tuple[Planted, Layout]:
    """Write a table of some methods with a wrong rounding, another protocol, and a wrong bold."""
    rng = np.random.default_rng(seed)
    names = [str(name) for name in rng.permutation(list(methods))[: int(rng.integers(3, 6))]]
    decimals = int(rng.integers(1, 3))
    unit = 10.0**-decimals
    values = {
        (name, key): rounded(methods[name][PROTOCOL][key], decimals)
        for name in names
        for key in KEYS
    }
    # One that is cut off, and not also somebody else's number.
    cuts = {
        cell: rounded(methods[cell[0]][PROTOCOL][cell[1]], decimals, ROUND_DOWN) for cell in values
    }
    wrong = [cell for cell in values if cuts[cell] != values[cell]]
    rounding = wrong[int(rng.integers(len(wrong)))]
    # One by the rules of another protocol, further off than any rounding.
    others = {
        (name, key): [
            rounded(scores[key], decimals)
            for scores in methods[name].values()
            if key in scores and abs(scores[key] - methods[name][PROTOCOL][key]) > 0.02 * unit
        ]
        for name, key in values
        if (name, key) != rounding
    }
    able = [cell for cell, several in others.items() if several]
    protocol = able[int(rng.integers(len(able)))]
    values |= {rounding: cuts[rounding], protocol: str(rng.choice(others[protocol]))}
    # Bold is what the authors then took for the best, except in one column.
    columns = {key: {name: float(values[name, key]) for name in names} for key in KEYS}
    bold = {
        (name, key) for key, of in columns.items() for name in names if of[name] == max(of.values())
    }
    uneven = [key for key, of in columns.items() if len(set(of.values())) > 1]
    moved = str(rng.choice(uneven))
    worse = [name for name in names if columns[moved][name] < max(columns[moved].values())]
    chosen = (str(rng.choice(worse)), moved)
    bold = {cell for cell in bold if cell[1] != moved} | {chosen}
    layout: Layout = ("tex", "md", "csv")[seed % 3]
    text = written(names, values, bold, layout)
    return Planted(text, rounding, protocol, chosen), layout


def written(
    names: Sequence[str],
    values: Mapping[tuple[str, str], str],
    bold: set[tuple[str, str]],
    layout: Layout,
) -> str:
    """Lay out a table."""
    mark = r"\textbf{{{}}}" if layout == "tex" else "**{}**"
    rows = [["Method", *(CATALOGUE[key].label for key in KEYS)]]
    rows += [
        [
            name,
            *(
                mark.format(values[name, key]) if (name, key) in bold else values[name, key]
                for key in KEYS
            ),
        ]
        for name in names
    ]
    if layout == "tex":
        body = "\n".join(" & ".join(row) + r" \\" for row in rows)
        return f"\\begin{{tabular}}{{lrrrrr}}\n{body}\n\\end{{tabular}}\n"
    if layout == "md":
        rows.insert(1, ["---"] * len(rows[0]))
        return "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return "\n".join(",".join(row) for row in rows)


def checked(text: str, layout: str, methods: Mapping[str, Mapping[str, Scores]]) -> TableCheck:
    """Check a table against these methods."""
    return check_tables(read_tables(text, f"paper.{layout}"), {SPLIT: methods}, PROTOCOL)


@pytest.mark.parametrize("seed", range(20))
def test_three_planted_errors_are_found_and_nothing_else(
    seed: int, methods: Mapping[str, Mapping[str, Scores]]
) -> None:
    planted, layout = plant(seed, methods)
    check = checked(planted.text, layout, methods)
    found = {
        verdict: [(each.method, each.metric) for each in check.numbers if each.verdict == verdict]
        for verdict in ("rounding", "protocol", "differs")
    }

    def labelled(cell: tuple[str, str]) -> tuple[str, str]:
        return cell[0], CATALOGUE[cell[1]].label

    assert found == {
        "rounding": [labelled(planted.rounding)],
        "protocol": [labelled(planted.protocol)],
        "differs": [],
    }
    wrong = [(each.row, each.metric) for each in check.looks if not each.is_right]
    assert wrong == [labelled(planted.bold)]
    assert not check.is_right
    (slip,) = [each for each in check.numbers if each.verdict == "rounding"]
    assert slip.finding.startswith("cut off, not rounded")


def test_of_one_target_bold_is_checked_but_not_tested() -> None:
    methods = {
        name: {PROTOCOL: evaluate(SAMPLES / f"{name}.json", split=SPLIT, subset=["1196_0_0"])}
        for name in ("good", "mediocre")
    }
    (look,) = checked("Method,SPL\ngood,**100.00**\nmediocre,0.00\n", "csv", methods).looks
    assert look.is_right
    assert look.finding.startswith("is the best; not tested: all episodes share one target")


# By hand.


def results(**by_protocol: dict[str, float]) -> Any:
    """Return a method's means by protocol, as if they were scores."""
    return {SPLIT: {"ours": by_protocol}}


def check_typed(text: str, found: Any) -> TableCheck:
    """Check a table in CSV."""
    return check_tables(read_tables(text, "typed.csv"), found, "official")


@pytest.mark.parametrize(
    ("printed", "verdict", "finding"),
    [
        pytest.param("54.53", "agrees", "rounded to 2 decimals", id="two decimals"),
        pytest.param("54.5", "agrees", "rounded to 1 decimal", id="one decimal"),
        pytest.param("55", "agrees", "rounded to 0 decimals", id="no decimals"),
        pytest.param("54.534700", "agrees", "rounded to 6 decimals", id="six decimals"),
        pytest.param("54.52", "rounding", "off by one in the last digit", id="off by one"),
        pytest.param("54.534", "rounding", "cut off, not rounded", id="cut off"),
        pytest.param("54", "rounding", "cut off, not rounded; or it agrees under other", id="both"),
        pytest.param("54.40", "protocol", "agrees under other", id="another protocol"),
        pytest.param("54.60", "differs", "agrees under no protocol", id="neither"),
    ],
)
def test_how_a_number_can_have_been_made(printed: str, verdict: str, finding: str) -> None:
    found = results(official={"success": 0.545347}, other={"success": 0.544})
    (number,) = check_typed(f"Method,SR\nours,{printed}", found).numbers
    assert (number.verdict, number.finding) == (verdict, finding)


@pytest.mark.parametrize(
    ("value", "printed", "verdict"),
    [
        pytest.param(0.125, "12", "agrees", id="a half, to even"),
        pytest.param(0.125, "13", "agrees", id="a half, up"),
        pytest.param(0.12449, "12.5", "rounding", id="rounded twice"),
        pytest.param(0.1234, "0.12", "agrees", id="a fraction"),
        pytest.param(0.1234, "0.123", "agrees", id="a fraction with three decimals"),
    ],
)
def test_a_rounding(value: float, printed: str, verdict: str) -> None:
    (number,) = check_typed(f"Method,SPL\nours,{printed}", results(official={"spl": value})).numbers
    assert number.verdict == verdict
    assert (number.finding == "rounded twice") == (verdict == "rounding")


def test_lengths_are_in_metres() -> None:
    found = results(official={"success": 0.5, "path_length": 9.473})
    check = check_typed("Method,SR,TL\nours,50.0,9.47", found)
    assert [each.verdict for each in check.numbers] == ["agrees", "agrees"]
    assert check.summary == "2 numbers checked: 2 agree"
    assert check.is_right


def test_a_row_without_a_label_is_found_by_its_numbers() -> None:
    found = results(
        official={"success": 0.5, "spl": 0.4, "rgs": 0.3},
        other={"success": 0.6, "spl": 0.45, "rgs": 0.31},
    )
    table = "Method,SR,SPL,RGS\nBase,10,20,30\nThe walker,60,45,32\nHuman,81,-,70"
    check = check_typed(table, found)
    assert [(each.row, each.verdict) for each in check.numbers] == [
        ("The walker", "protocol"),
        ("The walker", "protocol"),
        ("The walker", "differs"),
    ]
    assert check.summary == "3 numbers checked: 2 under another protocol, 1 wrong"
    assert check.notes == [
        "The walker is taken for ours, because 2 of 3 numbers agree; no label says so",
        "The walker: of 3 numbers, 0 agree under official, 2 under other",
        "not checked, without a file: Base, Human",
        f"no heading names a split: taken for {SPLIT}",
    ]


@pytest.mark.parametrize(
    ("labels", "matched"),
    [
        (["Base", "Ours [3]"], "Ours [3]"),
        (["Ours", "Ours (full)"], "Ours"),
        (["Walker (ours)", "Base"], "Walker (ours)"),
        # Two labels have the name in them, and no number says which.
        (["Ours A", "Ours B"], None),
    ],
)
def test_labels(labels: Sequence[str], matched: str | None) -> None:
    table = "\n".join(["Method,SR", *(f"{label},{number}" for label, number in zip(labels, "12"))])  # noqa: B905
    found = results(official={"success": 0.5})
    if matched is None:
        with pytest.raises(
            ProtocolError, match=r"no row is one of ours.*the rows are Ours A, Ours"
        ):
            check_typed(table, found)
    else:
        assert [each.row for each in check_typed(table, found).numbers] == [matched]


def test_labels_that_could_both_be_meant_are_told_apart_by_numbers() -> None:
    found = results(official={"success": 0.5, "spl": 0.4})
    check = check_typed("Method,SR,SPL\nOurs A,10,20\nOurs B,50,40", found)
    assert [each.row for each in check.numbers] == ["Ours B", "Ours B"]
    assert check.notes[0] == (
        "Ours B is taken for ours, because 2 of 2 numbers agree; no label says so"
    )


def test_splits_above_and_beside_each_other() -> None:
    found = {
        split: {"ours": {"official": {"success": share}}}
        for split, share in (("val_seen", 0.7), ("val_unseen", 0.5))
    }
    beside = "Method,Val Seen SR,Val Unseen SR,Test SR\nours,70,50,44"
    above = "Method,SR\nValidation Seen,\nours,70\nValidation Unseen,\nours,50\nTest,\nours,44"
    for table in (beside, above):
        check = check_typed(table, found)
        assert [(each.split, each.verdict) for each in check.numbers] == [
            ("val_seen", "agrees"),
            ("val_unseen", "agrees"),
        ]
        assert check.notes == ["not checked: test"]
    check = check_typed("Method,Val Seen SR,SR\nours,70,50", found)
    assert check.notes == ["not checked: columns whose split no heading names"]


def test_no_column_of_a_metric() -> None:
    with pytest.raises(ProtocolError, match=r"no column is headed by a metric.* of val_unseen"):
        check_typed("Method,Year\nours,2020", results(official={"success": 0.5}))


def test_a_file_without_the_metrics_of_its_row() -> None:
    with pytest.raises(ProtocolError, match="nothing to compare: the files have no scores of SPL"):
        check_typed("Method,SPL\nours,40", results(official={"success": 0.5}))


RULED = r"""\begin{tabular}{lrr}
Method & SR & SPL \\ \midrule
Human & 81.5 & 53.7 \\ \midrule
Walker-A & \textbf{SRA} & SPLA \\
Walker-F & SRF & \textbf{SPLF} \\
Walker-B & \underline{SRB} & \underline{SPLB} \\
\end{tabular}"""


def test_bold_between_two_rules_and_its_certainty(
    methods: Mapping[str, Mapping[str, Scores]],
) -> None:
    text = RULED
    for letter in "AFB":
        scores = methods[f"Walker-{letter}"][PROTOCOL]
        for key in ("spl", "success"):
            text = text.replace(f"{CATALOGUE[key].label}{letter}", rounded(scores[key], 1))
    check = checked(text, "tex", methods)
    found = [(each.row, each.metric, each.look, each.is_right) for each in check.looks]
    # Nobody is as good as humans, whose row is a block of its own.
    assert found == [
        ("Walker-A", "SR", "bold", True),
        ("Walker-B", "SR", "underlined", True),
        ("Walker-F", "SPL", "bold", False),
        ("Walker-B", "SPL", "underlined", True),
    ]
    first, _, third, _ = check.looks
    pair = compare(methods["Walker-B"][PROTOCOL], methods["Walker-A"][PROTOCOL], names=["b", "a"])
    difference = CATALOGUE["success"].display(pair["a"]["success"].mean)
    assert first.finding.startswith("is the best; ")
    assert f"better than Walker-B, by {difference}, p " in first.finding
    assert third.finding.startswith("is not the best: Walker-A has ")


def test_bold_that_is_the_best_as_printed_and_worse_by_the_files(
    methods: Mapping[str, Mapping[str, Scores]],
) -> None:
    better, worse = (methods[f"Walker-{letter}"][PROTOCOL]["success"] for letter in "AB")
    assert better > worse
    table = f"Method,SR\nWalker-A,{rounded(better, 1)}\nWalker-B,**99.9**\n"
    (bold,) = checked(table, "csv", methods).looks
    assert (bold.row, bold.is_right) == ("Walker-B", True)
    difference = CATALOGUE["success"].display(better - worse)
    says = f"is the best; but by their files, Walker-A is better by {difference}, p "
    assert bold.finding.startswith(says)


# At the terminal.

GOOD, MEDIOCRE = str(SAMPLES / "good.json"), str(SAMPLES / "mediocre.json")


def test_the_table_that_we_write_is_right(run: Run, tmp_path: Path) -> None:
    files = [f"ours={GOOD}", f"base={MEDIOCRE}", "--split", SPLIT]
    paper = tmp_path / "paper.tex"
    assert run("table", *files, "--baseline", "base", "--ci", "--format", "latex", "-o", str(paper))
    status, out, err = run("check-table", str(paper), *files)
    assert (status, err) == (0, "")
    assert out.startswith("12 numbers checked: 12 agree\n")
    assert "is the best; significantly better than base, by 39.29, p < 0.001" in out
    paper.write_text(paper.read_text().replace("80.95", "80.94"))
    status, out, err = run("check-table", str(paper), *files, "--format", "csv")
    assert status == 1
    lines = out.splitlines()
    assert len(lines) == 13
    line = next(n for n, it in enumerate(paper.read_text().splitlines(), 1) if "80.94" in it)
    assert lines[1] == (
        f"{line},ours,ours,{SPLIT},SR,80.94,80.9524,rounding,off by one in the last digit"
    )


def test_what_cannot_be_checked(run: Run, tmp_path: Path) -> None:
    paper = tmp_path / "paper.tex"
    paper.write_text(r"\begin{tabular}{lr} Method & Year \\ ours & 2020 \end{tabular}")
    files = [f"ours={GOOD}", "--split", SPLIT]
    status, _, err = run("check-table", str(paper), *files)
    assert (status, err.partition(": ")[2]) == (
        2,
        "no column is headed by a metric, such as SR or SPL, of val_unseen\n",
    )
    status, _, err = run("check-table", str(paper), *files, "--protocol", "dute")
    assert status == 2
    assert "duet" in err
    empty = [tmp_path / f"empty.{layout}" for layout in ("tex", "md", "csv")]
    for file in empty:
        file.write_text(r"Numbers are in \input{table}." if file != empty[-1] else "")
    pdf = tmp_path / "paper.pdf"
    pdf.touch()
    for wrong, says in [
        (str(pdf), "tables are not read from PDF"),
        ("no.tex", "no.tex: No such file"),
        *((str(file), f"{file}: no table found; in LaTeX (.tex), ") for file in empty),
    ]:
        status, _, err = run("check-table", wrong, *files)
        assert status == 2
        assert says in err
    status, _, err = run("check-table", str(paper), *files, "-o", str(paper))
    assert status == 2
    assert "paper.tex is an input" in err


def test_the_page_for_reviewers_shows_what_is_printed(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (REPOSITORY / "docs" / "how-to" / "review-numbers.md").read_text()
    (table,) = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    (words, printed) = re.findall(
        r"```sh\nreverie-eval (check-table .*?)\n```\n\n```\n(.*?)```", page, re.DOTALL
    )[0]
    (tmp_path / "paper.csv").write_text(table)
    (tmp_path / "demo").symlink_to(SAMPLES)
    monkeypatch.chdir(tmp_path)
    assert run(*words.split()) == (1, printed, "")
