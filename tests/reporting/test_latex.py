"""LaTeX by its structure, whatever wrote it: LaTeX itself is far too large to be asked here."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from reverie_eval.reporting.tables import latex_comments, latex_text
from tests.conftest import SAMPLES
from tests.support.flat_world import Run

HARD = r"50% & _a_ #1 $x$ {y} [z]* ~^ a<b|c> \cmd"
SAMPLE = str(SAMPLES / "mediocre.json")
MEANT = re.compile(
    r"\\multicolumn\{\d+\}\{c\}\{|\\textbf\{|\\text[a-z]+\{\}"
    r"|\\[&%$#_{}]|\{[\[\]*]\}|\}$"
)
"""What a cell holds on purpose."""


@pytest.fixture
def hard(tmp_path: Path) -> str:
    """Write a submission whose name is all that LaTeX stumbles over."""
    file = tmp_path / f"{HARD}.json"
    shutil.copy(SAMPLES / "good.json", file)
    return str(file)


def rows(latex: str) -> Iterator[list[str]]:
    """Return the cells of a table's rows."""
    body = latex.partition("\\toprule\n")[2].partition("\\bottomrule")[0]
    for line in body.splitlines():
        if not line.startswith((r"\midrule", r"\cmidrule")):
            assert line.endswith(r" \\")
            yield line.removesuffix(r" \\").split(" & ")


@pytest.mark.parametrize(
    "line",
    [
        pytest.param("{sample}", id="scores"),
        pytest.param("{sample} --ci", id="intervals"),
        pytest.param("{sample} --ci --protocol all", id="all protocols"),
        pytest.param("{sample} --diagnose", id="diagnosis"),
        pytest.param("{sample} --track grounding --ci --cluster scan", id="grounding"),
        pytest.param("compare {sample} {hard}", id="comparison"),
    ],
)
def test_no_cell_holds_what_means_something_else(line: str, hard: str, run: Run) -> None:
    given = [word.format(sample=SAMPLE, hard=hard) for word in line.split()]
    status, out, err = run(*given, "--split", "val_unseen", "--format", "latex")
    assert (status, err) == (0, "")
    columns = len(re.search(r"\\begin\{tabular\}\{([lr]+)\}", out)[1])  # type: ignore[index]
    *heads, last = rows(out)
    assert len(last) == columns
    for cells in (*heads, last):
        assert len(cells) in (columns, 2, 3)  # headings over all columns but the first
        assert not [
            cell for cell in cells if re.search(r"[&%$#_{}\[\]*~^\\<>|]", MEANT.sub("", cell))
        ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("95 % low", r"95 \% low"),
        ("a<b", r"a\textless{}b"),
        ("a>b", r"a\textgreater{}b"),
        ("split:a|n:3", r"split:a\textbar{}n:3"),
        ("two\nlines", "two lines"),
        (r"\cmd", r"\textbackslash{}cmd"),
        ("[x]*", "{[}x{]}{*}"),
        ("Équipe 蓝", "Équipe 蓝"),
    ],
)
def test_a_text_is_shown_as_it_is(text: str, expected: str) -> None:
    assert latex_text(text) == expected


def test_a_comment_ends_with_its_line() -> None:
    assert latex_comments(["of a\n\\input{b}.npz", ""]) == ["% of a \\input{b}.npz", "%"]
