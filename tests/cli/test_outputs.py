"""Nothing that was given is written over."""

from pathlib import Path

import pytest

from tests.support.flat import Run, words

pytestmark = pytest.mark.usefixtures("here")

COMPILE = "compile dataset --split val_unseen"


@pytest.mark.parametrize(
    "line",
    [
        pytest.param("submit.json {split} {full} --output submit.json", id="scores"),
        pytest.param("submit.json {split} {full} --episodes ./submit.json", id="episodes"),
        pytest.param("submit.json {split} {full} --output x --episodes x", id="one file for both"),
        pytest.param("submit.json {split} {full} --output full.npz", id="scores over the bundle"),
        pytest.param("convert submit.json -o submit.json", id="converted file"),
        pytest.param("agent stop {split} {full} -o full.npz", id="agent's file over the bundle"),
    ],
)
def test_a_file_that_is_used_already_is_refused(line: str, run: Run) -> None:
    given = {name: Path(name).read_bytes() for name in ("submit.json", "full.npz")}
    status, out, err = run(*words(line))
    assert (status, out) == (2, "")
    assert "is used already; choose another file to write to" in err
    assert {name: Path(name).read_bytes() for name in given} == given
    assert not Path("x").exists()


def test_compiling_never_replaces_the_annotations(run: Run) -> None:
    annotations = "dataset/tasks/REVERIE/data/REVERIE_val_unseen.json"
    before = Path(annotations).read_bytes()
    status, _, err = run(*words(f"{COMPILE} -o {annotations}"))
    assert (status, Path(annotations).read_bytes()) == (2, before)
    assert "is used already" in err


def test_a_slash_makes_a_folder_of_bundles(run: Run) -> None:
    status, _, err = run(*words(f"{COMPILE} -o new/bundles/"))
    assert (status, err) == (0, "")
    assert [path.name for path in Path("new/bundles").iterdir()] == ["val_unseen.npz"]


def test_what_is_no_file_is_not_replaced(run: Run) -> None:
    status, _, err = run(*words(f"{COMPILE} -o /dev/null"))
    assert (status, err) == (2, "reverie-eval: /dev/null is no file that could be replaced\n")


def test_a_split_s_name_is_no_path(run: Run) -> None:
    status, _, err = run("compile", "dataset", "--split", "../evil", "-o", "folder")
    assert status == 2
    assert "'../evil' is no name of a split" in err
