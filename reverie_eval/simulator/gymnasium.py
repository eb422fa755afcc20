"""Gymnasium environments of all tasks; needs ``pip install reverie-eval[gymnasium]``.

Importing this module registers them, as ``reverie_eval/REVERIE-v1``, ``reverie_eval/R2R-v1`` and so
on for R4R, RxR, NDH and SOON.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from operator import attrgetter
from os import PathLike
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from reverie_eval.arrays import LARGEST_OBJECT_ID
from reverie_eval.errors import ActionError, naming_missing_parts
from reverie_eval.geometry import HEIGHT, N_VIEWS, WIDTH, view_angles
from reverie_eval.ground_truth import GroundTruth, find_ground_truth
from reverie_eval.simulator._environment import Environment, Surroundings
from reverie_eval.simulator._observation import (
    Action,
    Answer,
    AnswerBox,
    Go,
    Observation,
    Part,
    Point,
    Stop,
    Turn,
)
from reverie_eval.tasks import BUILT_IN, DEFAULT_TASK, find_task

with naming_missing_parts():
    import gymnasium
    from gymnasium import spaces

Observed: TypeAlias = dict[str, Any]
Chosen: TypeAlias = tuple[int, Any]

IDS: Mapping[str, str] = MappingProxyType(
    {name: f"reverie_eval/{find_task(name).title}-v1" for name in BUILT_IN}
)
"""The registered id of each task."""

# The part of observations that a key belongs to; those without one are always there.
_PART_OF: Mapping[str, Part] = MappingProxyType(
    {
        "instruction": "instruction",
        "geometry": "geometry",
        "view": "geometry",
        "name": "names",
        "boxes": "boxes",
        "image": "pictures",
    }
)


class GymnasiumEnvironment(gymnasium.Env[Observed, Chosen]):
    """The episodes of a split, in Gymnasium's interface.

    An observation is a dictionary of what an :class:`Observation` has. Its ``neighbours`` and
    ``candidates`` are tuples, because they vary in number. An action is a number of ``actions`` and
    its argument: ``(0, k)`` goes to the neighbour ``k``. What cannot be done changes nothing, and
    ``info["is_possible"]`` says so. Rewards are 0: score ``environment.submission()`` instead.

    Parameters
    ----------
    task : str
        The task's name; by default, that of the id.
    split : str
    ground_truth : path or GroundTruth, optional
        A bundle, or a folder of bundles; by default the demo world.
    boxes, pictures : path, optional
        As for :class:`Environment`.
    parts : collection of Part
        What is observed besides where the agent is; all of it counts as read.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  # as the base class has it

    def __init__(
        self,
        task: str = DEFAULT_TASK,
        split: str = "val_unseen",
        ground_truth: str | PathLike[str] | GroundTruth | None = None,
        *,
        boxes: str | PathLike[str] | None = None,
        pictures: str | PathLike[str] | None = None,
        parts: Collection[Part] = ("instruction", "geometry", "names", "boxes"),
    ) -> None:
        truth = find_ground_truth(ground_truth, split, task)
        self.environment = Environment(truth, boxes=boxes, pictures=pictures)
        """What is walked."""
        self._seen: Observation | None = None
        graph, surroundings = truth.graph, self.environment.surroundings
        viewpoints = range(len(graph.viewpoint_ids))
        visible = [surroundings.visible_from(viewpoint) for viewpoint in viewpoints]
        arguments: dict[str, spaces.Space[Any]] = {
            "go": spaces.Discrete(max(len(surroundings.ways_from(it)) for it in viewpoints)),
            "turn": spaces.Discrete(N_VIEWS),
            "stop": spaces.Discrete(1),
        }
        if truth.task.has_targets:
            arguments["answer"] = spaces.Discrete(max(map(len, visible)) or 1)
            arguments["answer box"] = _boxes()
        if truth.task.has_items:
            arguments["point"] = _directions()
        self.actions = tuple(arguments)
        """What the first number of an action stands for."""
        self.action_space = spaces.OneOf(arguments.values())
        names = [it.name for candidates in visible for it in candidates]
        self.observation_space = _observation_space(truth, surroundings, names, parts)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Begin the episode ``options["episode"]``; without it, a random one."""
        super().reset(seed=seed)
        episodes = self.environment.episodes
        drawn = episodes[int(self.np_random.integers(len(episodes)))]
        self._seen = self.environment.reset((options or {}).get("episode", drawn))
        return _read(self.observation_space, self._seen), {}

    def step(self, action: Chosen) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Do an action. An episode terminates with its answer, and is never truncated.

        Raises
        ------
        ActionError
            If no episode goes on.
        """
        if self._seen is None or self._seen.is_over:
            raise ActionError("no episode goes on; call reset()")
        try:
            self._seen = self.environment.step(self._meant(self._seen, *action))
            is_possible = True
        except (ActionError, IndexError):  # there is no such neighbour or candidate
            is_possible = False
        info = {"is_possible": is_possible}
        return _read(self.observation_space, self._seen), 0.0, self._seen.is_over, False, info

    def _meant(self, seen: Observation, kind: int, argument: Any) -> Action:
        match self.actions[kind]:
            case "go":
                return Go(seen.neighbours[argument].viewpoint_id)
            case "turn":
                return Turn(*view_angles(np.array([argument]))[0].tolist())
            case "answer":
                return Answer(seen.candidates[argument].object_id)
            case "answer box":
                view, *xywh = argument.tolist()
                return AnswerBox(view, tuple(xywh))
            case "point":
                return Point(*argument.tolist())
            case _:
                return Stop()


