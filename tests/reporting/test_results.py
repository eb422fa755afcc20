"""Tables of several methods' results: values by hand, what is bold, and LaTeX's structure.

LaTeX itself is far too large to be asked here, so its lines are taken apart instead.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from reverie_eval import CATALOGUE, ProtocolError, Scores, evaluate
from reverie_eval.reporting import results_table
from reverie_eval.reporting.tables import Bold
from tests.conftest import SAMPLES
from tests.support.flat_world import Run

SPLIT = "val_unseen"
LABELS = ["SR", "OSR", "SPL", "TL", "RGS", "RGSPL"]
KEYS = ["success", "oracle_success", "spl", "path_length", "rgs", "rgspl"]


@pytest.fixture(scope="module")
def scores() -> Scores:
    """Score the good sample."""
    return evaluate(SAMPLES / "good.json", split=SPLIT)


def showing(scores: Scores, **means: float) -> Scores:
    """Return scores whose means are these, and 0 for all else."""
    episodes = {key: np.full(84, means.get(key, 0.0)) for key in KEYS}
    return replace(scores, episodes=episodes)


def on(scores: Scores, split: str, fingerprint: str = "f" * 64) -> Scores:
    """Return the same scores for another split."""
    truth = scores.ground_truth
    header = replace(truth.header, split=split, fingerprint=fingerprint)
    return replace(scores, ground_truth=replace(truth, header=header))


def bold(table: str) -> list[str]:
    """Return what a LaTeX table shows in bold."""
    return re.findall(r"\\textbf\{([^}]*)\}", table)


def lines_between(table: str, begin: str, end: str) -> Sequence[Sequence[str]]:
    """Return the cells of the lines between two others."""
    body = table.partition(f"{begin}\n")[2].partition(f"\n{end}")[0]
    assert all(line.endswith(r" \\") for line in body.splitlines())
    return [line.removesuffix(r" \\").split(" & ") for line in body.splitlines()]


# By hand.

ONE_SPLIT = r"""\begin{table}
\centering
\caption{Results on the synthetic demo world. TL in metres, all else in percent; the best of each column in bold. Scored by reverie-eval VERSION, protocol official-v1; data: val\_unseen DATA (84 episodes).}
\begin{tabular}{lrrrrrr}
\toprule
 & \multicolumn{6}{c}{Val unseen} \\
