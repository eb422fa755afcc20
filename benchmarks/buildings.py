"""How well buildings are modelled from poses and released boxes, judged by instructions.

``python benchmarks/buildings.py DATASET`` prints the figures of ``docs/how-to/report.md`` with
their bars. DATASET is a clone of the dataset repository; all scans with boxes are modelled, without
objects' centres; a plan of each and a view from each viewpoint are drawn. Times are medians, of the
processor. ``python benchmarks/buildings.py DATASET TRAIN`` instead chooses how clearly objects must
name a room, by the annotations of a train split.
"""

import gzip
import json
import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.bars import Figure, judge
from reverie_eval.analysis import VisibleObject
from reverie_eval.analysis._breakdown import NO_LEVEL, level_in
from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.dataset import DatasetFiles
from reverie_eval.dataset._boxes import Boxes
from reverie_eval.dataset._dataset import read_dataset
from reverie_eval.geometry import (
    HEIGHT,
    NEAR,
    VIEW_AXES,
    WIDTH,
    Building,
    RoomView,
    Seen,
    Sightings,
    _room_names,
    door_spans,
    model_building,
    pixels_of,
    polygon_overlap,
)
from reverie_eval.ground_truth import NavigationGraph
from reverie_eval.processes import no_progress
from reverie_eval.reporting.answer_svg import room_shapes
from reverie_eval.reporting.answers import seen_in
from reverie_eval.reporting.building_svg import BuildingPicture
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.text import category_text

ROOMS: Mapping[str, str] = {
    word: room
    for room, words in {
        "bathroom": "bathroom, restroom, powder room, washroom, toilet",
        "bedroom": "bedroom",
        "closet": "closet",
        "dining room": "dining room, diningroom",
        "gym": "gym, exercise room, workout room",
        "hallway": "hallway, hall, corridor",
        "kitchen": "kitchen, kitchenette",
        "laundry": "laundry, laundry room, laundryroom",
        "living room": "living room, livingroom, sitting room, family room, familyroom, lounge",
        "office": "office, study",
        "spa": "spa, sauna",
        "stairwell": "stairs, staircase, stairwell, stairway",
        "": "foyer, entryway, entry, garage, balcony, porch, patio, terrace, deck, "
        "bar, library, theater, lobby, utility room, game room, rec room, tv room, "
        "meeting room, conference room",
    }.items()
    for word in words.split(", ")
}
"""What instructions call rooms; those without a name are never told from objects."""
ROOM = re.compile(rf"\b({'|'.join(sorted(ROOMS, key=len, reverse=True))})s?\b", re.IGNORECASE)
_TASKS = Path("tasks", "REVERIE", "data")
MARGINS = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0, 3.5)
# How often that many buildings have to leave a name to that share of their goals: those of
# val_unseen are ten, and its bar is 70 %.
_DRAWS, _DRAWN, _OFTEN, _SHOWN = 2000, 10, 0.9, 0.7
_SEEN_WELL = 0.5
# Metres from where an edge passes a wall to a door in it, at most.
_BESIDE = 0.25


def main() -> int:
    """Print the figures; return 1 if one is over its bar."""
    if len(sys.argv) not in (2, 3):
        print(__doc__)
        return 2
    root = Path(sys.argv[1])
    dataset = read_dataset(DatasetFiles.find(root), no_progress)
    graph = dataset.graphs.ground_truth()
    found = [*scans(graph, dataset.boxes)]
    if len(sys.argv) > 2:
        choose_margin(json.loads(Path(sys.argv[2]).read_text(encoding="utf-8")), graph, found)
        return 0
    buildings: dict[str, Building] = {}
    seconds = []
    for scan in found:
        begin = process_time()
        buildings[scan.name] = model_building(scan.position, scan.edges, scan.seen)
        seconds.append(process_time() - begin)
    storeys = Counter(int(each.storey.max()) + 1 for each in buildings.values())
    rooms = [room for each in buildings.values() for room in each.rooms]
    n_halls = sum(room.is_hall for room in rooms)
    print(f"{len(buildings)} buildings, {sum(n * of for n, of in storeys.items())} storeys")
    print(
        f"by number of storeys: {dict(sorted(storeys.items()))}; {len(rooms) - n_halls:,} parts of "
        f"rooms, {sum(room.is_side_part for room in rooms)} of them side parts; "
        f"{sum(bool(room.name) for room in rooms):,} have a name; and {n_halls} halls"
    )
    stands = [each for its in buildings.items() for each in rooms_around(graph, *its)]
    own, some = np.mean(stands, axis=0)
    print(f"viewpoints in their own room {own:.1%}")
    named = {
        split: json.loads((root / _TASKS / f"REVERIE_{split}.json").read_text(encoding="utf-8"))
        for split in ("val_seen", "val_unseen")
    }
    figures = [
        ("model, ms", 1000 * float(np.median(seconds)), 500.0),
        *draw_plans(graph, found, buildings),
        *view_rooms(found, buildings),
        ("viewpoints in no room, %", 100 - 100 * some, 3.0),
        ("ways between rooms without a door", without_doors(found, buildings), 0),
        ("buildings of one storey with stairs", climbing(buildings), 0),
    ]
    for split, most in (("val_seen", 20.0), ("val_unseen", 23.0)):
        names, levels = compare(named[split], graph, buildings)
        print(f"{split}: {len(levels):,} instructions name a level, {len(names):,} one room")
        figures += [
            (f"{split}: another level than named, %", 100 - 100 * float(levels.mean()), 5.0),
            (f"{split}: goal in no named room, %", 100 - 100 * shown(names), 30.0),
            (f"{split}: name is another, %", 100 - 100 * right(names), most),
        ]
    return judge(figures)


