"""Whoever runs the episodes, and however many at a time, the submission has the same bytes."""

import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from reverie_eval.agents import AgentSource
from reverie_eval.runner import RunError, RunPlan, read_attempts, read_steps, run
from tests.conftest import REPOSITORY
from tests.support.executors import EXECUTORS
from tests.support.runs import some

BATCH = """
from reverie_eval.agents import RandomAgent

class Agent:
    batch_size = 4

    def __init__(self, wrong=0):
        self.wrong = wrong

    def start(self, episode):
        episode.memory = RandomAgent()
        episode.memory.start(episode)
        episode.log(input_tokens=1)

    def act_batch(self, episodes, observations):
        assert len(episodes) <= self.batch_size
        pairs = zip(episodes, observations)
        return [episode.memory.act(seen) for episode, seen in pairs][self.wrong:]
"""


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the submission of the random agent, with one episode at a time in one process."""
    folder = tmp_path_factory.mktemp("alone")
    run(RunPlan(AgentSource("random"), some(45)), folder)
    return (folder / "submission.json").read_bytes()


@pytest.mark.parametrize("name", EXECUTORS)
def test_an_executor_changes_nothing(name: str, expected: bytes, tmp_path: Path) -> None:
    with EXECUTORS[name]() as executor:
        totals = run(RunPlan(AgentSource("random"), some(45)), tmp_path, executor=executor)
    assert (tmp_path / "submission.json").read_bytes() == expected
    assert (totals.ended, totals.attempts) == (45, 45)
    assert len(list(read_steps(tmp_path))) == totals.steps


def test_threads_change_nothing(expected: bytes, tmp_path: Path) -> None:
    run(RunPlan(AgentSource("random"), some(45)), tmp_path, jobs=3, threads=True)
    assert (tmp_path / "submission.json").read_bytes() == expected


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_ends_ends_the_run(tmp_path: Path) -> None:
    (tmp_path / "agent.py").write_text("def Agent(seen): raise KeyboardInterrupt")
    others = set(threading.enumerate())
    with pytest.raises(RunError, match=r"a worker ended while it ran \S+: it was killed, perhaps"):
        run(
            RunPlan(AgentSource(f"{tmp_path}/agent.py"), some(9)),
            tmp_path / "run",
            jobs=2,
            threads=True,
        )
    for thread in set(threading.enumerate()) - others:
        thread.join()  # or the next test would be told of its exception


@pytest.mark.parametrize("how", [{}, {"jobs": 2, "threads": True}], ids=["alone", "threads"])
def test_a_batch_changes_nothing(how: Mapping[str, Any], expected: bytes, tmp_path: Path) -> None:
    (tmp_path / "agent.py").write_text(BATCH)
    folder = tmp_path / "run"
    totals = run(RunPlan(AgentSource(f"{tmp_path}/agent.py"), some(45)), folder, **how)
    assert (folder / "submission.json").read_bytes() == expected
    assert totals.input_tokens == 45  # of the first step of each
    episodes = [each.episode for each in read_steps(folder)]
    assert episodes != sorted(episodes, key=episodes.index)  # they took turns


def test_a_batch_with_too_few_actions_stops_the_run(tmp_path: Path) -> None:
    (tmp_path / "agent.py").write_text(BATCH)
    plan = RunPlan(AgentSource(f"{tmp_path}/agent.py", {"wrong": 1}), some(9))
    with pytest.raises(RunError, match=r"act_batch returned \[.*\]; expected a list of 4 actions"):
        run(plan, tmp_path / "run")
    assert [each.state for each in read_attempts(tmp_path / "run")] == ["failed"] * 4


@pytest.mark.parametrize("name", EXECUTORS)
def test_an_error_elsewhere_stops_the_run(name: str, tmp_path: Path) -> None:
    (tmp_path / "agent.py").write_text("def Agent(seen): return {}['key']")
    plan = RunPlan(AgentSource(f"{tmp_path}/agent.py"), some(45))
    with (
        EXECUTORS[name]() as executor,
        pytest.raises(RunError, match=r"stopped: \w+: KeyError: 'key' \(agent.py, line 1\)"),
    ):
        run(plan, tmp_path / "run", executor=executor)
    assert 1 <= len(list(read_attempts(tmp_path / "run"))) <= 3  # one for each task


def test_an_executor_that_fails_is_named(tmp_path: Path) -> None:
    failed: Future[Any] = Future()
    failed.set_exception(OSError("the worker is gone"))
    broken = SimpleNamespace(submit=lambda *_: failed)
    with pytest.raises(RunError, match="could not run some episodes: OSError: the worker is gone"):
        run(RunPlan(AgentSource("stop"), some(2)), str(tmp_path), executor=broken)


PROGRAM = """
import sys
from pathlib import Path
from reverie_eval.agents import AgentSource
from reverie_eval.runner import RunPlan, run
from tests.support.runs import some
if __name__ == "__main__":
    run(RunPlan(AgentSource(sys.argv[1]), some(2)), Path(sys.argv[2]), jobs=2)
"""


def test_processes_end_with_their_parent(tmp_path: Path) -> None:
    """Also in the middle of an action, which would take an hour."""
    pids = tmp_path / "pids"
    pids.mkdir()
    agent = tmp_path / "agent.py"
    agent.write_text(
        "import os, time\n"
        "def Agent(seen):\n"
        f"    open({str(pids)!r} + f'/{{os.getpid()}}', 'w')\n"
        "    time.sleep(3600)\n"
    )
    words = [sys.executable, "-c", PROGRAM, str(agent), str(tmp_path / "run")]
    with subprocess.Popen(words, cwd=REPOSITORY) as process:
        while len(list(pids.iterdir())) < 2 and process.poll() is None:
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    workers = [int(each.name) for each in pids.iterdir()]
    assert len(workers) == 2
    while any(map(is_alive, workers)):
        time.sleep(0.01)


def is_alive(pid: int) -> bool:
    """Whether a process is there; a dead one that nobody waited for is not."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False
    return not re.search(r"^State:\s+Z", status, re.MULTILINE)
