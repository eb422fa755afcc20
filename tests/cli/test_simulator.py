"""``reverie-eval simulator``: code that says ``import MatterSim`` runs."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from reverie_eval.simulator import FOLDER
from reverie_eval_cli.main import main

USE = "import MatterSim; print(MatterSim.__file__, MatterSim.Simulator().getState(), sep=chr(10))"


def used(folder: Path) -> list[str]:
    """Return what a program beside the file, or with the folder on its path, prints."""
    surroundings = {**os.environ, "PYTHONPATH": str(folder)}
    words = [sys.executable, "-c", USE]
    done = subprocess.run(words, env=surroundings, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def test_the_folder_is_one_for_python_path(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulator", "--path"]) == 0
    folder = Path(capsys.readouterr().out.strip())
    assert used(folder) == [str(folder / "MatterSim.py"), "[]"]
    assert {each.name for each in folder.glob("*.py")} == {"MatterSim.py", "__init__.py"}


def test_the_file_is_written_into_a_project(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):  # again is no harm
        assert main(["simulator", "--copy", str(tmp_path)]) == 0
    copy = tmp_path / "MatterSim.py"
    assert capsys.readouterr().out.splitlines() == [str(copy)] * 2
    assert copy.read_bytes() == (FOLDER / "MatterSim.py").read_bytes()
    assert used(tmp_path) == [str(copy), "[]"]


def test_another_file_of_that_name_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "MatterSim.py").write_text("mine")
    assert main(["simulator", "--copy", str(tmp_path)]) == 2
    assert "is another file; remove it first" in capsys.readouterr().err
    assert (tmp_path / "MatterSim.py").read_text() == "mine"
    assert main(["simulator", "--copy", str(tmp_path / "nowhere")]) == 2
    assert "is not a folder" in capsys.readouterr().err


def test_on_a_full_disk_no_half_of_the_file_is_left(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "reverie_eval_cli", "simulator", "--copy", str(tmp_path)],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == f"reverie-eval: {tmp_path / 'MatterSim.py'}: File too large\n"
    assert done.returncode == 2
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("words", [[], ["--path", "--copy", "."]])
def test_one_of_both_is_asked_for(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulator", *words]) == 2
    assert "give either --path or --copy DIR" in capsys.readouterr().err