class Scan(NamedTuple):
    """A scan, and what its model is made of."""

    name: str
    position: FloatArray
    edges: IntArray
    seen: Sightings
    objects: Sequence[Sequence[VisibleObject]]
    """What is visible from each viewpoint."""


def scans(graph: NavigationGraph, boxes: Boxes) -> Iterator[Scan]:
    """Yield each scan."""
    known = np.array([graph.index.get(key.viewpoint_id, -1) for key in boxes.viewpoints])
    viewpoint = known[boxes.viewpoint]
    scan = np.where(boxes.is_visible & (viewpoint >= 0), graph.viewpoint_scan[viewpoint], -1)
    for index, name in enumerate(graph.scan_ids):
        rows = graph.viewpoints_of(name)
        entries = np.flatnonzero(scan == index)
        is_its = np.isin(boxes.box_entry, entries)
        row = np.searchsorted(entries, boxes.box_entry[is_its])
        view, xywh = boxes.box_view[is_its], boxes.box_xywh[is_its]
        seen = Sightings.of_boxes(
            viewpoint=viewpoint[entries] - rows[0],
            object_id=boxes.object_id[entries],
            distance=np.full(len(entries), np.inf),
            names=[category_text(boxes.entries[entry].record.name) for entry in entries.tolist()],
            row=row,
            view=view,
            xywh=xywh,
        )
        objects: list[list[VisibleObject]] = [[] for _ in rows]
        for each in range(len(entries)):
            its = row == each
            objects[int(seen.viewpoint[each])].append(
                VisibleObject(int(seen.object_id[each]), seen.names[each], view[its], xywh[its])
            )
        yield Scan(name, graph.viewpoint_position[rows], graph.edges_of(name), seen, objects)


def view_rooms(found: Sequence[Scan], buildings: Mapping[str, Building]) -> Sequence[Figure]:
    """Draw the view with the most boxes from each viewpoint; return its figures with their bars.

    These are how long it takes, and how much the outline of each solid overlaps with its box.
    """
    seconds, overlaps = [], []
    for scan in found:
        for row, objects in enumerate(scan.objects):
            view = fullest_view(objects)
            seen = seen_in(view, objects)
            begin = process_time()
            room_view = RoomView(buildings[scan.name], scan.position, row, view, seen)
            room_shapes(room_view)
            seconds.append(process_time() - begin)
            overlaps.append(overlaps_of(room_view, scan.position[row], seen))
    overlap = np.concatenate(overlaps)
    print(
        f"{len(seconds):,} views, at most {1000 * max(seconds):.0f} ms; {len(overlap):,} solids, "
        f"IoU with the box at least 0.5 for {(overlap >= _SEEN_WELL).mean():.0%}"
    )
    return [
        ("view, ms", 1000 * float(np.median(seconds)), 50.0),
        ("1 - IoU of solid and box", 1 - float(np.median(overlap)), 0.3),
    ]


def fullest_view(objects: Sequence[VisibleObject]) -> int:
    """Return the view with the most boxes; to the north if there are none."""
    if not objects:
        return 12
    return int(np.bincount(np.concatenate([each.view for each in objects])).argmax())


