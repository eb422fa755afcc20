"""Building boxes with several processes is ended before it is done."""

import signal
import subprocess
from pathlib import Path

import pytest

from tests.conftest import COMMAND
from tests.support.waiting import wait_until


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_command_and_nothing_stays(
    number: signal.Signals, demo_world: Path, tmp_path: Path
) -> None:
    folders = [str(demo_world / kind) for kind in ("houses", "connectivity")]
    options = ["-o", "out", "--jobs", "2", "--max-distance", "1000"]
    process = subprocess.Popen(
        [COMMAND, "boxes", *folders, *options], cwd=tmp_path, stderr=subprocess.PIPE
    )
    wait_until(lambda: any(tmp_path.glob(".out-*/out/*")))
    process.send_signal(number)
    _, said = process.communicate()
    assert (process.returncode, said) == (2, b"reverie-eval: interrupted\n")
    assert list(tmp_path.iterdir()) == []
