"""What pointers have in common: what they are shown at a viewpoint, and what they answer."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from reverie_eval.agents.trained._coding import N_AROUND, N_LOCATION, N_OFFSET, Panorama
from reverie_eval.agents.trained._navigating import WordEncoder
from reverie_eval.arrays import FloatArray


class Question(NamedTuple):
    """The question which of the objects at a viewpoint an instruction means."""

    panorama: Panorama
    matches: FloatArray
    """Shape (n_names,): of the instruction with each name."""


class Candidates(NamedTuple):
    """The objects of B questions, padded to J."""

    valid: Tensor
    """bool (B, J)."""
    name: Tensor
    """int (B, J)."""
    match: Tensor
    """float (B, J, 1): the share of the name's words that the instruction says."""
    location: Tensor
    """float (B, J, N_LOCATION): where an object is and how large, also among those of its name."""
    around: Tensor
    """int (B, J, N_AROUND): the names of the nearest objects of other names; -1 if there are
    fewer."""
    offset: Tensor
    """float (B, J, N_AROUND, N_OFFSET): where those are from it."""

    def only(self, which: Tensor) -> "Candidates":
        """Return one object of each question, int (B,), as the only one."""
        rows = torch.arange(len(which))
        return Candidates(*(each[rows, which][:, None] for each in self))


def candidates_of(questions: Sequence[Question]) -> Candidates:
    """Put questions into tensors."""
    sizes = np.array([len(each.panorama.name) for each in questions])
    shape = len(questions), max(1, int(sizes.max()))
    name = np.zeros(shape, dtype=np.int64)
    match = np.zeros((*shape, 1), dtype=np.float32)
    location = np.zeros((*shape, N_LOCATION), dtype=np.float32)
    around = np.full((*shape, N_AROUND), -1)
    offset = np.zeros((*shape, N_AROUND, N_OFFSET), dtype=np.float32)
    for row, (size, question) in enumerate(zip(sizes, questions, strict=True)):
        panorama = question.panorama
        name[row, :size] = panorama.name
        match[row, :size, 0] = question.matches[panorama.name]
        layout = panorama.layout
        location[row, :size] = layout.location
        around[row, :size] = layout.around
        offset[row, :size] = layout.offset
    return Candidates(
        torch.from_numpy(np.arange(shape[1]) < sizes[:, None]),
        *map(torch.from_numpy, (name, match, location, around, offset)),
    )


class Pointer(nn.Module, ABC):
    """A model that scores the objects at a viewpoint."""

    encoder: WordEncoder

    @abstractmethod
    def forward(self, words: Tensor, tokens: Tensor, candidates: Candidates) -> Tensor:
        """Score candidates: float (B, J), -inf where there is none.

        ``words`` is int (B, L), and ``tokens`` int (n_names, T): the words of all names.
        """
