"""What a run keeps of each step, and that order, processes and limits do what they should."""

import importlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from reverie_eval import GroundTruth
from reverie_eval.agents import AgentSource
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle
from reverie_eval.runner import Limits, RunPlan, read_steps, run, run_agent, run_schema
from reverie_eval.simulator import Answer, Environment, Go, Observation, Stop, Turn
from tests.support.runs import EPISODES, Home, Scripted, scripted, stop, to_the_end


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    return scripted(tmp_path, monkeypatch)


# What is kept.


def test_the_submission_is_that_of_the_walks(home: Home) -> None:
    totals = home.run(to_the_end)
    walked = [["hall", 0.0, 0.0], ["north", 0.0, 0.0], ["far", 0.0, 0.0]]
    record = {"trajectory": walked, "predObjId": 5}
    assert home.submission == dict.fromkeys(EPISODES, record)
    assert (totals.ended, totals.steps, totals.attempts) == (4, 12, 4)


def test_a_step_has_where_what_and_what_it_cost(home: Home) -> None:
    def act(seen: Observation, agent: Scripted) -> Any:
        if agent.acted == 1:
            agent.episode.log(input_tokens=10, output_tokens=2, money=0.5, thought="nothing here")
            agent.episode.log(input_tokens=5, cached_tokens=4, reasoning_tokens=1, money=0.25)
            return Turn(1.0, 0.5)
        return Answer(8)

    home.run(act)
    first, second, *_ = map(msgspec.to_builtins, read_steps(home.folder))
    assert first.pop("seconds") >= 0
    assert first == {
        "episode": "7_5_0",
        "attempt": 1,
        "step": 1,
        "viewpoint_id": "hall",
        "heading": 0.0,
        "elevation": 0.0,
        "action": "Turn",
        "arguments": {"heading": 1.0, "elevation": 0.5},
        "input_tokens": 15,
        "cached_tokens": 4,
        "output_tokens": 2,
        "reasoning_tokens": 1,
        "money": 0.75,
        "notes": {"thought": "nothing here"},
    }
    assert (second["step"], second["heading"], second["elevation"]) == (2, 1.0, 0.5)
    assert (second["action"], second["arguments"]) == ("Answer", {"object_id": 8})
    assert (second["input_tokens"], second["money"], second["notes"]) == (None, None, {})


def test_numbers_of_numpy_are_written_as_numbers(home: Home) -> None:
    import numpy as np

    def act(seen: Observation, agent: Scripted) -> Any:
        agent.episode.log(scores=np.array([0.5, 1.5]))
        return Answer(np.int64(8))  # type: ignore[arg-type]

    home.run(act)
    step = next(read_steps(home.folder))
    assert (step.arguments, step.notes) == ({"object_id": 8}, {"scores": [0.5, 1.5]})


@pytest.mark.parametrize(
    ("money", "expected"),
    [
        pytest.param([0.5, 0.25], 3.0, id="added up"),
        pytest.param([0.0, 0.0], 0.0, id="free"),
        pytest.param([0.5, None], None, id="a call without a price"),
        pytest.param([None, None], None, id="no price"),
    ],
)
def test_the_cost_is_known_if_every_price_is(
    money: list[float | None], expected: float | None, home: Home
) -> None:
    def act(seen: Observation, agent: Scripted) -> Any:
        agent.episode.log(input_tokens=100, money=money[agent.acted - 1])
        return Go("north") if agent.acted == 1 else Stop()

    totals = home.run(act)
    assert (totals.input_tokens, totals.output_tokens) == (800, None)
    assert totals.money == expected


def test_an_agent_without_a_model_has_no_tokens_and_no_cost(home: Home) -> None:
    totals = home.run(stop)
    assert {totals.input_tokens, totals.output_tokens, totals.money} == {None}


@pytest.mark.parametrize(
    ("look", "read"),
    [
        pytest.param(lambda _: None, (), id="nothing"),
        pytest.param(lambda seen: [it.name for it in seen.candidates], ("names",), id="names"),
        pytest.param(
            repr, ("boxes", "geometry", "instruction", "names"), id="all but the pictures"
        ),
    ],
)
def test_the_card_says_what_the_agent_read(
    look: Callable[[Observation], object], read: tuple[str, ...], home: Home
) -> None:
    def act(seen: Observation, agent: Scripted) -> Any:
        look(seen)
        return Stop()

    assert home.run(act).read == read
    assert home.card.totals is not None
    assert home.card.totals.read == read


def test_an_episode_has_read_what_it_read_itself(home: Home) -> None:
    def act(seen: Observation, agent: Scripted) -> Any:
        if len(agent.begun) == 2:
            assert seen.instruction
        return Stop()

    home.run(act)
    assert [each.read for each in home.attempts] == [(), ("instruction",), (), ()]


