"""The answers of a split: targets, annotated paths, and candidates with their boxes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reverie_eval.arrays import (
    Array,
    BoolArray,
    FloatArray,
    IntArray,
    find_sorted,
    last_of,
    offsets_of,
    row_of,
)
from reverie_eval.geometry import N_VIEWS
from reverie_eval.ground_truth._bundle import Bundle, unpack_texts
from reverie_eval.metrics import SUCCESS_DISTANCE


@dataclass(frozen=True, eq=False)
class CandidateBoxes:
    """Every annotated box: a candidate in a view of its viewpoint."""

    candidate: IntArray
    """Shape (n_boxes,): row of the candidate, ascending."""
    candidate_viewpoint: IntArray
    """Shape (n_candidates,): the viewpoint that each candidate is seen from."""
    view: IntArray
    """Shape (n_boxes,): view index, 0 to 35."""
    xywh: IntArray
    """Shape (n_boxes, 4): left, top, width, height in pixels of the view."""

    def find(self, candidate: IntArray, view: IntArray) -> tuple[IntArray, BoolArray]:
        """Return the row of each candidate's box in each view, and whether there is one."""
        order, keys = self._by_candidate
        place, found = find_sorted(keys, self._key(candidate, view))
        return order[place], found

    def beside(self, box: IntArray) -> tuple[IntArray, IntArray]:
        """Pair boxes with the boxes of all other objects in the same view.

        Returns
        -------
        two int arrays of shape (n_pairs,)
            An index into ``box``, ascending, and the row of the other box.
        """
        order, images = self._by_image
        begin = np.searchsorted(images, self._image[box], side="left")
        end = np.searchsorted(images, self._image[box], side="right")
        position = row_of(offsets_of(end - begin))
        within = np.arange(len(position)) - offsets_of(end - begin)[:-1][position]
        other = order[begin[position] + within]
        is_other = self.candidate[other] != self.candidate[box[position]]
        return position[is_other], other[is_other]

    @cached_property
    def _by_candidate(self) -> tuple[IntArray, IntArray]:
        """Boxes in the order of candidate and view, and their keys."""
        keys = self._key(self.candidate, self.view)
        order = np.argsort(keys, kind="stable")
        return order, keys[order]

    @cached_property
    def _image(self) -> IntArray:
        """Shape (n_boxes,): one number for viewpoint and view."""
        return self._key(self.candidate_viewpoint[self.candidate], self.view)

    @cached_property
    def _by_image(self) -> tuple[IntArray, IntArray]:
        order = np.argsort(self._image, kind="stable")
        return order, self._image[order]

    @staticmethod
    def _key(owner: IntArray, view: IntArray) -> IntArray:
        return owner.astype(np.int64) * N_VIEWS + view


@dataclass(frozen=True, eq=False)
class Answers:
    """What a public bundle leaves out."""

    target_object: IntArray
    """Shape (n_episodes,): object id within the episode's scan."""
    goal: IntArray
    """Shape (n_episodes,): last viewpoint of the annotated path."""
    candidate_viewpoint: IntArray
    """Shape (n_candidates,): every visible object of every viewpoint, by viewpoint and id."""
    candidate_object: IntArray
    """Shape (n_candidates,): object id within the viewpoint's scan."""
    candidate_distance: FloatArray | None
    """Shape (n_candidates,): metres from camera to object centre, inf if the centre is unknown;
    None if the bundle was compiled without object positions."""
    boxes: CandidateBoxes
    """The boxes of the candidates in the views."""
    path: IntArray
    """Annotated paths of the tasks, end to end."""
    path_offsets: IntArray
    """Shape (n_tasks + 1,): where each task's path begins in ``path``."""
    packed_categories: Array | None = None

    @classmethod
    def from_bundle(cls, bundle: Bundle) -> "Answers | None":
        """Take the answers out of a bundle; None if it is public."""
        if bundle.is_public:
            return None
        arrays = bundle.arrays
        task = arrays["episode_task"]
        task_goal = arrays["path"][last_of(arrays["path_offsets"])]
        return cls(
            target_object=arrays["task_target"][task],
            goal=task_goal[task],
            candidate_viewpoint=arrays["candidate_viewpoint"],
            candidate_object=arrays["candidate_object"],
            candidate_distance=arrays.get("candidate_distance"),
            boxes=CandidateBoxes(
                candidate=arrays["box_candidate"],
                candidate_viewpoint=arrays["candidate_viewpoint"],
                view=arrays["box_view"],
                xywh=arrays["box_xywh"],
            ),
            path=arrays["path"],
            path_offsets=arrays["path_offsets"],
            packed_categories=bundle.texts.get("target_category"),
        )

    @cached_property
    def target_categories(self) -> tuple[str, ...]:
        """The annotated name of each task's target; empty if it has none.

        Raises
        ------
        GroundTruthError
            If the bundle has no names.
        """
        return unpack_texts(self.packed_categories, "categories", len(self.path_offsets) - 1)

    def is_visible(self, target_object: IntArray, viewpoint: IntArray) -> BoolArray:
        """Whether each object is visible from each viewpoint of its scan."""
        return self.find(target_object, viewpoint)[1]

    def is_visible_near(self, target_object: IntArray, viewpoint: IntArray) -> BoolArray:
        """Whether it is visible and its centre at most 3 m from the camera, in a straight line.

        Only for bundles with object positions.

        References
        ----------
        .. [1] ``r2r_src/eval.py`` lines 182-185 of YanyuanQiao/HOP-REVERIE-Challenge.
        """
        slot, found = self.find(target_object, viewpoint)
        distance = np.asarray(self.candidate_distance)
        return np.logical_and(found, distance[slot] <= SUCCESS_DISTANCE)

    def find(self, target_object: IntArray, viewpoint: IntArray) -> tuple[IntArray, BoolArray]:
        """Return the row of each object at each viewpoint, and whether it is a candidate there."""
        return find_sorted(self._candidates, _candidate_key(viewpoint, target_object))

    @cached_property
    def _candidates(self) -> IntArray:
        return _candidate_key(self.candidate_viewpoint, self.candidate_object)


def _candidate_key(viewpoint: IntArray, object_id: IntArray) -> IntArray:
    """One number for a viewpoint and an object, in the order of candidates."""
    return (viewpoint.astype(np.int64) << 32) | object_id
