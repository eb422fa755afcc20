"""Boxes from Matterport3D's houses: the objects listed at a viewpoint, and their boxes in views.

The files of many scans appear in the folder at once. If building fails or is interrupted, none
does.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.dataset._dataset import find_graphs, graph_name
from reverie_eval.dataset._graphs import GRAPH_RULES, read_graphs
from reverie_eval.dataset._houses import House, read_house
from reverie_eval.dataset._lint import file_problems
from reverie_eval.dataset._reader import Reader
from reverie_eval.dataset._rules import find_problems
from reverie_eval.errors import DatasetError, Problem, ReverieEvalError
from reverie_eval.files import staged_folder
from reverie_eval.geometry import boxes_in_views
from reverie_eval.processes import Progress, map_in_processes, no_progress
from reverie_eval.text import count_text, first_few

_HOUSE = ".house"
Occlusion = Literal["none", "paper"]
"""``none`` keeps every box; ``paper`` removes those that :func:`is_hidden` finds."""

MAX_DISTANCE = 3.0
"""Metres. Source: Qi et al., "REVERIE", CVPR 2020, section 3: objects within 3 metres. The released
files list objects nearer than 2 metres (38,283 of their 38,293 entries)."""

EXCLUDED_NAMES = frozenset(
    {
        "ceiling",
        "delete",
        "door",
        "door frame",
        "doorframe",
        "floor",
        "handrail",
        "object",
        "remove",
        "roof",
        "shower floor",
        "stairs",
        "unknown",
        "wall",
        "wall frame",
    }
)
"""Raw category names that are frequent in Matterport3D but never occur in the released files.

Objects with these names are not listed and do not hide others. Only equal names are excluded: the
released files do list ``shower wall``, ``garage door`` and ``doorway``.
"""


@dataclass(frozen=True, slots=True)
class BoxSettings:
    """How boxes are built."""

    max_distance: float = MAX_DISTANCE
    """Metres; objects whose centre is at least this far from the camera are not listed."""
    occlusion: Occlusion = "none"


Xywh: TypeAlias = Sequence[int]
"""Left, top, width and height in pixels."""
ListedBoxes: TypeAlias = Mapping[int, Mapping[int, Xywh]]
"""The boxes of a viewpoint by object id and view index; an object without boxes is listed but not
visible."""


def exclude_names(house: House) -> House:
    """Return the house without the objects that have one of ``EXCLUDED_NAMES``."""
    return house.take(
        np.array([name not in EXCLUDED_NAMES for name in house.names], dtype=np.bool_)
    )


def list_objects(house: House, position: FloatArray, settings: BoxSettings) -> ListedBoxes:
    """Return the objects listed at a viewpoint, in the order of object ids and views.

    ``position``, shape (3,), is the camera's in the scan's frame, metres. Names are ignored here:
    all objects of the house may be listed, and may hide each other.
    """
    near = house.take(_distances(house, position) < settings.max_distance)
    box, view, box_xywh = boxes_in_views(position, near.boxes)
    if settings.occlusion == "paper":
        shown = ~is_hidden(view, box_xywh, _distances(near, position)[box])
        box, view, box_xywh = box[shown], view[shown], box_xywh[shown]
    boxes_of: dict[int, dict[int, Xywh]] = {object_id: {} for object_id in near.object_id.tolist()}
    columns = near.object_id[box].tolist(), view.tolist(), box_xywh.tolist()
    for object_id, index, xywh in zip(*columns, strict=True):
        boxes_of[object_id][index] = xywh
    return boxes_of


def _published_form(house: House, listed: ListedBoxes) -> dict[str, dict[str, Any]]:
    """Return the objects listed at a viewpoint in the published form."""
    names = dict(zip(house.object_id.tolist(), house.names, strict=True))
    return {
        str(object_id): {
            "name": names[object_id],
            "visible_pos": list(boxes),
            "bbox2d": list(boxes.values()),
        }
        for object_id, boxes in listed.items()
    }


def _distances(house: House, position: FloatArray) -> FloatArray:
    """Return the metres from the camera to the objects' centres."""
    # Written out because numpy's norm differs in the last bit between machines, and the files must
    # have the same bytes everywhere.
    x, y, z = (house.boxes.centre - position).T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def is_hidden(view: IntArray, box_xywh: IntArray, distance: FloatArray) -> BoolArray:
    """Whether each box lies entirely within the box of a nearer object in the same view.

    Boxes are compared with all others, including hidden ones, so their order does not matter. Equal
    boxes lie within each other; objects at the same distance do not hide each other.

    ``view`` is the view that each box is in, and ``distance`` the metres from the camera to the
    centre of its object.

    References
    ----------
    .. [1] Qi et al., "REVERIE", CVPR 2020, section 3: a box that is fully covered by another and
       has a larger depth is removed.

    Examples
    --------
    >>> boxes = np.array([[0, 0, 9, 9], [0, 0, 9, 5], [0, 0, 9, 9]])
    >>> is_hidden(np.array([12, 12, 13]), boxes, np.array([1.0, 2.0, 2.0]))
    array([False,  True, False])
    """
    hidden = np.zeros(len(view), dtype=np.bool_)
    for index in np.unique(view):
        rows = np.flatnonzero(view == index)
        near, far = box_xywh[rows, :2], box_xywh[rows, :2] + box_xywh[rows, 2:]
        # All pairs of a view at once: it has some dozens of boxes at most.
        contains = ((near[:, None] <= near) & (far[:, None] >= far)).all(axis=-1)
        is_nearer = distance[rows, None] < distance[rows]
        hidden[rows] = (contains & is_nearer).any(axis=0)
    return hidden