def overlaps_of(room_view: RoomView, camera: FloatArray, seen: Seen) -> FloatArray:
    """Return the IoU of the outline of each solid in the view of its box with the box."""
    corners = np.einsum("nki,nji->nkj", room_view.fitted.corners() - camera, VIEW_AXES[seen.view])
    corners[..., 2] = np.maximum(corners[..., 2], NEAR)
    outlines = shapely.convex_hull(shapely.multipoints(shapely.points(pixels_of(corners))))
    shared, both = polygon_overlap(
        shapely.intersection(outlines, shapely.box(0, 0, WIDTH, HEIGHT)), seen.xywh
    )
    return shared / (both - shared)


def rooms_around(
    graph: NavigationGraph, scan: str, building: Building
) -> Iterator[tuple[bool, bool]]:
    """Yield for each viewpoint whether it is inside its own room, and inside any of its storey.

    Halls do not count: they are where viewpoints are.
    """
    for row, position in enumerate(graph.viewpoint_position[graph.viewpoints_of(scan), :2]):
        inside = {
            index
            for index, room in enumerate(building.rooms)
            if room.storey == building.storey[row]
            and not room.is_hall
            and room.contains(position[None])[0]
        }
        yield int(building.room[row]) in inside, bool(inside)


def draw_plans(
    graph: NavigationGraph, found: Sequence[Scan], buildings: Mapping[str, Building]
) -> Sequence[Figure]:
    """Draw all levels of each building; return time and packed size with their bars."""
    seconds, sizes = [], []
    for scan in found:
        begin = process_time()
        picture = plan_picture(graph, scan, buildings[scan.name]).svg()
        seconds.append(process_time() - begin)
        sizes.append(len(gzip.compress(picture.encode())) / 1000)
    print(f"{len(sizes)} plans: at most {1000 * max(seconds):.0f} ms, {max(sizes):.0f} kB packed")
    return [
        ("plan, ms", 1000 * float(np.median(seconds)), 100.0),
        ("plan, kB packed", float(np.median(sizes)), 25.0),
    ]


def plan_picture(graph: NavigationGraph, scan: Scan, building: Building) -> BuildingPicture:
    """Return a picture of all levels, without a walk: as if all viewpoints were goals."""
    rows = graph.viewpoints_of(scan.name)
    every = np.arange(len(rows))
    return BuildingPicture(
        EpisodeMap(
            instr_id=scan.name,
            scan=scan.name,
            instruction="",
            graph=graph,
            graph_row=rows,
            viewpoint_ids=[graph.viewpoint_ids[row] for row in rows],
            position=scan.position,
            building=building,
            edges=scan.edges,
            routes=[],
            annotated_path=every[:1],
            goal_viewpoints=every,
            start=0,
        )
    )


def without_doors(found: Sequence[Scan], buildings: Mapping[str, Building]) -> int:
    """Count the walkable edges of a storey that pass a wall of a room where it has no door."""
    count = 0
    for scan in found:
        building = buildings[scan.name]
        walls: dict[int, list[tuple[FloatArray, FloatArray, FloatArray]]] = {}
        for room in building.rooms:
            doors = building.doors_on(room.storey)
            for outline in room.outlines:
                for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
                    spans = door_spans(doors, start, end)
                    walls.setdefault(room.storey, []).append((start, end, spans))
        for first, last in scan.edges.tolist():
            storey = int(building.storey[first])
            if storey == building.storey[last]:
                leg = scan.position[[first, last], :2]
                count += any(not has_door(leg, *wall) for wall in walls.get(storey, ()))
    return count


def has_door(leg: FloatArray, start: FloatArray, end: FloatArray, spans: FloatArray) -> bool:
    """Whether a leg does not pass a wall, or where the wall has one of its doors.

    ``spans``, shape (n, 2), are where these are: metres from the start of the wall.
    """
    wall, way = end - start, leg[1] - leg[0]
    area = way[0] * wall[1] - way[1] * wall[0]
    if area == 0:
        return True
    off = start - leg[0]
    walked = (off[0] * wall[1] - off[1] * wall[0]) / area
    share = (off[0] * way[1] - off[1] * way[0]) / area
    if not (0 < walked < 1 and 0 < share < 1):
        return True
    at = share * np.linalg.norm(wall)
    off = np.maximum(spans[:, 0] - at, at - spans[:, 1])
    return bool((off <= _BESIDE + 1e-6).any())


