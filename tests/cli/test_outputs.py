"""Inputs are never overwritten."""

from pathlib import Path

import pytest

from tests.support.flat_world import Run, words

pytestmark = pytest.mark.usefixtures("here")

IN_USE = "is an input, or named twice; choose another file to write to"
COMPILE = "compile dataset --split val_unseen"


@pytest.mark.parametrize(
    "line",
    [
        pytest.param("submit.json {split} {full} --output submit.json", id="scores"),
        pytest.param("submit.json {split} {full} --episodes ./submit.json", id="episodes"),
        pytest.param("submit.json {split} {full} --output x --episodes x", id="one file for both"),
        pytest.param("submit.json {split} {full} --output full.npz", id="scores over the bundle"),
        pytest.param("convert submit.json -o submit.json", id="converted file"),
    ],
)
def test_a_file_in_use_is_not_written_to(line: str, run: Run) -> None:
    given = {name: Path(name).read_bytes() for name in ("submit.json", "full.npz")}
    status, out, err = run(*words(line))
    assert (status, out) == (2, "")
    assert IN_USE in err
    assert {name: Path(name).read_bytes() for name in given} == given
    assert not Path("x").exists()


@pytest.mark.parametrize(
    "line", ["not-read.json {split} --episodes none/x.csv", "table not-read.json {split} -o none/x"]
)
def test_a_missing_folder_is_named_before_anything_is_read(line: str, run: Run) -> None:
    Path("not-read.json").touch()
    status, out, err = run(*words(line))
    assert (status, out) == (2, "")
    assert err == f"reverie-eval: {line.rsplit(maxsplit=1)[-1]}: No such file or directory\n"


def test_compiling_never_replaces_the_annotations(run: Run) -> None:
    annotations = "dataset/tasks/REVERIE/data/REVERIE_val_unseen.json"
    before = Path(annotations).read_bytes()
    status, _, err = run(*words(f"{COMPILE} -o {annotations}"))
    assert (status, Path(annotations).read_bytes()) == (2, before)
    assert IN_USE in err


def test_a_slash_makes_a_folder_of_bundles(run: Run) -> None:
    status, _, err = run(*words(f"{COMPILE} -o new/bundles/"))
    assert (status, err) == (0, "")
    assert [path.name for path in Path("new/bundles").iterdir()] == ["val_unseen.npz"]


def test_a_device_is_not_replaced(run: Run) -> None:
    status, _, err = run(*words(f"{COMPILE} -o /dev/null"))
    assert (status, err) == (
        2,
        "reverie-eval: /dev/null is not a regular file, and is not replaced\n",
    )


def test_a_path_is_not_a_split_s_name(run: Run) -> None:
    status, _, err = run("compile", "dataset", "--split", "../evil", "-o", "folder")
    assert status == 2
    assert "'../evil' is not a split's name" in err


def test_a_dash_is_standard_output(run: Run) -> None:
    printed = run(*words("submit.json {split} {full}"))
    assert run(*words("submit.json {split} {full} -o -")) == printed
    assert not Path("-").exists()