# The files of many scans.


@dataclass(frozen=True, slots=True)
class Scan:
    """The files of a scan that boxes are built from."""

    scan_id: str
    house: Path
    connectivity: Path


@dataclass(frozen=True, slots=True)
class FoundScans:
    """Scans that have both files, and scans that have only one."""

    complete: tuple[Scan, ...]
    without_house: tuple[str, ...]
    without_connectivity: tuple[str, ...]

    def notes(self) -> list[str]:
        """Say which scans were left out, and why."""
        left_out = {
            "no .house file": self.without_house,
            "no connectivity file": self.without_connectivity,
        }
        return [
            f"{reason} for {count_text(len(scans), 'scan')}, left out: {first_few(scans)}"
            for reason, scans in left_out.items()
            if scans
        ]


def find_scans(houses: Path, connectivity: Path, wanted: Iterable[str] | None = None) -> FoundScans:
    """Find the files of scans.

    Parameters
    ----------
    houses : Path
        A folder with ``{scan}.house`` at any depth, as in Matterport's download.
    connectivity : Path
        The folder of ``{scan}_connectivity.json`` files.
    wanted : iterable of str, optional
        The scans to build; each needs both files. By default, all scans that have both.

    Raises
    ------
    DatasetError
        Listing everything that is missing or ambiguous.
    """
    absent = [folder for folder in (houses, connectivity) if not folder.is_dir()]
    if absent:
        message = "there is no such folder"
        raise DatasetError([Problem("missing-input", str(folder), message) for folder in absent])
    # Sorted, so that of two files of a scan the same one is named first on every machine.
    house_files = sorted(houses.rglob(f"*{_HOUSE}"))
    house_of = {path.stem: path for path in house_files}
    graph_of = find_graphs(connectivity)
    scans = sorted(house_of.keys() | graph_of.keys() if wanted is None else set(wanted))
    found = FoundScans(
        complete=tuple(
            Scan(scan, house_of[scan], graph_of[scan])
            for scan in scans
            if scan in house_of and scan in graph_of
        ),
        without_house=tuple(scan for scan in scans if scan not in house_of),
        without_connectivity=tuple(scan for scan in scans if scan not in graph_of),
    )
    missing = _duplicate_houses([path for path in house_files if path.stem in scans])
    if wanted is not None or not found.complete:
        house, graph = f"SCAN{_HOUSE}", graph_name("SCAN")
        missing += _missing("missing-house", houses, house, found.without_house, scans)
        missing += _missing("missing-scan", connectivity, graph, found.without_connectivity, scans)
    if missing:
        raise DatasetError(missing)
    return found


