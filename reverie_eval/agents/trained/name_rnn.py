"""The paper's CNN-RNN pointer, with names in place of pictures.

Qi et al., "REVERIE", CVPR 2020, section 5: an LSTM reads the expression, a CNN sees a candidate,
and a triplet loss ranks them by the likeness of both vectors. Here the mean of a name's words is
what a candidate looks like; boxes are not read.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from reverie_eval.agents.trained._navigating import WordEncoder
from reverie_eval.agents.trained._pointing import Candidates, Pointer


class NameRnn(Pointer):
    """The pointer. E: size of an embedding, H: of a hidden state."""

    def __init__(
        self, n_words: int, *, embedding: int = 64, hidden: int = 64, dropout: float = 0.3
    ) -> None:
        super().__init__()
        self.encoder = WordEncoder(n_words, embedding, hidden, dropout)
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
