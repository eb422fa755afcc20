"""What models learn from: imitation and reinforcement for navigators, ranking for pointers.

Beside the loss of a batch stands what training is stopped by, the share of episodes that a model
gets right. Episodes are walked in batches, on the observations of the simulator but without the
runner, which keeps every step of one episode at a time.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from reverie_eval.agents.trained._coding import UNKNOWN
from reverie_eval.agents.trained._world import World
from reverie_eval.agents.trained.navigators import ActionScores, Navigator, collate
from reverie_eval.agents.trained.pointers import MAttNet, Pointer, Question, candidates_of
from reverie_eval.arrays import FloatArray, IntArray

MOST_ACTIONS = 10
"""Actions in an episode. Source: ``max_episode_len`` in ``trainFast.py`` of YuankaiQi/REVERIE."""
PROGRESS_WEIGHT = 0.5
"""Lambda of Ma et al., 2019, section 3, as in REVERIE's ``follower.py``."""
DISCOUNT = 0.95
"""What a reward is worth a step before it comes. Source: Wang et al., CVPR 2019, section 4."""
CRITIC_WEIGHT = 0.5
"""Half of a squared error, whose gradient is the error, as in ``agent.py`` of EnvDrop (Tan et al.,
NAACL 2019)."""
MARGIN = 0.1
"""By how much right scores should exceed wrong ones. Source: ``tools/opt.py`` of MAttNet."""

# Episodes that are tried at once, which changes no rate.
_EVALUATED_AT_ONCE = 256


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
    # An episode may begin at its goal.
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
            # The monitor cannot say less than -1, which an agent that walks away may deserve.
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
    for batch in batches(world, rows, _EVALUATED_AT_ONCE):
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

    The policy gradient of RCM: Wang et al., CVPR 2019, section 3. The reward of a step is by how
    many metres it comes nearer to the goal, and that of a stop is 1 if it is a success.

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


def hinge(right: Tensor, wrong: Tensor) -> Tensor:
    """Return how far wrong scores come within the margin below the right ones, or above them."""
    return (MARGIN + wrong - right).clamp(min=0)


def ranking_loss(model: Pointer, world: World, rows: IntArray, *, erases: bool = False) -> Tensor:
    """Return the loss of a batch, the mean over its episodes.

    The target comes before other objects, and before it for other expressions. The loss of Yu et
    al., 2018, section 3.3, which the paper's CNN-RNN and CM-Erase use as well: ``max(0, margin +
    S(o_k | r_i) - S(o_i | r_i)) + max(0, margin + S(o_i | r_j) - S(o_i | r_i))``. The first term is
    added up over all other objects at the goal where MAttNet draws one of them.

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
    for batch in batches(world, rows, _EVALUATED_AT_ONCE):
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
