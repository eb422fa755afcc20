"""Navigators learn by imitation: teacher forcing, student forcing, and how well they do greedily.

Episodes are walked in batches, on the observations of the simulator but without the runner, which
keeps every step of one episode at a time.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from reverie_eval.agents.trained._navigating import ActionScores, Navigator, collate
from reverie_eval.agents.trained._world import World
from reverie_eval.arrays import IntArray

MOST_ACTIONS = 10
"""Actions in an episode. Source: ``max_episode_len`` in ``trainFast.py`` of YuankaiQi/REVERIE."""
PROGRESS_WEIGHT = 0.5
"""Lambda of Ma et al., 2019, section 3, as in REVERIE's ``follower.py``."""


class Step(NamedTuple):
    """What a navigator says about the episodes of a batch that are not over."""

    episode: IntArray
    """int (B,): which of the batch these are."""
    rows: IntArray
    """int (B,): their episodes."""
    viewpoints: IntArray
    """int (B,): where each of them is."""
    scores: ActionScores


class Walks:
    """Some episodes, whose instructions have the same number of words, walked at the same time.

    Parameters
    ----------
    model : Navigator
    world : World
    rows : int array of shape (B,)
    """

    def __init__(self, model: Navigator, world: World, rows: IntArray) -> None:
        self._model, self._world = model, world
        self.rows = rows
        self.viewpoints = np.array([world.start[row] for row in rows])
        self._heading = np.array([world.heading[row] for row in rows])
        words = torch.from_numpy(np.stack([world.words[row] for row in rows]))
        self._reading, self._state = model.read(words, torch.from_numpy(world.coder.tokens))
        self._active = np.arange(len(rows))

    def steps(self) -> Iterator[Step]:
        """Yield each step; :meth:`act` is called before the next."""
        while len(self._active):
            rows, viewpoints = self.rows[self._active], self.viewpoints[self._active]
            slots = collate(self._world.decisions(rows, viewpoints, self._heading[self._active]))
            here = torch.from_numpy(self._active)
            reading = self._reading._replace(context=self._reading.context[here])
            self._scores = self._model(reading, self._state, slots)
            yield Step(self._active, rows, viewpoints, self._scores)

    def act(self, actions: Tensor) -> None:
        """Do an action, int (B,), in each of the episodes that are not over."""
        goes = actions > 0
        self._state = self._scores.after(actions).take(goes)
        self._active = self._active[goes.numpy()]
        for index, slot in zip(self._active, actions[goes].tolist(), strict=True):
            at = self.viewpoints[index]
            self._heading[index] = self._world.panoramas[at].ways[slot - 1, 0]
            self.viewpoints[index] = self._world.neighbours[at][slot]


def imitation_loss(model: Navigator, world: World, rows: IntArray, *, is_student: bool) -> Tensor:
    """Return the loss of a batch, the mean over its steps.

    With teacher forcing the agent is led along the annotated path; with student forcing it draws
    its own actions, and is told at each step the first one of the shortest route to the goal.
    Anderson et al., 2018, section 4. A progress monitor, if there is one, is to say which part
    of the distance to the goal is done (Ma et al., 2019, section 3).
    """
    walks = Walks(model, world, rows)
    paths = {row: world.path(row) for row in rows.tolist()}
    whole = world.distance(rows, walks.viewpoints).clip(min=1e-6)
    whole_of = dict(zip(rows.tolist(), whole, strict=True))
    losses, progress_losses = [], []
    for number, (_, here, viewpoints, scores) in enumerate(walks.steps()):
        targets = [
            world.slot_towards(at, world.goal[row])
            if is_student
            else _slot_along(world, paths[row], number)
            for row, at in zip(here.tolist(), viewpoints.tolist(), strict=True)
        ]
        target = torch.tensor(targets)
        losses.append(functional.cross_entropy(scores.logits, target, reduction="none"))
        if scores.progress is not None:
            left = world.distance(here, viewpoints) / [whole_of[row] for row in here.tolist()]
            done = torch.tensor((1 - left).clip(min=-1), dtype=torch.float32)
            progress_losses.append(functional.mse_loss(scores.progress, done, reduction="none"))
        actions = draw(scores.logits.detach()) if is_student else target
        walks.act(actions if number + 1 < MOST_ACTIONS else torch.zeros_like(actions))
    loss = torch.cat(losses).mean()
    if not progress_losses:
        return loss
    return (1 - PROGRESS_WEIGHT) * loss + PROGRESS_WEIGHT * torch.cat(progress_losses).mean()


def _slot_along(world: World, path: Sequence[int], number: int) -> int:
    """Return the slot of the next viewpoint of a path; 0 at its end."""
    if number + 1 == len(path):
        return 0
    return world.neighbours[path[number]].index(path[number + 1])


def draw(logits: Tensor) -> Tensor:
    """Draw an action of each row."""
    return torch.multinomial(logits.softmax(dim=-1), 1)[:, 0]


@torch.no_grad()
def success_rate(model: Navigator, world: World, rows: IntArray) -> float:
    """Return the share of episodes in which a navigator, always taking the best, succeeds."""
    model.eval()
    successes = 0
    for batch in batches(world, rows, 256):
        walks = Walks(model, world, batch)
        for number, step in enumerate(walks.steps()):
            best = step.scores.logits.argmax(dim=-1)
            walks.act(best if number + 1 < MOST_ACTIONS else torch.zeros_like(best))
        successes += int(world.is_success(batch, walks.viewpoints).sum())
    model.train()
    return successes / max(1, len(rows))


def batches(world: World, rows: IntArray, size: int) -> Iterator[IntArray]:
    """Cut episodes into batches, each with instructions of the same number of words."""
    by_length: dict[int, list[int]] = {}
    for row in rows.tolist():
        by_length.setdefault(len(world.words[row]), []).append(row)
    for its in by_length.values():
        for begin in range(0, len(its), size):
            yield np.array(its[begin : begin + size])
