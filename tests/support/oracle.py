"""What every protocol means, written once more: slowly, literally, and without the package.

Every function is a sentence of ``metrics.md`` or ``protocols.md`` in ``docs/reference``, in
dictionaries and loops.
Tests hold the package against it on random worlds; it shares no line of code with what it judges.
"""

import heapq
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property

from tests.support.panorama import (
    PICTURE,
    Box,
    Camera,
    Number,
    area,
    camera_of,
    common,
    is_a_view,
    overlap_over_union,
    overlap_over_union_from,
    view_of,
)

Position = tuple[float, float, float]

SPL_BY_ANNOTATED_LENGTH = ("duet", "scalevln", "navrag")
SPL_WITH_FLOOR = ("challenge-2022", "airbert", "duet", "scalevln", "navrag")
RGSPL_WITH_FLOOR = ("duet", "scalevln")
GROUNDING_NEEDS_SUCCESS = ("paper", "paper-3m", "scalevln")
TEXT_IS_NEVER_RIGHT = ("challenge-2022",)
WITHOUT_GROUNDING = ("r2r-style", "navrag")
BY_THE_PATHS_END = ("r2r-style", "navrag")

USUAL_BOX = (1, 2, 30, 40)


@dataclass(frozen=True)
class Viewpoint:
    """A place to stand: where it is, in metres, and what is listed there."""

    position: Position
    included: bool = True
    """Whether it is a node of the navigation graph."""
    views: Mapping[int, Sequence[int]] = field(default_factory=dict)
    """The views that show each listed object; none for one that is listed but not visible."""
    boxes: Mapping[tuple[int, int], Box] = field(default_factory=dict)
    """Where an object is in a view, by both; at the usual place if it is not said."""

    def box(self, object_id: int, view: int) -> Box:
        """Return where an object is in a view that shows it."""
        return self.boxes.get((object_id, view), USUAL_BOX)


@dataclass(frozen=True)
class Scan:
    """One building: its viewpoints, and which pairs of them are unobstructed."""

    viewpoints: Mapping[str, Viewpoint]
    unobstructed: frozenset[tuple[str, str]]
    """Each pair once, in either order."""
    centres: Mapping[int, Position] = field(default_factory=dict)
    """Where the objects are, in metres, as far as that is known."""

    @cached_property
    def routes(self) -> Mapping[str, Mapping[str, float]]:
        """From every viewpoint the distance of every viewpoint that can be reached."""
        return {
            viewpoint_id: distances_from(self, viewpoint_id) for viewpoint_id in self.viewpoints
        }

    @cached_property
    def edges(self) -> Mapping[str, Mapping[str, float]]:
        """From every viewpoint the metres to each that it has an edge to."""
        return {
            here: {
                there: straight(self, here, there)
                for there in self.viewpoints
                if self.has_edge(here, there)
            }
            for here in self.viewpoints
        }

    def has_edge(self, a: str, b: str) -> bool:
        """Whether the pair is unobstructed and both viewpoints are included."""
        included = self.viewpoints[a].included and self.viewpoints[b].included
        return included and ((a, b) in self.unobstructed or (b, a) in self.unobstructed)

    def sees(self, viewpoint_id: str, object_id: int) -> bool:
        """Whether some view of the viewpoint shows the object."""
        return bool(self.viewpoints[viewpoint_id].views.get(object_id))


@dataclass(frozen=True)
class Item:
    """An annotated path to a target object, with one or more instructions."""

    item_id: str
    scan_id: str
    path: Sequence[str]
    target: int
    instructions: int = 1

    @property
    def instr_ids(self) -> Sequence[str]:
        """One episode per instruction."""
        return [f"{self.item_id}_{number}" for number in range(self.instructions)]


@dataclass(frozen=True)
class World:
    """A whole benchmark."""

    scans: Mapping[str, Scan]
    items: Sequence[Item]


@dataclass(frozen=True)
class Drawing:
    """A box that an agent drew, in which picture, and how large the picture is."""

    box: Box
    view: int | None
    """None for what the camera saw at the stop."""
    camera: Camera = (0.0, 0.0)
    image_size: tuple[float, float] = (640, 480)


@dataclass(frozen=True)
class Prediction:
    """What an agent did in an episode: the viewpoints it took, and the object it named or -1."""

    trajectory: Sequence[str]
    object_id: int
    as_text: bool = False
    """Whether it wrote the object's id as a text."""
    drawing: Drawing | None = None
    """The box that it drew in place of naming an object."""


