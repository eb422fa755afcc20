"""An episode from above, as data: what a map of it shows, whoever draws it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, Self

import numpy as np

from reverie_eval.analysis import Episode
from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray
from reverie_eval.text import count_text

STOREY_HEIGHT = 2.0
"""Metres that storeys are apart at least."""
LEVEL_HEIGHT = 0.5
"""Metres that viewpoints of one floor differ in height at most, most of them."""
LEAST_VIEWPOINTS = 3
"""Of one height make a storey; fewer are a landing."""


SignKind = Literal["stop", "start", "jump", "annotated", "goal", "success", "elsewhere"]


class Sign(NamedTuple):
    """What is drawn on a map, and what it means."""

    kind: SignKind
    meaning: str
    route: int = 0
    """Of a stop, the number of the submission, from 1."""


@dataclass(frozen=True, eq=False)
class Route:
    """Where one submission's agent went."""

    name: str
    """Of the submission."""
    viewpoint: IntArray
    """Shape (n_poses,): rows of the map's viewpoints."""
    outcome: str

    @property
    def legs(self) -> IntArray:
        """Shape (n_legs, 2): the moves to another viewpoint, in their order."""
        is_move = np.diff(self.viewpoint) != 0
        legs: IntArray = np.column_stack([self.viewpoint[:-1], self.viewpoint[1:]])[is_move]
        return legs

    @property
    def stop(self) -> int:
        """Where the agent stopped."""
        return int(self.viewpoint[-1])


@dataclass(frozen=True, eq=False)
class EpisodeMap:
    """A scan's navigation graph from above, and what happened on it in one episode.

    Everything that is a place is given as a row of ``position``.
    """

    instr_id: str
    scan: str
    instruction: str
    viewpoint_ids: Sequence[str]
    position: FloatArray
    """Shape (n_viewpoints, 3): metres, z up."""
    storey: IntArray
    """Shape (n_viewpoints,): from 0, the lowest."""
    edges: IntArray
    """Shape (n_edges, 2): pairs that an agent can walk between, each once."""
    routes: Sequence[Route]
    """One for each submission that is shown."""
    annotated_path: IntArray
    """Shape (n_nodes,)."""
    success: IntArray
    """Shape (n_success,): where a stop counts as success under the protocol."""
    start: int

    @classmethod
    def of(cls, episodes: Mapping[str, Episode]) -> Self:
        """Lay out one episode, as one or several submissions went through it.

        Parameters
        ----------
        episodes : mapping of Episode
            The same episode, by the names of the submissions.
        """
        first, *_ = episodes.values()
        graph = first.graph
        number = graph.scan_ids.index(first.scan)
        rows = np.flatnonzero(graph.viewpoint_scan == number)
        ids = [graph.viewpoint_ids[row] for row in rows]
        place = {viewpoint_id: row for row, viewpoint_id in enumerate(ids)}

        def places(viewpoint_ids: Sequence[str]) -> IntArray:
            return np.array([place[each] for each in viewpoint_ids], dtype=np.int64)

        position = graph.viewpoint_position[rows]
        start, end = np.triu_indices(len(rows), k=1)
        joined = graph.has_edge(rows[start], rows[end])
        return cls(
            instr_id=first.instr_id,
            scan=first.scan,
            instruction=first.instruction,
            viewpoint_ids=ids,
            position=position,
            storey=storeys_of(position[:, 2]),
            edges=np.column_stack([start, end])[joined],
            routes=[
                Route(name, places(episode.trajectory), episode.outcome)
                for name, episode in episodes.items()
            ],
            annotated_path=places(first.annotated_path),
            success=places(first.goal_viewpoints),
            start=place[first.start],
        )

    def without_routes(self) -> Self:
        """Return the same with what was annotated alone."""
        return replace(self, routes=())

    @property
    def goal(self) -> int:
        """Where the annotated path ends."""
        return int(self.annotated_path[-1])

    @property
    def concerned(self) -> IntArray:
        """The viewpoints that the episode is about: walked, annotated, or a success."""
        walked: Sequence[Array] = [route.viewpoint for route in self.routes]
        return np.unique(np.concatenate([[self.start], *walked, self.annotated_path, self.success]))

    @property
    def is_elsewhere(self) -> BoolArray:
        """Shape (n_viewpoints,): whether it is on a storey that the episode has no part in."""
        return ~np.isin(self.storey, self.storey[self.concerned])

    def is_jump(self, route: Route) -> BoolArray:
        """Tell which legs of a route no edge joins: shape (n_legs,)."""
        size = len(self.viewpoint_ids)
        edge, leg = (
            pairs.min(axis=1) * size + pairs.max(axis=1) for pairs in (self.edges, route.legs)
        )
        return ~np.isin(leg, edge)

    @property
    def storeys(self) -> str:
        """Which storeys the episode is on, counted from the lowest: ``level 1 of 2``."""
        count = int(self.storey.max()) + 1
        levels = sorted({int(storey) + 1 for storey in self.storey[self.concerned]})
        if count == 1:
            return "one level"
        named = " and ".join(", ".join(map(str, levels)).rsplit(", ", 1))
        return f"level{'s' if len(levels) > 1 else ''} {named} of {count}"

    @property
    def description(self) -> str:
        """What the map shows, for whoever cannot see it."""
        steps = count_text(len(self.annotated_path) - 1, "step")
        places = count_text(len(self.success), "viewpoint")
        return " ".join(
            [
                f"Scan {self.scan}, {self.storeys}, seen from above.",
                f"The annotated path has {steps}; a stop counts as success at {places}.",
                *(_sentence(route, int(self.is_jump(route).sum())) for route in self.routes),
            ]
        )


