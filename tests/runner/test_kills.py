"""Runs that are killed at random moments end in the submission of one that was left alone.

``scripts/evidence runs [NUMBER]`` kills that many, with one process and with four.
"""

import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from reverie_eval.runner import read_attempts, read_steps
from tests.conftest import REPOSITORY
from tests.support.amounts import amount, is_evidence, tell
from tests.support.ledgers import PAUSE, run_with_ledger

KILLS = amount(in_suite=2)
EPISODES = min(198, 12 + 4 * KILLS)
PROGRAM = """
import sys
from pathlib import Path
from tests.support.ledgers import run_with_ledger
run_with_ledger(*map(Path, sys.argv[1:3]), *map(int, sys.argv[3:]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 4 if is_evidence() else 2])
def test_a_run_that_is_killed_goes_on(jobs: int, tmp_path: Path) -> None:
    rng, ledger = random.Random(jobs), tmp_path / "ledger"
    killed, hits = tmp_path / "killed", 0
    words = [sys.executable, "-c", PROGRAM, *map(str, (ledger, killed, EPISODES, jobs))]
    for _ in range(KILLS):
        with subprocess.Popen(words, cwd=REPOSITORY) as process:
            wait_for_steps(killed / "steps.jsonl", rng.randint(1, 6 + 6 * jobs), process)
            time.sleep(rng.uniform(0, 2 * PAUSE))
            process.send_signal(signal.SIGKILL)
        hits += process.returncode == -signal.SIGKILL
    run_with_ledger(ledger, killed, EPISODES)

    alone = tmp_path / "alone"
    run_with_ledger(ledger, alone, EPISODES)  # the ledger's path is an option: the same identity
    submissions = [(folder / "submission.json").read_bytes() for folder in (killed, alone)]
    assert submissions[0] == submissions[1]

    attempts, steps = list(read_attempts(killed)), list(read_steps(killed))
    answered = Counter(each.episode for each in attempts if each.state == "ended")
    assert set(answered.values()) == {1}
    assert len(answered) == EPISODES
    last = {each.episode: each.attempt for each in attempts}
    assert all(step.attempt <= last[step.episode] for step in steps)
    assert hits == KILLS
    interrupted = sum(each.state == "interrupted" for each in attempts)
    assert interrupted <= KILLS * jobs
    # What was paid is on record, but for the action that each process had just begun.
    paid = len(ledger.read_text().splitlines()) - len(list(read_steps(alone)))
    assert 0 <= paid - len(steps) <= KILLS * jobs
    assert sum(each.money or 0 for each in attempts) == pytest.approx(0.25 * len(steps))
    tell(**{f"with {jobs} processes": f"{hits} kills, {interrupted} episodes interrupted"})


def wait_for_steps(log: Path, more: int, process: subprocess.Popen[bytes]) -> None:
    """Wait until a run has made some more steps, or has ended."""

    def count() -> int:
        return log.read_bytes().count(b"\n") if log.exists() else 0

    end = count() + more
    while count() < end and process.poll() is None:
        time.sleep(0.002)