\cmidrule(lr){2-7}
Method & SR & OSR & SPL & TL & RGS & RGSPL \\
\midrule
first & \textbf{50.00} & 75.00 & 25.00 & 12.50 & \textbf{12.50} & 0.00 \\
second & 25.00 & \textbf{87.50} & \textbf{50.00} & 9.25 & \textbf{12.50} & \textbf{6.25} \\
\bottomrule
\end{tabular}
\end{table}"""  # noqa: E501  # a caption is one line
MEANS = [
    {"success": 0.5, "oracle_success": 0.75, "spl": 0.25, "path_length": 12.5, "rgs": 0.125},
    {
        "success": 0.25,
        "oracle_success": 0.875,
        "spl": 0.5,
        "path_length": 9.25,
        "rgs": 0.125,
        "rgspl": 0.0625,
    },
]


def test_two_methods_on_one_split(scores: Scores) -> None:
    first, second = (showing(scores, **means) for means in MEANS)
    said = dict(part.split(":") for part in scores.signature.split("|"))
    expected = ONE_SPLIT.replace("VERSION", said["version"]).replace("DATA", said["data"])
    assert results_table({"first": first, "second": second}).to_latex() == expected


def test_the_same_as_markdown(scores: Scores) -> None:
    first, second = (showing(scores, **means) for means in MEANS)
    table = results_table({"a|b": first, "second": second})
    lines = table.to_markdown().splitlines()
    assert lines[:4] == [
        "| Method | SR | OSR | SPL | TL | RGS | RGSPL |",
        "| :--- | ---: | ---: | ---: | ---: | ---: | ---: |",
        r"| a\|b | **50.00** | 75.00 | 25.00 | 12.50 | **12.50** | 0.00 |",
        "| second | 25.00 | **87.50** | **50.00** | 9.25 | **12.50** | **6.25** |",
    ]
    assert lines[4:] == ["", table.caption]
    assert table._repr_markdown_() == repr(table) == table.to_markdown()  # what Jupyter calls


# What is bold.


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        pytest.param([0.1, 0.3, 0.2], ["30.00"], id="the highest"),
        pytest.param([0.3, 0.3, 0.2], ["30.00", "30.00"], id="ties, all of them"),
        pytest.param([0.54321, 0.54324, 0.2], ["54.32", "54.32"], id="ties in what is shown"),
        pytest.param([0.0, 0.0, 0.0], ["0.00"] * 3, id="all the same"),
        pytest.param([0.09, 0.1, 0.02], ["10.00"], id="as numbers, not as texts"),
    ],
)
def test_the_best_of_a_column(values: list[float], expected: list[str], scores: Scores) -> None:
    methods = {f"method {n}": showing(scores, rgs=value) for n, value in enumerate(values)}
    only_rgs = {
        name: replace(each, episodes={"rgs": each.episodes["rgs"]})
        for name, each in methods.items()
    }
    assert bold(results_table(only_rgs).to_latex()) == expected


def test_of_trajectory_lengths_none_is_best(scores: Scores) -> None:
    methods = {name: showing(scores, path_length=length) for name, length in (("a", 1), ("b", 2))}
    table = results_table(methods)
    column = table.headings.index("TL")
    assert CATALOGUE["path_length"].better == "neither"
    assert not any(isinstance(row[column], Bold) for row in table.rows)


def test_one_method_is_not_the_best_of_one(scores: Scores) -> None:
    assert bold(results_table({"alone": scores}).to_latex()) == []


# Several splits.


def test_every_method_on_every_split(scores: Scores) -> None:
    seen, unseen = on(scores, "val_seen", "a" * 64), on(scores, "val_unseen", "b" * 64)
    table = results_table({"a": [seen, unseen], "b": [unseen], "c": unseen})
    text = table.to_latex()
    assert text.startswith("\\begin{table*}\n")
    assert text.endswith("\\end{table*}")
    assert r" & \multicolumn{6}{c}{Val seen} & \multicolumn{6}{c}{Val unseen} \\" in text
    assert r"\cmidrule(lr){2-7} \cmidrule(lr){8-13}" in text
    (headings,) = lines_between(text, r"\cmidrule(lr){2-7} \cmidrule(lr){8-13}", r"\midrule")
    rows = lines_between(text, r"\midrule", r"\bottomrule")
    assert headings == ["Method", *LABELS, *LABELS]
    assert [len(row) for row in rows] == [13, 13, 13]
    assert [row[0] for row in rows] == ["a", "b", "c"]
    assert rows[1][1:7] == ["-"] * 6
    assert rows[1][7:] == rows[2][7:] == rows[0][7:]
    assert r"val\_seen aaaaaaaaaaaa (84 episodes), val\_unseen bbbbbbbbbbbb (84 episodes)" in text
    assert "Val seen SR | Val seen OSR" in table.to_markdown()


def test_a_method_is_never_best_where_it_has_no_score(scores: Scores) -> None:
    seen, unseen = on(scores, "val_seen"), on(scores, "val_unseen")
    table = results_table({"a": [seen, unseen], "b": unseen, "c": unseen})
    assert table.rows[1][:7] == ["b", *["-"] * 6]
    assert not any(isinstance(cell, Bold) for row in table.rows for cell in row[:7])


def test_the_grounding_track_has_one_column(scores: Scores) -> None:
    grounding = evaluate(SAMPLES / "good.json", split=SPLIT, track="grounding")
    table = results_table({"a": grounding, "b": grounding})
    assert table.headings == ["Method", "RGS"]
    assert "In percent; the best" in table.caption
    assert "protocol official-v1 track:grounding" in table.caption


# Names.


@pytest.mark.parametrize(
    ("name", "escaped"),
    [
        ("DUET_r", r"DUET\_r"),
        ("100% & #1", r"100\% \& \#1"),
        ("$x^2$", r"\$x\textasciicircum{}2\$"),
        ("~{a}", r"\textasciitilde{}\{a\}"),
        ("a\\b", r"a\textbackslash{}b"),
        ("Équipe 蓝", "Équipe 蓝"),
    ],
)
def test_names_are_shown_as_they_are(name: str, escaped: str, scores: Scores) -> None:
    (row,) = lines_between(results_table({name: scores}).to_latex(), r"\midrule", r"\bottomrule")
    joined = " & ".join(row)
    assert joined.startswith(f"{escaped} & 80.95 & ")


def test_braces_and_environments_close(scores: Scores) -> None:
    both = [scores, on(scores, "val_seen")]
    text = re.sub(r"\\[&%$#_{}]", "", results_table({"a_{b}": both, "100 %}": scores}).to_latex())
    depths = np.cumsum([{"{": 1, "}": -1}.get(letter, 0) for letter in text])
    assert depths.min() == depths[-1] == 0
    assert "%" not in text  # which would hide the rest of its line
    opened = re.findall(r"\\begin\{([^}]*)\}", text)
    assert re.findall(r"\\end\{([^}]*)\}", text) == opened[::-1]


# What does not belong into one table.


@pytest.mark.parametrize("results", [{}, {"a": []}], ids=["nothing", "no scores"])
def test_an_empty_table(results: dict[str, list[Scores]]) -> None:
    with pytest.raises(ProtocolError, match="needs the scores of at least one method"):
        results_table(results)


@pytest.mark.parametrize("other", [{"protocol": "r2r-style"}, {"track": "grounding"}])
def test_what_does_not_compare(other: dict[str, Any], scores: Scores) -> None:
    says = r"not comparable: split:val_unseen\|protocol:official-v1"
    with pytest.raises(ProtocolError, match=says):
        results_table({"a": scores, "b": evaluate(SAMPLES / "good.json", split=SPLIT, **other)})


def test_two_protocols_on_two_splits(scores: Scores) -> None:
    other = evaluate(SAMPLES / "good.json", split=SPLIT, protocol="r2r-style")
    with pytest.raises(ProtocolError, match="not comparable"):
        results_table({"a": scores, "b": on(other, "val_seen")})


def test_two_ground_truths_of_a_split(scores: Scores) -> None:
    with pytest.raises(ProtocolError, match="not comparable"):
        results_table({"a": scores, "b": on(scores, SPLIT)})


def test_a_method_that_is_scored_twice(scores: Scores) -> None:
    with pytest.raises(ProtocolError, match="mine has two scores of the same split"):
        results_table({"mine": [scores, scores]})


# At the terminal.

FILES = [str(SAMPLES / f"{name}.json") for name in ("mediocre", "good")]


def test_comparing_in_latex(run: Run) -> None:
    status, out, err = run("compare", *FILES, "--split", SPLIT, "--format", "latex")
    comments, _, table = out.rstrip("\n").partition("\\begin{table}")
    assert (status, err) == (0, "")
    assert all(line.startswith("% ") for line in comments.splitlines())
    assert comments.startswith("% good is better than mediocre by 22.70 RGSPL, 95 % interval ")
    scored = {file: evaluate(file, split=SPLIT) for file in FILES}
    named = dict(zip(("mediocre", "good"), scored.values(), strict=True))
    assert rf"\begin{{table}}{table}" == results_table(named).to_latex()


def test_comparing_in_markdown(run: Run) -> None:
    status, out, err = run("compare", *FILES, "--split", SPLIT, "--format", "markdown")
    assert (status, err) == (0, "")
    assert out.startswith("| Method | SR | OSR | SPL | TL | RGS | RGSPL |\n")
    assert "\n\ngood is better than mediocre by 22.70 RGSPL, 95 % interval " in out
