"""An episode from above, as the data of its map: viewpoints, storeys, routes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.analysis import Episode
from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray
from reverie_eval.geometry import Building
from reverie_eval.ground_truth import NavigationGraph
from reverie_eval.reporting.answers import AnswerView
from reverie_eval.reporting.buildings import building_of
from reverie_eval.text import count_text

_JUMP, _GOAL_VIEWPOINT = "jump between unconnected viewpoints", "goal viewpoint"
_CLIMB = "to another level"
_ELSEWHERE = "on a level that the episode does not reach"
_PLAN = "walls and doors, inferred from where objects are"

AROUND = 4.0
"""Metres around an episode's viewpoints that stacked floors show, rooms as a whole."""

SignKind = Literal[
    "stop",
    "sight",
    "start",
    "jump",
    "annotated",
    "end",
    "goal",
    "climb",
    "elsewhere",
    "plan",
]


class Sign(NamedTuple):
    """A sign on a map, and its meaning."""

    kind: SignKind
    meaning: str
    route: int = 0
    """The number of the submission whose stop this is, from 1; 0 for other marks."""


@dataclass(frozen=True, eq=False)
class Route:
    """The route of one submission's agent."""

    number: int
    """Number of the submission, from 1."""
    name: str
    """Name of the submission; may be empty if there is only one."""
    outcome: str
    viewpoint: IntArray
    """Shape (n_poses,): rows of the map's viewpoints."""
    sight: float | None = None
    """Heading of the view of the answer, radians; None if no view shows it."""
    steps: Mapping[int, Sequence[int]] = field(default_factory=dict)
    """The numbers of the logged steps at a viewpoint, by its row."""

    @property
    def legs(self) -> IntArray:
        """Shape (n_legs, 2): the moves to another viewpoint; turns on the spot are left out."""
        return _legs(self.viewpoint)

    @property
    def meaning(self) -> str:
        """What the line and its end mean, for a key."""
        return f"{self.name}: route and stop" if self.name else "route and stop"

    @property
    def stop(self) -> int:
        """The viewpoint where the agent stopped."""
        return int(self.viewpoint[-1])


@dataclass(frozen=True, slots=True)
class Step:
    """A viewpoint on a route; turns on the spot are not steps."""

    number: int
    """0 is the start."""
    viewpoint_id: str
    level: int
    """The storey, from 1 for the lowest."""
    walked: float
    """Metres since the start."""
    to_goal: float
    """Metres along the graph to the nearest goal viewpoint; inf without a goal."""
    to_path_end: float
    """Metres along the graph to the end of the annotated path."""
    is_goal: bool
    """Whether the step ends at a goal viewpoint."""
    is_jump: bool
    """Whether no edge leads here from the previous step."""
    is_stop: bool
    facing: int | None
    """The heading of the agent, degrees in [0, 360); None if nothing tells."""

    @property
    def note(self) -> str:
        """What is notable about the step; empty for most."""
        notes = {
            "start": self.number == 0,
            _JUMP: self.is_jump,
            "stop": self.is_stop,
            _GOAL_VIEWPOINT: self.is_goal,
        }
        return ", ".join(note for note, applies in notes.items() if applies)


