"""Runs that are killed at random moments end in the submission of one that was left alone.

``scripts/evidence runs [NUMBER]`` kills that many, with one process and with four.
"""

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from reverie_eval.runner import read_attempts, read_steps
from tests.conftest import REPOSITORY
from tests.support.amounts import amount, is_evidence, tell
from tests.support.endpoints import Behaviour, endpoint, saying, well_behaved
from tests.support.ledgers import PAUSE_VARIABLE, run_chat, run_with_ledger

KILLS = amount(in_suite=2)
EPISODES = min(198, 12 + 4 * KILLS)
PAUSE = 0.1
"""Seconds for each action and reply of a run that is to be killed, so that it does not end before,
not even on a slow machine."""
PROGRAM = """
import sys
from pathlib import Path
from tests.support.endpoints import Behaviour, endpoint, saying, well_behaved
from tests.support.ledgers import run_with_ledger
run_with_ledger(*map(Path, sys.argv[1:3]), *map(int, sys.argv[3:]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 4 if is_evidence() else 2])
def test_a_run_that_is_killed_goes_on(jobs: int, tmp_path: Path) -> None:
    rng, ledger = random.Random(jobs), tmp_path / "ledger"
    killed, hits = tmp_path / "killed", 0
    words = [sys.executable, "-c", PROGRAM, *map(str, (ledger, killed, EPISODES, jobs))]
    slowly = os.environ | {PAUSE_VARIABLE: f"{PAUSE}"}
    for _ in range(KILLS):
        with subprocess.Popen(words, cwd=REPOSITORY, env=slowly) as process:
            wait_for_lines(killed / "steps.jsonl", rng.randint(1, 6 + 6 * jobs), process)
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


def wait_for_lines(log: Path, more: int, process: subprocess.Popen[bytes]) -> None:
    """Wait until a run has written some more lines, or has ended."""

    def count() -> int:
        return content_of(log).count(b"\n")

    end = count() + more
    while count() < end and process.poll() is None:
        time.sleep(0.002)


CHAT = """
import json, sys
from tests.support.ledgers import run_chat
run_chat(*json.loads(sys.argv[1]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 4] if is_evidence() else [4])
def test_no_reply_of_a_language_model_is_paid_twice(jobs: int, tmp_path: Path) -> None:
    """The endpoint looks whether what it is asked for is on disk already."""
    rng, episodes = random.Random(jobs), min(84, 6 + 3 * KILLS)
    killed, alone, hits = tmp_path / "killed", tmp_path / "alone", 0
    twice: list[str] = []

    def reply(request: Mapping[str, Any]) -> Behaviour:
        key = hashlib.sha256(json.dumps(request["messages"]).encode()).hexdigest()
        if not alone.exists() and key.encode() in content_of(killed / "replies.jsonl"):
            twice.append(key)
        chosen = json.loads(well_behaved(request).document["choices"][0]["message"]["content"])
        if hits < KILLS:
            time.sleep(PAUSE)
        return saying(json.dumps({**chosen, "thought": key}))

    with endpoint() as served:
        served.good = reply
        words = [sys.executable, "-c", CHAT, json.dumps([served.url, str(killed), episodes, jobs])]
        for _ in range(KILLS):
            with subprocess.Popen(words, cwd=REPOSITORY) as process:
                wait_for_lines(killed / "replies.jsonl", rng.randint(1, 2 + 2 * jobs), process)
                time.sleep(rng.uniform(0, 2 * PAUSE))
                process.send_signal(signal.SIGKILL)
            hits += process.returncode == -signal.SIGKILL
        for folder in (killed, alone):
            run_chat(served.url, str(folder), episodes)
        received = served.sent
    submissions = [(folder / "submission.json").read_bytes() for folder in (killed, alone)]
    assert submissions[0] == submissions[1]
    assert (hits, twice) == (KILLS, [])
    paid, wanted = (
        [json.loads(line)["key"] for line in content_of(folder / "replies.jsonl").splitlines()]
        for folder in (killed, alone)
    )
    assert len({*paid}) == len(paid)
    assert {*paid} == {*wanted}
    # Replies that were on their way to a process that was killed are lost.
    assert 0 <= received - len(paid) - len(wanted) <= KILLS * jobs
    # All that is on disk is in the log of steps, once.
    logged = [key for step in read_steps(killed) for key in step.notes.get("replies", ())]
    assert sorted(logged) == sorted(paid)
    tokens = [sum(each.input_tokens or 0 for each in read_attempts(it)) for it in (killed, alone)]
    assert tokens == [100 * len(paid)] * 2
    tell(**{f"a language model at {jobs} requests a time": f"{hits} kills, {len(paid)} replies"})


def content_of(file: Path) -> bytes:
    """Return what is in a file, nothing if it does not exist."""
    return file.read_bytes() if file.exists() else b""
