"""MAttNet, and what CM-Erase trains, with names in place of pictures.

Yu et al., "MAttNet: Modular Attention Network for Referring Expression Comprehension", CVPR 2018:
language attention (section 3.1), and modules for the subject, its location and its relations
(section 3.2), whose scores are added up by the weights that the expression gives them.

The subject is the object's name and how much of it the expression says, in place of what a CNN and
its attributes see. Locations are directions and sizes in the panorama, and objects around it are
the nearest of other names in any view, where MAttNet has one picture.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from reverie_eval.agents.trained._coding import N_LOCATION, N_OFFSET
from reverie_eval.agents.trained._navigating import WordEncoder
from reverie_eval.agents.trained._pointing import Candidates, Pointer

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

    def __init__(self, size: int, phrase: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.candidate = _mlp(size, hidden, dropout)
        self.phrase = _mlp(phrase, hidden, dropout)

    def forward(self, candidates: Tensor, phrase: Tensor, row: Tensor) -> Tensor:
        """Return scores (n,), of candidates (n, V) and the phrases (B, E) of their rows (n,)."""
        v = functional.normalize(self.candidate(candidates), dim=-1)
        q = functional.normalize(self.phrase(phrase), dim=-1)
        return (v * q[row]).sum(dim=-1)


def _mlp(size: int, hidden: int, dropout: float) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(size, hidden), nn.ReLU(), nn.Dropout(dropout), nn.Linear(hidden, hidden)
    )


class MAttNet(Pointer):
    """The pointer. E: size of an embedding, H: of a hidden state."""

    def __init__(
        self, n_words: int, *, embedding: int = 64, hidden: int = 64, dropout: float = 0.3
    ) -> None:
        super().__init__()
        self.encoder = WordEncoder(n_words, embedding, hidden, dropout)
        self.attend = nn.Linear(hidden, len(MODULES), bias=False)  # f_m
        self.weigh = nn.Linear(hidden, len(MODULES))  # W_m
        self.subject = Matching(embedding + 1, embedding, hidden, dropout)
        self.location = Matching(N_LOCATION, embedding, hidden, dropout)
        self.relation = Matching(embedding + N_OFFSET, embedding, hidden, dropout)

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
