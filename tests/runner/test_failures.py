"""Which errors end in an answer, in another attempt, or in the end of the run."""

import asyncio
import importlib
from collections import Counter
from collections.abc import Container
from email.message import Message
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError

import pytest

from reverie_eval import ReverieEvalError
from reverie_eval.agents import AgentSource
from reverie_eval.runner import (
    FAILED_IN_A_ROW,
    TREATMENTS,
    WAITS,
    RunError,
    RunPlan,
    read_steps,
    run,
)
from reverie_eval.runner._walking import treatment_of
from reverie_eval.simulator import Go, Observation, Stop, Turn
from tests.support.runs import EPISODES, STAYED, Act, Home, Scripted, scripted, some, stop


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    return scripted(tmp_path, monkeypatch)


def raising(error: BaseException, starts: Container[int]) -> Act:
    """Return the behaviour of an agent that pays, fails after some of its starts, and stops."""

    def act(seen: Observation, agent: Scripted) -> Any:
        agent.episode.log(input_tokens=1, money=1.0)
        if len(agent.begun) in starts:
            raise error
        return Stop()

    return act


def test_what_cannot_be_done_ends_an_episode_without_an_answer(home: Home) -> None:
    totals = home.run(lambda *_: Go("far"))
    (reason,) = {each.reason for each in home.attempts}
    assert reason.startswith("ActionError: 'far' is not a neighbour of hall")
    assert totals.cut_off == 4
    assert home.submission["7_5_0"] == STAYED
    assert [step.action for step in read_steps(home.folder)] == ["Go"] * 4


@pytest.mark.parametrize("returned", [None, "stop", [Stop()]], ids=repr)
def test_what_is_not_an_action_stops_the_run(returned: object, home: Home) -> None:
    """An agent that forgot its return must not look as if it had answered."""
    with pytest.raises(RunError, match="which is not an action"):
        home.run(lambda *_: returned)
    assert not (home.folder / "submission.json").exists()


def test_an_unknown_error_stops_the_run_and_the_same_command_goes_on(home: Home) -> None:
    with pytest.raises(RunError, match=r"stopped: 7_5_1: KeyError: 'x' \(runs.py, line "):
        home.run(raising(KeyError("x"), starts=[2]))
    assert [(each.episode, each.state) for each in home.attempts] == [
        ("7_5_0", "ended"),
        ("7_5_1", "failed"),
    ]
    assert "raise error" in home.attempts[1].traceback
    assert not (home.folder / "submission.json").exists()
    assert home.card.totals is not None
    assert (home.card.totals.failed, home.card.totals.missing) == (1, 2)
    totals = home.run(raising(KeyError("x"), starts=[]))
    assert [(each.episode, each.attempt) for each in home.attempts[2:]] == [
        ("7_5_1", 2),
        ("7_5_2", 1),
        ("7_5_3", 1),
    ]
    assert (totals.ended, totals.attempts) == (4, 5)
    assert (totals.input_tokens, totals.money) == (5, 5.0)  # the failed attempt's included
    assert len(home.card.circumstances) == 2


def test_the_time_to_start_and_of_a_choice_that_fails_counts(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]
    walking = importlib.import_module("reverie_eval.runner._walking")
    monkeypatch.setattr(walking.time, "perf_counter", lambda: clock[0])

    def start(agent: Scripted, episode: Any) -> None:
        clock[0] += 4
        begin(agent, episode)

    begin = Scripted.start
    monkeypatch.setattr(Scripted, "start", start)

    def act(seen: Observation, agent: Scripted) -> Any:
        clock[0] += agent.acted  # 1 s for the first action, 2 s until it fails
        if agent.acted == 2:
            raise KeyError
        return Turn(1.0)

    with pytest.raises(RunError):
        home.run(act)
    assert [(each.steps, each.seconds) for each in home.attempts] == [(1, 7.0)]


@pytest.mark.parametrize(
    ("error", "told"),
    [
        pytest.param(SystemExit(3), "SystemExit: 3", id="exit"),
        pytest.param(asyncio.CancelledError(), "CancelledError", id="cancelled"),
    ],
)
def test_whatever_an_agent_raises_stops_the_run(
    error: BaseException, told: str, home: Home
) -> None:
    with pytest.raises(RunError, match=rf"stopped: 7_5_1: {told} \(runs.py, line "):
        home.run(raising(error, starts=[2]))
    assert [each.state for each in home.attempts] == ["ended", "failed"]


def test_an_error_that_passes_is_tried_again(home: Home) -> None:
    totals = home.run(raising(ConnectionResetError("reset"), starts=[2, 3]))
    assert [(each.attempt, each.state) for each in home.attempts if each.episode == "7_5_1"] == [
        (1, "failed"),
        (2, "failed"),
        (3, "ended"),
    ]
    assert [each.wait for each in home.ends] == [None, 0.0, 0.0, None, None, None]
    assert (totals.ended, totals.attempts, totals.input_tokens) == (4, 6, 6)