def _observation_space(
    truth: GroundTruth, surroundings: Surroundings, names: Sequence[str], parts: Collection[Part]
) -> spaces.Dict:
    def given(**keys: spaces.Space[Any]) -> spaces.Dict:
        return spaces.Dict(
            {key: it for key, it in keys.items() if _PART_OF.get(key) in {None, *parts}}
        )

    viewpoint_id = _texts(truth.graph.viewpoint_ids)
    neighbour = given(
        viewpoint_id=viewpoint_id, geometry=_geometry(), view=spaces.Discrete(N_VIEWS)
    )
    candidate = given(
        object_id=spaces.Discrete(LARGEST_OBJECT_ID + 1),
        name=_texts(names),
        boxes=spaces.Sequence(_boxes()),
    )
    return given(
        instruction=_texts(surroundings.instructions),
        language=_texts(surroundings.languages),
        scan_id=_texts(truth.graph.scan_ids),
        viewpoint_id=viewpoint_id,
        direction=_directions(),
        neighbours=spaces.Sequence(neighbour),
        candidates=spaces.Sequence(candidate),
        image=spaces.Box(0, 255, (HEIGHT, WIDTH, 3), np.uint8),
    )


# Each environment has spaces of its own, because a space draws its samples one after another.


def _directions() -> spaces.Box:
    """Return the space of headings and elevations."""
    return spaces.Box(np.array([0, -np.pi / 2]), np.array([2 * np.pi, np.pi / 2]), dtype=np.float64)


def _boxes() -> spaces.Box:
    """Return the space of boxes: view, left, top, width and height."""
    highest = np.array([N_VIEWS - 1, WIDTH, HEIGHT, WIDTH, HEIGHT])
    return spaces.Box(np.zeros(5, np.int64), highest, dtype=np.int64)


def _geometry() -> spaces.Box:
    """Return the space of relative headings and elevations, and distances."""
    highest = np.array([np.pi, np.pi, np.inf])
    return spaces.Box(np.array([-np.pi, -np.pi, 0]), highest, dtype=np.float64)


def _texts(texts: Sequence[str]) -> spaces.Text:
    """Return the space of all texts in the letters of the given ones: RxR's are also Indian."""
    letters = frozenset[str]().union(*texts) or frozenset("?")
    return spaces.Text(max(map(len, texts), default=0) or 1, min_length=0, charset=letters)


def _read(space: spaces.Space[Any], value: Any) -> Any:
    """Return a part of an observation as a space has it, and read nothing else."""
    match space:
        case spaces.Dict():
            return {
                key: _read(each, _READERS.get(key, attrgetter(key))(value))
                for key, each in space.items()
            }
        case spaces.Sequence():
            return tuple(_read(space.feature_space, each) for each in value)
        case spaces.Box():
            return np.array(value, space.dtype)
        case _:
            return value


# How keys are read that are not attributes of the same name.
_READERS: Mapping[str, Callable[[Any], Any]] = MappingProxyType(
    {
        "direction": attrgetter("heading", "elevation"),
        "geometry": attrgetter("relative_heading", "relative_elevation", "distance"),
        "boxes": lambda it: [(box.view, *box.xywh) for box in it.boxes],
        "image": lambda it: it.image(),
    }
)


for _name, _id in IDS.items():
    gymnasium.register(_id, f"{__name__}:{GymnasiumEnvironment.__name__}", kwargs={"task": _name})
