"""Episodes to walk through: observations, actions, and the submission that comes of them."""

import copy
import hashlib
import json
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, overload

import numpy as np

from reverie_eval.arrays import LARGEST_OBJECT_ID
from reverie_eval.errors import ActionError, ReverieEvalError
from reverie_eval.geometry import N_VIEWS, snap
from reverie_eval.ground_truth import GroundTruth, NavigationGraph
from reverie_eval.metrics import ABSTAINED
from reverie_eval.simulator._observation import (
    Action,
    Answer,
    AnswerBox,
    Box,
    Candidate,
    Go,
    Neighbour,
    Notes,
    Observation,
    Part,
    Picture,
    Point,
    Stop,
    Turn,
)
from reverie_eval.simulator.on_path import MatterSim
from reverie_eval.submissions import NO_POINT, join_items, official_point
from reverie_eval.tasks import turns_of
from reverie_eval.text import category_text, count_text

# Viewpoint, heading and elevation.
_Pose: TypeAlias = tuple[int, float, float]


@dataclass(frozen=True, slots=True)
class _Walk:
    """An episode so far."""

    row: int
    poses: tuple[_Pose, ...]
    answer: Mapping[str, Any] | None = None
    """The fields of the record; None while the episode goes on."""


class Environment:
    """The episodes of a split, for an agent to walk.

    Observations have nothing of the annotation in them, whether or not the bundle has the solution.

    Parameters
    ----------
    ground_truth : GroundTruth
        A bundle; a public one suffices.
    boxes : path, optional
        Where objects are visible: the released folder ``BBox``, the file ``BBoxes.json``, or a
        bundle with the solution. By default, ``ground_truth`` says that if it has the solution.
    pictures : path, optional
        The folder of the scans with their skyboxes, as ``MatterSim.setDatasetPath`` takes it.

    Raises
    ------
    ReverieEvalError
        If there is no ground truth, ``boxes`` cannot be read, or ``pictures`` is not a folder.

    Examples
    --------
    >>> from reverie_eval.ground_truth import DEMO_BUNDLES
    >>> environment = Environment(GroundTruth.load(DEMO_BUNDLES / "val_unseen.npz"))
    >>> seen = environment.reset(environment.episodes[0])
    >>> seen = environment.step(Go(seen.neighbours[0].viewpoint_id))
    >>> seen = environment.step(Stop())
    >>> [(len(it["trajectory"]), it["predObjId"]) for it in environment.submission()]
    [(2, -1)]
    """

    def __init__(
        self,
        ground_truth: GroundTruth,
        *,
        boxes: str | PathLike[str] | None = None,
        pictures: str | PathLike[str] | None = None,
    ) -> None:
        if not isinstance(ground_truth, GroundTruth):
            raise ReverieEvalError(
                f"an Environment takes a ground truth, such as GroundTruth.load('bundle.npz'), not "
                f"{ground_truth!r}"
            )
        if pictures is not None and not Path(pictures).is_dir():
            raise ReverieEvalError(f"{fspath(pictures)}: there is no such folder of pictures")
        self._truth = ground_truth
        self.surroundings = Surroundings(ground_truth, boxes)
        """What is asked, reachable and visible, as one source for all that show it."""
        self._pictures = pictures
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._notes = Notes()
        self._walks: tuple[_Walk, ...] = ()
        self._is_batch = False
        self._ended: dict[int, _Walk] = {}
        self._candidates: dict[int, tuple[Candidate, ...]] = {}

    def copy(self) -> "Environment":
        """Return an environment in which no episode began yet, and which shares what is loaded."""
        other = copy.copy(self)
        other._begin_anew()  # noqa: SLF001
        return other

    @property
    def episodes(self) -> Sequence[str]:
        """The ids of the split's episodes."""
        return self._truth.episodes.instr_ids

    @property
    def parts_read(self) -> frozenset[Part]:
        """The parts of observations that were read so far, or since :meth:`forget_parts_read`."""
        return frozenset(self._notes)

    def forget_parts_read(self) -> None:
        """Forget which parts were read, to note those of another episode."""
        self._notes.clear()

    @overload
    def reset(self, episode: str) -> Observation: ...

    @overload
    def reset(self, episode: list[str] | tuple[str, ...]) -> tuple[Observation, ...]: ...

    def reset(
        self, episode: str | list[str] | tuple[str, ...]
    ) -> Observation | tuple[Observation, ...]:
        """Begin an episode, or a batch of them.

        Raises
        ------
        ReverieEvalError
            If the split has no such episode.
        """
        instr_ids = [episode] if isinstance(episode, str) else episode
        if not isinstance(instr_ids, list | tuple):
            raise ReverieEvalError(
                f"reset() takes an episode's id or a list of them, not {episode!r}"
            )
        self._walks = tuple(map(self._begun, instr_ids))
        self._is_batch = not isinstance(episode, str)
        return self._observed()

    @overload
    def step(self, action: Action) -> Observation: ...

    @overload
    def step(self, action: Sequence[Action | None]) -> tuple[Observation, ...]: ...

    def step(
        self, action: Action | Sequence[Action | None]
    ) -> Observation | tuple[Observation, ...]:
        """Do an action; in a batch, one in each episode, and None in those that are over.

        Raises
        ------
        ActionError
            If an action cannot be done. Nothing is done then, in a batch in no episode.
        """
        actions = action if isinstance(action, list | tuple) else [action]
        if isinstance(action, list | tuple) != self._is_batch or len(actions) != len(self._walks):
            begun = count_text(len(self._walks), "episode")
            raise ActionError(
                f"{begun} began{' as a batch' if self._is_batch else ''}; call reset(), then "
                "step() with an action, or after reset([...]) with a list of one for each episode"
            )
        self._walks = tuple(map(self._after, self._walks, actions))
        self._ended |= {walk.row: walk for walk in self._walks if walk.answer is not None}
        return self._observed()

    def observe(self, episode: str, viewpoint_id: str) -> Observation:
        """Return what an agent would observe at any viewpoint, facing north and level.

        Nothing is begun or done by it: it is for training, which knows where it wants to look.

        Raises
        ------
        ReverieEvalError
            If the split has no such episode, or no such viewpoint.
        """
        viewpoint = self._truth.graph.index.get(viewpoint_id)
        if viewpoint is None:
            raise ReverieEvalError(f"the split's buildings have no viewpoint {viewpoint_id!r}")
        return self._observe(_Walk(self._truth.row_of(episode), ((viewpoint, 0.0, 0.0),)))

    def submission(self) -> list[dict[str, Any]]:
        """Return the official record of each episode that ended, as it was walked last."""
        records = [self._record(self._ended[row]) for row in sorted(self._ended)]
        return join_items(records) if self._truth.task.has_items else records

    def record(self, episode: str) -> dict[str, Any]:
        """Return the record of an episode that ended; of SOON's items, one start has it alone.

        Raises
        ------
        ReverieEvalError
            If the split has no such episode, or it did not end.
        """
        walk = self._ended.get(self._truth.row_of(episode))
        if walk is None:
            raise ReverieEvalError(f"{episode} did not end; it has no record yet")
        return self._record(walk)

    def _record(self, walk: _Walk) -> dict[str, Any]:
        return {
            **self._truth.task.official_id(self.episodes[walk.row]),
            "trajectory": [
                [self._truth.graph.viewpoint_ids[viewpoint], heading, elevation]
                for viewpoint, heading, elevation in walk.poses
            ],
            **(walk.answer or {}),
        }

    # Actions.

    def _begun(self, instr_id: str) -> _Walk:
        row = self._truth.row_of(instr_id)
        start = int(self._truth.episodes.start[row]), float(self._truth.episodes.heading[row]), 0.0
        return _Walk(row, (start,))

    def _after(self, walk: _Walk, action: Action | None) -> _Walk:
        """Return an episode after an action."""
        if action is None and walk.answer is not None:
            return walk
        if walk.answer is not None:
            raise ActionError(f"the episode is over; there is no {action} after its end")
        match action:
            case Go(viewpoint_id):
                return replace(walk, poses=(*walk.poses, self._pose_at(walk, viewpoint_id)))
            case Turn(heading, elevation):
                _check_direction(action, heading, elevation)
                pose = walk.poses[-1][0], float(heading) % math.tau, float(elevation)
                return replace(walk, poses=(*walk.poses[:-1], pose))
            case Stop() | Answer() | AnswerBox() | Point():
                return replace(walk, answer=self._answer(walk, action))
            case _:
                raise ActionError(f"{action!r} is not an action, such as a Go, a Turn or a Stop")

    def _pose_at(self, walk: _Walk, viewpoint_id: str) -> _Pose:
        """Return the pose of someone who came to a neighbour."""
        here, graph = walk.poses[-1][0], self._truth.graph
        for way in self.surroundings.ways_from(here):
            if graph.viewpoint_ids[way.viewpoint] == viewpoint_id:
                return way.viewpoint, way.heading, way.elevation
        raise ActionError(
            f"{viewpoint_id!r} is not a neighbour of {graph.viewpoint_ids[here]}; go to one of the "
            "observation's neighbours"
        )

    def _answer(self, walk: _Walk, action: Stop | Answer | AnswerBox | Point) -> Mapping[str, Any]:
        """Return the fields of an answer in the official form."""
        task = self._truth.task
        if isinstance(action, Answer | AnswerBox) and not task.has_targets:
            raise ActionError(f"{task.title} has no target objects; end the episode with a Stop")
        if isinstance(action, Point) and not task.has_items:
            raise ActionError(f"the answer in {task.title} is not a direction")
        match action:
            case Answer(object_id):
                if type(object_id) is not int and not isinstance(object_id, np.integer):
                    raise ActionError(
                        f"{action!r} has no object id; expected a whole number, such as the "
                        "object_id of a candidate"
                    )
                visible: Collection[int] = range(LARGEST_OBJECT_ID + 1)
                if self.surroundings.has_objects:
                    visible = {it.object_id for it in self._candidates_at(walk.poses[-1][0])}
                if object_id not in visible:
                    raise ActionError(
                        f"object {object_id} is not visible from where the agent is; answer with "
                        "one of the observation's candidates"
                    )
                return {"predObjId": int(object_id)}
            case AnswerBox(view, xywh):
                _check_box(action, view, xywh)
                return {"predBox": np.array(xywh).tolist(), "predView": int(view)}
            case Point(heading, elevation):
                _check_direction(action, heading, elevation)
                return official_point(turns_of(float(heading) % math.tau, float(elevation)))
            case Stop():
                abstained = {"predObjId": ABSTAINED} if task.has_targets else {}
                return {**abstained, **(official_point(NO_POINT) if task.has_items else {})}

    # Observations.

    def _observed(self) -> Observation | tuple[Observation, ...]:
        observations = tuple(map(self._observe, self._walks))
        return observations if self._is_batch else observations[0]

    def _observe(self, walk: _Walk) -> Observation:
        viewpoint, heading, elevation = walk.poses[-1]
        graph = self._truth.graph
        return Observation(
            instruction=self.surroundings.instructions[walk.row],
            language=self.surroundings.languages[walk.row],
            scan_id=graph.scan_of(viewpoint),
            viewpoint_id=graph.viewpoint_ids[viewpoint],
            heading=heading,
            elevation=elevation,
            neighbours=tuple(
                Neighbour(
                    viewpoint_id=graph.viewpoint_ids[way.viewpoint],
                    relative_heading=math.remainder(way.heading - heading, math.tau),
                    relative_elevation=way.elevation - elevation,
                    distance=way.distance,
                    view=way.view,
                    notes=self._notes,
                )
                for way in self.surroundings.ways_from(viewpoint)
            ),
            candidates=self._candidates_at(viewpoint),
            is_over=walk.answer is not None,
            picture=self._picture(*walk.poses[-1]),
            notes=self._notes,
        )

    def _candidates_at(self, viewpoint: int) -> tuple[Candidate, ...]:
        seen = self._candidates.get(viewpoint)
        if seen is None:
            seen = self._candidates[viewpoint] = tuple(
                Candidate(
                    object_id=it.objectId,
                    name=it.name,
                    boxes=tuple(
                        Box(view, (x, y, width, height))
                        for view, (x, y, width, height) in zip(
                            it.visible_pos, it.bbox2d, strict=True
                        )
                    ),
                    notes=self._notes,
                )
                for it in self.surroundings.visible_from(viewpoint)
            )
        return seen

    def _picture(self, viewpoint: int, heading: float, elevation: float) -> Picture:
        graph, skybox = self._truth.graph, None
        if self._pictures is not None:
            folder = f"{fspath(self._pictures)}/{graph.scan_of(viewpoint)}/matterport_skybox_images"
            skybox = f"{folder}/{graph.viewpoint_ids[viewpoint]}_skybox_small.jpg"
        return Picture(skybox, graph.viewpoint_rotation[viewpoint], heading, elevation)


