"""The code blocks of the library's pages run and print the output shown below them."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import pytest

import reverie_eval as rv
from reverie_eval import Comparison, Scores, compare, evaluate
from reverie_eval.analysis import GROUPINGS
from tests.conftest import REPOSITORY, SAMPLES, unavailable

PAGES = {
    name: (REPOSITORY / "docs" / "how-to" / f"{name}.md").read_text()
    for name in ("notebook", "training")
}
PAGE = PAGES["notebook"]
REPORT = (REPOSITORY / "docs" / "how-to" / "report.md").read_text()
FILES = {"submit.json": "good.json", "other.json": "mediocre.json"}


every_page = pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)


class Block(NamedTuple):
    """A block of code and the output that the page shows."""

    code: str
    printed: str


def blocks(page: str) -> Iterator[Block]:
    """Find the code blocks; a block without a language is the output of the one above."""
    pattern = r"^```python\n(.*?)^```\n(?:\n```\n(.*?)^```\n)?"
    for code, printed in re.findall(pattern, page, re.MULTILINE | re.DOTALL):
        yield Block(code, printed)


@pytest.fixture
def readers_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Change to a folder with the two result files that the page uses."""
    for name, sample in FILES.items():
        (tmp_path / name).write_bytes((SAMPLES / sample).read_bytes())
    monkeypatch.chdir(tmp_path)
    # The page runs the command as a reader does who installed it.
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    yield tmp_path
    from matplotlib import pyplot as plt

    plt.close("all")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "written"),
    [
        pytest.param(PAGES["notebook"], {"episode.svg", "comparison.pdf"}, id="notebook"),
        pytest.param(PAGES["training"], {"runs", "epoch_1.npz", "curve.pdf"}, id="training"),
    ],
)
def test_every_block_runs_and_prints_what_the_page_shows(
    page: str, written: set[str], readers_folder: Path
) -> None:
    if not (find_spec("matplotlib") and find_spec("tensorboardX")):
        unavailable("matplotlib and tensorboardX are not installed")
    names: dict[str, object] = {}
    for block in blocks(page):
        shown = StringIO()
        with redirect_stdout(shown):
            exec(block.code, names)
        printed = [line.rstrip() for line in shown.getvalue().splitlines()]
        assert printed == block.printed.splitlines()
    assert {file.name for file in readers_folder.iterdir()} - FILES.keys() == written


@pytest.mark.slow
@pytest.mark.usefixtures("readers_folder")
def test_what_goes_on_from_scores_runs() -> None:
    names: dict[str, object] = {"rv": rv, "scores": evaluate("submit.json", split="val_unseen")}
    for block in blocks(REPORT):
        exec(block.code, names)


@every_page
def test_every_block_is_found(page: str) -> None:
    assert page.count("```python") == len(list(blocks(page)))
    assert page.count("```") == sum(4 if block.printed else 2 for block in blocks(page))


# Frames.


@pytest.fixture(scope="module")
def scores() -> Scores:
    """Score the sample with boxes, whose frames have all possible columns."""
    return evaluate(SAMPLES / "drawn.json", split="val_unseen")


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    """Compare two samples."""
    return compare(SAMPLES / "mediocre.json", SAMPLES / "good.json", split="val_unseen")


def columns_documented(frame: str) -> set[str]:
    """Return the words marked as code in a frame's row of the table."""
    (row,) = re.findall(rf"^\| `{re.escape(frame)}` \|(.*)$", PAGE, re.MULTILINE)
    return set(re.findall(r"`(\w+)`", row))


def test_the_columns_of_a_comparison(comparison: Comparison) -> None:
    frame = comparison.to_pandas()
    said = columns_documented("comparison.to_pandas()")
    assert said == {*frame.columns, *frame.index.names}


def test_the_columns_of_an_episode_table(scores: Scores) -> None:
    frame = scores.to_pandas()
    assert columns_documented("scores.to_pandas()") == {"instr_id", *set(frame.columns) - {*scores}}


@pytest.mark.parametrize("by", GROUPINGS)
def test_the_columns_of_a_breakdown(by: str, scores: Scores) -> None:
    frame = scores.breakdown(by=by)
    assert list(frame.columns) == ["episodes", *(metric.key for metric in scores.headline)]
    assert frame.index.name == by
    assert frame["episodes"].sum() == len(scores.instr_ids)
    assert f"| `{by}` |" in REPORT


@pytest.mark.parametrize("metric", ["rgs", "spl"])
def test_the_columns_of_episodes_with_different_values(metric: str, comparison: Comparison) -> None:
    frame = comparison.episodes(metric)
    assert list(frame.columns) == ["mediocre", "good"]
    assert frame.index.name == "instr_id"


def test_values_are_in_the_units_of_their_metrics(scores: Scores) -> None:
    """Unrounded, and not percentages: the means of the table are the scores."""
    means = scores.to_pandas()[list(scores)].mean()
    assert means.to_dict() == pytest.approx(dict(scores), rel=1e-12)
    one_part = scores.breakdown(by="scan")
    weighted = (one_part["success"] * one_part["episodes"]).sum() / one_part["episodes"].sum()
    assert weighted == pytest.approx(scores["success"])
