"""Trained models as agents: the walk and the answer, for all of them."""

import hashlib
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch

from reverie_eval.agents._episode import Agent, Episode
from reverie_eval.agents._exploring import Explored
from reverie_eval.agents.trained._advice import best_names, point
from reverie_eval.agents.trained._coding import Coder, Panorama
from reverie_eval.agents.trained._imitation import MOST_ACTIONS
from reverie_eval.agents.trained._model_file import (
    ModelCard,
    coder_of,
    load_weights,
    read_card,
    set_threads,
)
from reverie_eval.agents.trained._navigating import Decision, Navigator, Reading, Scores, collate
from reverie_eval.agents.trained._pointing import Pointer, Question
from reverie_eval.agents.trained._queue import Choice, Queue
from reverie_eval.agents.trained._recipes import Walk, recipe_of
from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.errors import ReverieEvalError
from reverie_eval.simulator import Action, Answer, Go, Observation, Stop

MODEL, POINTER = "model.safetensors", "pointer.safetensors"
"""The files of a model's folder: what was trained, and the pointer that answers for a navigator."""
_DIGEST_SHOWN = 12


def find_trained(folder: Path) -> type[Agent]:
    """Return the class of the agent in a folder that ``reverie-eval train`` wrote.

    Raises
    ------
    ReverieEvalError
        If the folder has no model.
    """
    card = read_card(folder / MODEL)
    kind = PointingAgent if recipe_of(card).is_pointer else WalkingAgent
    files = [file for name in (MODEL, POINTER) if (file := folder / name).exists()]
    version = "+".join(
        hashlib.sha256(file.read_bytes()).hexdigest()[:_DIGEST_SHOWN] for file in files
    )
    return type(kind.__name__, (kind,), {"folder": folder, "version": version})


class LoadedPointer:
    """A pointer, and what it says about the objects at viewpoints."""

    def __init__(self, file: Path) -> None:
        set_threads()
        card = read_card(file)
        self.digest = hashlib.sha256(file.read_bytes()).hexdigest()
        """SHA-256 of its file."""
        self.coder = coder_of(card)
        self.model = _pointer(card, self.coder)
        load_weights(file, self.model)
        self.model.eval()

    def scores(self, seen: Observation) -> tuple[Panorama, FloatArray]:
        """Return the score of each candidate, in their order."""
        panorama = self.coder.panorama(seen)
        words = self.coder.words(seen.instruction)
        question = Question(panorama, self.coder.matches(words))
        scores = point(self.model, self.coder, words[None], [question])[0]
        return panorama, scores[: len(panorama.name)]  # padded to one if nothing is visible

    def answer(self, seen: Observation) -> Action:
        """Predict the object that is scored best."""
        if not seen.candidates:
            return Stop()
        panorama, scores = self.scores(seen)
        return Answer(int(panorama.object_id[int(np.argmax(scores))]))


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

    def start(self, episode: Episode) -> None:
        """Read the route."""
        self._ahead = iter(episode.solution().route)

    def act(self, seen: Observation) -> Action:
        """Go on, or point."""
        ahead = next(self._ahead, None)
        return self._pointer.answer(seen) if ahead is None else Go(ahead)


class WalkingAgent:
    """Walks as a navigator scores actions, and answers as its pointer does.

    Parameters
    ----------
    walk : {"greedy", "fast"}, optional
        ``greedy`` always takes the best action where it is, at most ten; ``fast`` takes the best
        one that it knows of, by the queue of FAST-Short. By default, what the recipe says.
    """

    folder: ClassVar[Path]

    def __init__(self, walk: Walk | None = None) -> None:
        file, pointer = self.folder / MODEL, self.folder / POINTER
        card = read_card(file)
        self._recipe = recipe_of(card)
        self._walk = walk or self._recipe.walk
        if self._walk not in {"greedy", "fast"}:
            raise ReverieEvalError(f"walk is greedy or fast, not {walk!r}")
        self._pointer = LoadedPointer(pointer) if pointer.exists() else None
        set_threads()
        self._coder = coder_of(card, reads_objects=self._recipe.reads_objects)
        model = self._recipe.build(self._coder)
        assert isinstance(model, Navigator)  # noqa: S101  # `find_trained` has looked
        load_weights(file, model)
        self._model = model.eval()

    def start(self, episode: Episode) -> None:
        """Forget the last episode."""
        self._log = episode.log
        self._queue, self._explored = Queue(), Explored()
        self._taken: Choice | None = None
        self._n_actions = 0

    @torch.no_grad()
    def act(self, seen: Observation) -> Action:
        """Go on towards the action that was taken last, and do it; score new ones on arrival."""
        if self._taken is None:
            self._words = self._coder.words(seen.instruction)
            self._reading, state = self._model.read(
                torch.from_numpy(self._words)[None], torch.from_numpy(self._coder.tokens)
            )
            self._taken = Choice(None, seen.viewpoint_id, 0.0, state)
        self._explored.add(seen)
        if self._taken.target == seen.viewpoint_id and not self._taken.is_stop:
            self._taken = self._choose(seen, self._taken)
        if self._taken.target != seen.viewpoint_id:
            target = self._taken.target
            return Go(self._explored.route(seen.viewpoint_id, lambda each: each == target)[0])
        return self._pointer.answer(seen) if self._pointer else Stop()

    def _choose(self, seen: Observation, came_by: Choice) -> Choice:
        """Score the actions where the agent is, and return the next one to take."""
        panorama = self._coder.panorama(seen)
        scores = self._score(seen, panorama, came_by)
        logits = scores.logits[0].tolist()
        self._log(logits=[round(each, 3) for each in logits])
        choices = [
            Choice(seen.viewpoint_id, target, came_by.score + logit, scores.after(slot[None]))
            for target, logit, slot in zip(
                panorama.viewpoint_ids, logits, torch.arange(len(logits)), strict=True
            )
        ]
        self._n_actions += 1
        if self._walk == "fast":
            self._queue.add(choices)
            return self._queue.pop()
        return choices[int(np.argmax(logits)) if self._n_actions < MOST_ACTIONS else 0]

    def _score(self, seen: Observation, panorama: Panorama, came_by: Choice) -> Scores:
        top: IntArray | None = None
        if self._recipe.inputs.top and self._pointer:
            _, its = self._pointer.scores(seen)
            top = best_names(its, panorama.name, panorama.in_slot)
        matches = self._coder.matches(self._words)
        # The names are read again, because there are new ones at each viewpoint.
        names = self._model.encoder.names(torch.from_numpy(self._coder.tokens))
        slots = collate([Decision(panorama, seen.heading, matches, top)])
        reading = Reading(self._reading.context, names)
        scores: Scores = self._model(reading, came_by.state, slots)
        return scores
