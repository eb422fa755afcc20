"""A check for environments of your own, for a test of yours to call.

It walks a few episodes, and raises :class:`ConformanceError` with the first thing that is wrong.
:func:`reverie_eval.runner.check_agent` does it for agents.
"""

import json
import math
import random
import typing
from collections.abc import Callable, Sequence
from typing import Any

from reverie_eval.errors import ActionError, ReverieEvalError
from reverie_eval.geometry import N_VIEWS
from reverie_eval.simulator._observation import Action, Go, Observation, Part, Stop, Turn


class ConformanceError(ReverieEvalError):
    """An environment or an agent does not do what it should."""


class AnyEnvironment(typing.Protocol):
    """What an environment must have."""

    @property
    def episodes(self) -> Sequence[str]:
        """The ids of the split's episodes."""

    @property
    def parts_read(self) -> frozenset[Part]:
        """The parts of observations that were read so far."""

    def reset(self, episode: str, /) -> Observation:
        """Begin an episode."""

    def step(self, action: Action, /) -> Observation:
        """Do an action."""

    def submission(self) -> list[dict[str, Any]]:
        """Return the records of the episodes that ended."""


# Enough for copies that differ to show it.
_EPISODES, _STEPS = 5, 20


def check_environment(make: Callable[[], AnyEnvironment]) -> None:
    """Walk through some episodes of two copies of an environment side by side, at random.

    The copies must show the same. Observations must be of the promised form, and must not change
    later. What cannot be done must be refused.

    Parameters
    ----------
    make : callable
        Returns a new environment.

    Raises
    ------
    ConformanceError
        If something is wrong.
    """
    pair, rng = (make(), make()), random.Random(0)  # noqa: S311
    episodes = list(pair[0].episodes)
    for episode in rng.sample(episodes, min(_EPISODES, len(episodes))):
        seen, other = (each.reset(episode) for each in pair)
        visited = [seen.viewpoint_id]
        for step in range(_STEPS):
            where = f"{episode}, step {step}"
            _require(seen == other, where, "two copies show different things")
            _check_observation(where, seen)
            _require(not seen.is_over, where, "the episode is over before its answer")
            _check_refusal(where, pair[0], Go("nowhere"))
            before, shown = seen, repr(seen)
            action = _draw(rng, seen)
            seen, other = (each.step(action) for each in pair)
            _require(repr(before) == shown, where, "a step changed an earlier observation")
            if isinstance(action, Go):
                visited.append(action.viewpoint_id)
            _require(seen.viewpoint_id == visited[-1], where, f"{action} led elsewhere")
        _require(all(it.step(Stop()).is_over for it in pair), episode, "it goes on after a Stop")
        _check_refusal(f"{episode}, after its end", pair[0], Stop())
    first, second = (json.dumps(each.submission()) for each in pair)
    _require(first == second, "submission()", "two copies give different ones")


def _require(is_right: bool, where: str, what: str) -> None:  # noqa: FBT001
    if not is_right:
        raise ConformanceError(f"{where}: {what}")


def _draw(rng: random.Random, seen: Observation) -> Action:
    turn = Turn(rng.uniform(0, math.tau), rng.uniform(-1, 1))
    actions: list[Action] = [turn, *(Go(each.viewpoint_id) for each in seen.neighbours)]
    return rng.choice(actions)


def _check_refusal(where: str, environment: AnyEnvironment, action: Action) -> None:
    try:
        environment.step(action)
    except ActionError:
        return
    raise ConformanceError(f"{where}: {action} raises no ActionError")


def _check_observation(where: str, seen: Observation) -> None:
    is_direction = 0 <= seen.heading < math.tau and abs(seen.elevation) <= math.pi / 2
    _require(is_direction, where, "heading or elevation is out of range")
    near = [each.viewpoint_id for each in seen.neighbours]
    _require(len({*near, seen.viewpoint_id}) == len(near) + 1, where, "neighbours are not distinct")
    for way in seen.neighbours:
        is_near = abs(way.relative_heading) <= math.pi and 0 <= way.distance < math.inf
        _require(is_near and way.view in range(N_VIEWS), where, f"{way} is out of range")
    objects = [each.object_id for each in seen.candidates]
    _require(objects == sorted(set(objects)), where, "candidates are not distinct, by object id")
    for candidate in seen.candidates:
        for box in candidate.boxes:
            is_box = box.view in range(N_VIEWS) and min(box.xywh[2:]) > 0
            _require(is_box, where, f"{box} of object {candidate.object_id} is not a box")