def climbing(buildings: Mapping[str, Building]) -> int:
    """Count the buildings of one storey with stairs."""
    return sum(bool(each.treads) for each in buildings.values() if not each.storey.any())


def compare(
    items: Sequence[dict[str, Any]], graph: NavigationGraph, buildings: Mapping[str, Building]
) -> tuple[BoolArray, BoolArray]:
    """Compare where the goal is with what each instruction says.

    Returns
    -------
    bool array of shape (n_names, 2)
        Of instructions that name one room: whether the goal's has a name, and whether it is that.
    bool array of shape (n_levels,)
        Of instructions that name a level: whether the goal's is that.
    """
    levels, names = [], []
    for item in items:
        building, goal = buildings[item["scan"]], graph.index[item["path"][-1]]
        row = goal - int(graph.viewpoints_of(item["scan"])[0])
        room = building.room[row]
        name = building.rooms[room].name if room >= 0 else ""
        for text in item["instructions"]:
            if (level := level_in(text)) != NO_LEVEL:
                levels.append(level == f"level {building.storey[row] + 1}")
            called = {ROOMS[word.lower()] for word in ROOM.findall(text)}
            if len(called) == 1:
                names.append((bool(name), bool(name) and name in called))
    return np.array(names, dtype=bool).reshape(-1, 2), np.array(levels)


def shown(names: BoolArray) -> float:
    """Return the share of goals in a room with a name."""
    return float(names[:, 0].mean())


def right(names: BoolArray) -> float:
    """Return the share of these whose name is that of the instruction."""
    return float(names[names[:, 0], 1].mean())


def choose_margin(
    items: Sequence[dict[str, Any]], graph: NavigationGraph, found: Sequence[Scan]
) -> None:
    """Print how often goals of a train split have a name, and a right one, with several margins.

    The choice is the largest margin with which enough draws of buildings have names for enough of
    their goals. It does not count the right ones: the words were chosen on the same split.
    """
    of_scan: dict[str, list[dict[str, Any]]] = {}
    for item in items:
        of_scan.setdefault(item["scan"], []).append(item)
    compared = {}
    for margin in MARGINS:
        _room_names.MARGIN = margin
        tried = {
            each.name: model_building(each.position, each.edges, each.seen)
            for each in found
            if each.name in of_scan
        }
        compared[margin] = [compare(its, graph, tried)[0] for its in of_scan.values()]
        names = np.concatenate(compared[margin])
        print(
            f"margin {margin}: {shown(names):.1%} of {len(names):,} goals have a name, "
            f"{right(names):.1%} of these are right; at least {_SHOWN:.0%} have one in "
            f"{enough_shown(compared[margin]):.1%} of draws of {_DRAWN} buildings, and "
            f"at least {usually_right(compared[margin]):.1%} are right in {_OFTEN:.0%}"
        )
    without_one = {
        largest_margin({margin: its[:row] + its[row + 1 :] for margin, its in compared.items()})
        for row in range(len(of_scan))
    }
    print(f"choice: {largest_margin(compared)}; without one of the buildings: {without_one}")


def largest_margin(compared: Mapping[float, Sequence[BoolArray]]) -> float:
    """Return the largest margin that often enough leaves a name to enough goals."""
    return max(margin for margin, its in compared.items() if enough_shown(its) >= _OFTEN)


def enough_shown(names: Sequence[BoolArray]) -> float:
    """Return the share of draws of buildings whose goals have a name often enough.

    ``names`` has the goals of each building, as :func:`compare` returns them.
    """
    named, _, count = drawn_goals(names)
    return float((named >= _SHOWN * count).mean())


def usually_right(names: Sequence[BoolArray]) -> float:
    """Return what share of names is right at least, as often as goals have to have one."""
    named, right_ones, _ = drawn_goals(names)
    return float(np.quantile(right_ones / named, 1 - _OFTEN))


def drawn_goals(names: Sequence[BoolArray]) -> IntArray:
    """Draw buildings; return how many goals have a name, a right one, and are there in each draw.

    Shape (3, n_draws).
    """
    of_building = np.array([(*its.sum(axis=0), len(its)) for its in names])
    order = np.random.default_rng(0).random((_DRAWS, len(names))).argsort(axis=1)
    return np.asarray(of_building[order[:, :_DRAWN]].sum(axis=1).T)


if __name__ == "__main__":
    sys.exit(main())
