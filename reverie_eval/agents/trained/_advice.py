"""The interaction of navigator and pointer: which objects a pointer would choose in each slot.

Qi et al., "REVERIE", CVPR 2020, section 4: the labels of the three objects that the pointer
scores best in each view that the agent can go to are a part of what the navigator sees.
"""

from collections.abc import Sequence

import numpy as np
import torch

from reverie_eval.agents.trained._coding import Coder
from reverie_eval.agents.trained._navigating import N_TOP
from reverie_eval.agents.trained._world import World
from reverie_eval.agents.trained.pointers import Pointer, Question, candidates_of
from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.ground_truth import GroundTruth


class AdvisedWorld(World):
    """A world in which a pointer, which is not trained any more, looks at every viewpoint first."""

    def __init__(self, truth: GroundTruth, coder: Coder, pointer: Pointer, its: Coder) -> None:
        super().__init__(truth, coder)
        self._pointer, self._its = pointer, World(truth, its)
        self._tops: dict[tuple[int, int], IntArray] = {}

    def tops(self, rows: IntArray, viewpoints: IntArray) -> Sequence[IntArray | None]:
        """Return the names that the pointer chooses in each slot, (n_slots, N_TOP)."""
        asked = list(zip(rows.tolist(), viewpoints.tolist(), strict=True))
        new = [each for each in asked if each not in self._tops]
        if new:
            questions = [
                Question(self._its.panoramas[at], self._its.matches(row)) for row, at in new
            ]
            words = np.stack([self._its.words[row] for row, _ in new])
            scores = point(self._pointer, self._its.coder, words, questions)
            for (row, at), its in zip(new, scores, strict=True):
                panorama = self.panoramas[at]
                top = best_names(its[: len(panorama.name)], panorama.name, panorama.in_slot)
                self._tops[row, at] = top
        return [self._tops[each] for each in asked]


@torch.no_grad()
def point(
    model: Pointer, coder: Coder, words: IntArray, questions: Sequence[Question]
) -> FloatArray:
    """Return the scores (B, J) of all objects, for expressions (B, L) with words of the coder."""
    tokens = torch.from_numpy(coder.tokens)
    scores: FloatArray = model(torch.from_numpy(words), tokens, candidates_of(questions)).numpy()
    return scores


def best_names(scores: FloatArray, name: IntArray, in_slot: BoolArray) -> IntArray:
    """Return the names of the best objects in each slot, and -1 where there are fewer.

    Parameters
    ----------
    scores : float array of shape (n_objects,)
        The pointer's.
    name : int array of shape (n_objects,)
        The names, as the navigator numbers them.
    in_slot : bool array of shape (n_slots, n_objects)

    Returns
    -------
    int array of shape (n_slots, N_TOP)
        The best first.
    """
    in_order = np.argsort(-scores, kind="stable")
    best = np.full((len(in_slot), N_TOP), -1)
    for row, its in zip(best, in_slot[:, in_order], strict=True):
        chosen = name[in_order[its][:N_TOP]]
        row[: len(chosen)] = chosen
    return best
