"""RCM: the follower, with a critic that says what reward is still to come.

Wang et al., "Reinforced Cross-Modal Matching and Self-Supervised Imitation Learning for
Vision-Language Navigation", CVPR 2019, section 3: the policy gradient whose loss is in
``_reinforcement``. The intrinsic reward, by which a second network says how well a trajectory tells
the instruction, is left out, and so is the self-supervised imitation, which walks in the buildings
of the evaluation.
"""

from torch import nn

from reverie_eval.agents.trained._navigating import Inputs, Reading, Scores, Slots, State
from reverie_eval.agents.trained.follower import Follower


class Rcm(Follower):
    """The follower, and b, the reward that is expected at a step."""

    def __init__(
        self,
        n_words: int,
        n_remembered: int,
        inputs: Inputs,
        *,
        embedding: int = 64,
        hidden: int = 128,
    ) -> None:
        super().__init__(n_words, n_remembered, inputs, embedding=embedding, hidden=hidden)
        self.critic = nn.Sequential(nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, 1))

    def forward(self, reading: Reading, state: State, slots: Slots) -> Scores:
        """Score the actions of B decisions."""
        scores = super().forward(reading, state, slots)
        # The critic judges states; it does not shape them.
        return scores._replace(value=self.critic(scores.h.detach())[..., 0])
