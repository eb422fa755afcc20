"""A walk, step by step: what the line on a map says, in words and numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reverie_eval.analysis import Episode
from reverie_eval.reporting._maps import EpisodeMap, Route


@dataclass(frozen=True, slots=True)
class Step:
    """A viewpoint of a walk; turns on the spot are none."""

    number: int
    """0 is the start."""
    viewpoint_id: str
    level: int
    """From 1, the lowest storey."""
    walked: float
    """Metres since the start."""
    to_the_goal: float
    """Metres along the graph to the end of the annotated path."""
    is_success: bool
    """Whether a stop here is a success."""
    is_jump: bool
    """Whether no edge leads here from the step before."""


def steps_of(episode: Episode, episode_map: EpisodeMap, route: Route) -> Sequence[Step]:
    """Tell a walk of an episode step by step."""
    graph = episode.graph
    rows = np.array([route.viewpoint[0], *route.legs[:, 1]])
    numbers = np.array([graph.index[episode_map.viewpoint_ids[row]] for row in rows])
    leg = graph.distance_between(numbers[:-1], numbers[1:])
    walked = np.concatenate([[0.0], np.cumsum(leg)])
    goal = np.full(len(numbers), graph.index[episode.goal])
    left = graph.distance_between(numbers, goal)
    is_jump = np.concatenate([[False], episode_map.is_jump(route)])
    success = set(episode_map.success.tolist())
    return [
        Step(
            number=number,
            viewpoint_id=episode_map.viewpoint_ids[row],
            level=int(episode_map.storey[row]) + 1,
            walked=float(walked[number]),
            to_the_goal=float(left[number]),
            is_success=row in success,
            is_jump=bool(is_jump[number]),
        )
        for number, row in enumerate(rows.tolist())
    ]


def remark_on(step: Step, last: int) -> str:
    """Say what a step is, beyond a place; empty for most.

    Parameters
    ----------
    last : int
        The number of the walk's last step.
    """
    said = [
        "start" if step.number == 0 else "",
        "a jump where no edge is" if step.is_jump else "",
        "stop" if step.number == last else "",
        "a stop here is a success" if step.is_success else "",
    ]
    return ", ".join(filter(None, said))
