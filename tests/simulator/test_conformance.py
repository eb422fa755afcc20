"""The check for environments finds what is wrong, and passes ours."""

import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from reverie_eval import GroundTruth
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.simulator import (
    Action,
    ActionError,
    Environment,
    Observation,
    Turn,
)
from reverie_eval.simulator.conformance import ConformanceError, check_environment

BUNDLES = sorted(DEMO_BUNDLES.rglob("*.npz"))


@pytest.mark.parametrize("path", BUNDLES, ids=lambda it: str(it.relative_to(DEMO_BUNDLES)))
def test_the_environment_passes_with_every_bundle(path: Any) -> None:
    truth = GroundTruth.load(path)
    check_environment(lambda: Environment(truth))


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
