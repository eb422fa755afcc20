"""Whether the boxes have the published form, and whether they belong to the navigation graphs."""

from collections import defaultdict

import numpy as np

from reverie_eval.arrays import BoolArray
from reverie_eval.geometry import HEIGHT, N_VIEWS, WIDTH
from reverie_eval.linting.boxes import Boxes
from reverie_eval.linting.graphs import Graphs
from reverie_eval.linting.rows import Count, Found, fact, fault, remark

_FETCH = "Fetch the files again, or mend what wrote them."


def box_form_counts(boxes: Boxes, graphs: Graphs) -> list[Count]:
    """Count records and boxes, and whatever is not as published."""
    return [
        fact("viewpoints-with-boxes", "viewpoints with a record of boxes", len(boxes.places)),
        fact("listed", "objects listed at viewpoints", len(boxes.listed)),
        fact("boxes", "boxes", len(boxes.box_entry)),
        *_belonging(boxes, graphs),
        *_entries(boxes),
        *_numbers(boxes),
    ]


def _belonging(boxes: Boxes, graphs: Graphs) -> list[Count]:
    there, nodes = set(boxes.places), graphs.nodes
    without = Found.among([str(place) for place in nodes if place not in there], len(nodes))
    none = Found(0, len(nodes))
    unknown = [p for p in boxes.places if not graphs.is_node(p) and not graphs.is_excluded(p)]
    excluded = [place for place in boxes.places if graphs.is_excluded(place)]
    return [
        fault(
            "missing-boxes",
            "included viewpoints without a box file",
            "A viewpoint that sees nothing has an empty one: copy the whole box folder.",
            without if boxes.is_folder else none,
        ),
        remark(
            "left-out-of-boxes",
            "included viewpoints that the one file with all boxes leaves out",
            "They see nothing, if the file is whole.",
            none if boxes.is_folder else without,
        ),
        fault(
            "boxes-of-unknown-viewpoint",
            "viewpoints with boxes that no navigation graph knows",
            "Boxes and connectivity files belong to different datasets, or a graph is missing.",
            Found.among(list(map(str, unknown)), len(boxes.places)),
        ),
        fault(
            "boxes-of-excluded-viewpoint",
            "viewpoints with boxes that are not included in their navigation graph",
            "Nobody can stand there: the published files have none, so others were mixed in.",
            Found.among(list(map(str, excluded)), len(boxes.places)),
        ),
        fault(
            "misnamed-boxes",
            "box files that do not hold the one viewpoint they are named after",
            "Some programs read the name, others the content: name the file SCAN_VIEWPOINT.json.",
            Found.among(boxes.misnamed, len(boxes.places)),
        ),
    ]


def _entries(boxes: Boxes) -> list[Count]:
    views = [entry.visible_pos for _, _, entry in boxes.listed]
    twice = np.array([len(set(seen)) < len(seen) for seen in views], dtype=np.bool_)
    unsorted = np.array([sorted(seen) != seen for seen in views], dtype=np.bool_)
    return [
        fault(
            "malformed-entry",
            "listed objects that are not of the published types",
            f"They are not counted below. {_FETCH}",
            Found.among(boxes.malformed, len(boxes.listed) + len(boxes.malformed)),
        ),
        fault(
            "unequal-lists",
            "listed objects with more views than boxes, or fewer",
            f"Which box is in which view is not known. {_FETCH}",
            Found.where(boxes.n_views != boxes.n_boxes, boxes.name_of_entry),
        ),
        fault(
            "duplicate-view",
            "listed objects with two boxes in one view",
            f"An object has one box in a view. {_FETCH}",
            Found.where(twice, boxes.name_of_entry),
        ),
        remark(
            "unsorted-views",
            "listed objects whose views are not in ascending order",
            "The published ones are; no score depends on it.",
            Found.where(unsorted, boxes.name_of_entry),
        ),
        _several_names(boxes),
    ]


def _several_names(boxes: Boxes) -> Count:
    names: dict[int, set[str]] = defaultdict(set)
    for number, (_, _, entry) in zip(boxes.scan_object.tolist(), boxes.listed, strict=True):
        names[number].add(entry.name)
    _, first = np.unique(boxes.scan_object, return_index=True)
    several = np.array([len(names[n]) > 1 for n in sorted(names)], dtype=np.bool_)
    return remark(
        "several-names",
        "objects that are not called the same wherever they are listed",
        "The published ones are; ids may have been mixed up between scans or releases.",
        Found.where(several, lambda row: boxes.name_of_entry(first[row])),
    )


def _numbers(boxes: Boxes) -> list[Count]:
    return [
        fault(
            "view-out-of-range",
            f"boxes in a view that is none of 0 to {N_VIEWS - 1}",
            f"Views are 12 headings in 3 rows, counted from 0. {_FETCH}",
            Found.where(~np.isin(boxes.box_view, np.arange(N_VIEWS)), boxes.name_of_box),
        ),
        fault(
            "box-without-area",
            "boxes whose width or height is not positive",
            f"Width and height count pixels, the last one included. {_FETCH}",
            Found.where(boxes.box_xywh[:, 2:].min(axis=1) < 1, boxes.name_of_box),
        ),
        fault(
            "box-outside",
            f"boxes that reach beyond the {WIDTH} x {HEIGHT} picture",
            "Boxes are cut to the picture: corners taken for sizes, or another picture size, look "
            f"like this. {_FETCH}",
            Found.where(_reaches_outside(boxes), boxes.name_of_box),
        ),
    ]


def _reaches_outside(boxes: Boxes) -> BoolArray:
    near, extent = boxes.box_xywh[:, :2], boxes.box_xywh[:, 2:]
    return np.asarray(((near < 0) | (near + extent > (WIDTH, HEIGHT))).any(axis=1))
