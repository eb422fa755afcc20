"""Building boxes with several processes, one of which, or all, are ended before they are done."""

import fcntl
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from reverie_eval import ReverieEvalError
from reverie_eval.dataset import _box_builder as build
from reverie_eval.dataset._box_builder import Scan
from tests.conftest import REPOSITORY
from tests.support.processes import COMMAND
from tests.support.waiting import PATIENCE, wait_until


def test_a_process_that_is_ended_from_outside() -> None:
    with pytest.raises(ReverieEvalError, match="try fewer --jobs"):
        list(build._build_all(_end, [Scan("x", Path(), Path())], 2))  # noqa: SLF001


def _end(_: Scan) -> Any:
    os._exit(1)


LONG = 2 * PATIENCE
"""Seconds that no test would wait."""


def _linger(scan: Scan) -> Any:
    scan.house.touch()
    time.sleep(LONG)


def test_an_interrupt_does_not_wait_for_scans(tmp_path: Path) -> None:
    scans = [Scan(name, tmp_path / name, Path()) for name in "xy"]

    def interrupt() -> None:
        wait_until(lambda: all(scan.house.exists() for scan in scans))
        os.kill(os.getpid(), signal.SIGINT)

    start = time.monotonic()
    interrupting = threading.Thread(target=interrupt)
    interrupting.start()
    with (
        pytest.raises(KeyboardInterrupt),
        closing(build._build_all(_linger, scans, 2)) as results,  # noqa: SLF001
    ):
        list(results)
    interrupting.join()
    assert time.monotonic() - start < LONG
    assert multiprocessing.active_children() == []


def test_processes_end_with_their_scan_if_their_parent_is_killed(tmp_path: Path) -> None:
    program = """if True:
        import sys
        from pathlib import Path
        from reverie_eval.dataset._box_builder import Scan, _build_all
        from tests.dataset.test_ended_builds import _work_until_told
        scans = [Scan(name, Path(sys.argv[1], name), Path()) for name in "wxyz"]
        list(_build_all(_work_until_told, scans, 2))
    """
    files = [tmp_path / name for name in "wxyz"]
    for file in files:
        file.touch()
    parent = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], cwd=REPOSITORY)
    try:
        wait_until(lambda: sum(map(is_held, files)) == 2)
    finally:
        parent.kill()
    parent.wait()
    (tmp_path / "done").touch()
    wait_until(lambda: not any(map(is_held, files)))
    assert [file.name for file in files if file.read_text()] == ["w", "x"]


_HELD: list[Any] = []


def _work_until_told(scan: Scan) -> Any:
    """Write to the scan's file, hold it until the process ends; work until ``done`` is there."""
    file = scan.house.open("w")
    _HELD.append(file)
    fcntl.flock(file, fcntl.LOCK_EX)
    print("begun", file=file, flush=True)
    wait_until(scan.house.with_name("done").exists)


def is_held(path: Path) -> bool:
    """Whether another process has locked a file, and lives."""
    with path.open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


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
