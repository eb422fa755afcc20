"""Examples in docstrings run beside the files of ``reverie-eval demo``, as a reader's do."""

from pathlib import Path
from zipfile import ZipFile

import pytest

from reverie_eval.ground_truth import DEMO_SAMPLES


@pytest.fixture(scope="session")
def beside_the_demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the folder of samples in it."""
    folder = tmp_path_factory.mktemp("reader")
    with ZipFile(DEMO_SAMPLES) as samples:
        samples.extractall(folder / "demo")
    return folder


@pytest.fixture(autouse=True)
def _where_a_reader_is(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if isinstance(request.node, pytest.DoctestItem):
        monkeypatch.chdir(request.getfixturevalue("beside_the_demo"))
