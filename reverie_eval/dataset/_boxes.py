"""All listed objects and their boxes as columns, valid or not, and the rules for them.

The rules are about the form of boxes, their sizes, and which objects are visible from where.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from reverie_eval.arrays import BoolArray, IntArray, with_object
from reverie_eval.dataset._graphs import Graphs
from reverie_eval.dataset._reader import BOXES, ObjectRecord, Reader, ViewpointKey, object_key
from reverie_eval.dataset._rules import Count, Rule, Spread, error, info, spread, warning
from reverie_eval.geometry import HEIGHT, N_VIEWS, WIDTH
from reverie_eval.text import category_text


class Entry(NamedTuple):
    """An object that is listed at a viewpoint."""

    viewpoint: int
    """Index into the viewpoints."""
    object_id: int
    record: ObjectRecord


@dataclass(frozen=True, eq=False)
class Boxes:
    """Every object that is listed anywhere, and every box."""

    viewpoints: Sequence[ViewpointKey]
    """Viewpoints that have a record of boxes, even if it is empty."""
    entries: Sequence[Entry]
    graphs: Graphs
    """The navigation graphs that the viewpoints should be in."""
    misnamed: Sequence[str] = ()
    """Files that do not contain exactly the viewpoint in their name."""
    malformed: Sequence[str] = ()
    """Entries that are not an :class:`ObjectRecord`, with the reason."""
    is_folder: bool = True
    """Whether there is a file for each viewpoint; a single file for all may leave some out."""

    @cached_property
    def viewpoint(self) -> IntArray:
        """Shape (n_entries,): the viewpoint at which each object is listed."""
        return np.array([viewpoint for viewpoint, _, _ in self.entries], dtype=np.int64)

    @cached_property
    def object_id(self) -> IntArray:
        """Shape (n_entries,): the id of each object within its scan."""
        return np.array([object_id for _, object_id, _ in self.entries], dtype=np.int64)

    @cached_property
    def scan_object(self) -> IntArray:
        """Shape (n_entries,): a number for each object, the same wherever it is listed."""
        scan_ids = sorted({key.scan_id for key in self.viewpoints})
        number = {scan_id: n for n, scan_id in enumerate(scan_ids)}
        scan = np.array([number[key.scan_id] for key in self.viewpoints], dtype=np.int64)
        return with_object(scan[self.viewpoint], self.object_id)

    @cached_property
    def n_views(self) -> IntArray:
        """Shape (n_entries,): the number of views in which each object is visible."""
        return np.array([len(record.visible_pos) for _, _, record in self.entries], dtype=np.int64)

    @cached_property
    def n_boxes(self) -> IntArray:
        """Shape (n_entries,): the number of boxes of each object."""
        return np.array([len(record.bbox2d) for _, _, record in self.entries], dtype=np.int64)

    @property
    def is_visible(self) -> BoolArray:
        """Shape (n_entries,): whether any view shows the object.

        ``eval_release.py`` of the dataset's repository, line 122: only objects whose
        ``visible_pos`` is not empty are visible.
        """
        return self.n_views > 0

    @cached_property
    def visible(self) -> IntArray:
        """Shape (n_visible,): the entries that are visible."""
        return np.flatnonzero(self.is_visible)

    @cached_property
    def sightings(self) -> tuple[IntArray, IntArray]:
        """The objects that are visible somewhere, ascending, and how many viewpoints see each."""
        # An object is listed at most once at a viewpoint, so entries count viewpoints.
        return np.unique(self.scan_object[self.is_visible], return_counts=True)

    @cached_property
    def box_entry(self) -> IntArray:
        """Shape (n_boxes,): the entry of each box that has a view."""
        # The lists should be equally long; if not, `unequal-lists` reports it and the rest is cut.
        return np.repeat(np.arange(len(self.entries)), np.minimum(self.n_views, self.n_boxes))

    @cached_property
    def box_view(self) -> IntArray:
        """Shape (n_boxes,): the view that each box is in."""
        return np.array([view for view, _ in self._pairs()], dtype=np.int64)

    @cached_property
    def box_xywh(self) -> IntArray:
        """Shape (n_boxes, 4): left, top, width and height."""
        return np.array([box for _, box in self._pairs()], dtype=np.int64).reshape(-1, 4)

    @cached_property
    def entry_at(self) -> Mapping[tuple[ViewpointKey, int], int]:
        """The entry of each object at each viewpoint where it is listed."""
        return {
            (self.viewpoints[viewpoint], object_id): row
            for row, (viewpoint, object_id, _) in enumerate(self.entries)
        }

    @cached_property
    def largest_area(self) -> IntArray:
        """Shape (n_entries,): pixels of the largest box; 0 without a box."""
        area = np.zeros(len(self.entries), dtype=np.int64)
        np.maximum.at(area, self.box_entry, self.box_xywh[:, 2:].prod(axis=1))
        return area

    def entry_text(self, entry: int) -> str:
        """Return a listed object as examples show it."""
        viewpoint, object_id, _ = self.entries[entry]
        return f"{self.viewpoints[viewpoint]} object {object_id}"

    def box_text(self, box: int) -> str:
        """Return a box as examples show it, with its numbers."""
        numbers = self.box_xywh[box].tolist()
        return f"{self.entry_text(self.box_entry[box])} view {self.box_view[box]} {numbers}"

    def _pairs(self) -> Iterator[tuple[int, tuple[int, int, int, int]]]:
        for _, _, record in self.entries:
            yield from zip(record.visible_pos, record.bbox2d, strict=False)


def read_boxes(reader: Reader, path: Path, graphs: Graphs, scans: Collection[str] | None) -> Boxes:
    """Read the ``BBox`` folder, or one file with all boxes, for the given scans; None for all."""
    is_folder = path.is_dir()
    misnamed: list[str] = []
    if is_folder:
        listed, misnamed = _read_folder(reader, path, scans)
    else:
        content = reader.read(BOXES, path, "boxes") or {}
        keyed = [(_key(name), objects) for name, objects in content.items()]
        listed = [(key, objects) for key, objects in keyed if scans is None or key.scan_id in scans]
    entries, malformed = [], []
    for number, (key, objects) in enumerate(listed):
        for object_id, fields in objects.items():
            try:
                record = msgspec.convert(fields, ObjectRecord)
                record.name.encode()  # a lone surrogate is valid JSON, but not valid text
                entries.append(Entry(number, int(object_key(object_id)), record))
            except ValueError as error:  # msgspec's and the encoder's errors are ValueErrors
                malformed.append(f"{key} object {object_id}: {error}")
    viewpoints = [key for key, _ in listed]
    return Boxes(viewpoints, entries, graphs, misnamed, malformed, is_folder=is_folder)


_Listed = list[tuple[ViewpointKey, dict[str, Any]]]


def _read_folder(
    reader: Reader, folder: Path, scans: Collection[str] | None
) -> tuple[_Listed, list[str]]:
    paths = sorted(folder.glob("*.json"))
    wanted = [path for path in paths if scans is None or _key(path.stem).scan_id in scans]
    listed, misnamed = [], []
    for path, content in reader.read_each(BOXES, wanted, "boxes"):
        scan_id, viewpoint_id = _key(path.stem)
        if list(content) != [viewpoint_id]:
            misnamed.append(path.name)
        listed += [(ViewpointKey(scan_id, key), objects) for key, objects in content.items()]
    return listed, misnamed


def _key(scan_and_viewpoint: str) -> ViewpointKey:
    # From the right, because names of scans other than Matterport's may contain underscores.
    scan_id, _, viewpoint_id = scan_and_viewpoint.rpartition("_")
    return ViewpointKey(scan_id, viewpoint_id)


# Rules about the form of boxes.

_FETCH = "Fetch the files again, or fix the program that wrote them."


# A folder has a file for every viewpoint, so a missing one is an error. DUET's single file leaves
# out viewpoints without objects, so there it is a warning, unless the file is empty altogether.
def _without_boxes(boxes: Boxes, *, is_error: bool) -> Count:
    applies = is_error == (boxes.is_folder or not boxes.viewpoints)
    present = set(boxes.viewpoints)
    return Count.among(boxes.graphs.nodes, lambda key: applies and key not in present)


def _unknown(boxes: Boxes) -> Count:
    graphs = boxes.graphs

    def is_unknown(key: ViewpointKey) -> bool:
        is_known = graphs.is_node(key) or graphs.is_excluded(key)
        return not is_known and key.scan_id not in graphs.unreadable

    return Count.among(boxes.viewpoints, is_unknown)


def _views_where(boxes: Boxes, test: Callable[[list[int]], bool]) -> Count:
    """Count the entries whose views pass a test."""
    passes = [test(record.visible_pos) for _, _, record in boxes.entries]
    return Count.where(np.array(passes, dtype=np.bool_), boxes.entry_text)


def _several_names(boxes: Boxes) -> Count:
    names: dict[int, set[str]] = defaultdict(set)
    for number, (_, _, record) in zip(boxes.scan_object.tolist(), boxes.entries, strict=True):
        names[number].add(record.name)
    _, first = np.unique(boxes.scan_object, return_index=True)
    several = np.array([len(names[n]) > 1 for n in sorted(names)], dtype=np.bool_)
    return Count.where(several, lambda row: boxes.entry_text(first[row]))


def _reach_outside(boxes: Boxes) -> Count:
    near, extent = boxes.box_xywh[:, :2], boxes.box_xywh[:, 2:]
    outside = ((near < 0) | (near + extent > (WIDTH, HEIGHT))).any(axis=1)
    return Count.where(np.asarray(outside), boxes.box_text)


BOX_RULES: Sequence[Rule[Boxes]] = (
    info(
        "viewpoints-with-boxes",
        "viewpoints with a record of boxes",
        lambda boxes: Count(len(boxes.viewpoints)),
    ),
    info("listed", "objects listed at viewpoints", lambda boxes: Count(len(boxes.entries))),
    info("boxes", "boxes", lambda boxes: Count(len(boxes.box_entry))),
    error(
        "missing-boxes",
        "included viewpoints without a box file",
        "A viewpoint that sees no object has an empty file: copy the whole box folder.",
        partial(_without_boxes, is_error=True),
    ),
    warning(
        "left-out-of-boxes",
        "included viewpoints missing from the single file with all boxes",
        "They see no object, if the file is complete.",
        partial(_without_boxes, is_error=False),
    ),
    error(
        "boxes-of-unknown-viewpoint",
        "viewpoints with boxes that are not in any navigation graph",
        "Boxes and connectivity files belong to different datasets, or a graph is missing.",
        _unknown,
    ),
    warning(
        "boxes-of-excluded-viewpoint",
        "viewpoints with boxes that are not included in their navigation graph",
        "No agent can stand there, so no score depends on them. The published files have none.",
        lambda boxes: Count.among(boxes.viewpoints, boxes.graphs.is_excluded),
    ),
    error(
        "misnamed-boxes",
        "box files that do not contain exactly the viewpoint in their name",
        "Some programs use the name, others the content: name the file SCAN_VIEWPOINT.json.",
        lambda boxes: Count.from_names(boxes.misnamed, len(boxes.viewpoints)),
    ),
    error(
        "malformed-entry",
        "listed objects that do not have the published types",
        f"All other counts leave them out. {_FETCH}",
        lambda boxes: Count.from_names(boxes.malformed, len(boxes.entries) + len(boxes.malformed)),
    ),
    error(
        "unequal-lists",
        "listed objects with different numbers of views and boxes",
        f"It is unknown which box is in which view. {_FETCH}",
        lambda boxes: Count.where(boxes.n_views != boxes.n_boxes, boxes.entry_text),
    ),
    error(
        "duplicate-view",
        "listed objects with two boxes in one view",
        f"An object has one box in a view. {_FETCH}",
        lambda boxes: _views_where(boxes, lambda views: len(set(views)) < len(views)),
    ),
    warning(
        "unsorted-views",
        "listed objects whose views are not in ascending order",
        "They are in the published files, but no score depends on it.",
        lambda boxes: _views_where(boxes, lambda views: sorted(views) != views),
    ),
    warning(
        "several-names",
        "objects with different names at different viewpoints",
        "Published objects have one name; ids may be mixed up between scans or releases.",
        _several_names,
    ),
    error(
        "view-out-of-range",
        f"boxes in a view outside the range 0 to {N_VIEWS - 1}",
        f"Views are 12 headings in 3 rows, counted from 0. {_FETCH}",
        lambda boxes: Count.where(~np.isin(boxes.box_view, np.arange(N_VIEWS)), boxes.box_text),
    ),
    error(
        "box-without-area",
        "boxes whose width or height is not positive",
        f"Width and height count pixels, including the last one. {_FETCH}",
        lambda boxes: Count.where(boxes.box_xywh[:, 2:].min(axis=1) < 1, boxes.box_text),
    ),
    error(
        "box-outside",
        f"boxes that reach beyond the {WIDTH} x {HEIGHT} image",
        "Published boxes are cut to the image. Corners in place of sizes, or another image size, "
        f"cause this. {_FETCH}",
        _reach_outside,
    ),
)


# Rules about which objects are visible from where.

# How often a name must be listed for its share of visible objects to mean something.
_OFTEN = 100
_VISIBLE_FROM_FEW = (
    ("seen-once", "one viewpoint", 1),
    ("seen-twice", "two viewpoints", 2),
    ("seen-thrice", "three viewpoints", 3),
)


def _visible_from(boxes: Boxes, number: int) -> Count:
    return Count.where(boxes.sightings[1] == number)


def _visible_where(boxes: Boxes, mask: BoolArray) -> Count:
    """Count the visible entries for which the mask is true."""
    visible = boxes.visible
    return Count.where(mask[visible], lambda row: boxes.entry_text(visible[row]))


def _never_visible(boxes: Boxes) -> Count:
    objects, first = np.unique(boxes.scan_object, return_index=True)
    never = ~np.isin(objects, boxes.sightings[0])
    return Count.where(never, lambda row: boxes.entry_text(first[row]))


def _hidden_names(boxes: Boxes) -> Count:
    names = [record.name for _, _, record in boxes.entries]
    listed, visible = Counter(names), Counter(names[row] for row in boxes.visible.tolist())
    often = {name: visible[name] / count for name, count in listed.items() if count >= _OFTEN}
    # The most hidden come first, and those of equal shares in the order of their names.
    hidden = sorted((share, name) for name, share in often.items() if share < 1 / 2)
    examples = [
        f"{category_text(name)}: {listed[name] - visible[name]} of {listed[name]}"
        for _, name in hidden
    ]
    return Count.from_names(examples, len(often))


VISIBILITY_RULES: Sequence[Rule[Boxes]] = (
    info(
        "listing-viewpoints",
        "viewpoints that list an object",
        lambda boxes: Count(len(np.unique(boxes.viewpoint)), len(boxes.viewpoints)),
    ),
    info(
        "seeing-viewpoints",
        "viewpoints that see an object",
        lambda boxes: Count(
            len(np.unique(boxes.viewpoint[boxes.is_visible])), len(boxes.viewpoints)
        ),
    ),
    info(
        "objects",
        "objects listed somewhere",
        lambda boxes: Count(len(np.unique(boxes.scan_object))),
    ),
    info(
        "visible-objects",
        "objects visible somewhere",
        lambda boxes: Count(len(boxes.sightings[1]), len(np.unique(boxes.scan_object))),
    ),
    warning(
        "never-visible",
        "objects that are listed but visible nowhere",
        "None of them can be a target.",
        _never_visible,
    ),
    warning(
        "listed-not-visible",
        "listed objects that no view shows",
        "A listed object need not be visible: the dataset's own eval_release.py ignores these.",
        lambda boxes: Count.where(~boxes.is_visible, boxes.entry_text),
    ),
    warning(
        "hidden-name",
        f"names listed {_OFTEN} times or more, mostly without a view that shows the object",
        "Large things near the camera are often not visible in v1; small ones nearly always are.",
        _hidden_names,
    ),
    info(
        "visible",
        "listed objects that a view shows",
        lambda boxes: Count(len(boxes.visible), len(boxes.entries)),
    ),
    *(
        info(code, f"objects visible from {words}", partial(_visible_from, number=number))
        for code, words, number in _VISIBLE_FROM_FEW
    ),
    warning(
        "in-all-views",
        f"visible objects that have a box in each of the {N_VIEWS} views",
        "The camera seems to be inside them.",
        lambda boxes: _visible_where(boxes, boxes.n_views == N_VIEWS),
    ),
)


def visibility_spreads(boxes: Boxes) -> list[Spread]:
    """Measure how much of the objects can be seen."""
    return [
        spread(
            "viewpoints-per-object",
            "viewpoints that see an object, over visible objects",
            "",
            boxes.sightings[1],
        ),
        spread(
            "views-per-sighting",
            "views that show an object, over viewpoints that see it",
            "",
            boxes.n_views[boxes.visible],
        ),
    ]


# Rules about the sizes of boxes.

# A box is a sliver if its shorter side has at most so many pixels.
_SLIVER = 4
# An object is a speck if its largest box has an area of at most so many pixels.
_SPECK = 100


def touches_border(xywh: IntArray) -> BoolArray:
    """Whether boxes touch the image's left, upper, right and lower border: shape (n, 4)."""
    near, far = xywh[:, :2], xywh[:, :2] + xywh[:, 2:]
    return np.concatenate([near <= 0, far >= (WIDTH, HEIGHT)], axis=1)


