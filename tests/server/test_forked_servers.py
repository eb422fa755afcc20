"""Tested servers and what scores for them are copies of one process that has imported everything.

Another Python that imports it all takes more of the processor than most tests.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import httpx
import pytest

from tests.support.forking import PRELOADED, Forked, Surroundings
from tests.support.processes import Laptop
from tests.support.serving import NO_TLS, running
from tests.support.waiting import PATIENCE

# Python runs a module of this name before anything else, in each process that is not a copy.
NOTING = """
import os, sys

with open(os.environ["STARTS"], "a") as file:
    print(sys.orig_argv, file=file)
"""


class Starts:
    """What is started with some environment variables, and is not a copy of a process."""

    def __init__(self, folder: Path) -> None:
        (folder / "sitecustomize.py").write_text(NOTING)
        self._file = folder / "starts"
        self._file.touch()
        self.variables = {"PYTHONPATH": str(folder), "STARTS": str(self._file)}

    def told(self) -> Sequence[str]:
        """Return the command of each."""
        return self._file.read_text().splitlines()


@pytest.fixture
def starts(tmp_path: Path) -> Starts:
    """Note what is started."""
    folder = tmp_path / "starts"
    folder.mkdir()
    return Starts(folder)


def score(url: str) -> None:
    """Wait until the server has a process that scores, and has scored in it."""
    httpx.get(f"{url}/healthz", timeout=PATIENCE, verify=NO_TLS).raise_for_status()


copies = pytest.mark.skipif(
    sys.version_info >= (3, 14), reason="a copy may not ask for others (tests/support/forking.py)"
)


@copies
def test_a_server_starts_no_python(folder: Path, starts: Starts) -> None:
    with running(folder, **starts.variables) as (_, url):
        score(url)
    assert starts.told() == []


@copies
def test_the_command_that_serves_starts_no_python(laptop: Laptop, starts: Starts) -> None:
    with laptop.serving(variables=starts.variables) as server:
        score(server.url)
    assert starts.told() == []


def test_a_start_would_be_noted(tmp_path: Path, starts: Starts) -> None:
    surroundings = Surroundings(
        Path.cwd(), os.environ | starts.variables, tmp_path / "output", tmp_path / "errors"
    )
    words = [sys.executable, "-c", ""]
    assert Forked(subprocess.run, surroundings, words).wait() == 0
    assert starts.told() == [str(words)]


def write_missing(names: Sequence[str]) -> None:
    sys.stdout.writelines(f"{name}\n" for name in names if name not in sys.modules)


def test_a_copy_has_everything_imported(tmp_path: Path) -> None:
    """What cannot be imported is left out without a word."""
    output = tmp_path / "output"
    surroundings = Surroundings(Path.cwd(), dict(os.environ), output, tmp_path / "errors")
    assert Forked(write_missing, surroundings, PRELOADED).wait() == 0
    assert output.read_text() == ""
