"""Tables of several methods' results: values by hand, what is set apart, and LaTeX's structure.

LaTeX itself is far too large to be asked here, so its lines are taken apart instead.
"""

import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reverie_eval import CATALOGUE, GroundTruth, ProtocolError, Runs, Scores, compare, evaluate
from reverie_eval.reporting import results_table
from reverie_eval.reporting.tables import Number
from reverie_eval.scoring import clusters_of
from reverie_eval.tasks import PublishedResult
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


def spread(scores: Scores, **shares: float) -> Scores:
    """Return scores with success in the first share of the targets, by metric, and 0 for all else.

    Whole targets succeed or fail, so that two shares differ in some of them and agree in the rest.
    """
    target = clusters_of(scores.ground_truth, "target")
    rank = np.argsort(np.argsort(np.unique(target)))[np.unique(target, return_inverse=True)[1]]
    n_targets = rank.max() + 1
    episodes = {
        key: (rank < round(share * n_targets)).astype(float) for key, share in shares.items()
    }
    return replace(scores, episodes=episodes)


# By hand. Of 29 targets, all differ by 25 points, which is significant, or by 12.5, which is not.

ONE_SPLIT = r"""% SIGNATURE
\begin{table}
\centering
\caption{Results on the synthetic demo world. TL in metres, all else in percent. Bold: significantly better than all others; underlined: than all but the best (p \textless{} 0.05, paired randomisation test over targets, Holm's correction for all pairs in a column). \textdagger{} differs significantly from first (the same test). Scored by reverie-eval VERSION, protocol official-v1; data: val\_unseen DATA (84 episodes).}
\setlength{\tabcolsep}{3pt}
\begin{tabular}{lrrrrrr}
\toprule
 & \multicolumn{6}{c}{Val unseen} \\
\cmidrule(lr){2-7}
 & \multicolumn{4}{c}{Navigation} & \multicolumn{2}{c}{Grounding} \\
\cmidrule(lr){2-5} \cmidrule(lr){6-7}
Method & SR & OSR & SPL & TL & RGS & RGSPL \\
\midrule
first & \textbf{50.00} & 75.00 & 25.00 & 12.50 & 12.50 & 0.00 \\
second & 25.00DAGGER & 87.50 & \textbf{50.00}DAGGER & 9.25 & 12.50 & 6.25 \\
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
    expected = expected.replace("SIGNATURE", scores.signature)
    expected = expected.replace("DAGGER", r"\rlap{\textsuperscript{\textdagger{}}}")
    table = results_table({"first": first, "second": second}, baselines=["first"])
    assert table.to_latex() == expected


def test_the_same_as_markdown(scores: Scores) -> None:
    first, second = (showing(scores, **means) for means in MEANS)
    table = results_table({"a|b": first, "second": second})
    lines = table.to_markdown().splitlines()
    assert lines[:4] == [
        "| Method | SR | OSR | SPL | TL | RGS | RGSPL |",
        "| :--- | ---: | ---: | ---: | ---: | ---: | ---: |",
        r"| a\|b | **50.00** | 75.00 | 25.00 | 12.50 | 12.50 | 0.00 |",
        "| second | 25.00 | 87.50 | **50.00** | 9.25 | 12.50 | 6.25 |",
    ]
    assert lines[4:] == ["", table.caption, "", scores.signature]
    assert table._repr_markdown_() == repr(table) == table.to_markdown()  # what Jupyter calls


# What is bold, underlined and marked. All 29 targets of the demo world weigh alike in the test.


@pytest.mark.parametrize(
    ("shares", "expected"),
    [
        pytest.param([0.2, 0.9, 0.55], "bold b, underlined c", id="all apart"),
        pytest.param([0.2, 0.9, 0.25], "bold b", id="no second"),
        pytest.param([0.2, 0.9, 0.85], "", id="the best is not apart"),
        pytest.param([0.5, 0.5, 0.1], "", id="a tie"),
        pytest.param([0.1, 0.9], "bold b", id="nobody is second of two"),
    ],
)
def test_what_stands_out_is_apart(shares: list[float], expected: str, scores: Scores) -> None:
    methods = {name: spread(scores, rgs=share) for name, share in zip("abc", shares, strict=False)}
    table = results_table(methods)
    cells = {name: number for name, number in table.rows if isinstance(number, Number)}
    shown = sorted(f"{it.style} {name}" for name, it in cells.items() if it.style != "plain")
    assert ", ".join(shown) == expected
    # The words of `compare`, with each pair alone, whose p-values are smaller, agree.
    for name, other in permutations(methods, 2):
        if cells[name].style == "bold":
            assert compare(methods[other], methods[name], names=["a", "b"]).verdict("b") == "better"


def test_a_baseline_marks_what_differs(scores: Scores) -> None:
    shares = {"base": 0.4, "worse": 0.1, "same": 0.4, "near": 0.45, "better": 0.9, "other": 0.8}
    methods = {name: spread(scores, rgs=share) for name, share in shares.items()}
    table = results_table(methods, baselines=["base", "other"])
    marks = {name: cell.marks for name, cell in table.rows if isinstance(cell, Number)}
    # "other" is a baseline, so it has no mark.
    assert marks == {
        "base": "",
        "worse": "†‡",
        "same": "‡",
        "near": "‡",
        "better": "†",
        "other": "",
    }
    assert (
        "† differs significantly from base (the same test, Holm's correction for 5 comparisons in "
        "a column). ‡ differs significantly from other (the same test"
    ) in table.caption


def test_of_trajectory_lengths_none_is_best(scores: Scores) -> None:
    methods = {name: showing(scores, path_length=length) for name, length in (("a", 1), ("b", 2))}
    table = results_table(methods, baselines=["a"])
    column = table.headings.index("TL")
    assert CATALOGUE["path_length"].better == "neither"
    assert [row[column] for row in table.rows] == ["1.00", "2.00"]
    assert bold(table.to_latex()) == []


def test_one_method_is_not_the_best_of_one(scores: Scores) -> None:
    assert bold(results_table({"alone": scores}).to_latex()) == []


# Several splits.


def test_every_method_on_every_split(scores: Scores) -> None:
    seen, unseen = on(scores, "val_seen", "a" * 64), on(scores, "val_unseen", "b" * 64)
    table = results_table({"a": [seen, unseen], "b": [unseen], "c": unseen})
    text = table.to_latex()
    assert "\n\\begin{table*}\n" in text
    assert text.endswith("\\end{table*}")
    assert r" & \multicolumn{6}{c}{Val seen} & \multicolumn{6}{c}{Val unseen} \\" in text
    families = r"\cmidrule(lr){2-5} \cmidrule(lr){6-7} \cmidrule(lr){8-11} \cmidrule(lr){12-13}"
    assert r"\cmidrule(lr){2-7} \cmidrule(lr){8-13}" in text
    (headings,) = lines_between(text, families, r"\midrule")
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
    assert not any(bold(cell) for cell in table.rows[1][:7])


def test_the_grounding_track_has_one_column(scores: Scores) -> None:
    grounding = evaluate(SAMPLES / "good.json", split=SPLIT, track="grounding")
    table = results_table({"a": grounding, "b": grounding})
    assert table.headings == ["Method", "RGS"]
    assert "world. In percent. Bold" in table.caption
    assert len(table.groups) == 1
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
    assert "%" not in text.partition("\\begin")[2]  # which would hide the rest of its line
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


# Intervals.


def test_every_row_has_an_interval_if_any_has(scores: Scores) -> None:
    other = evaluate(SAMPLES / "mediocre.json", split=SPLIT)
    sure, runs = scores.with_intervals("scan", confidence=0.9), Runs.of({"1": scores, "2": other})
    table = results_table({"sure": sure, "bare": other})
    number = table.rows[1][-1]
    found = other.with_intervals("scan", confidence=0.9).intervals
    assert found is not None
    ends = found["rgspl"].low, found["rgspl"].high
    assert isinstance(number, Number)
    assert number.interval == tuple(f"{100 * end:.2f}" for end in ends)
    assert all(" to " in cell for row in table.rows for cell in row[1:])
    assert "In parentheses: 90 % intervals over scans." in table.caption
    assert f"{SPLIT}: {found.caption}" in table.notes
    of_runs = results_table({"ours": runs, "bare": other})
    assert all(" to " in cell for row in of_runs.rows for cell in row[1:])
    assert "Student's t test over runs and targets" in of_runs.caption
    assert "95 % intervals over runs and targets" in of_runs.caption
    with pytest.raises(ProtocolError, match="some intervals are 90 % over scans and others are"):
        results_table({"sure": sure, "ours": runs})


# Published results.


def published(method: str, rgs: float, **changes: Any) -> PublishedResult:
    """Return a published result on the demo world."""
    fields = {
        "task": "reverie",
        "split": SPLIT,
        "method": method,
        "scores": {"rgs": rgs},
        "episodes": None,
        "protocol": "official-v1",
        "track": "full",
        "dataset": "demo",
        "paper": "A. Author, 2020",
        "title": "results",
        "source": "https://example.org",
    }
    return PublishedResult(**(fields | changes))


@pytest.mark.parametrize(("rgs", "expected"), [(0.89, ["90.00"]), (0.9, []), (0.95, [])])
def test_nobody_leads_behind_a_published_result(
    rgs: float, expected: list[str], scores: Scores
) -> None:
    # Exactly 0.9 is no lead.
    ours = showing(scores, rgs=0.9)
    methods = {"ours": ours, "base": showing(scores, rgs=0.2)}
    dataset = scores.ground_truth.header.dataset
    theirs = published("theirs", rgs, dataset=dataset, episodes=50)
    table = results_table(methods, baselines=["base"], published=[theirs])
    assert [row[0] for row in table.rows] == ["theirs", "", "ours", "base"]
    assert table.rows[0] == ["theirs", *["-"] * 4, f"{100 * rgs:.2f}", "-"]
    assert bold(table.to_latex()) == expected
    said = "Above the line, as published, without tests: theirs (A. Author, 2020, over 50 episodes)"
    assert said in table.caption
    other_split = published("theirs", rgs, split="test", dataset=dataset)
    assert len(results_table(methods, published=[other_split]).rows) == 2


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"protocol": "duet"}, "theirs was scored by duet on"),
        ({"dataset": "REVERIE v1"}, "theirs was scored by official-v1 on REVERIE v1, and these"),
        ({"method": "ours"}, "ours is both published and scored"),
    ],
)
def test_a_published_result_by_other_rules(
    changes: dict[str, str], says: str, scores: Scores
) -> None:
    dataset = scores.ground_truth.header.dataset
    theirs = published(**{"method": "theirs", "rgs": 0.5, "dataset": dataset, **changes})  # type: ignore[arg-type]
    with pytest.raises(ProtocolError, match=says):
        results_table({"ours": scores}, published=[theirs])


def test_a_baseline_without_a_row(scores: Scores) -> None:
    with pytest.raises(ProtocolError, match="no method is named 'our'; did you mean ours"):
        results_table({"ours": scores}, baselines=["our"])


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
    assert table == results_table(named).to_latex().partition("\\begin{table}")[2]


def test_comparing_in_markdown(run: Run) -> None:
    status, out, err = run("compare", *FILES, "--split", SPLIT, "--format", "markdown")
    assert (status, err) == (0, "")
    assert out.startswith("| Method | SR | OSR | SPL | TL | RGS | RGSPL |\n")
    assert "\n\ngood is better than mediocre by 22.70 RGSPL, 95 % interval " in out


PUBLISHED = """
[[table]]
task = "reverie"
paper = "A. Author, 2020"
title = "results"
source = "https://example.org"
dataset = "DATASET"
protocol = "official-v1"
metrics = ["success", "rgs"]
results.val_unseen.theirs = [50.5, 20]
"""


def test_the_table_of_a_paper(run: Run, demo: GroundTruth, tmp_path: Path) -> None:
    rows = tmp_path / "rows.toml"
    rows.write_text(PUBLISHED.replace("DATASET", demo.header.dataset))
    methods = [f"base={FILES[0]}", f"ours={FILES[1]},{SAMPLES / 'drawn.json'}"]
    options = ["--split", SPLIT, "--baseline", "base", "--published", str(rows)]
    status, out, err = run("table", *methods, *options, "--format", "csv")
    heading, theirs, base, ours = out.splitlines()
    assert (status, err) == (0, "")
    assert heading == "Method,SR,OSR,SPL,TL,RGS,RGSPL"
    assert theirs == "theirs,50.50,-,-,-,20.00,-"
    assert base.startswith("base,41.67 (")
    assert ours.startswith("ours,80.95† (")
    for layout, begins in [("latex", "% split:"), ("markdown", "| Method |"), ("html", "<table>")]:
        status, out, err = run("table", *methods, *options, "--format", layout)
        assert (status, err) == (0, "")
        assert out.startswith(begins)


def test_splits_side_by_side_by_their_names(run: Run, tmp_path: Path) -> None:
    for name, sample in (("base", "mediocre"), ("ours", "good")):
        (tmp_path / name).mkdir()
        shutil.copy(SAMPLES / f"{sample}.json", tmp_path / name / "val_unseen.json")
    files = [f"{tmp_path}/{name}/{{split}}.json" for name in ("base", "ours")]
    status, out, err = run("table", *files, "--split", SPLIT)
    assert (status, err) == (0, "")
    assert [line.split()[0] for line in out.splitlines()[:3]] == ["Method", "base", "ours"]
    status, _, err = run("table", *files, "--split", "val_seen,val_unseen")
    assert status == 2
    assert f"val_seen: no file {tmp_path}/base/val_seen.json" in err
    status, _, err = run("table", f"ours={FILES[0]}", "--split", "val_seen,val_unseen")
    assert status == 2
    assert "of which split? Write {split} where its name stands" in err
    assert run("table", *files, "--split", f" {SPLIT} ").out == out
    status, _, err = run("table", *files, "--split", f"{SPLIT},")
    assert (status, f"--split {SPLIT},: a comma has no split" in err) == (2, True)


def test_what_joins_a_method_s_name_to_the_split_s_is_left_out(run: Run, tmp_path: Path) -> None:
    files = [tmp_path / "val_unseen.first.json", tmp_path / "second_val_unseen.json"]
    for file, sample in zip(files, ("mediocre", "good"), strict=True):
        shutil.copy(SAMPLES / f"{sample}.json", file)
    _, out, _ = run("table", *map(str, files), "--split", SPLIT)
    assert [line.split()[0] for line in out.splitlines()[1:3]] == ["first", "second"]


def test_nothing_published_of_that_name(run: Run) -> None:
    status, _, err = run("table", *FILES, "--split", SPLIT, "--published", "FAST-Shrot")
    assert status == 2
    assert "nothing on val_unseen is known here; did you mean FAST-Short" in err
