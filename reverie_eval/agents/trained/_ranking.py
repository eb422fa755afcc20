"""Pointers learn by ranking: the target before other objects, and before it for other expressions.

The loss of Yu et al., 2018, section 3.3, which the paper's CNN-RNN and CM-Erase use as well:
``max(0, margin + S(o_k | r_i) - S(o_i | r_i)) + max(0, margin + S(o_i | r_j) - S(o_i | r_i))``. The
first term is added up over all other objects at the goal where MAttNet draws one of them.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from reverie_eval.agents.trained._coding import UNKNOWN
from reverie_eval.agents.trained._imitation import batches
from reverie_eval.agents.trained._world import World
from reverie_eval.agents.trained.pointers import MAttNet, Pointer, Question, candidates_of
from reverie_eval.arrays import IntArray

MARGIN = 0.1


def hinge(right: Tensor, wrong: Tensor) -> Tensor:
    """Return how far wrong scores come within the margin below the right ones, or above them."""
    return (MARGIN + wrong - right).clamp(min=0)


def ranking_loss(model: Pointer, world: World, rows: IntArray, *, erases: bool = False) -> Tensor:
    """Return the loss of a batch, the mean over its episodes.

    With ``erases``, expressions are read a second time, without the word that the modules attend to
    most: Liu et al., "Improving Referring Expression Grounding with Cross-modal Attention-guided
    Erasing", CVPR 2019, section 3. Words alone are erased, since no picture is there.
    """
    words = torch.from_numpy(np.stack([world.words[row] for row in rows]))
    tokens = torch.from_numpy(world.coder.tokens)
    candidates = candidates_of(_questions(world, rows))
    target = torch.tensor([_target(world, row) for row in rows.tolist()])
    # The targets alone, asked for by the expressions of other episodes of the batch.
    others = np.roll(rows, 1)
    matches = [
        world.matches(other)[name]
        for other, name in zip(others.tolist(), candidates.only(target).name[:, 0], strict=True)
    ]
    swapped = candidates.only(target)._replace(
        match=torch.tensor(matches, dtype=torch.float32)[:, None, None]
    )
    wrong = model(words.roll(1, dims=0), tokens, swapped)[:, 0]
    is_other = torch.from_numpy(world.item[rows] != world.item[others])

    def loss_of(words: Tensor) -> Tensor:
        scores = model(words, tokens, candidates)
        right = scores.gather(1, target[:, None])
        by_object = hinge(right, scores).scatter(1, target[:, None], 0.0).sum(dim=1)
        return (by_object + hinge(right[:, 0], wrong) * is_other).mean()

    loss = loss_of(words)
    if erases and isinstance(model, MAttNet):
        loss = (loss + loss_of(erase(model, words))) / 2
    return loss


@torch.no_grad()
def erase(model: MAttNet, words: Tensor) -> Tensor:
    """Return expressions, each without the word that its modules attend to most."""
    weights, attention, _ = model.language(words)
    dominant = (weights[:, None] @ attention)[:, 0].argmax(dim=-1)  # (B,)
    return words.scatter(1, dominant[:, None], UNKNOWN)


@torch.no_grad()
def pointing_rate(model: Pointer, world: World, rows: IntArray) -> float:
    """Return the share of episodes whose target a pointer scores best at the goal."""
    model.eval()
    right = 0
    tokens = torch.from_numpy(world.coder.tokens)
    for batch in batches(world, rows, 256):
        words = torch.from_numpy(np.stack([world.words[row] for row in batch]))
        best = model(words, tokens, candidates_of(_questions(world, batch))).argmax(dim=1)
        right += sum(
            _target(world, row) == chosen
            for row, chosen in zip(batch.tolist(), best.tolist(), strict=True)
        )
    model.train()
    return right / max(1, len(rows))


def _questions(world: World, rows: IntArray) -> Sequence[Question]:
    """Ask for the objects at the goals of episodes."""
    return [Question(world.panoramas[world.goal[row]], world.matches(row)) for row in rows.tolist()]


def _target(world: World, row: int) -> int:
    """Return the number of an episode's target among the objects at its goal."""
    objects = world.panoramas[world.goal[row]].object_id
    return int(np.flatnonzero(objects == world.solution.target_object[row])[0])
