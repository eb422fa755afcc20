"""The boxes of a split's candidates, found by what they surround or by the picture they are in."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reverie_eval.arrays import BoolArray, IntArray, find_sorted, offsets_of, row_of
from reverie_eval.geometry import N_VIEWS


@dataclass(frozen=True, eq=False)
class CandidateBoxes:
    """Every box of the annotation: a candidate in a view of its viewpoint."""

    candidate: IntArray
    """Shape (n_boxes,): row of the candidate, ascending."""
    candidate_viewpoint: IntArray
    """Shape (n_candidates,): where each candidate is seen from."""
    view: IntArray
    """Shape (n_boxes,): view index, 0 to 35."""
    xywh: IntArray
    """Shape (n_boxes, 4): left, top, width, height in pixels of the view."""

    def find(self, candidate: IntArray, view: IntArray) -> tuple[IntArray, BoolArray]:
        """Return the box of each candidate in each view, if it has one there."""
        order, keys = self._by_candidate
        place, found = find_sorted(keys, self._key(candidate, view))
        return order[place], found

    def beside(self, box: IntArray) -> tuple[IntArray, IntArray]:
        """Pair boxes with all other objects' boxes in the same picture.

        Returns
        -------
        two int arrays of shape (n_pairs,)
            A position in ``box``, ascending, and the other box.
        """
        order, pictures = self._by_picture
        begin = np.searchsorted(pictures, self._picture[box], side="left")
        end = np.searchsorted(pictures, self._picture[box], side="right")
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
    def _picture(self) -> IntArray:
        """Shape (n_boxes,): one number for viewpoint and view."""
        return self._key(self.candidate_viewpoint[self.candidate], self.view)

    @cached_property
    def _by_picture(self) -> tuple[IntArray, IntArray]:
        order = np.argsort(self._picture, kind="stable")
        return order, self._picture[order]

    @staticmethod
    def _key(owner: IntArray, view: IntArray) -> IntArray:
        return owner.astype(np.int64) * N_VIEWS + view
