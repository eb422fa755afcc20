"""What `official-v1` means, written once more: slowly, literally, and without the package.

Every function is a sentence of DESIGN, section 3, in dictionaries and loops. Tests hold the
package against it on random worlds; it shares no line of code with what it judges.
"""

import heapq
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

Position = tuple[float, float, float]


@dataclass(frozen=True)
class Viewpoint:
    """A place to stand: where it is, in metres, and what is listed there."""

    position: Position
    included: bool = True
    """Whether it is a node of the navigation graph."""
    views: Mapping[int, Sequence[int]] = field(default_factory=dict)
    """The views that show each listed object; none for one that is listed but not visible."""


@dataclass(frozen=True)
class Scan:
    """One building: its viewpoints, and which pairs of them are unobstructed."""

    viewpoints: Mapping[str, Viewpoint]
    unobstructed: frozenset[tuple[str, str]]
    """Each pair once, in either order."""

    def has_edge(self, a: str, b: str) -> bool:
        """Whether the pair is unobstructed and both viewpoints are included."""
        included = self.viewpoints[a].included and self.viewpoints[b].included
        return included and ((a, b) in self.unobstructed or (b, a) in self.unobstructed)

    def sees(self, viewpoint_id: str, object_id: int) -> bool:
        """Whether some view of the viewpoint shows the object."""
        return bool(self.viewpoints[viewpoint_id].views.get(object_id))


@dataclass(frozen=True)
class Task:
    """An annotated path to a target object, with one or more instructions."""

    task_id: str
    scan_id: str
    path: Sequence[str]
    target: int
    instructions: int = 1

    @property
    def instr_ids(self) -> Sequence[str]:
        """One episode per instruction."""
        return [f"{self.task_id}_{number}" for number in range(self.instructions)]


@dataclass(frozen=True)
class World:
    """A whole benchmark."""

    scans: Mapping[str, Scan]
    tasks: Sequence[Task]


@dataclass(frozen=True)
class Prediction:
    """What an agent did in an episode: the viewpoints it took, and the object it named or -1."""

    trajectory: Sequence[str]
    object_id: int


Predictions = Mapping[str, Prediction]
"""By instr_id."""
Values = Mapping[str, float]
"""By metric key."""


def score(world: World, predictions: Predictions) -> Mapping[str, Values]:
    """Give every episode, in the order of the tasks, its value of every metric."""
    return {
        instr_id: score_episode(world.scans[task.scan_id], task, predictions[instr_id])
        for task in world.tasks
        for instr_id in task.instr_ids
    }


def score_episode(scan: Scan, task: Task, prediction: Prediction) -> Values:
    """Give one episode its values, in the order in which DESIGN lists them."""
    trajectory, goal = prediction.trajectory, task.path[-1]
    walked = trajectory_length(scan, trajectory)
    shortest = distance(scan, task.path[0], goal)
    errors = [distance(scan, viewpoint_id, goal) for viewpoint_id in trajectory]
    sightings = [scan.sees(viewpoint_id, task.target) for viewpoint_id in trajectory]
    right = prediction.object_id == task.target
    return {
        "path_length": walked,
        "success": float(sightings[-1]),
        "oracle_success": float(any(sightings)),
        "spl": weighted(walked, shortest, achieved=sightings[-1]),
        "rgs": float(right),
        "rgspl": weighted(walked, shortest, achieved=right),
        "navigation_error": errors[-1],
        "oracle_error": min(errors),
        "shortest_length": shortest,
        "steps": len(trajectory) - 1,
        "jumps": count_jumps(scan, trajectory),
    }


def weighted(walked: float, shortest: float, *, achieved: bool) -> float:
    """Success x S / max(TL, S); an agent that is there already and stays scores 1."""
    if not achieved:
        return 0.0
    if walked == shortest == 0:
        return 1.0
    return shortest / max(walked, shortest)


def trajectory_length(scan: Scan, trajectory: Sequence[str]) -> float:
    """Add up the legs, first to last; `sum` would compensate from Python 3.12 on."""
    total = 0.0
    for a, b in legs(trajectory):
        total += distance(scan, a, b)
    return total


def count_jumps(scan: Scan, trajectory: Sequence[str]) -> int:
    """Count the legs that lead to another viewpoint without an edge."""
    jumps = 0
    for a, b in legs(trajectory):
        if a != b and not scan.has_edge(a, b):
            jumps += 1
    return jumps


def legs(trajectory: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Pair every pose with the next."""
    for number in range(len(trajectory) - 1):
        yield trajectory[number], trajectory[number + 1]


def distance(scan: Scan, a: str, b: str) -> float:
    """Metres of the shortest route from one viewpoint to another that it leads to."""
    return distances_from(scan, a)[b]


def distances_from(scan: Scan, start: str) -> Mapping[str, float]:
    """Dijkstra's algorithm: the distance of every viewpoint that can be reached."""
    reached: dict[str, float] = {}
    queue = [(0.0, start)]
    while queue:
        walked, here = heapq.heappop(queue)
        if here in reached:
            continue
        reached[here] = walked
        for there in scan.viewpoints:
            if scan.has_edge(here, there):
                heapq.heappush(queue, (walked + straight(scan, here, there), there))
    return reached


def straight(scan: Scan, a: str, b: str) -> float:
    """Metres as the crow flies, in the powers that published evaluators use."""
    ax, ay, az = scan.viewpoints[a].position
    bx, by, bz = scan.viewpoints[b].position
    return float(((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2) ** 0.5)
