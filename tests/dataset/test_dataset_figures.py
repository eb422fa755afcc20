"""The figures of a dataset's description."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from reverie_eval.dataset import DatasetFiles, describe_dataset
from reverie_eval.reporting.datasets import write_figures
from tests.support.described import SPLITS, TABLE, write_dataset
from tests.support.flat_world import Run


@pytest.fixture
def dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with the dataset, `dataset`."""
    monkeypatch.chdir(tmp_path)
    return write_dataset(Path("dataset"))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Draw the dataset's figures into a folder."""
    folder = tmp_path_factory.mktemp("drawn")
    description = describe_dataset(DatasetFiles.find(write_dataset(folder / "dataset")))
    write_figures(description, folder / "figures")
    return folder / "figures"


NAMES = ("words", "categories", "goals", "paths")
FILES = {f"{name}.{form}" for name in NAMES for form in ("svg", "png")}
COLOURS = {"train": "#0072B2", "val_seen": "#E69F00", "val_unseen": "#009E73", "test": "#CC79A7"}


def names_in(folder: Path) -> set[str]:
    """Return the names of a folder's files."""
    return {path.name for path in folder.iterdir()}


def test_figures_beside_the_table(dataset: Path, drawn: Path, run: Run) -> None:
    """Equal numbers give equal files."""
    assert run("describe", "dataset", "--figures", "a/folder") == (0, TABLE, "")
    assert names_in(Path("a/folder")) == FILES
    for name in FILES:
        assert Path("a/folder", name).read_bytes() == (drawn / name).read_bytes()


@pytest.mark.parametrize("name", NAMES)
def test_a_figure_shows_every_split_that_has_the_numbers_in_its_colour(
    name: str, drawn: Path
) -> None:
    pixels = np.rint(255 * imread(drawn / f"{name}.png")[..., :3]).astype(np.int64)
    colours = set(np.unique(pixels @ [0x10000, 0x100, 1]).tolist())
    shown = {split for split, colour in COLOURS.items() if int(colour[1:], 16) in colours}
    assert shown == {"val_seen", "val_unseen", *(["test"] if name == "words" else [])}


def test_without_targets_there_are_words_to_draw(tmp_path: Path, run: Run) -> None:
    root = write_dataset(tmp_path / "dataset", {"test": SPLITS["test"]})
    status, _, err = run("describe", str(root), "--figures", str(tmp_path / "figures"))
    assert (status, err) == (0, "")
    assert names_in(tmp_path / "figures") == {"words.svg", "words.png"}


WITHOUT_MATPLOTLIB = """
import sys
sys.modules["matplotlib"] = None
from reverie_eval_cli.main import main
sys.exit(main(sys.argv[1:]))
"""


REMEDY = "reverie-eval: figures need: pip install 'reverie-eval[report]'\n"


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        pytest.param([], (0, TABLE, ""), id="not needed"),
        pytest.param(
            ["--figures", "figures"],
            (2, "", REMEDY),
            id="needed",
        ),
    ],
)
def test_without_matplotlib(
    options: list[str], expected: tuple[int, str, str], dataset: Path
) -> None:
    process = subprocess.run(
        [sys.executable, "-c", WITHOUT_MATPLOTLIB, "describe", "dataset", *options],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (process.returncode, process.stdout, process.stderr) == expected
