"""What tests stand on: the demo world as files, and the published REVERIE files where they are."""

import gc
import lzma
import os
import signal
import sys
from collections.abc import Generator
from pathlib import Path
from typing import NoReturn

import pytest
from _pytest.doctest import DoctestModule
from hypothesis import HealthCheck, settings

from fixtures.demo_world import write_demo_world
from fixtures.published import published_folder, unpack_dataset
from reverie_eval import PROTOCOLS, GroundTruth
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.tasks import find_task
from reverie_eval_cli.main import main
from tests.support.amounts import amount, is_evidence
from tests.support.flat_world import Outcome, Run, write_flat
from tests.support.sharing import shared_folder

collect_ignore = ["support/mutation_testing.py"]  # which needs what scripts/evidence installs

# Tests interrupt what they start, which nohup or a script that runs this behind may have forbidden.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests score by the embedded demo world, whatever the developer's environment names.
os.environ.pop("REVERIE_EVAL_GROUND_TRUTH", None)

# A slow machine is no failure. The suite tries the same examples in every run, so that a change
# fails only by its own fault; scripts/evidence tries others each time, and many more.
settings.register_profile(
    "unhurried",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=not is_evidence(),
    max_examples=amount(40),
)
settings.load_profile("unhurried")

REPOSITORY = Path(__file__).parents[1]
SAMPLES = REPOSITORY / "fixtures" / "submissions"
COMMAND = Path(sys.executable).with_name("reverie-eval")
TEST_EVERYTHING = "REVERIE_TEST_EVERYTHING"


SHARED_FIXTURES = [
    "tests.support.serving",
    "tests.support.participants",
    "tests.support.server_data",
    "tests.support.processes",
    "tests.support.browser",
    "tests.support.episode_pages",
]
FOLDERS_THAT_SHARE = {"browser", "cli", "client", "pages", "reporting", "server"}
"""Tests in the others need no server and no browser."""
MARKS_OF_FOLDERS = {
    "browser": ("browser", "server"),
    "client": ("server",),
    "pages": ("server",),
    "server": ("server",),
}


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keep the garbage collector away from what is collected here: nearly all of it stays.

    What tests make goes young, so going over all that is left may be rare too.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(700, 10, 100)
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(
    file_path: Path, parent: pytest.Collector
) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Import the fixtures that folders share before the first test that may use one.

    Examples to run are in the docstrings of the package, not in those of its tests.
    """
    folder = file_path.parent
    if folder.name in FOLDERS_THAT_SHARE and folder.parent == Path(__file__).parent:
        for name in SHARED_FIXTURES:
            parent.config.pluginmanager.import_plugin(name)
    collectors = yield
    return [each for each in collectors if not isinstance(each, DoctestModule)]


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish() -> None:
    """Collect the garbage once: what is left of the tests stays until the process ends.

    Pytest collects five times to hear of what was not closed, and goes over all of it each time.
    """
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test by the folder that it is in and the fixtures that it uses."""
    for item in items:
        for mark in MARKS_OF_FOLDERS.get(item.path.parent.name, ()):
            item.add_marker(mark)
        if "chromium" in getattr(item, "fixturenames", ()):
            item.add_marker("browser")


def unavailable(reason: str) -> NoReturn:
    """Skip the test, or fail it where everything has to be there."""
    if os.environ.get(TEST_EVERYTHING):
        pytest.fail(f"{TEST_EVERYTHING} is set, but {reason}")
    pytest.skip(reason)


@pytest.fixture
def printed_protocols(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make ``all`` protocols those that printed tables show, so that a new one changes no table."""
    names = (
        *("official-v1", "paper", "paper-3m", "challenge-2022", "airbert", "duet", "scalevln"),
        *("r2r-style", "navrag"),
    )
    protocols = [PROTOCOLS[name] for name in names]
    monkeypatch.setitem(vars(find_task("reverie")), "protocols", protocols)


@pytest.fixture(scope="session")
def demo_world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the demo world in the published file layout."""
    return shared_folder(tmp_path_factory, "demo_world", write_demo_world)


@pytest.fixture(scope="session")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Unpack REVERIE v1 as published, with reference submissions and their scores."""
    folder = published_folder()
    if folder is None:
        unavailable("the published REVERIE files are not here (REVERIE_DATA names their folder)")

    def unpack(unpacked: Path) -> None:
        unpack_dataset(folder, unpacked)
        (unpacked / "reference").symlink_to(folder / "reference")

    return shared_folder(tmp_path_factory, "published", unpack)


@pytest.fixture(scope="session")
def published_centres(published: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Unpack the centres of REVERIE's objects."""
    packed = (published_folder() or Path()) / "objpos.json.xz"
    if not packed.is_file():
        unavailable("the centres of the objects are not here (objpos.json.xz)")

    def unpack(folder: Path) -> None:
        (folder / "objpos.json").write_bytes(lzma.decompress(packed.read_bytes()))

    return shared_folder(tmp_path_factory, "published_centres", unpack) / "objpos.json"


@pytest.fixture(scope="session")
def published_bundles(published: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the bundles of REVERIE v1."""

    def make(folder: Path) -> None:
        for split in ("val_seen", "val_unseen", "test"):
            bundle = compile_split(DatasetFiles.find(published / "reverie-v1", split=split), split)
            bundle.save(folder / f"{split}{'.public' if bundle.is_public else ''}.npz")

    return shared_folder(tmp_path_factory, "published_bundles", make)


@pytest.fixture(scope="session")
def demo() -> GroundTruth:
    """Load the embedded ground truth of the demo world's val_unseen split."""
    return GroundTruth.load(
        REPOSITORY / "reverie_eval" / "ground_truth" / "demo" / "val_unseen.npz"
    )


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Return what runs the command in this process."""

    def run(*words: str) -> Outcome:
        status = main(words)
        return Outcome(status, *capsys.readouterr())

    return run


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with the flat: its dataset, its bundles and submissions."""
    write_flat(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path
