"""The names of submissions that are compared."""

import io
import shutil
from pathlib import Path

import pytest

from reverie_eval.submissions import submission_names
from tests.conftest import SAMPLES
from tests.support.flat_world import Run

GOOD = str(SAMPLES / "good.json")


@pytest.mark.parametrize(
    ("files", "names"),
    [
        pytest.param(["runs/a.json", "b.json.gz"], ["a", "b"], id="files"),
        pytest.param([Path("runs/a.json"), "b.json"], ["a", "b"], id="a path"),
        pytest.param(["val.a.json.zip", "val.b.zip"], ["val.a", "val.b"], id="dots"),
        pytest.param(["1/a.json", "2/a.json"], ["1", "2"], id="folders differ"),
        pytest.param(
            ["runs/A/predictions/submit.json", "runs/B/predictions/submit.json"],
            ["A", "B"],
            id="a folder above differs",
        ),
        pytest.param(
            ["runs/A/1/submit.json", "runs/A/2/submit.json", "runs/B/1/submit.json"],
            ["A/1", "A/2", "B/1"],
            id="two folders differ",
        ),
        pytest.param(["x/a.json", "x/y/a.json"], ["a", "y/a"], id="one is deeper"),
        pytest.param(["/x/a.json", "x/a.json"], ["/x", "x"], id="one is absolute"),
        pytest.param(["x/a.json", "x/a.json.gz"], ["a.json", "a.json.gz"], id="endings differ"),
        pytest.param(["a.json", "a.json"], ["submission 1", "submission 2"], id="one file twice"),
        pytest.param([b"[]", "a.json"], ["submission 1", "submission 2"], id="not all files"),
        pytest.param(["-", "a.json"], ["standard input", "a"], id="standard input"),
        pytest.param([".json", "a.json"], [".json", "a"], id="all ending"),
        pytest.param([], [], id="none"),
    ],
)
def test_names_of_submissions(files: list[object], names: list[str]) -> None:
    assert list(submission_names(files)) == names


def test_files_with_the_same_name_are_named_by_their_folders(tmp_path: Path, run: Run) -> None:
    files = [tmp_path / "runs" / each / "predictions" / "submit.json" for each in "AB"]
    for file, sample in zip(files, ("good", "mediocre"), strict=True):
        file.parent.mkdir(parents=True)
        shutil.copy(SAMPLES / f"{sample}.json", file)
    out = run("compare", *map(str, files), "--split", "val_unseen").out
    assert "B is worse than A by 22.70 RGSPL" in out
    assert "runs" not in out


@pytest.mark.parametrize("command", ["report", "compare"])
def test_the_name_of_standard_input(
    command: str, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    given = Path(GOOD).read_bytes()
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(given)))
    status, out, err = run(command, "-", str(SAMPLES / "mediocre.json"), "--split", "val_unseen")
    assert (status, err) == (0, "")
    assert "mediocre is worse than standard input by" in out
