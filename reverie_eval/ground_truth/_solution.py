"""The solution of a split: targets, annotated paths, and candidates with their boxes."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, starmap
from typing import Literal

import numpy as np

from reverie_eval.arrays import (
    Array,
    BoolArray,
    FloatArray,
    IntArray,
    KeyTable,
    find_sorted,
    last_of,
    offsets_of,
    row_of,
    take_rows,
    with_object,
)
from reverie_eval.errors import GroundTruthError
from reverie_eval.geometry import N_VIEWS
from reverie_eval.ground_truth._bundle import Bundle, pack_texts, unpack_texts
from reverie_eval.metrics import SUCCESS_DISTANCE

_FURTHER = "path/"
NO_TARGET = -2
"""The target object of episodes without one; no prediction equals it, not even an abstention."""


@dataclass(frozen=True, eq=False)
class CandidateBoxes:
    """The annotated boxes: one for each view of its viewpoint that shows a candidate."""

    candidate: IntArray
    """Shape (n_boxes,): row of the candidate, ascending."""
    candidate_viewpoint: IntArray
    """Shape (n_candidates,): the viewpoint from which each candidate is visible."""
    view: IntArray
    """Shape (n_boxes,): view index, 0 to 35."""
    xywh: IntArray
    """Shape (n_boxes, 4): left, top, width, height in pixels of the view."""

    def find(self, candidate: IntArray, view: IntArray) -> tuple[IntArray, BoolArray]:
        """Return the row of each candidate's box in each view, and whether there is one."""
        order, keys = self._by_candidate
        index, has_box = keys.find(_view_key(candidate, view))
        return order[index], has_box

    def pair_with_others(self, box: IntArray) -> tuple[IntArray, IntArray]:
        """Pair boxes with the boxes of all other objects in the same view.

        Returns
        -------
        two int arrays of shape (n_pairs,)
            An index into ``box``, ascending, and the row of the other box.
        """
        index, other = self._pair_with_images(self._image[box])
        # An image lists the box itself as well.
        is_other = self.candidate[other] != self.candidate[box[index]]
        return index[is_other], other[is_other]

    def pair_with_all(self, viewpoint: IntArray, view: IntArray) -> tuple[IntArray, IntArray]:
        """Pair views at viewpoints with all boxes in them.

        Returns
        -------
        two int arrays of shape (n_pairs,)
            An index into ``viewpoint`` and ``view``, ascending, and the row of the box.
        """
        return self._pair_with_images(_view_key(viewpoint, view))

    def _pair_with_images(self, image: IntArray) -> tuple[IntArray, IntArray]:
        order, images, offsets = self._by_image
        number, has_boxes = images.find(image)
        index, number = np.flatnonzero(has_boxes), number[has_boxes]
        return np.repeat(index, np.diff(offsets)[number]), order[take_rows(number, offsets)]

    # Sorted indexes are cached, so that an evaluator sorts the boxes of a split only once.

    @cached_property
    def _by_candidate(self) -> tuple[IntArray, KeyTable]:
        """Rows of the boxes in the order of candidate and view, and their keys."""
        keys = _view_key(self.candidate, self.view)
        order = np.argsort(keys, kind="stable")
        return order, KeyTable(keys[order])

    @cached_property
    def _by_image(self) -> tuple[IntArray, KeyTable, IntArray]:
        """Rows of the boxes in the order of viewpoint and view; their images; offsets."""
        order = np.argsort(self._image, kind="stable")
        images, count = np.unique(self._image, return_counts=True)
        return order, KeyTable(images), offsets_of(count)

    @cached_property
    def _image(self) -> IntArray:
        """Shape (n_boxes,): one number for the viewpoint and view of each box."""
        return _view_key(self.candidate_viewpoint[self.candidate], self.view)


