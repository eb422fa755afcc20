"""Work in several processes, one of which, or all, are ended before they are done."""

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
from reverie_eval.processes import can_start_processes, map_in_processes
from tests.conftest import REPOSITORY
from tests.support.waiting import PATIENCE, wait_until


def test_a_process_that_is_ended_from_outside() -> None:
    with pytest.raises(ReverieEvalError, match="try fewer --jobs"):
        list(map_in_processes(_end, [1, 2], 2))


def _end(_: int) -> Any:
    os._exit(1)


LONG = 2 * PATIENCE
"""Seconds that no test would wait."""


def _linger(file: Path) -> Any:
    file.touch()
    time.sleep(LONG)


def test_an_interrupt_does_not_wait_for_the_work(tmp_path: Path) -> None:
    files = [tmp_path / name for name in "xy"]

    def interrupt() -> None:
        wait_until(lambda: all(file.exists() for file in files))
        os.kill(os.getpid(), signal.SIGINT)

    others = multiprocessing.active_children()
    start = time.monotonic()
    interrupting = threading.Thread(target=interrupt)
    interrupting.start()
    with (
        pytest.raises(KeyboardInterrupt),
        closing(map_in_processes(_linger, files, 2)) as results,
    ):
        list(results)
    interrupting.join()
    assert time.monotonic() - start < LONG
    assert set(multiprocessing.active_children()) <= set(others)


@pytest.mark.parametrize(
    ("script", "can_start"),
    [
        pytest.param("print(1)", False, id="plain"),
        pytest.param('if __name__ == "__main__":\n    print(1)', True, id="guarded"),
        pytest.param(None, True, id="notebook"),
    ],
)
def test_a_script_that_processes_would_run_again_starts_none(
    script: str | None, *, can_start: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "script.py"
    if script is not None:
        file.write_text(script)
    monkeypatch.setattr(sys.modules["__main__"], "__file__", str(file), raising=False)
    assert can_start_processes() == can_start
    if not can_start:
        with pytest.raises(ReverieEvalError, match='into a file, below if __name__ == "__main'):
            list(map_in_processes(len, ["a", "b"], 2))


def test_a_script_from_standard_input_starts_none() -> None:
    script = """if True:
        from reverie_eval.processes import map_in_processes
        print(*map_in_processes(len, ["a", "b"], 2))
    """
    ended = subprocess.run(
        [sys.executable], input=script, capture_output=True, text=True, check=False
    )
    told = ended.stderr.splitlines()[-1]
    assert "ReverieEvalError: several jobs start this script again" in told


def test_processes_end_with_their_item_if_their_parent_is_killed(tmp_path: Path) -> None:
    program = """if True:
        import sys
        from pathlib import Path
        from reverie_eval.processes import map_in_processes
        from tests.core.test_processes import _work_until_told
        files = [Path(sys.argv[1], name) for name in "wxyz"]
        list(map_in_processes(_work_until_told, files, 2))
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


def _work_until_told(path: Path) -> Any:
    """Write to a file, hold it until the process ends; work until ``done`` is there."""
    file = path.open("w")
    _HELD.append(file)
    fcntl.flock(file, fcntl.LOCK_EX)
    print("begun", file=file, flush=True)
    wait_until(path.with_name("done").exists)


def is_held(path: Path) -> bool:
    """Whether another process has locked a file, and lives."""
    with path.open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