SIZE_RULES: Sequence[Rule[Boxes]] = (
    warning(
        "full-image",
        "boxes that cover the whole image",
        "Any box of half the image is correct there: report what whole-image boxes would score.",
        lambda boxes: Count.where(
            (boxes.box_xywh[:, 2:] == (WIDTH, HEIGHT)).all(axis=1), boxes.box_text
        ),
    ),
    warning(
        "sliver",
        f"boxes with a side of at most {_SLIVER} pixels",
        "Usually the rest of an object at a border, or between other objects.",
        lambda boxes: Count.where(boxes.box_xywh[:, 2:].min(axis=1) <= _SLIVER, boxes.box_text),
    ),
    warning(
        "speck",
        f"visible objects whose largest box has at most {_SPECK} pixels",
        "They count as visible although hardly anything can be seen.",
        lambda boxes: _visible_where(boxes, boxes.largest_area <= _SPECK),
    ),
)


def size_spreads(boxes: Boxes) -> list[Spread]:
    """Measure the positions and sizes of the boxes."""
    left, top, width, height = boxes.box_xywh.T
    return [
        spread("box-left", "left edge of the boxes", "px", left),
        spread("box-top", "upper edge of the boxes", "px", top),
        spread("box-width", "width of the boxes", "px", width),
        spread("box-height", "height of the boxes", "px", height),
        spread("box-right", "right edge of the boxes: left + width", "px", left + width),
        spread("box-bottom", "lower edge of the boxes: top + height", "px", top + height),
        spread("box-area", "area of the boxes", "px", width * height),
    ]
