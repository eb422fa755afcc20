"""The navigators of the papers, each a network that scores actions.

Where they see pictures, these are given the vectors of slots: names, geometry, matches, memory.
E is the size of an embedding, and H that of a hidden state.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from reverie_eval.agents.trained._coding import MAX_WORDS
from reverie_eval.agents.trained._navigating import (
    ActionScores,
    Attention,
    Navigator,
    Reading,
    Sizes,
    SlotInputs,
    Slots,
    State,
)


class Follower(Navigator):
    """The sequence-to-sequence follower of R2R: R2R-TF and R2R-SF.

    Anderson et al., "Vision-and-Language Navigation", CVPR 2018, section 4: an LSTM reads the
    instruction, a second one attends to its words and chooses actions. Actions are neighbours, as
    in Fried et al., "Speaker-Follower Models", NeurIPS 2018, section 3.3, and as REVERIE's code has
    them. In place of the picture that the agent faces, the second LSTM is given the vectors of all
    slots, attended to by its last state.
    """

    def __init__(self, sizes: Sizes, inputs: SlotInputs, n_remembered: int) -> None:
        super().__init__(sizes, inputs, n_remembered)
        hidden = sizes.hidden
        self.see = Attention(hidden, hidden)
        self.lstm = nn.LSTMCell(2 * hidden, hidden)
        self.listen = Attention(hidden, hidden)
        self.combine = nn.Linear(2 * hidden, hidden, bias=False)
        self.score = nn.Linear(hidden, hidden, bias=False)

    def forward(self, reading: Reading, state: State, slots: Slots) -> ActionScores:
        """Score the actions of B decisions."""
        u = self.dropout(self.slots(slots, reading.names))  # (B, S, H)
        v, _ = self.see(state.h, u, slots.valid)  # (B, H)
        h, c = self.lstm(torch.cat([v, state.action], dim=-1), (state.h, state.c))
        x, _ = self.listen(self.dropout(h), reading.context)  # c_t of the paper, (B, H)
        h_tilde = self.combine(torch.cat([x, self.dropout(h)], dim=-1)).tanh()
        logits: Tensor = (u @ self.score(self.dropout(h_tilde))[..., None])[..., 0]  # (B, S)
        return ActionScores(logits.masked_fill(~slots.valid, -torch.inf), h, c, u, None)


class Rcm(Follower):
    """RCM: the follower, with a critic that says what reward is still to come, b.

    Wang et al., "Reinforced Cross-Modal Matching and Self-Supervised Imitation Learning for
    Vision-Language Navigation", CVPR 2019, section 3: the policy gradient whose loss is in
    ``_reinforcement``. The intrinsic reward, by which a second network says how well a trajectory
    tells the instruction, is left out, and so is the self-supervised imitation, which walks in the
    buildings of the evaluation.
    """

    def __init__(self, sizes: Sizes, inputs: SlotInputs, n_remembered: int) -> None:
        super().__init__(sizes, inputs, n_remembered)
        hidden = sizes.hidden
        self.critic = nn.Sequential(nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, 1))

    def forward(self, reading: Reading, state: State, slots: Slots) -> ActionScores:
        """Score the actions of B decisions."""
        scores = super().forward(reading, state, slots)
        # The critic judges states; it does not shape them.
        return scores._replace(value=self.critic(scores.h.detach())[..., 0])


def positions(n_words: int, size: int) -> Tensor:
    """Return PE, float (n_words, size): sines and cosines of each word's number.

    Vaswani et al., "Attention Is All You Need", 2017, section 3.5.
    """
    rate = torch.exp(torch.arange(0, size, 2) * (-math.log(10_000) / size))
    angle = torch.arange(n_words)[:, None] * rate
    return torch.stack([angle.sin(), angle.cos()], dim=-1).flatten(1)


class SelfMonitor(Navigator):
    """The self-monitoring agent: SelfMonitor, and the network of FAST and Interactive.

    Ma et al., "Self-Monitoring Navigation Agent via Auxiliary Progress Estimation", ICLR 2019:
    co-grounding of words and views, and a progress monitor (section 3). v_k, the feature of a view,
    is the vector of a slot.
    """

    def __init__(self, sizes: Sizes, inputs: SlotInputs, n_remembered: int) -> None:
        super().__init__(sizes, inputs, n_remembered)
        hidden = sizes.hidden
        self.positions: Tensor
        self.register_buffer("positions", positions(MAX_WORDS, hidden), persistent=False)
        self.text = Attention(hidden, hidden)
        self.visual = Attention(hidden, hidden)
        self.lstm = nn.LSTMCell(3 * hidden, hidden)
        self.action = nn.Linear(2 * hidden, hidden)
        self.monitor = nn.Linear(2 * hidden, hidden)
        self.progress = nn.Linear(MAX_WORDS + hidden, 1)

    def forward(self, reading: Reading, state: State, slots: Slots) -> ActionScores:
        """Score the actions of B decisions."""
        g = self.dropout(self.slots(slots, reading.names))  # (B, S, H)
        n_words = reading.context.shape[1]
        # The words are told apart by position; the sum is of the words themselves.
        _, alpha = self.text(state.h, reading.context + self.positions[:n_words])  # (B, L)
        x = (alpha[:, None] @ reading.context)[:, 0]  # (B, H)
        v, _ = self.visual(state.h, g, slots.valid)  # (B, H)
        h, c = self.lstm(torch.cat([x, v, state.action], dim=-1), (state.h, state.c))
        # The score o of each action: of W_a [h, x] with its vector g(v).
        o = (g @ self.action(self.dropout(torch.cat([h, x], dim=-1)))[..., None])[..., 0]
        # alpha, of a varying number of words, is padded to the longest instruction.
        h_pm = c.sigmoid() * self.monitor(torch.cat([state.h, v], dim=-1)).tanh()
        padded = functional.pad(alpha, (0, MAX_WORDS - n_words))
        p_pm = self.progress(torch.cat([padded, h_pm], dim=-1)).tanh()[..., 0]
        return ActionScores(o.masked_fill(~slots.valid, -torch.inf), h, c, g, p_pm)