Predictions = Mapping[str, Prediction]
"""By instr_id."""
Values = Mapping[str, float]
"""By metric key."""


def score(
    world: World, predictions: Predictions, protocols: Iterable[str] = ("official-v1",)
) -> Mapping[str, Mapping[str, Values]]:
    """Give, under these protocols, every episode in the order of the items its values.

    A protocol that none of the lists above names has the rules of ``official-v1``.
    """
    episodes = {
        instr_id: measure(world.scans[item.scan_id], item, predictions[instr_id])
        for item in world.items
        for instr_id in item.instr_ids
    }
    unscored = set() if has_boxes(predictions) else {"iou", "iou_25", "iou_50", "iou_75"}
    of_objects = {"rgs", "rgspl", "iou", "iou_25", "iou_50", "iou_75"}
    return {
        protocol: {
            instr_id: {
                key: value
                for key, value in score_episode(episode, protocol).items()
                if key not in (of_objects if protocol in WITHOUT_GROUNDING else unscored)
            }
            for instr_id, episode in episodes.items()
        }
        for protocol in protocols
    }


def has_boxes(predictions: Predictions) -> bool:
    """Whether any answer is a box."""
    return any(prediction.drawing is not None for prediction in predictions.values())


@dataclass(frozen=True)
class Episode:
    """What an agent did in an episode, and what no protocol sees differently."""

    scan: Scan
    item: Item
    prediction: Prediction
    walked: float
    shortest: float
    annotated: float
    errors: Sequence[float]
    """Metres from every pose to the goal."""
    iou: Number
    warped: float
    likeness: float
    coverage: float
    jumps: int


def measure(scan: Scan, item: Item, prediction: Prediction) -> Episode:
    """Measure what an agent did."""
    trajectory, goal = prediction.trajectory, item.path[-1]
    warped = dynamic_time_warping(scan, trajectory, item.path)
    return Episode(
        scan,
        item,
        prediction,
        walked=trajectory_length(scan, trajectory),
        shortest=distance(scan, item.path[0], goal),
        annotated=trajectory_length(scan, item.path),
        errors=[distance(scan, viewpoint_id, goal) for viewpoint_id in trajectory],
        iou=overlap_with_target(scan, item, prediction),
        warped=warped,
        likeness=math.exp(-warped / (3.0 * len(item.path))),
        coverage=coverage_by_length(scan, trajectory, item.path),
        jumps=count_jumps(scan, trajectory),
    )


def score_episode(episode: Episode, protocol: str) -> Values:
    """Give one episode its values, in the order in which docs/reference/metrics.md lists them."""
    scan, item, prediction = episode.scan, episode.item, episode.prediction
    walked, iou, trajectory = episode.walked, episode.iou, prediction.trajectory
    length = episode.annotated if protocol in SPL_BY_ANNOTATED_LENGTH else episode.shortest
    arrivals = [is_at_goal(scan, item, viewpoint_id, protocol) for viewpoint_id in trajectory]
    success = arrivals[-1]
    right = is_right(item, prediction, iou, protocol, success=success)
    spl_floor = 0.01 if protocol in SPL_WITH_FLOOR else 0.0
    rgspl_floor = 0.01 if protocol in RGSPL_WITH_FLOOR else 0.0
    return {
        "path_length": walked,
        "success": float(success),
        "oracle_success": float(any(arrivals)),
        "spl": weighted(walked, length, spl_floor, achieved=success),
        "rgs": float(right),
        "rgspl": weighted(walked, length, rgspl_floor, achieved=right),
        "iou": float(iou),
        "iou_25": float(iou >= Fraction(1, 4)),
        "iou_50": float(iou >= Fraction(1, 2)),
        "iou_75": float(iou >= Fraction(3, 4)),
        "navigation_error": episode.errors[-1],
        "oracle_error": min(episode.errors),
        "dtw": episode.warped,
        "ndtw": episode.likeness,
        "sdtw": episode.likeness if success else 0.0,
        "cls": episode.coverage,
        "shortest_length": episode.shortest,
        "steps": len(trajectory) - 1,
        "jumps": episode.jumps,
    }


def is_at_goal(scan: Scan, item: Item, viewpoint_id: str, protocol: str) -> bool:
    """Whether an agent that stops there succeeds."""
    if protocol in BY_THE_PATHS_END:
        return distance(scan, viewpoint_id, item.path[-1]) < 3.0
    if protocol == "paper-3m":
        return metres_to_centre(scan, viewpoint_id, item.target) <= 3.0
    if protocol == "challenge-2022":
        near = metres_to_centre(scan, viewpoint_id, item.target) <= 3.0
        return near and scan.sees(viewpoint_id, item.target)
    return scan.sees(viewpoint_id, item.target)


