"""Trained models as agents: the walk and the answer, for all of them."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from itertools import count
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from reverie_eval.agents._episode import Agent, BatchAgent, Episode
from reverie_eval.agents._untrained import Explored
from reverie_eval.agents.trained._coding import Coder, Panorama
from reverie_eval.agents.trained._losses import MOST_ACTIONS
from reverie_eval.agents.trained._model_file import (
    ModelCard,
    coder_of,
    load_weights,
    read_model_card,
    set_threads,
)
from reverie_eval.agents.trained._recipes import WALKS, Walk, recipe_of
from reverie_eval.agents.trained.navigators import Decision, Navigator, Reading, State, collate
from reverie_eval.agents.trained.pointers import Pointer, Question, best_names, point
from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.errors import ReverieEvalError
from reverie_eval.simulator import Action, Answer, Go, Observation, Stop
from reverie_eval.text import short_digest

MODEL, POINTER = "model.safetensors", "pointer.safetensors"
"""The files of a model's folder: what was trained, and the pointer that answers for a navigator."""
DECIMALS = 6
"""Decimals of a score. In double precision, the rest of a batch changes only later ones."""
MOST_EXPANDED = 40
"""Viewpoints whose actions are scored, after which the best of the known ends is taken."""


def find_trained(folder: Path) -> type[Agent | BatchAgent]:
    """Return the class of the agent in a folder that ``reverie-eval train`` wrote.

    Raises
    ------
    ReverieEvalError
        If the folder has no model.
    """
    card = read_model_card(folder / MODEL)
    kind = PointingAgent if recipe_of(card).is_pointer else WalkingAgent
    files = [file for name in (MODEL, POINTER) if (file := folder / name).exists()]
    version = "+".join(
        short_digest(hashlib.sha256(file.read_bytes()).hexdigest()) for file in files
    )
    return type(kind.__name__, (kind,), {"folder": folder, "version": version})


class LoadedPointer:
    """A pointer, and what it says about the objects at viewpoints."""

    def __init__(self, file: Path) -> None:
        set_threads()
        card = read_model_card(file)
        self.digest = hashlib.sha256(file.read_bytes()).hexdigest()
        """SHA-256 of its file."""
        self.coder = coder_of(card)
        self.model = _pointer(card, self.coder)
        load_weights(file, self.model)
        self.model.eval()

    def scores(self, observations: Sequence[Observation]) -> Sequence[FloatArray]:
        """Return the scores of the candidates of each, whose instructions are equally long."""
        words = np.stack([self.coder.vocabulary.encode(seen.instruction) for seen in observations])
        panoramas = [self.coder.panorama(seen) for seen in observations]
        questions = [
            Question(panorama, self.coder.matches(its))
            for panorama, its in zip(panoramas, words, strict=True)
        ]
        scores = point(self.model, self.coder, words, questions).round(DECIMALS)
        return [its[: len(each.name)] for its, each in zip(scores, panoramas, strict=True)]

    def answers(self, observations: Sequence[Observation]) -> Sequence[Action]:
        """Predict the objects that are scored best."""
        return [
            Answer(seen.candidates[int(np.argmax(scores))].object_id) if seen.candidates else Stop()
            for seen, scores in zip(observations, self.scores(observations), strict=True)
        ]


def _pointer(card: ModelCard, coder: Coder) -> Pointer:
    model = recipe_of(card).build(coder)
    if not isinstance(model, Pointer):
        raise ReverieEvalError(f"{card.name} is not a pointer; choose mattnet or another one")
    return model


class PointingAgent:
    """Is led to the goal on the shortest route, and points there: grounding alone."""

    folder: ClassVar[Path]
    needs_solution = True

    def __init__(self) -> None:
        self._pointer = LoadedPointer(self.folder / MODEL)
        self._pointer.model.double()

    def start(self, episode: Episode) -> None:
        """Read the route."""
        self._ahead = iter(episode.solution().route)

    def act(self, seen: Observation) -> Action:
        """Go on, or point."""
        ahead = next(self._ahead, None)
        return self._pointer.answers([seen])[0] if ahead is None else Go(ahead)