def key_of(names: Sequence[str]) -> Sequence[Sign]:
    """List the signs of a map, whoever explains them.

    Parameters
    ----------
    names : sequence of str
        Of the submissions whose routes are shown, if any are; for one, an empty name will do.
    """
    return [
        *(
            Sign("stop", f"{name or 'the agent'}, stop", number)
            for number, name in enumerate(names, 1)
        ),
        Sign("start", "start"),
        *([Sign("jump", "a jump where no edge is")] if names else []),
        Sign("annotated", "annotated path"),
        Sign("goal", "end of the annotated path"),
        Sign("success", "a stop here is a success"),
        Sign("elsewhere", "on another level"),
    ]


def storeys_of(height: FloatArray) -> IntArray:
    """Give the storeys of a scan numbers by the heights of its viewpoints.

    The dataset names no storeys. A height at which many viewpoints are is one; what lies between
    two, on stairs, belongs to the nearer.

    Parameters
    ----------
    height : array, shape (n_viewpoints,)
        Metres.

    Returns
    -------
    array of int, shape (n_viewpoints,)
        0 is the lowest.

    Examples
    --------
    >>> storeys_of(np.array([1.5, 1.5, 1.6, 2.9, 4.3, 4.3, 4.4]))
    array([0, 0, 0, 0, 1, 1, 1])
    """
    alike = (np.abs(height[:, None] - height) <= LEVEL_HEIGHT).sum(axis=1)
    floors: list[float] = []
    for row in np.argsort(-alike, kind="stable").tolist():
        is_apart = all(abs(height[row] - floor) >= STOREY_HEIGHT for floor in floors)
        if is_apart and (alike[row] >= LEAST_VIEWPOINTS or not floors):
            floors.append(float(height[row]))
    storey: IntArray = np.abs(height[:, None] - np.sort(floors)).argmin(axis=1)
    return storey


def _sentence(route: Route, jumps: int) -> str:
    whose = f"The agent of {route.name}" if route.name else "The agent"
    outcome = f"; {route.outcome}" if route.outcome else ""
    jumped = f", {jumps} of them where no edge is" if jumps else ""
    return f"{whose} makes {count_text(len(route.legs), 'move')}{jumped}{outcome}."