@dataclass(frozen=True, eq=False)
class Solution:
    """Everything that a public bundle leaves out.

    In a task without target objects there are no candidates, boxes and categories either.
    """

    target_object: IntArray
    """Shape (n_episodes,): object id within the episode's scan, or ``NO_TARGET``."""
    goal: IntArray
    """Shape (n_episodes,): last viewpoint of the annotated path."""
    candidate_viewpoint: IntArray
    """Shape (n_candidates,): the viewpoints of all visible objects, by viewpoint and object id."""
    candidate_object: IntArray
    """Shape (n_candidates,): object id within the viewpoint's scan."""
    candidate_distance: FloatArray | None
    """Shape (n_candidates,): metres from camera to object centre, inf if the centre is unknown;
    None if the bundle was compiled without object positions."""
    target_position: FloatArray | None
    """Shape (n_episodes, 3): the target's centre in the scan's frame, metres, inf if unknown; None
    if the bundle was compiled without object positions."""
    boxes: CandidateBoxes
    path: IntArray
    """Annotated paths of the items, end to end."""
    path_offsets: IntArray
    """Shape (n_items + 1,): where each item's path begins in ``path``."""
    # Unpacked when needed: scoring does not read them.
    packed_categories: Array
    packed_candidate_categories: Array
    goal_viewpoint: IntArray | None = None
    """Annotated goals of the items, end to end; None if the task has none besides paths."""
    goal_offsets: IntArray | None = None
    """Shape (n_items + 1,): where each item's goals begin in ``goal_viewpoint``."""
    goal_outline: FloatArray | None = None
    """Shape (n_goals, 5, 2): centre and corners of the target as each goal viewpoint sees it,
    heading and elevation in turns; None if the task does not annotate that."""
    further_paths: Mapping[str, tuple[IntArray, IntArray]] = field(default_factory=dict)
    """Other annotated paths by name, each as ``path`` and ``path_offsets``."""

    @classmethod
    def from_bundle(cls, bundle: Bundle) -> "Solution | None":
        """Return the solution in a bundle; None if it is public."""
        if bundle.is_public:
            return None
        arrays = bundle.arrays
        item = arrays["episode_task"]
        item_goal = arrays["path"][last_of(arrays["path_offsets"])]
        has_targets = "task_target" in arrays
        targets = {**arrays, **bundle.texts} if has_targets else _without_targets(len(item_goal))
        position = arrays.get("target_position")
        return cls(
            target_object=targets["task_target"][item],
            goal=item_goal[item],
            candidate_viewpoint=targets["candidate_viewpoint"],
            candidate_object=targets["candidate_object"],
            candidate_distance=targets.get("candidate_distance"),
            target_position=None if position is None else position[item],
            boxes=CandidateBoxes(
                candidate=targets["box_candidate"],
                candidate_viewpoint=targets["candidate_viewpoint"],
                view=targets["box_view"],
                xywh=targets["box_xywh"],
            ),
            path=arrays["path"],
            path_offsets=arrays["path_offsets"],
            packed_categories=targets["target_category"],
            packed_candidate_categories=targets["candidate_category"],
            goal_viewpoint=arrays.get("goal_viewpoint"),
            goal_offsets=arrays.get("goal_offsets"),
            goal_outline=arrays.get("goal_outline"),
            further_paths={
                name.removeprefix(_FURTHER): (path, arrays[f"path_offsets/{name[len(_FURTHER) :]}"])
                for name, path in arrays.items()
                if name.startswith(_FURTHER)
            },
        )

    def take(self, rows: IntArray) -> "Solution":
        """Return the solution of some episodes; items, paths and candidates stay."""
        position = self.target_position
        return replace(
            self,
            target_object=self.target_object[rows],
            goal=self.goal[rows],
            target_position=None if position is None else position[rows],
        )

    @cached_property
    def target_categories(self) -> tuple[str, ...]:
        """The annotated category of each item's target; empty if it has none."""
        return unpack_texts(self.packed_categories, "categories", len(self.path_offsets) - 1)

    @cached_property
    def candidate_categories(self) -> tuple[str, ...]:
        """The annotated category of each candidate."""
        packed, count = self.packed_candidate_categories, len(self.candidate_object)
        return unpack_texts(packed, "categories of candidates", count)

    def along(self, reference: str, item: IntArray) -> "Solution":
        """Return the solution with one of the further paths in place of the usual one.

        ``item`` is the item of each episode.
        """
        path, offsets = self.further_paths[reference]
        return replace(self, path=path, path_offsets=offsets, goal=path[last_of(offsets)][item])

    def goals(self) -> tuple[IntArray, IntArray]:
        """Return the annotated goals of the items, and where each item's begin.

        Raises
        ------
        GroundTruthError
            If the bundle has none.
        """
        if self.goal_viewpoint is None or self.goal_offsets is None:
            raise GroundTruthError("this ground truth has no goals besides its paths")
        return self.goal_viewpoint, self.goal_offsets

    def is_goal(self, item: IntArray, viewpoint: IntArray) -> BoolArray:
        """Whether each viewpoint is an annotated goal of the item."""
        return find_sorted(self._goal_keys, with_object(item, viewpoint))[1]

    def outlines(
        self, item: IntArray, viewpoint: IntArray, which: Literal["first", "last"]
    ) -> FloatArray:
        """Return the outline of each item's target as a viewpoint sees it.

        Returns
        -------
        float array of shape (n, 5, 2)
            The first or the last of a viewpoint's outlines; NaN where it does not see the target.

        Raises
        ------
        GroundTruthError
            If the bundle has none.
        """
        goal, offsets = self.goals()
        if self.goal_outline is None:
            raise GroundTruthError("this ground truth has no outlines of its targets")
        # np.unique gives the first of equal keys; in a reversed column, that is the last.
        step = 1 if which == "first" else -1
        keys, row = np.unique(with_object(row_of(offsets), goal)[::step], return_index=True)
        index, is_seen = find_sorted(keys, with_object(item, viewpoint))
        outline = self.goal_outline[::step][row[index]]
        return np.where(is_seen[:, None, None], outline, np.nan)

    @cached_property
    def goal_region(self) -> IntArray:
        """Shape (n_items,): a number for each set of annotated goals."""
        goal, offsets = self.goals()
        sets = [frozenset(goal[slice(*ends)].tolist()) for ends in pairwise(offsets.tolist())]
        number = {region: index for index, region in enumerate(dict.fromkeys(sets))}
        return np.array([number[region] for region in sets])

    @cached_property
    def _goal_keys(self) -> IntArray:
        goal, offsets = self.goals()
        return np.unique(with_object(row_of(offsets), goal))

    def visible_from(self, viewpoint: int) -> Iterator[tuple[int, slice]]:
        """Yield the candidates of a viewpoint, by object id, and where the boxes of each are."""
        first, end = np.searchsorted(self.candidate_viewpoint, [viewpoint, viewpoint + 1]).tolist()
        begin = np.searchsorted(self.boxes.candidate, np.arange(first, end + 1)).tolist()
        yield from zip(range(first, end), starmap(slice, pairwise(begin)), strict=True)

    def is_visible(self, target_object: IntArray, viewpoint: IntArray) -> BoolArray:
        """Whether each object is visible from each viewpoint of its scan."""
        return self.find(target_object, viewpoint)[1]

    def is_visible_near(self, target_object: IntArray, viewpoint: IntArray) -> BoolArray:
        """Whether each object is visible and at most 3 m from the camera, in a straight line.

        Only for bundles with object positions. Distances are to the object's centre.

        References
        ----------
        .. [1] ``r2r_src/eval.py`` lines 182-185 of YanyuanQiao/HOP-REVERIE-Challenge.
        """
        candidate, is_visible = self.find(target_object, viewpoint)
        distance = np.asarray(self.candidate_distance)
        return np.logical_and(is_visible, distance[candidate] <= SUCCESS_DISTANCE)

    def find(self, target_object: IntArray, viewpoint: IntArray) -> tuple[IntArray, BoolArray]:
        """Return the candidate's row for each object and viewpoint, and whether there is one."""
        return self._candidate_keys.find(with_object(viewpoint, target_object))

    @cached_property
    def _candidate_keys(self) -> KeyTable:
        # Ascending without a sort, because the compiler orders candidates by viewpoint and object.
        return KeyTable(with_object(self.candidate_viewpoint, self.candidate_object))


def _without_targets(n_items: int) -> Mapping[str, Array]:
    """Return the arrays and texts of targets and candidates for a task that has none."""
    nothing = np.zeros(0, dtype=np.int64)
    return {
        "task_target": np.full(n_items, NO_TARGET),
        "candidate_viewpoint": nothing,
        "candidate_object": nothing,
        "box_candidate": nothing,
        "box_view": nothing,
        "box_xywh": nothing.reshape(0, 4),
        "target_category": pack_texts([""] * n_items),
        "candidate_category": pack_texts([]),
    }


def _view_key(candidate_or_viewpoint: IntArray, view: IntArray) -> IntArray:
    """Return one number for each pair, as :func:`reverie_eval.arrays.with_object` does."""
    return candidate_or_viewpoint.astype(np.int64) * N_VIEWS + view