@dataclass(frozen=True, slots=True)
class Choice:
    """An action that was scored."""

    origin: str | None
    """The viewpoint at which it was; None at the start."""
    target: str
    """The viewpoint to which it leads; ``origin`` if it is to stop there."""
    score: float
    """The sum of the scores along its way."""
    state: Any
    """What the model keeps, after this action."""

    @property
    def is_stop(self) -> bool:
        """Whether it ends the episode."""
        return self.origin == self.target


class Queue:
    """The queue of FAST-Short: the actions that were scored and not taken, wherever they were.

    Ke et al., "Tactical Rewind: Self-Correction via Backtracking in Vision-and-Language
    Navigation", CVPR 2019, section 3: every action that was scored and not taken stays in the
    queue, with the sum of the logits along its way; the best one is taken next, wherever it is. The
    agent walks there. It stops when the best action is to stop: *short*, because no other end is
    looked for after the first.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[float, int, Choice]] = []
        self._number = count()  # of equal scores, the earlier one is better
        self._expanded: set[str | None] = set()

    def add(self, choices: Sequence[Choice]) -> None:
        """Add all actions of a viewpoint."""
        self._expanded.add(choices[0].origin)
        for choice in choices:
            heappush(self._waiting, (-choice.score, next(self._number), choice))

    def pop(self) -> Choice:
        """Take the best action: one that stops, or one that leads where the agent was not yet.

        There is one, because each viewpoint has an action to stop, and the first that is taken ends
        the episode. After :data:`MOST_EXPANDED` viewpoints it is the best stop.
        """
        is_full = len(self._expanded) >= MOST_EXPANDED
        while True:
            _, _, choice = heappop(self._waiting)
            if choice.is_stop or not (is_full or choice.target in self._expanded):
                return choice


@dataclass(eq=False)
class _Walking:
    """What an agent remembers of an episode."""

    words: IntArray
    """Shape (L,)."""
    context: Tensor
    """float (L, H)."""
    taken: Choice
    """The action that it is on its way to do."""
    explored: Explored = field(default_factory=Explored)
    queue: Queue = field(default_factory=Queue)
    n_actions: int = 0

    def has_arrived(self, seen: Observation) -> bool:
        """Whether it is where it wanted to go, to choose its next action."""
        return self.taken.target == seen.viewpoint_id and not self.taken.is_stop

    def way_on(self, seen: Observation) -> Action | None:
        """Return the next step on its way; None where it stops."""
        target = self.taken.target
        if target == seen.viewpoint_id:
            return None
        return Go(self.explored.route(seen.viewpoint_id, lambda each: each == target)[0])


class WalkingAgent:
    """Walks as a navigator scores actions, and answers as its pointer does.

    Episodes whose instructions are equally long are scored together.

    Parameters
    ----------
    walk : {"greedy", "fast", "likeliest"}, optional
        ``greedy`` always takes the best action where it is, at most ten; ``fast`` takes the best
        one that it knows of, by the queue of FAST-Short; ``likeliest`` has log-probabilities in
        this queue, in place of logits. By default, what the recipe says.
    """

    folder: ClassVar[Path]
    batch_size = 512

    def __init__(self, walk: Walk | None = None) -> None:
        file, pointer = self.folder / MODEL, self.folder / POINTER
        card = read_model_card(file)
        self._recipe = recipe_of(card)
        self._walk = walk or self._recipe.walk
        if self._walk not in WALKS:
            raise ReverieEvalError(f"walk is {', '.join(WALKS)}, not {walk!r}")
        self._pointer = LoadedPointer(pointer) if pointer.exists() else None
        if self._pointer:
            self._pointer.model.double()
        set_threads()
        self._coder = coder_of(card, reads_objects=self._recipe.reads_objects)
        model = self._recipe.build(self._coder)
        assert isinstance(model, Navigator)  # noqa: S101  # `find_trained` has looked
        load_weights(file, model)
        self._model = model.eval().double()

    def start(self, episode: Episode) -> None:
        """Begin an episode; what it asks for is in its first observation."""

    @torch.no_grad()
    def act_batch(
        self, episodes: Sequence[Episode], observations: Sequence[Observation]
    ) -> Sequence[Action]:
        """Go on towards the actions that were taken last, and do them; score new ones there."""
        walks: list[_Walking] = []
        for episode, seen in zip(episodes, observations, strict=True):
            if episode.memory is None:
                episode.memory = self._begin(seen)
            walks.append(episode.memory)
            walks[-1].explored.add(seen)
        for group in _equally_long(walks, range(len(walks))):
            arrived = [index for index in group if walks[index].has_arrived(observations[index])]
            if arrived:
                its = [walks[index] for index in arrived]
                all_logits = self._choose(its, [observations[index] for index in arrived])
                for index, logits in zip(arrived, all_logits, strict=True):
                    episodes[index].log(logits=logits)
        ways = [walk.way_on(seen) for walk, seen in zip(walks, observations, strict=True)]
        actions: list[Action] = [way or Stop() for way in ways]
        if self._pointer:
            for group in _equally_long(walks, [n for n, way in enumerate(ways) if way is None]):
                answers = self._pointer.answers([observations[index] for index in group])
                for index, answer in zip(group, answers, strict=True):
                    actions[index] = answer
        return actions

    def _begin(self, seen: Observation) -> _Walking:
        words = self._coder.vocabulary.encode(seen.instruction)
        reading, state = self._model.read(torch.from_numpy(words)[None], self._tokens())
        came_by = Choice(None, seen.viewpoint_id, 0.0, state.take(torch.tensor(0)))
        return _Walking(words, reading.context[0], came_by)

    def _choose(
        self, walks: Sequence[_Walking], observations: Sequence[Observation]
    ) -> Sequence[Sequence[float]]:
        """Score the actions where agents are, take the next ones, and return the scores."""
        panoramas = [self._coder.panorama(seen) for seen in observations]
        state = State(*map(torch.stack, zip(*(walk.taken.state for walk in walks), strict=True)))
        context = torch.stack([walk.context for walk in walks])
        # The names are read again, because there are new ones at new viewpoints.
        names = self._model.encoder.names(self._tokens())
        tops = self._tops(panoramas, observations)
        slots = collate(
            [
                Decision(panorama, seen.heading, self._coder.matches(walk.words), top)
                for walk, panorama, seen, top in zip(
                    walks, panoramas, observations, tops, strict=True
                )
            ]
        )
        scores = self._model(Reading(context, names), state, slots)
        logits = scores.logits
        if self._walk == "likeliest":
            logits = logits.log_softmax(dim=-1)
        scored = []
        for row, (walk, panorama) in enumerate(zip(walks, panoramas, strict=True)):
            targets = panorama.viewpoint_ids
            scored.append(logits[row, : len(targets)].numpy().round(DECIMALS).tolist())
            after = zip(targets, scored[-1], scores.actions[row], strict=False)  # without padding
            walk.taken = self._take(
                walk,
                [
                    Choice(
                        targets[0],
                        target,
                        walk.taken.score + logit,
                        State(scores.h[row], scores.c[row], action),
                    )
                    for target, logit, action in after
                ],
            )
        return scored

    def _take(self, walk: _Walking, choices: Sequence[Choice]) -> Choice:
        """Return the next action of an episode."""
        walk.n_actions += 1
        if self._walk == "greedy":
            best = max(choices, key=lambda each: each.score)
            return best if walk.n_actions < MOST_ACTIONS else choices[0]
        walk.queue.add(choices)
        return walk.queue.pop()

    def _tops(
        self, panoramas: Sequence[Panorama], observations: Sequence[Observation]
    ) -> Iterable[IntArray | None]:
        if not (self._recipe.inputs.top and self._pointer):
            return [None] * len(panoramas)
        return [
            best_names(scores, panorama.name, panorama.in_slot)
            for scores, panorama in zip(self._pointer.scores(observations), panoramas, strict=True)
        ]

    def _tokens(self) -> Tensor:
        return torch.from_numpy(self._coder.tokens)


def _equally_long(walks: Sequence[_Walking], indices: Iterable[int]) -> Iterator[list[int]]:
    """Group walks by how many words their instructions have."""
    groups: dict[int, list[int]] = {}
    for index in indices:
        groups.setdefault(len(walks[index].words), []).append(index)
    yield from groups.values()