def test_an_episode_fails_after_its_last_attempt_and_others_go_on(home: Home) -> None:
    message = (
        r"1 episode of 4 failed, such as 7_5_1 .*episodes.jsonl.*the same command.*--fill-missing"
    )
    with pytest.raises(RunError, match=message):
        home.run(raising(TimeoutError("late"), starts=[2, 3, 4]))
    states = Counter((each.episode, each.state) for each in home.attempts)
    assert states == {
        ("7_5_0", "ended"): 1,
        ("7_5_1", "failed"): 3,
        ("7_5_2", "ended"): 1,
        ("7_5_3", "ended"): 1,
    }
    assert not (home.folder / "submission.json").exists()
    begun = len(home.script.begun)
    totals = home.run(stop, fill_missing=True)
    assert len(home.script.begun) == begun  # nothing was run
    assert (totals.failed, totals.missing, totals.filled) == (1, 0, 1)
    assert home.submission["7_5_1"] == STAYED
    with pytest.raises(RunError, match="1 episode of 4 failed"):
        home.run(raising(TimeoutError("late"), starts=range(100)))
    assert not (home.folder / "submission.json").exists()  # it was the filled one


def test_only_a_run_can_be_filled(home: Home) -> None:
    with pytest.raises(RunError, match="run has no run to fill; run it first, without --fill-miss"):
        home.run(stop, fill_missing=True)
    assert not home.folder.exists()


def test_an_endpoint_that_is_gone_stops_the_run(home: Home) -> None:
    act = raising(ConnectionRefusedError("refused"), starts=range(100))
    with pytest.raises(RunError, match="3 episodes in a row failed, the last by Connection"):
        home.run(act)
    assert FAILED_IN_A_ROW == 3
    assert Counter(each.episode for each in home.attempts) == dict.fromkeys(EPISODES[:3], 3)


def test_waits_are_bounded_and_grow() -> None:
    assert list(WAITS) == sorted(WAITS)
    assert sum(WAITS) < 100


@pytest.mark.parametrize(
    ("error", "treatment"),
    [
        pytest.param(KeyError("x"), "stop", id="unknown"),
        pytest.param(ReverieEvalError("no pictures"), "stop", id="one of ours"),
        pytest.param(PermissionError("x"), "stop", id="file"),
        pytest.param(BrokenPipeError("x"), "retry", id="a kind of ConnectionError"),
        pytest.param(TimeoutError("x"), "retry", id="time out"),
    ],
)
def test_the_table_decides_by_the_nearest_base(error: Exception, treatment: str) -> None:
    assert treatment_of(error) == treatment


def test_a_wrong_key_is_not_tried_again() -> None:
    assert treatment_of(URLError("refused")) == "retry"
    assert treatment_of(HTTPError("", 401, "Unauthorized", Message(), None)) == "stop"


@pytest.mark.parametrize("name", [name for name in TREATMENTS if find_spec(name.partition(".")[0])])
def test_the_table_has_names_as_classes_have_them(name: str) -> None:
    module, _, attribute = name.rpartition(".")
    found = getattr(importlib.import_module(module), attribute)
    assert issubclass(found, Exception)
    if found is not TimeoutError:  # which others are merged with, from Python 3.11 on
        assert f"{found.__module__}.{found.__qualname__}" == name


def test_what_was_paid_for_an_action_that_failed_is_kept(home: Home) -> None:
    with pytest.raises(RunError):
        home.run(raising(KeyError("x"), starts=[1]))
    (step,) = read_steps(home.folder)
    assert (step.action, step.arguments, step.money) == ("", {}, 1.0)


def test_a_log_that_is_not_json_stops_the_run(home: Home) -> None:
    def act(seen: Observation, agent: Scripted) -> Any:
        agent.episode.log(thought=object())
        return Stop()

    with pytest.raises(RunError, match="object cannot be written as JSON"):
        home.run(act)


def test_a_cost_that_is_not_a_number_is_named(home: Home) -> None:
    def act(seen: Observation, agent: Scripted) -> Any:
        agent.episode.log(money="$0.01")
        return Stop()

    with pytest.raises(RunError, match=r"money should be a number to add up, not '\$0.01' \(runs"):
        home.run(act)


def test_a_process_that_is_killed_stops_the_run(tmp_path: Path) -> None:
    file = tmp_path / "deadly.py"
    file.write_text("import os, signal\ndef Agent(seen): os.kill(os.getpid(), signal.SIGKILL)\n")
    plan = RunPlan(AgentSource(str(file)), some(2))
    with pytest.raises(
        RunError, match=r"a worker ended while it ran \d+_\d+_\d+: it was killed, perhaps"
    ):
        run(plan, tmp_path / "run", jobs=2)


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_agent_that_is_refused_says_why_and_leaves_folders_as_they_were(
    tmp_path: Path, jobs: int
) -> None:
    file = tmp_path / "unready.py"
    file.write_text("class Agent:\n    def __init__(self): raise KeyError('MY_KEY')\n")
    plan = RunPlan(AgentSource(str(file)), some(2))
    (mine := tmp_path / "mine").mkdir()
    for folder in (tmp_path / "runs" / "new", mine):
        with pytest.raises(ReverieEvalError, match="cannot be made: KeyError: 'MY_KEY'"):
            run(plan, folder, jobs=jobs)
    assert not (tmp_path / "runs").exists()
    assert not any(mine.iterdir())


def test_a_refused_agent_leaves_a_folder_with_files_of_others(tmp_path: Path) -> None:
    file, others = tmp_path / "unready.py", tmp_path / "run" / ".others"
    file.write_text("class Agent:\n    def __init__(self): raise KeyError('MY_KEY')\n")
    others.parent.mkdir()
    others.touch()
    with pytest.raises(ReverieEvalError, match="cannot be made: KeyError: 'MY_KEY'"):
        run(RunPlan(AgentSource(str(file)), some(2)), tmp_path / "run")
    assert others.is_file()