def test_the_solution_is_read_by_those_who_ask_for_it(home: Home) -> None:
    shortest = run(replace(home.plan, agent=AgentSource("shortest")), home.folder)
    assert shortest.read == ("solution",)
    assert [home.submission[each] for each in EPISODES] == [
        {key: value for key, value in record.items() if key != "instr_id"}
        for record in run_agent("shortest", home.plan.ground_truth)
    ]


@pytest.mark.parametrize("task", ["reverie", "r2r", "r4r", "rxr", "ndh", "soon"])
def test_every_task_has_runs(task: str, tmp_path: Path) -> None:
    truth = GroundTruth.load(DEMO_BUNDLES / task.replace("reverie", "") / "val_unseen.npz")
    run(RunPlan(AgentSource("shortest"), truth), tmp_path / "run")
    submission = json.loads((tmp_path / "run" / "submission.json").read_text())
    assert submission == json.loads(json.dumps(run_agent("shortest", truth)))


# Order and processes change nothing.


def test_an_episode_is_random_in_its_own_way(tmp_path: Path) -> None:
    truth = GroundTruth.load(DEMO_BUNDLES / "val_unseen.npz")
    some = truth.subset(truth.episodes.instr_ids[10:15])
    whole, part, other, several = (tmp_path / name for name in ("a", "b", "c", "d"))
    run(RunPlan(AgentSource("random"), truth), whole)
    run(RunPlan(AgentSource("random"), some), part)
    run(RunPlan(AgentSource("random"), some, seed=1), other)
    run(RunPlan(AgentSource("random"), some), several, jobs=2)
    texts = [(each / "submission.json").read_text() for each in (whole, part, other, several)]
    records = [json.loads(each) for each in texts]
    assert records[0][10:15] == records[1]
    assert records[1] != records[2]
    assert texts[1] == texts[3]


# Limits.


@pytest.mark.parametrize(
    ("steps", "state", "reason", "end"),
    [
        pytest.param(1, "cut_off", "1 step", "north", id="after one"),
        pytest.param(2, "cut_off", "2 steps", "far", id="before its answer"),
        pytest.param(3, "ended", "", "far", id="at its answer"),
    ],
)
def test_an_episode_is_stopped_after_some_steps(
    steps: int, state: str, reason: str, end: str, home: Home
) -> None:
    totals = home.run(to_the_end, limits=Limits(steps=steps))
    assert {(each.state, each.reason, each.steps) for each in home.attempts} == {
        (state, reason, steps)
    }
    record = home.submission["7_5_3"]
    assert record["trajectory"][-1][0] == end
    assert record["predObjId"] == (5 if state == "ended" else -1)
    assert (totals.ended, totals.cut_off) == ((4, 0) if state == "ended" else (0, 4))


def test_an_episode_is_stopped_after_some_seconds(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each action takes two and a half."""
    clock = [0.0]
    walking = importlib.import_module("reverie_eval.runner._walking")
    monkeypatch.setattr(walking.time, "perf_counter", lambda: clock[0])

    def act(_: Observation, agent: Scripted) -> Any:
        clock[0] += 2.5
        return Turn(float(agent.acted))

    home.run(act, limits=Limits(seconds=5))
    assert {(each.state, each.reason, each.steps) for each in home.attempts} == {
        ("cut_off", "5 seconds", 2)
    }


def test_a_public_bundle_is_enough(tmp_path: Path) -> None:
    public = GroundTruth.from_bundle(Bundle.load(DEMO_BUNDLES / "val_unseen.npz").public())
    boxes = DEMO_BUNDLES / "val_unseen.npz"
    run(RunPlan(AgentSource("word-match"), public, boxes=boxes), tmp_path / "with")
    whole = GroundTruth.load(boxes)
    run(RunPlan(AgentSource("word-match"), whole), tmp_path / "whole")
    texts = [(tmp_path / name / "submission.json").read_text() for name in ("with", "whole")]
    assert texts[0] == texts[1]
    environment = Environment(public)
    assert environment.reset(environment.episodes[0]).candidates == ()


def test_lines_are_of_the_published_schemas(home: Home) -> None:
    from jsonschema import validate

    home.run(to_the_end)
    files = {"run-step": "steps.jsonl", "run-episode": "episodes.jsonl"}
    for name, file in files.items():
        for line in (home.folder / file).read_text().splitlines():
            validate(json.loads(line), run_schema(name))
    validate(json.loads((home.folder / "run.json").read_text()), run_schema("run-card"))
