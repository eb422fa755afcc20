"""What an agent finds around it: neighbours, routes, objects, directions."""

import math
from collections.abc import Sequence

import numpy as np

from reverie_eval.ground_truth import GroundTruth


class Surroundings:
    """The navigation graphs and candidates of a split, viewpoint by viewpoint."""

    def __init__(self, ground_truth: GroundTruth) -> None:
        self._graph = ground_truth.graph
        self._answers = ground_truth.secret
        self._neighbours: dict[int, list[int]] = {}

    def neighbours(self, viewpoint: int) -> list[int]:
        """Return the viewpoints that an edge leads to, or the viewpoint itself if none does."""
        if viewpoint not in self._neighbours:
            scan = np.flatnonzero(
                self._graph.viewpoint_scan == self._graph.viewpoint_scan[viewpoint]
            )
            here = np.full_like(scan, viewpoint)
            found = scan[self._graph.has_edge(here, scan)].tolist()
            self._neighbours[viewpoint] = found or [viewpoint]
        return self._neighbours[viewpoint]

    def shortest_route(self, start: int, goal: int) -> list[int]:
        """Return the viewpoints of a shortest route, both ends included."""
        route = [start]
        while route[-1] != goal:
            choices = np.array(self.neighbours(route[-1]))
            here, there = np.full_like(choices, route[-1]), np.full_like(choices, goal)
            length = self._graph.distance_between(here, choices)
            length = length + self._graph.distance_between(choices, there)
            route.append(int(choices[np.argmin(length)]))
        return route

    def visible_objects(self, viewpoint: int) -> list[int]:
        """Return the ids of the objects that are visible from a viewpoint."""
        begin, end = np.searchsorted(self._answers.candidate_viewpoint, [viewpoint, viewpoint + 1])
        objects: list[int] = self._answers.candidate_object[begin:end].tolist()
        return objects

    def poses(self, viewpoints: Sequence[int]) -> list[list[str | float]]:
        """Return poses that look where the agent came to, the first one north and level."""
        poses: list[list[str | float]] = []
        previous = viewpoints[0]
        for viewpoint in viewpoints:
            position = self._graph.viewpoint_position
            x, y, z = (position[viewpoint] - position[previous]).tolist()
            heading, elevation = math.atan2(x, y) % math.tau, math.atan2(z, math.hypot(x, y))
            poses.append([self._graph.viewpoint_ids[viewpoint], heading, elevation])
            previous = viewpoint
        return poses