@dataclass(frozen=True, eq=False)
class EpisodeMap:
    """A scan's navigation graph from above, and one episode on it.

    Viewpoints are given by their rows in ``position``.
    """

    instr_id: str
    scan: str
    instruction: str
    graph: NavigationGraph
    """The graph of all scans of the split."""
    graph_row: IntArray
    """Shape (n_viewpoints,): the scan's viewpoints in ``graph``."""
    viewpoint_ids: Sequence[str]
    position: FloatArray
    """Shape (n_viewpoints, 3): metres, z up."""
    building: Building
    edges: IntArray
    """Shape (n_edges, 2): connected pairs of viewpoints, each once."""
    routes: Sequence[Route]
    """One for each submission that is shown."""
    annotated_path: IntArray
    """Shape (n_path,)."""
    goal_viewpoints: IntArray
    """Shape (n_goals,): where a stop counts as success under the protocol."""
    start: int

    @classmethod
    def of(cls, episodes: Mapping[str, Episode]) -> Self:
        """Lay out the same episode of one or several submissions, by their names."""
        first, *_ = episodes.values()
        graph = first.graph
        rows = graph.viewpoints_of(first.scan)
        ids = [graph.viewpoint_ids[row] for row in rows]
        index = {viewpoint_id: row for row, viewpoint_id in enumerate(ids)}

        def rows_of(viewpoint_ids: Sequence[str]) -> IntArray:
            return np.array([index[each] for each in viewpoint_ids], dtype=np.int64)

        return cls(
            instr_id=first.instr_id,
            scan=first.scan,
            instruction=first.instruction,
            graph=graph,
            graph_row=rows,
            viewpoint_ids=ids,
            position=graph.viewpoint_position[rows],
            building=building_of(graph, first.solution, first.scan),
            edges=graph.edges_of(first.scan),
            routes=[
                Route(
                    number,
                    name,
                    episode.outcome,
                    rows_of(episode.trajectory),
                    AnswerView.at_stop(episode).heading,
                    _steps_at(episode, index),
                )
                for number, (name, episode) in enumerate(episodes.items(), 1)
            ],
            annotated_path=rows_of(first.annotated_path),
            goal_viewpoints=rows_of(first.goal_viewpoints),
            start=index[first.start],
        )

    def without_routes(self) -> Self:
        """Return the map with the annotations only."""
        return replace(self, routes=())

    def along_path(self) -> Self:
        """Return the map with a single route, along the annotated path."""
        return replace(self, routes=[Route(1, "", "", self.annotated_path)])

    @property
    def storey(self) -> IntArray:
        """Shape (n_viewpoints,): from 0 for the lowest."""
        return self.building.storey

    @property
    def start_storey(self) -> int:
        """The storey of the start, whose plan is on the map."""
        return int(self.storey[self.start])

    @property
    def path_end(self) -> int:
        """The viewpoint where the annotated path ends."""
        return int(self.annotated_path[-1])

    @property
    def visited(self) -> IntArray:
        """The viewpoints of the episode: on a route, on the annotated path, or goals."""
        routes: Sequence[Array] = [route.viewpoint for route in self.routes]
        rows = np.concatenate([[self.start], *routes, self.annotated_path, self.goal_viewpoints])
        return np.unique(rows)

    @property
    def is_near(self) -> BoolArray:
        """Shape (n_viewpoints,): whether it is near one of the episode, on its storey."""
        here, there = self.position[:, None, :2], self.position[self.visited, :2]
        is_near = np.hypot(*np.moveaxis(there - here, -1, 0)) <= AROUND
        return np.asarray(
            (is_near & (self.storey[:, None] == self.storey[self.visited])).any(axis=1)
        )

    def cropped(self) -> Self:
        """Return the map with the building as far as it is near the episode."""
        near, storey = self.position[self.visited, :2], self.storey[self.visited]
        return replace(self, building=self.building.around(near, storey, AROUND))

    @property
    def is_elsewhere(self) -> BoolArray:
        """Shape (n_viewpoints,): whether it is on a storey where the episode has no viewpoint."""
        return ~np.isin(self.storey, self.storey[self.visited])

    @property
    def signs(self) -> Sequence[Sign]:
        """The signs that are on the map, for its key."""
        legs = [self.annotated_legs, *(route.legs for route in self.routes)]
        is_shown = {
            Sign("sight", "direction of the view of the answer"): any(
                route.sight is not None for route in self.routes
            ),
            Sign("start", "start"): True,
            Sign("jump", _JUMP): any(self.is_jump(route).any() for route in self.routes),
            Sign("annotated", "annotated path"): len(self.annotated_legs) > 0,
            Sign("end", "end of the annotated path"): True,
            Sign("goal", f"{_GOAL_VIEWPOINT} (success)"): len(self.goal_viewpoints) > 0,
            Sign("climb", _CLIMB): any(self.is_climb(each).any() for each in legs),
            Sign("elsewhere", _ELSEWHERE): not self.leaves_level and bool(self.is_elsewhere.any()),
            Sign("plan", _PLAN): len(self.building.rooms_on(self.start_storey)) > 0,
        }
        return [
            *(Sign("stop", route.meaning, route.number) for route in self.routes),
            *(sign for sign, is_on in is_shown.items() if is_on),
        ]

    @property
    def annotated_legs(self) -> IntArray:
        """Shape (n_legs, 2): the moves of the annotated path."""
        return _legs(self.annotated_path)

    @property
    def leaves_level(self) -> bool:
        """Whether the episode has viewpoints on several storeys."""
        return len(self.levels(self.visited)) > 1

    def is_climb(self, legs: IntArray) -> BoolArray:
        """Shape (n_legs,): whether the ends of a leg are on two storeys."""
        return np.asarray(np.diff(self.storey[legs], axis=1)[:, 0] != 0)

    def level_note(self, route: Route) -> str:
        """Say on which storeys the agent stops and the path ends; empty if it is the same."""
        stop, end = (self.storey[[route.stop, self.path_end]] + 1).tolist()
        return "" if stop == end else f"stopped on level {stop}, the path ends on level {end}"

    @property
    def level_notes(self) -> Sequence[str]:
        """The notes of :meth:`level_note` about all routes."""
        return list(map(self.level_note, self.routes))

    def is_jump(self, route: Route) -> BoolArray:
        """Shape (n_legs,): whether the ends of a route's leg are unconnected."""
        start, end = self.graph_row[route.legs].T
        return ~self.graph.has_edge(start, end)

    def to_goal(self, viewpoints: IntArray) -> FloatArray:
        """Return the metres along the graph from viewpoints to the nearest goal viewpoint."""
        start, end = np.meshgrid(viewpoints, self.goal_viewpoints, indexing="ij")
        distance = self.graph.distance_between(self.graph_row[start], self.graph_row[end])
        return np.asarray(distance.min(axis=1, initial=np.inf))

    def to_path_end(self, viewpoints: IntArray) -> FloatArray:
        """Return the metres along the graph from viewpoints to the end of the annotated path."""
        end = np.full(len(viewpoints), self.graph_row[self.path_end])
        return self.graph.distance_between(self.graph_row[viewpoints], end)

    def steps(self, route: Route, headings: Sequence[float | None] = ()) -> Sequence[Step]:
        """Return a route step by step.

        ``headings`` are those of its poses, radians, as far as the file has them. Without one, an
        agent looks where it goes next and, at its stop, where it came.
        """
        legs = route.legs
        viewpoints = np.array([route.viewpoint[0], *legs[:, 1]])
        # A jump counts at the length of the shortest path, as in the scores.
        lengths = self.graph.distance_between(*self.graph_row[legs].T)
        is_goal = np.isin(viewpoints, self.goal_viewpoints)
        columns = zip(
            viewpoints.tolist(),
            np.concatenate([[0.0], np.cumsum(lengths)]).tolist(),
            self.to_goal(viewpoints).tolist(),
            self.to_path_end(viewpoints).tolist(),
            is_goal.tolist(),
            [False, *self.is_jump(route).tolist()],
            self._headings(route, headings),
            strict=True,
        )
        return [
            Step(
                number=number,
                viewpoint_id=self.viewpoint_ids[viewpoint],
                level=int(self.storey[viewpoint]) + 1,
                walked=walked,
                to_goal=to_goal,
                to_path_end=to_path_end,
                is_goal=is_goal,
                is_jump=is_jump,
                is_stop=number == len(legs),
                facing=None if heading is None else round(np.rad2deg(heading)) % 360,
            )
            for number, (
                viewpoint,
                walked,
                to_goal,
                to_path_end,
                is_goal,
                is_jump,
                heading,
            ) in enumerate(columns)
        ]

    def _headings(self, route: Route, given: Sequence[float | None]) -> Sequence[float | None]:
        """Return where an agent looks as it leaves each viewpoint of its route, and at its stop."""
        x, y, _ = np.diff(self.position[route.legs], axis=1)[:, 0].T
        onward: list[float | None] = np.arctan2(x, y).tolist()
        onward = [*onward, onward[-1] if onward else None]
        if len(given) != len(route.viewpoint):
            return onward
        is_last = np.append(np.diff(route.viewpoint) != 0, True)
        last = np.flatnonzero(is_last).tolist()
        return [
            way if (found := given[pose]) is None else found
            for pose, way in zip(last, onward, strict=True)
        ]

    def levels(self, viewpoints: IntArray | Sequence[int]) -> Sequence[int]:
        """Return the storeys of viewpoints, counted from 1."""
        return sorted({int(storey) + 1 for storey in self.storey[viewpoints]})

    @property
    def storeys(self) -> str:
        """The storeys of the episode, counted from the lowest: ``level 1 of 2``."""
        count = int(self.storey.max()) + 1
        levels = self.levels(self.visited)
        if count == 1:
            return "one level"
        numbers = " and ".join(", ".join(map(str, levels)).rsplit(", ", 1))
        return f"level{'s' if len(levels) > 1 else ''} {numbers} of {count}"

    @property
    def description(self) -> str:
        """What the map shows, for readers who cannot see it."""
        steps = count_text(len(self.annotated_path) - 1, "step")
        goals = count_text(len(self.goal_viewpoints), "goal viewpoint")
        seen = "on stacked floors" if self.leaves_level else "seen from above"
        sentences = [
            f"Scan {self.scan}, {self.storeys}, {seen}.",
            f"The annotated path has {steps}, the episode {goals}.",
        ]
        for route in self.routes:
            agent = f"The agent of {route.name}" if route.name else "The agent"
            moves, jumps = count_text(len(route.legs), "move"), int(self.is_jump(route).sum())
            among = f", {jumps} of them between unconnected viewpoints" if jumps else ""
            said = [f"{agent} makes {moves}{among}", route.outcome, self.level_note(route)]
            sentences.append(f"{'; '.join(filter(None, said))}.")
        return " ".join(sentences)


def _steps_at(episode: Episode, index: Mapping[str, int]) -> Mapping[int, Sequence[int]]:
    """Return the numbers of the steps at each viewpoint, by its row."""
    found: dict[int, list[int]] = {}
    for step in episode.steps:
        if step.viewpoint_id in index:  # a log may be of other buildings
            found.setdefault(index[step.viewpoint_id], []).append(step.step)
    return found


def _legs(viewpoint: IntArray) -> IntArray:
    """Return the pairs of viewpoints, shape (n_legs, 2), that follow each other and differ."""
    legs = np.column_stack([viewpoint[:-1], viewpoint[1:]])
    return np.asarray(legs[legs[:, 0] != legs[:, 1]])
