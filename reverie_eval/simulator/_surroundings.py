"""What is asked in the episodes of a split, and what is reachable and visible from viewpoints."""

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from os import PathLike, fspath
from typing import NamedTuple

import numpy as np

from reverie_eval.errors import GroundTruthError, ReverieEvalError
from reverie_eval.geometry import snap
from reverie_eval.ground_truth import GroundTruth, NavigationGraph
from reverie_eval.simulator.on_path import MatterSim
from reverie_eval.text import category_text


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
        """The instruction of each episode; empty if the bundle was compiled without them."""
        try:
            return self._episodes.instructions
        except GroundTruthError:
            return [""] * len(self._episodes.instr_ids)

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
        if self._graph.viewpoint_rotation is not None:
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
            name = self._categories[row] if self._categories else ""
            yield MatterSim.Candidate(
                object_id, name, boxes.view[its].tolist(), boxes.xywh[its].tolist()
            )

    @cached_property
    def _categories(self) -> Sequence[str]:
        try:
            return self._solution.candidate_categories if self._solution else ()
        except GroundTruthError:  # compiled without them
            return ()


def _read_boxes(boxes: str | PathLike[str], graph: NavigationGraph) -> MatterSim.Objects:
    try:
        objects = MatterSim.Objects(fspath(boxes))
        viewpoints = enumerate(graph.viewpoint_ids)
        if any(objects.visible_from(graph.scan_of(row), name) for row, name in viewpoints):
            return objects
    except ValueError as error:
        raise ReverieEvalError(str(error).removeprefix("MatterSim: ")) from None
    raise ReverieEvalError(f"{fspath(boxes)}: no viewpoint of the split has an object in it")
