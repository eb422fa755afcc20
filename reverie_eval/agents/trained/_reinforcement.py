"""Navigators learn by reinforcement: the policy gradient of RCM.

Wang et al., CVPR 2019, section 3. The reward of a step is by how many metres it comes nearer to
the goal, and that of a stop is 1 if it is a success.
"""

import numpy as np
import torch
from torch import Tensor

from reverie_eval.agents.trained._imitation import MOST_ACTIONS, Walks, draw
from reverie_eval.agents.trained._navigating import Navigator
from reverie_eval.agents.trained._world import World
from reverie_eval.arrays import FloatArray, IntArray

DISCOUNT = 0.95
CRITIC_WEIGHT = 0.5


def returns_of(
    rewards: list[FloatArray], indices: list[IntArray], n_episodes: int
) -> list[FloatArray]:
    """Return the discounted sum of the rewards from each step on.

    Parameters
    ----------
    rewards : list of float arrays
        Of each step, for the episodes that are not over.
    indices : list of int arrays
        Which episodes these are.
    n_episodes : int
    """
    total, sums = np.zeros(n_episodes), []
    for reward, index in zip(reversed(rewards), reversed(indices), strict=True):
        total[index] = reward + DISCOUNT * total[index]
        sums.append(total[index])
    return sums[::-1]


def policy_loss(model: Navigator, world: World, rows: IntArray) -> Tensor:
    """Return the loss of a batch whose actions the agent draws, the mean over its steps.

    Each action is made likelier by how much more reward follows than the critic expects, which
    learns to expect it. What cannot be done any more after :data:`MOST_ACTIONS` is not rewarded.
    """
    walks = Walks(model, world, rows)
    chosen, expected = [], []
    rewards: list[FloatArray] = []
    indices: list[IntArray] = []
    for number, step in enumerate(walks.steps()):
        if number == MOST_ACTIONS:
            break
        actions = draw(step.scores.logits.detach())
        likelihood = step.scores.logits.log_softmax(dim=-1)
        chosen.append(likelihood.gather(1, actions[:, None])[:, 0])
        assert step.scores.value is not None  # noqa: S101  # a recipe pairs this loss with a critic
        expected.append(step.scores.value)
        before = world.distance(step.rows, step.viewpoints)
        walks.act(actions)
        at = walks.viewpoints[step.episode]
        is_right_stop = (actions == 0).numpy() & world.is_success(step.rows, at)
        rewards.append(before - world.distance(step.rows, at) + is_right_stop)
        indices.append(step.episode)
    returns = np.concatenate(returns_of(rewards, indices, len(rows)))
    advantage = torch.from_numpy(returns.astype(np.float32)) - torch.cat(expected)
    gradient = -(torch.cat(chosen) * advantage.detach()).mean()
    return gradient + CRITIC_WEIGHT * advantage.square().mean()
