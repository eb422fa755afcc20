"""Rules for annotations: ids, paths in the navigation graphs, and targets at the goals."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from reverie_eval.arrays import BoolArray
from reverie_eval.dataset._dataset import Items, Targets
from reverie_eval.dataset._reader import mentioned_by
from reverie_eval.dataset._rules import Count, Rule, Spread, error, info, spread, warning
from reverie_eval.tasks import Annotation


def _shared_episodes(items: Items) -> Count:
    instr_ids, other = dict.fromkeys(items.split.instr_ids), items.other_splits
    return Count.among(instr_ids, lambda id_: id_ in other, lambda id_: f"{id_} of {other[id_]}")


def _count_items(items: Sequence[Annotation], which: Callable[[Annotation], bool]) -> Count:
    return Count.among(items, which, lambda item: item.name)


def _without_solution(items: Items) -> Count:
    # A split without any is a private one, and sound.
    has_solution = items.split.has_solution
    return _count_items(items.split.items, lambda item: has_solution and not item.has_solution)


def _without_graph(items: Items) -> Count:
    graphs = items.graphs
    # An unreadable file is reported by a rule of its own.
    with_file = graphs.scans.keys() | graphs.unreadable
    return _count_items(items.split.items, lambda item: item.scan not in with_file)


def _off_the_graph(items: Items) -> Count:
    scans, all_items = items.graphs.scans, items.split.items
    return _count_items(all_items, lambda item: item.scan in scans and not items.is_on_graph(item))


def _unreachable(items: Items) -> Count:
    def is_cut_off(item: Annotation) -> bool:
        scan = items.graphs.scans[item.scan]
        return len({scan.component[scan.row[id_]] for _, id_ in mentioned_by(item)}) > 1

    return _count_items(items.on_graph, is_cut_off)


def _off_the_edges(items: Items) -> Count:
    def leaves_edges(item: Annotation) -> bool:
        scan = items.graphs.scans[item.scan]
        return any(a != b and not scan.has_edge(a, b) for a, b in pairwise(item.reference))

    return _count_items(items.on_graph, leaves_edges)


ITEM_RULES: Sequence[Rule[Items]] = (
    info("items", "items", lambda items: Count(len(items.split.items))),
    info(
        "episodes",
        "episodes, one per instruction",
        lambda items: Count(len(items.split.instr_ids)),
    ),
    info("item-scans", "scans with an item", lambda items: Count(len(items.split.scans))),
    error(
        "malformed-item",
        "records that do not have the published form",
        "All other counts leave them out. Fetch the file again, or fix the program that wrote it.",
        lambda items: Count.from_names(
            items.split.malformed, len(items.split.items) + len(items.split.malformed)
        ),
    ),
    error(
        "missing-solution",
        "items without a solution in a file where others have one",
        "Give every item its solution, or none, as in the published test file. A solution is the "
        "objId (REVERIE), the bboxes (SOON), the paths and end_panos (NDH), or else a path of more "
        "than one viewpoint.",
        _without_solution,
    ),
    error(
        "duplicate-episode",
        "instr_ids used by more than one episode",
        "A submission has one prediction per instr_id: give every item its own id.",
        lambda items: Count.repeated(items.split.instr_ids),
    ),
    warning(
        "shared-episode",
        "instr_ids that also occur in another split",
        "Submissions to the two splits cannot be told apart: use different ids.",
        _shared_episodes,
    ),
    error(
        "missing-scan",
        "items in a scan without a connectivity file",
        "Copy the whole connectivity folder.",
        _without_graph,
    ),
    error(
        "unknown-viewpoint",
        "items with a viewpoint on their path that is not in their scan's graph",
        "Annotations and connectivity files belong to different datasets.",
        _off_the_graph,
    ),
    error(
        "unreachable-goal",
        "items with a viewpoint on their path that cannot be reached",
        "They cannot be scored: distances would be infinite.",
        _unreachable,
    ),
    warning(
        "path-off-edges",
        "items whose path moves between unconnected viewpoints",
        "Such a move counts at shortest-path distance.",
        _off_the_edges,
    ),
)

_MIXED_RELEASES = (
    "Annotations and boxes are probably from different releases (v2 annotations of val_seen with "
    "v1 boxes give 3 of 501): fetch both from the same one."
)


def _where(targets: Targets, mask: BoolArray) -> Count:
    """Count the items for which the mask is true."""
    return Count.where(mask, lambda row: targets.items[row].name)


TARGET_RULES: Sequence[Rule[Targets]] = (
    info(
        "targets",
        "distinct target objects",
        lambda targets: Count(len({(item.scan, item.target) for item in targets.items})),
    ),
    error(
        "target-not-listed",
        "items whose target is not listed where the path ends",
        _MIXED_RELEASES,
        lambda targets: _where(targets, targets.at_goal < 0),
        tolerated_by=["describe"],
    ),
    error(
        "target-not-visible",
        "items whose target is listed where the path ends, but not visible in any view",
        _MIXED_RELEASES,
        lambda targets: _where(
            targets, (targets.at_goal >= 0) & ~targets.is_visible(targets.at_goal)
        ),
        # The published train split has one; `describe` adds a note.
        tolerated_by=["describe"],
    ),
    warning(
        "target-at-start",
        "items whose target is visible where the path begins",
        "An agent that does not move succeeds.",
        lambda targets: _where(targets, targets.is_visible(targets.at_start)),
    ),
    info(
        "single-goal",
        "items whose target is visible from one viewpoint only",
        lambda targets: Count.where(targets.n_viewpoints == 1),
    ),
)


def target_spreads(targets: Targets) -> list[Spread]:
    """Measure how visible the targets are, and how many other objects are at the goals."""
    boxes = targets.boxes
    visible_target = targets.at_goal[targets.is_visible(targets.at_goal)]
    goal = boxes.viewpoint[targets.at_goal[targets.at_goal >= 0]]
    visible = np.bincount(boxes.viewpoint[boxes.is_visible], minlength=len(boxes.viewpoints))
    n_boxes = np.bincount(boxes.viewpoint, boxes.n_boxes, minlength=len(boxes.viewpoints))
    views, area = boxes.n_views[visible_target], boxes.largest_area[visible_target]
    seen_from = targets.n_viewpoints
    return [
        spread("viewpoints-per-target", "viewpoints that see the target", "", seen_from),
        spread("views-per-target", "views that show the target at the goal", "", views),
        spread("target-area", "largest box of the target at the goal", "px", area),
        spread("objects-at-goal", "objects visible at the goal", "", visible[goal]),
        spread("boxes-at-goal", "boxes at the goal", "", n_boxes[goal]),
    ]