def is_right(
    item: Item, prediction: Prediction, iou: Number, protocol: str, *, success: bool
) -> bool:
    """Whether the named object counts as the target, or the box as one around it."""
    if protocol in GROUNDING_NEEDS_SUCCESS and not success:
        return False
    if prediction.drawing is not None:
        return iou >= Fraction(1, 2)
    if protocol in TEXT_IS_NEVER_RIGHT and prediction.as_text:
        return False
    return prediction.object_id == item.target


def overlap_with_target(scan: Scan, item: Item, prediction: Prediction) -> Number:
    """IoU of the box with the target's in the same view at the stop; 0 where there is none."""
    if prediction.drawing is None:
        return 0
    box, camera = drawn_in_pixels(prediction.drawing), camera_used(prediction.drawing)
    stop, view = scan.viewpoints[prediction.trajectory[-1]], view_of(camera)
    if view not in stop.views.get(item.target, []) or area(box) == 0:
        return 0
    target = stop.box(item.target, view)
    if is_a_view(camera):
        return overlap_over_union(box, target)
    return overlap_over_union_from(camera, box, target)


def camera_used(drawing: Drawing) -> Camera:
    """Return where the view that is named looks, or else the camera at the stop."""
    return drawing.camera if drawing.view is None else camera_of(drawing.view)


def drawn_in_pixels(drawing: Drawing) -> Box:
    """Scale the box to a picture of 640 x 480, each axis by itself, and cut it to the picture."""
    x, y, width, height = (Fraction(number) for number in drawing.box)
    across, down = 640 / Fraction(drawing.image_size[0]), 480 / Fraction(drawing.image_size[1])
    return common((x * across, y * down, width * across, height * down), PICTURE)


def weighted(walked: float, length: float, floor: float, *, achieved: bool) -> float:
    """Success x length / max(TL, length, floor); where all of them are 0, success."""
    if not achieved:
        return 0.0
    longest = max(walked, length, floor)
    return length / longest if longest > 0 else 1.0


def dynamic_time_warping(scan: Scan, trajectory: Sequence[str], path: Sequence[str]) -> float:
    """Fill the whole table, cell by cell: the way here costs what the cheapest way before did."""
    total = {(0, 0): 0.0}
    for i, pose in enumerate(trajectory, start=1):
        for j, node in enumerate(path, start=1):
            before = [(i - 1, j), (i, j - 1), (i - 1, j - 1)]
            cheapest = min(total.get(cell, math.inf) for cell in before)
            total[i, j] = distance(scan, pose, node) + cheapest
    return total[len(trajectory), len(path)]


def coverage_by_length(scan: Scan, trajectory: Sequence[str], path: Sequence[str]) -> float:
    """Coverage of the path, times how well the trajectory's length fits that coverage."""
    nearness = 0.0
    for node in path:
        nearest = min(distance(scan, pose, node) for pose in trajectory)
        nearness += math.exp(-nearest / 3.0)
    coverage = nearness / len(path)
    expected, walked = coverage * trajectory_length(scan, path), trajectory_length(scan, trajectory)
    if expected == walked == 0:
        return 1.0
    return coverage * expected / (expected + abs(expected - walked))


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
    return scan.routes[a][b]


def distances_from(scan: Scan, start: str) -> Mapping[str, float]:
    """Dijkstra's algorithm: the distance of every viewpoint that can be reached."""
    reached: dict[str, float] = {}
    queue = [(0.0, start)]
    while queue:
        walked, here = heapq.heappop(queue)
        if here in reached:
            continue
        reached[here] = walked
        for there, metres in scan.edges[here].items():
            heapq.heappush(queue, (walked + metres, there))
    return reached


def straight(scan: Scan, a: str, b: str) -> float:
    """Metres as the crow flies, in the powers that published evaluators use."""
    ax, ay, az = scan.viewpoints[a].position
    bx, by, bz = scan.viewpoints[b].position
    return float(((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2) ** 0.5)


def metres_to_centre(scan: Scan, viewpoint_id: str, object_id: int) -> float:
    """Metres from the camera to the object's centre, inf where that is not known."""
    if object_id not in scan.centres:
        return math.inf
    x, y, z = scan.viewpoints[viewpoint_id].position
    dx, dy, dz = (c - v for c, v in zip(scan.centres[object_id], (x, y, z), strict=True))
    return math.sqrt(dx * dx + dy * dy + dz * dz)
