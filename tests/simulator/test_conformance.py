"""The checks for environments and agents find what is wrong, and pass ours."""

import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from reverie_eval import GroundTruth
from reverie_eval.agents import BUILT_IN, Episode
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.simulator import (
    Action,
    ActionError,
    Answer,
    Environment,
    Go,
    Observation,
    Stop,
    Turn,
)
from reverie_eval.simulator.conformance import ConformanceError, check_agent, check_environment

BUNDLES = sorted(DEMO_BUNDLES.rglob("*.npz"))


@pytest.mark.parametrize("path", BUNDLES, ids=lambda it: str(it.relative_to(DEMO_BUNDLES)))
def test_the_environment_passes_with_every_bundle(path: Any) -> None:
    truth = GroundTruth.load(path)
    check_environment(lambda: Environment(truth))


@pytest.mark.parametrize(
    ("name", "read"),
    [
        pytest.param("stop", [], id="stop"),
        pytest.param("shortest", [], id="shortest"),
        pytest.param("random", [], id="random"),
        pytest.param("nearest-first", ["geometry"], id="nearest-first"),
        pytest.param("word-match", ["geometry", "instruction", "names"], id="word-match"),
    ],
)
def test_agents_pass_and_read_no_more_than_they_say(
    name: str, read: list[str], demo: GroundTruth
) -> None:
    first = demo.subset(demo.episodes.instr_ids[:1])

    def begun() -> Callable[[Observation], Action]:
        agent = BUILT_IN[name]()
        agent.start(Episode(first, 0, random.Random(0)))
        return agent.act

    assert sorted(check_agent(begun, Environment(first))) == read


def test_every_agent_is_checked() -> None:
    (mark,) = test_agents_pass_and_read_no_more_than_they_say.pytestmark  # type: ignore[attr-defined]
    assert {each.values[0] for each in mark.args[1]} == set(BUILT_IN)


def altered(truth: GroundTruth, alter: Callable[[Observation], Observation]) -> Any:
    """Return an environment that shows something else than it should."""
    environment: Any = Environment(truth)
    reset, step = environment.reset, environment.step
    environment.reset = lambda episode: alter(reset(episode))
    environment.step = lambda action: alter(step(action))
    return environment


def last_twice(seen: Observation) -> Observation:
    return replace(seen, neighbours=(*seen.neighbours, seen.neighbours[-1]))


def too_far(seen: Observation) -> Observation:
    return replace(seen, neighbours=tuple(replace(it, distance=-1.0) for it in seen.neighbours))


def reversed_candidates(seen: Observation) -> Observation:
    return replace(seen, candidates=seen.candidates[::-1] * 2)


@pytest.mark.parametrize(
    ("alter", "says"),
    [
        pytest.param(last_twice, "step 0: neighbours are not distinct", id="a neighbour twice"),
        pytest.param(too_far, r"step 0: Neighbour\(.*\) is out of range", id="below zero"),
        pytest.param(reversed_candidates, "candidates are not distinct", id="candidates twice"),
        pytest.param(lambda it: replace(it, heading=7.0), "heading or elevation", id="a heading"),
        pytest.param(lambda it: replace(it, is_over=True), "over before its answer", id="over"),
        pytest.param(lambda it: replace(it, is_over=False), "it goes on after a Stop", id="no end"),
        pytest.param(
            lambda it: replace(it, instruction=str(random.random())),
            "step 0: two copies show different things",
            id="chance",
        ),
        pytest.param(
            lambda it: replace(it, viewpoint_id="here"), "led elsewhere", id="another place"
        ),
    ],
)
def test_what_is_wrong_with_an_environment_is_found(
    alter: Callable[[Observation], Observation], says: str, demo: GroundTruth
) -> None:
    with pytest.raises(ConformanceError, match=says):
        check_environment(lambda: altered(demo, alter))


def lenient(truth: GroundTruth) -> Any:
    """Return an environment that stays as it is if something cannot be done."""
    environment: Any = Environment(truth)
    step = environment.step

    def try_to_step(action: Action) -> Observation:
        try:
            seen: Observation = step(action)
        except ActionError:
            seen = step(Turn(0.0))
        return seen

    environment.step = try_to_step
    return environment


def test_an_environment_must_refuse_what_cannot_be_done(demo: GroundTruth) -> None:
    with pytest.raises(ConformanceError, match=r"Go\(.*\) raises no ActionError"):
        check_environment(lambda: lenient(demo))


def test_what_an_agent_read_is_returned(demo: GroundTruth) -> None:
    def act(seen: Observation) -> Action:
        named = [it for it in seen.candidates if it.name in seen.instruction]
        return Answer(named[0].object_id) if named else Stop()

    assert check_agent(lambda: act, Environment(demo)) == {"instruction", "names"}


@pytest.mark.parametrize(
    ("act", "error", "says"),
    [
        pytest.param(lambda _: Turn(0.0), ConformanceError, "not end it in 9 actions", id="no end"),
        pytest.param(lambda _: Go("nowhere"), ActionError, "is not a neighbour", id="impossible"),
    ],
)
def test_what_is_wrong_with_an_agent_is_found(
    act: Callable[[Observation], Action], error: type[Exception], says: str, demo: GroundTruth
) -> None:
    with pytest.raises(error, match=says):
        check_agent(lambda: act, Environment(demo), most=9)


def test_an_agent_must_do_the_same_the_second_time(demo: GroundTruth) -> None:
    actions: Iterator[Action] = iter([Turn(1.0), Stop(), Turn(2.0), Stop()])
    with pytest.raises(ConformanceError, match="does something else the second time"):
        check_agent(lambda: lambda _: next(actions), Environment(demo))
