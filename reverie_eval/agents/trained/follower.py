"""The sequence-to-sequence follower of R2R: R2R-TF and R2R-SF, and what RCM begins with.

Anderson et al., "Vision-and-Language Navigation", CVPR 2018, section 4: an LSTM reads the
instruction, a second one attends to its words and chooses actions. Actions are neighbours, as in
Fried et al., "Speaker-Follower Models", NeurIPS 2018, section 3.3, and as REVERIE's code has them.

In place of the picture that the agent faces, the second LSTM is given the vectors of all slots,
attended to by its last state.
"""

import torch
from torch import Tensor, nn

from reverie_eval.agents.trained._navigating import (
    Attention,
    Inputs,
    Navigator,
    Reading,
    Scores,
    SlotEncoder,
    Slots,
    State,
    WordEncoder,
)


class Follower(Navigator):
    """The follower. E: size of an embedding, H: of a hidden state."""

    def __init__(
        self,
        n_words: int,
        n_remembered: int,
        inputs: Inputs,
        *,
        embedding: int = 64,
        hidden: int = 128,
        dropout: float = 0.3,
    ) -> None:
        super().__init__()
        self.encoder = WordEncoder(n_words, embedding, hidden, dropout)
        self.slots = SlotEncoder(embedding, hidden, inputs, n_remembered)
        self.see = Attention(hidden, hidden)
        self.lstm = nn.LSTMCell(2 * hidden, hidden)
        self.listen = Attention(hidden, hidden)
        self.combine = nn.Linear(2 * hidden, hidden, bias=False)
        self.score = nn.Linear(hidden, hidden, bias=False)
        self.dropout = nn.Dropout(dropout)

    def forward(self, reading: Reading, state: State, slots: Slots) -> Scores:
        """Score the actions of B decisions."""
        u = self.dropout(self.slots(slots, reading.names))  # (B, S, H)
        v, _ = self.see(state.h, u, slots.valid)  # (B, H)
        h, c = self.lstm(torch.cat([v, state.action], dim=-1), (state.h, state.c))
        x, _ = self.listen(self.dropout(h), reading.context)  # c_t of the paper, (B, H)
        h_tilde = self.combine(torch.cat([x, self.dropout(h)], dim=-1)).tanh()
        logits: Tensor = (u @ self.score(self.dropout(h_tilde))[..., None])[..., 0]  # (B, S)
        return Scores(logits.masked_fill(~slots.valid, -torch.inf), h, c, u, None)
