"""How well buildings are modelled from poses and released boxes, judged by instructions.

``python benchmarks/buildings.py DATASET`` prints the figures of ``docs/how-to/report.md``. DATASET
is a clone of the dataset repository; all scans with boxes are modelled, without objects' centres,
and a view from each viewpoint is drawn. Times are those of the processor.
"""

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

from reverie_eval.analysis import VisibleObject
from reverie_eval.analysis._breakdown import NO_LEVEL, level_in
from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.dataset import DatasetFiles
from reverie_eval.dataset._boxes import Boxes
from reverie_eval.dataset._dataset import read_dataset
from reverie_eval.dataset._reader import no_progress
from reverie_eval.geometry import (
    HEIGHT,
    NEAR,
    VIEW_AXES,
    WIDTH,
    Building,
    RoomView,
    Seen,
    Sightings,
    model_building,
    pixels_of,
    polygon_overlap,
)
from reverie_eval.ground_truth import NavigationGraph
from reverie_eval.reporting.answer_svg import room_shapes
from reverie_eval.reporting.answers import seen_in
from reverie_eval.text import category_text

ROOMS: Mapping[str, str] = {
    word: room
    for room, words in {
        "bathroom": "bathroom, restroom, powder room, washroom",
        "bedroom": "bedroom",
        "closet": "closet",
        "dining room": "dining room",
        "gym": "gym, exercise room, workout room",
        "kitchen": "kitchen",
        "laundry": "laundry, laundry room",
        "living room": "living room, family room, lounge",
        "office": "office, study",
        "": "hallway, hall, foyer, entryway, entry, stairs, garage, balcony, porch, patio, spa, "
        "bar, library, theater, utility room, game room, rec room, tv room, toilet",
    }.items()
    for word in words.split(", ")
}
"""What instructions call rooms; those without a name are never told from objects."""
_SEEN_WELL = 0.5
ROOM = re.compile(rf"\b({'|'.join(sorted(ROOMS, key=len, reverse=True))})s?\b", re.IGNORECASE)


def main() -> int:
    """Print the figures."""
    if len(sys.argv) != 2:  # the script, and what its docstring names
        print("usage: python benchmarks/buildings.py DATASET")
        return 2
    root = Path(sys.argv[1])
    dataset = read_dataset(DatasetFiles.find(root), no_progress)
    graph = dataset.graphs.ground_truth()
    buildings: dict[str, Building] = {}
    seconds = []
    found = [*scans(graph, dataset.boxes)]
    for scan in found:
        begin = process_time()
        buildings[scan.name] = model_building(scan.position, scan.edges, scan.seen)
        seconds.append(process_time() - begin)
    storeys = Counter(int(each.storey.max()) + 1 for each in buildings.values())
    rooms = sum(len(each.rooms) for each in buildings.values())
    print(f"{len(buildings)} buildings, {sum(n * of for n, of in storeys.items())} storeys")
    print(f"by number of storeys: {dict(sorted(storeys.items()))}; {rooms:,} rooms")
    print(f"model: median {np.median(seconds):.2f} s, at most {max(seconds):.2f} s")
    view_rooms(found, buildings)
    stands = [each for its in buildings.items() for each in rooms_around(graph, *its)]
    own, some = np.mean(stands, axis=0)
    print(f"viewpoints in a room of their storey {some:.1%}, in their own room {own:.1%}")
    for split in ("val_seen", "val_unseen"):
        path = root / "tasks" / "REVERIE" / "data" / f"REVERIE_{split}.json"
        compare(split, json.loads(path.read_text(encoding="utf-8")), graph, buildings)
    return 0


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


def view_rooms(found: Sequence[Scan], buildings: Mapping[str, Building]) -> None:
    """Draw the view with the most boxes from each viewpoint, and print how long it takes.

    Print as well how much the outline of each solid overlaps with its box.
    """
    seconds, overlaps = [], []
    for scan in found:
        for row, objects in enumerate(scan.objects):
            views = np.concatenate([[12], *(each.view for each in objects)]).astype(np.int64)
            view = int(np.bincount(views).argmax())
            seen = seen_in(view, objects)
            begin = process_time()
            room_view = RoomView(buildings[scan.name], scan.position, row, view, seen)
            room_shapes(room_view)
            seconds.append(process_time() - begin)
            overlaps.append(overlaps_of(room_view, scan.position[row], seen))
    overlap = np.concatenate(overlaps)
    print(
        f"{len(seconds):,} views: median {1000 * np.median(seconds):.0f} ms, at most "
        f"{1000 * max(seconds):.0f} ms; {len(overlap):,} solids, IoU with the box: median "
        f"{np.median(overlap):.2f}, at least 0.5 for {(overlap >= _SEEN_WELL).mean():.0%}"
    )


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
    """Yield for each viewpoint whether it is inside its own room, and inside any of its storey."""
    for row, position in enumerate(graph.viewpoint_position[graph.viewpoints_of(scan), :2]):
        inside = {
            index
            for index, room in enumerate(building.rooms)
            if room.storey == building.storey[row] and room.contains(position[None])[0]
        }
        yield int(building.room[row]) in inside, bool(inside)


def compare(
    split: str,
    items: Sequence[dict[str, Any]],
    graph: NavigationGraph,
    buildings: Mapping[str, Building],
) -> None:
    """Print how often the goal is where the instruction says: on its level, in its room."""
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
                names.append((bool(name), name in called))
    is_shown, is_right = np.array(names).T
    print(
        f"{split}: storey as in {np.mean(levels):.1%} of {len(levels):,} instructions that name one"
        f"; of {len(names):,} that name one room, {is_shown.mean():.0%} are in a named room, "
        f"{is_right[is_shown].mean():.1%} of these as in the instruction"
    )


if __name__ == "__main__":
    sys.exit(main())
