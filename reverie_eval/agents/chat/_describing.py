"""What an agent observes, in words."""

import math
from collections.abc import Iterable, Sequence

from reverie_eval.geometry import FOCAL_LENGTH, N_HEADINGS, STEP, WIDTH
from reverie_eval.simulator import Candidate, Neighbour, Observation

AHEAD = 10
"""Degrees on each side that are straight ahead, or behind."""
STEEP = math.radians(15)
"""From here on, a way leads up or down stairs."""
N_PICTURES = 6
"""Level views, every second of the twelve; each is 75 degrees wide, so they overlap."""

_FIRST_LEVEL_VIEW = N_HEADINGS


class Explored:
    """The part of a building that was seen: places by numbers, in the order in which they came."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._ways: dict[int, list[int]] = {}
        self._objects: dict[int, str] = {}
        self._walked: list[int] = []

    def enter(self, seen: Observation) -> int:
        """Return the number of a place, and give its neighbours theirs."""
        here = self.number(seen.viewpoint_id)
        self._walked.append(here)
        self._ways[here] = [self.number(way.viewpoint_id) for way in seen.neighbours]
        return here

    def note_objects(self, candidates: Sequence[Candidate]) -> None:
        """Remember the names of what is visible from the last place."""
        names = sorted({each.name for each in candidates} - {""})
        self._objects[self._walked[-1]] = f"; visible: {', '.join(names)}" if names else ""

    def number(self, viewpoint_id: str) -> int:
        """Return the number of a place."""
        return self._numbers.setdefault(viewpoint_id, len(self._numbers) + 1)

    def is_visited(self, number: int) -> bool:
        """Whether the agent was at a place."""
        return number in self._ways

    def map(self, thought: str) -> str:
        """Return a description of all visited places, with what was thought last."""
        lines = [
            f"- place {number} leads to {_list(ways)}{self._objects.get(number, '')}"
            for number, ways in self._ways.items()
        ]
        unknown = sorted(set(self._numbers.values()) - self._ways.keys())
        ends = [
            f"Your way so far: {_list(self._walked)}",
            *[f"Not visited yet: {_list(unknown)}"] * bool(unknown),
            *[f"Your last thought: {thought}"] * bool(thought),
        ]
        return "\n".join(["Your map:", *lines, *ends])


def _list(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


def ways(
    seen: Observation,
    neighbours: Sequence[Neighbour],
    explored: Explored,
    pictures: Sequence[int],
) -> str:
    """Return a line for each neighbour that is left; with pictures, also in which it is."""
    lines = [_way(seen, each, explored, pictures) for each in neighbours]
    return "\n".join(lines) or "- nowhere any more"


def _way(seen: Observation, way: Neighbour, explored: Explored, pictures: Sequence[int]) -> str:
    number = explored.number(way.viewpoint_id)
    elevation = seen.elevation + way.relative_elevation
    parts = [
        f"- place {number}: {direction(way.relative_heading)}",
        f"{way.distance:.1f} m",
        *["upwards"] * (elevation > STEEP),
        *["downwards"] * (elevation < -STEEP),
        *["visited"] * explored.is_visited(number),
    ]
    if pictures:
        off = [abs(_heading_of(seen, view) - way.relative_heading) for view in pictures]
        nearest = min(range(len(pictures)), key=lambda row: min(off[row], math.tau - off[row]))
        parts.append(f"in picture {nearest + 1}")
    return ", ".join(parts)


def objects(seen: Observation) -> str:
    """Return a line for each visible object, from left to right."""
    lines = [
        f"- object {number}: {name or 'unnamed'}, {direction(heading)}"
        for heading, number, name in sorted(
            (_heading_of_object(seen, each), each.object_id, each.name) for each in seen.candidates
        )
    ]
    return "\n".join(["Visible from here:", *lines]) if lines else "No object is visible from here."


def pictures_around(seen: Observation) -> Sequence[int]:
    """Return the views to show, clockwise from the one that is nearest to straight ahead."""
    first = round(seen.heading / STEP)
    step = N_HEADINGS // N_PICTURES
    return [_FIRST_LEVEL_VIEW + (first + step * row) % N_HEADINGS for row in range(N_PICTURES)]


def captions(seen: Observation, views: Sequence[int]) -> str:
    """Return a line for each picture."""
    lines = [
        f"- picture {row}: {direction(_heading_of(seen, view))}"
        for row, view in enumerate(views, 1)
    ]
    return "\n".join(["The pictures show:", *lines])


def direction(heading: float) -> str:
    """Return a relative heading in words.

    >>> [direction(math.radians(each)) for each in (0, 45, -90, 175)]
    ['straight ahead', '45° right', '90° left', 'behind you']
    """
    degrees = round(math.degrees(heading))
    if abs(degrees) <= AHEAD:
        return "straight ahead"
    if abs(degrees) >= 180 - AHEAD:
        return "behind you"
    return f"{abs(degrees)}° {'right' if degrees > 0 else 'left'}"


def _heading_of(seen: Observation, view: int) -> float:
    """Return the heading of a view, relative to where the agent looks, in [-pi, pi]."""
    return math.remainder(view % N_HEADINGS * STEP - seen.heading, math.tau)


def _heading_of_object(seen: Observation, candidate: Candidate) -> float:
    """Return the relative heading of an object's largest box."""
    view, (left, _, width, _) = max(candidate.boxes, key=lambda box: box.xywh[2] * box.xywh[3])
    off = math.atan2(left + width / 2 - WIDTH / 2, FOCAL_LENGTH)
    return math.remainder(_heading_of(seen, view) + off, math.tau)