def _missing(
    code: str, folder: Path, file: str, without: Sequence[str], scans: Collection[str]
) -> list[Problem]:
    if not scans:
        return [Problem(code, str(folder), f"there is no {file}")]
    if not without:
        return []
    message = f"no {file} for {count_text(len(without), 'scan')}: {first_few(without)}"
    return [Problem(code, str(folder), message)]


def _duplicate_houses(houses: Iterable[Path]) -> list[Problem]:
    first: dict[str, Path] = {}
    return [
        Problem(
            "duplicate-house",
            str(path),
            f"the scan also has the file {first[path.stem]}; keep only one of them",
        )
        for path in houses
        if first.setdefault(path.stem, path) != path
    ]


class BuiltBoxes(NamedTuple):
    """How many viewpoints, objects and boxes were built."""

    viewpoints: int
    listed: int
    """Objects listed at the viewpoints, visible or not."""
    boxes: int


ScanResult: TypeAlias = BuiltBoxes | DatasetError


def build_boxes(
    scans: Sequence[Scan],
    folder: Path,
    settings: BoxSettings,
    *,
    jobs: int = 1,
    progress: Progress = no_progress,
) -> BuiltBoxes:
    """Build the boxes of scans into a folder of ``{scan}_{viewpoint}.json`` files.

    Every included viewpoint gets a file, even if no object is listed there. The files do not depend
    on the number of processes.

    Parameters
    ----------
    scans : sequence of Scan
        From :func:`find_scans`.
    folder : Path
        Where to write: a folder that does not exist yet, or is empty.
    settings : BoxSettings
        Which objects are listed, and which boxes are hidden.
    jobs : int
        Number of processes.
    progress : callable, optional
        Shows progress; called with an iterator over the results, a description and their number.

    Raises
    ------
    DatasetError
        Listing every problem in the scans' files; nothing is written.
    ReverieEvalError
        If the folder is not empty, or a process was killed.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ReverieEvalError(
            f"{folder} is not an empty folder; choose another, or remove it first"
        )
    with staged_folder(folder) as staging:
        build = partial(_build_scan, folder=staging, settings=settings)
        # Closing the generator stops the processes if showing progress fails or is interrupted.
        with closing(map_in_processes(build, scans, jobs)) as running:
            results = list(progress(running, "boxes", len(scans)))
        # Problems are sorted by position: with the scan first, each scan's stay together.
        found = [
            replace(problem, position=(index, *problem.position))
            for index, result in enumerate(results)
            for problem in _problems(result)
        ]
        if found:
            raise DatasetError(found)
    built = [result for result in results if isinstance(result, BuiltBoxes)]
    return BuiltBoxes(*map(sum, zip(*built, strict=True)))


def _build_scan(scan: Scan, *, folder: Path, settings: BoxSettings) -> ScanResult:
    """Build and write one scan; return an error, which is raised together with other scans'."""
    # All files are read before any problem is raised, so that one attempt lists everything.
    house = _read_house(scan.house)
    reader = Reader()
    graphs = read_graphs(reader, {scan.scan_id: scan.connectivity})
    found = [
        *_problems(house),
        *file_problems(reader, "boxes"),
        *find_problems(GRAPH_RULES, graphs, scan.connectivity, "boxes"),
    ]
    if isinstance(house, DatasetError) or found:
        return DatasetError(found)
    graph, house = graphs.scans[scan.scan_id], exclude_names(house)
    listed = boxes = 0
    for viewpoint_id, position in zip(graph.viewpoint_ids, graph.position, strict=True):
        objects = list_objects(house, position, settings)
        content = {viewpoint_id: _published_form(house, objects)}
        file = folder / f"{scan.scan_id}_{viewpoint_id}.json"
        file.write_bytes(msgspec.json.encode(content) + b"\n")
        listed += len(objects)
        boxes += sum(map(len, objects.values()))
    return BuiltBoxes(len(graph.viewpoint_ids), listed, boxes)


def _read_house(path: Path) -> House | DatasetError:
    try:
        return read_house(path)
    except DatasetError as error:
        return error
    except OSError as error:
        return DatasetError([Problem("unreadable-file", str(path), f"{error.strerror}")])


def _problems(result: object) -> tuple[Problem, ...]:
    return result.problems if isinstance(result, DatasetError) else ()