def _check_direction(action: Action, heading: float, elevation: float) -> None:
    try:
        is_direction = math.isfinite(heading) and abs(elevation) <= math.pi / 2
    except (TypeError, OverflowError):  # not a number, or too large for one of floating point
        is_direction = False
    if not is_direction:
        raise ActionError(f"{action!r} is not a direction; angles are radians")


def _check_box(action: Action, view: int, xywh: Sequence[float]) -> None:
    try:
        is_box = len(xywh) == 4 and all(map(math.isfinite, xywh)) and min(xywh[2:]) > 0
    except (TypeError, OverflowError):
        is_box = False
    if not is_box or view not in range(N_VIEWS):
        raise ActionError(
            f"{action!r} is not a box; expected left, top, width and height in one of 36 views"
        )


# What is asked in the episodes, and what is reachable and visible from viewpoints.


class Way(NamedTuple):
    """The way to a neighbour."""

    viewpoint: int
    heading: float
    """Radians, in [0, 2 pi)."""
    elevation: float
    """Radians."""
    distance: float
    """Metres."""
    view: int
    """The view of the 36 in which it appears nearest to the centre."""


class Surroundings:
    """The instructions, the neighbours of viewpoints, and the objects that are visible there."""

    def __init__(self, ground_truth: GroundTruth, boxes: str | PathLike[str] | None) -> None:
        self._episodes = ground_truth.episodes
        self._graph = ground_truth.graph
        self._solution = ground_truth.solution
        self._boxes = None if boxes is None else _read_boxes(boxes, self._graph)
        self._ways: dict[int, Sequence[Way]] = {}

    @cached_property
    def instructions(self) -> Sequence[str]:
        """The instruction of each episode."""
        return self._episodes.instructions

    @cached_property
    def languages(self) -> Sequence[str]:
        """The language of each instruction; empty in a task of one language."""
        return self._episodes.languages or [""] * len(self._episodes.instr_ids)

    @property
    def unscored_digest(self) -> str:
        """SHA-256 of what is shown of a bundle and missing in its fingerprint: no score needs it.

        These are instructions, languages, headings at the start, names of objects, and the
        directions of cameras.
        """
        texts = self.instructions, self.languages, self._categories
        digest = hashlib.sha256(json.dumps([list(each) for each in texts]).encode())
        digest.update(self._episodes.heading.tobytes())
        digest.update(self._graph.viewpoint_rotation.tobytes())
        return digest.hexdigest()

    @property
    def has_objects(self) -> bool:
        """Whether boxes or a solution say where objects are visible."""
        return self._boxes is not None or self._solution is not None

    def ways_from(self, viewpoint: int) -> Sequence[Way]:
        """Return the ways to all neighbours, in the order of the connectivity file."""
        ways = self._ways.get(viewpoint)
        if ways is None:
            ways = self._ways[viewpoint] = list(self._find_ways(viewpoint))
        return ways

    def _find_ways(self, here: int) -> Iterator[Way]:
        near, position = self._graph.neighbours(here), self._graph.viewpoint_position
        angles = [
            (math.atan2(x, y) % math.tau, math.atan2(z, math.hypot(x, y)))
            for x, y, z in (position[list(near)] - position[here]).tolist()
        ]
        views = snap(np.array(angles).reshape(-1, 2)).tolist()
        columns = zip(near.items(), angles, views, strict=True)
        for (viewpoint, distance), (heading, elevation), view in columns:
            yield Way(viewpoint, heading, elevation, distance, view)

    def visible_from(self, viewpoint: int) -> Sequence[MatterSim.Candidate]:
        """Return the objects that are visible from a viewpoint, by id."""
        if self._boxes is not None:
            graph = self._graph
            found = self._boxes.visible_from(
                graph.scan_of(viewpoint), graph.viewpoint_ids[viewpoint]
            )
        else:
            found = list(self._in_bundle(viewpoint))
        return [it._replace(name=category_text(it.name)) for it in found]

    def _in_bundle(self, viewpoint: int) -> Iterator[MatterSim.Candidate]:
        if self._solution is None:
            return
        boxes = self._solution.boxes
        for row, its in self._solution.visible_from(viewpoint):
            object_id = int(self._solution.candidate_object[row])
            name = self._categories[row]
            yield MatterSim.Candidate(
                object_id, name, boxes.view[its].tolist(), boxes.xywh[its].tolist()
            )

    @cached_property
    def _categories(self) -> Sequence[str]:
        return self._solution.candidate_categories if self._solution else ()


def _read_boxes(boxes: str | PathLike[str], graph: NavigationGraph) -> MatterSim.Objects:
    try:
        objects = MatterSim.Objects(fspath(boxes))
        viewpoints = enumerate(graph.viewpoint_ids)
        if any(objects.visible_from(graph.scan_of(row), name) for row, name in viewpoints):
            return objects
    except ValueError as error:
        raise ReverieEvalError(str(error).removeprefix("MatterSim: ")) from None
    raise ReverieEvalError(f"{fspath(boxes)}: no viewpoint of the split has an object in it")
