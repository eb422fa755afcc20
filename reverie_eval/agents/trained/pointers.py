"""The pointers of the papers, each a network that scores the objects at a viewpoint by their names.

E is the size of an embedding, and H that of a hidden state.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from reverie_eval.agents.trained._coding import N_AROUND, N_LOCATION, N_OFFSET, Coder, Panorama
from reverie_eval.agents.trained.navigators import DROPOUT, N_TOP, Sizes, WordEncoder
from reverie_eval.arrays import BoolArray, FloatArray, IntArray


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

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.encoder = WordEncoder(sizes)

    @abstractmethod
    def forward(self, words: Tensor, tokens: Tensor, candidates: Candidates) -> Tensor:
        """Return the scores of candidates, float (B, J): -inf where there is no candidate.

        ``words`` is int (B, L), and ``tokens`` int (n_names, T): the words of all names.
        """


class NameRnn(Pointer):
    """The paper's CNN-RNN pointer.

    Qi et al., "REVERIE", CVPR 2020, section 5: an LSTM reads the expression, a CNN sees a
    candidate, and a triplet loss ranks them by the likeness of both vectors. Here the mean of a
    name's words is what a candidate looks like; boxes are not read.
    """

    def __init__(self, sizes: Sizes) -> None:
        super().__init__(sizes)
        _, embedding, hidden = sizes
        self.expression = nn.Linear(hidden, hidden)
        self.candidate = nn.Sequential(
            nn.Linear(embedding, hidden), nn.ReLU(), nn.Linear(hidden, hidden)
        )

    def forward(self, words: Tensor, tokens: Tensor, candidates: Candidates) -> Tensor:
        """Score candidates, (B, J), by the cosine with the expression."""
        _, h, _ = self.encoder(words)
        r = functional.normalize(self.expression(h), dim=-1)  # (B, H)
        looks = self.candidate(self.encoder.names(tokens))  # (n_names, H)
        v = functional.normalize(looks, dim=-1)[candidates.name]  # (B, J, H)
        scores: Tensor = (v @ r[..., None])[..., 0]  # (B, J)
        return scores.masked_fill(~candidates.valid, -torch.inf)


MODULES = ("subject", "location", "relation")


class Phrases(NamedTuple):
    """What the language attention network makes of expressions."""

    weights: Tensor
    """w: float (B, 3), how much each module counts."""
    attention: Tensor
    """a: float (B, 3, L), the words that each module attends to."""
    phrases: Tensor
    """q: float (B, 3, E), their sums."""


class Matching(nn.Module):
    """S(v | q): the cosine of a candidate's and a phrase's vector, each through an MLP."""

    def __init__(self, size: int, phrase: int, hidden: int) -> None:
        super().__init__()
        self.candidate = _mlp(size, hidden)
        self.phrase = _mlp(phrase, hidden)

    def forward(self, candidates: Tensor, phrase: Tensor, row: Tensor) -> Tensor:
        """Return scores (n,), of candidates (n, V) and the phrases (B, E) of their rows (n,)."""
        v = functional.normalize(self.candidate(candidates), dim=-1)
        q = functional.normalize(self.phrase(phrase), dim=-1)
        return (v * q[row]).sum(dim=-1)


def _mlp(size: int, hidden: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(size, hidden), nn.ReLU(), nn.Dropout(DROPOUT), nn.Linear(hidden, hidden)
    )


class MAttNet(Pointer):
    """MAttNet, and what CM-Erase trains.

    Yu et al., "MAttNet: Modular Attention Network for Referring Expression Comprehension", CVPR
    2018: language attention (section 3.1), and modules for the subject, its location and its
    relations (section 3.2), whose scores are added up by the weights that the expression gives
    them.

    The subject is the object's name and how much of it the expression says, in place of what a CNN
    and its attributes see. Locations are directions and sizes in the panorama, and objects around
    it are the nearest of other names in any view, where MAttNet has one picture.
    """

    def __init__(self, sizes: Sizes) -> None:
        super().__init__(sizes)
        _, embedding, hidden = sizes
        self.attend = nn.Linear(hidden, len(MODULES), bias=False)  # f_m
        self.weigh = nn.Linear(hidden, len(MODULES))  # W_m
        self.subject = Matching(embedding + 1, embedding, hidden)
        self.location = Matching(N_LOCATION, embedding, hidden)
        self.relation = Matching(embedding + N_OFFSET, embedding, hidden)

    def language(self, words: Tensor) -> Phrases:
        """Return what each module is to look for."""
        context, h, _ = self.encoder(words)  # (B, L, H), (B, H)
        attention = self.attend(context).softmax(dim=1).transpose(1, 2)  # (B, 3, L)
        phrases = attention @ self.encoder.embedding(words)  # (B, 3, E)
        return Phrases(self.weigh(h).softmax(dim=-1), attention, phrases)

    def forward(self, words: Tensor, tokens: Tensor, candidates: Candidates) -> Tensor:
        """Score candidates, (B, J)."""
        weights, _, phrases = self.language(words)
        subject, location, relation = phrases.unbind(dim=1)  # (B, E)
        names = self.encoder.names(tokens)  # (n_names, E)
        # Padding is left out: most of it would be in the relations of objects that are not there.
        valid, is_near = candidates.valid, candidates.around >= 0
        row, near_row = valid.nonzero()[:, 0], is_near.nonzero()[:, 0]
        looks = torch.cat([names[candidates.name[valid]], candidates.match[valid]], dim=-1)
        near = torch.cat([names[candidates.around[is_near]], candidates.offset[is_near]], dim=-1)
        related = names.new_full(is_near.shape, -1.0)
        related[is_near] = self.relation(near, relation, near_row)
        scores = torch.stack(
            [
                self.subject(looks, subject, row),
                self.location(candidates.location[valid].to(names), location, row),
                related.amax(dim=-1)[valid],  # the one that fits best; section 3.2.3
            ],
            dim=-1,
        )
        total = names.new_full(valid.shape, -torch.inf)
        total[valid] = (scores * weights[row]).sum(dim=-1)  # section 3.3
        return total


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
