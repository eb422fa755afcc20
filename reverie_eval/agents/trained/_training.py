"""Training a row of the paper: epochs, early stopping by what is held back, and going on."""

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from reverie_eval.agents.trained._agent import MODEL, POINTER, LoadedPointer
from reverie_eval.agents.trained._losses import (
    batches,
    imitation_loss,
    pointing_rate,
    policy_loss,
    ranking_loss,
    success_rate,
)
from reverie_eval.agents.trained._model_file import (
    FORMAT_VERSION,
    Epoch,
    ModelCard,
    encode_card,
    read_model_card,
    save_model,
    set_threads,
)
from reverie_eval.agents.trained._recipes import Recipe, find_recipe
from reverie_eval.agents.trained._world import AdvisedWorld, World, hold_back, make_coder
from reverie_eval.agents.trained.navigators import Navigator
from reverie_eval.agents.trained.pointers import Pointer
from reverie_eval.arrays import IntArray
from reverie_eval.dataset import DatasetFiles, compile_for_training, scans_of
from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import made_folder, staged_file
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.processes import locked_folder
from reverie_eval.text import changes
from reverie_eval.version import __version__

BATCH_SIZE = 64
PATIENCE = 6
"""Epochs without a better one, after which training ends. What is held back says how good an epoch
is to within some points only, so fewer would end it by chance."""
# Longer gradients of a batch are scaled down to this length.
_LARGEST_GRADIENT = 5.0
# Files of a training that has not ended: the weights and the optimizer after the last epoch, and
# the best weights so far.
_LATEST = "latest.safetensors"
_BEST = "best.safetensors"


@dataclass(frozen=True)
class TrainingPlan:
    """What is to be trained, and on what."""

    name: str
    """A recipe."""
    files: DatasetFiles
    split: str = "train"
    options: Mapping[str, Any] = field(default_factory=dict)
    """Inputs of a navigator to switch on or off."""
    seed: int = 0
    pointer: Path | None = None
    """The folder of a pointer that answers for a navigator."""


def train(
    plan: TrainingPlan, folder: Path, on_epoch: Callable[[int, Epoch], None] = lambda *_: None
) -> ModelCard:
    """Train a model, or go on with a training that was interrupted.

    The same plan gives the same bytes on the same machine, interrupted or not. The processor uses
    one thread, for the whole process.

    Parameters
    ----------
    plan : TrainingPlan
    folder : Path
        A new folder, or one of a training with the same plan.
    on_epoch : callable
        Is called with the number of each epoch, from 1, and its point of the curve.

    Raises
    ------
    ReverieEvalError
        If there is no such recipe, option or pointer, if the folder has something else, or if
        another process is training in it.
    DatasetError
        If the dataset's files cannot be compiled.
    """
    if folder.exists() and not folder.is_dir():
        raise ReverieEvalError(
            f"{folder} is a file; a model needs a folder, such as models/{folder.stem}"
        )
    set_threads()
    recipe = find_recipe(plan.name, plan.options)
    pointer = None if plan.pointer is None else LoadedPointer(plan.pointer / MODEL)
    if pointer and recipe.is_pointer:
        raise ReverieEvalError(f"{plan.name} is a pointer itself, and needs no other")
    if recipe.inputs.top and not pointer:
        raise ReverieEvalError(f"{plan.name} asks a pointer: train one first, and name its folder")
    bundle, left_out = compile_for_training(plan.files, plan.split)
    truth = GroundTruth.from_bundle(bundle, origin=str(plan.files.annotations[plan.split]))
    if recipe.is_pointer and not truth.task.has_targets:
        raise ReverieEvalError(f"{truth.task.title} has no target objects to point at")
    parts = hold_back(truth, scans_of(plan.files, but=plan.split))
    coder = make_coder(truth, parts.trained, reads_objects=recipe.reads_objects)
    card = ModelCard(
        format_version=FORMAT_VERSION,
        name=plan.name,
        options=plan.options,
        seed=plan.seed,
        input_class=_input_class(recipe, truth, pointer),
        task=truth.task.name,
        split=plan.split,
        sources=dict(bundle.header.sources),
        left_out=left_out,
        episodes={name: len(rows) for name, rows in parts._asdict().items()},
        curve=[],
        best=0,
        vocabulary_digest=coder.vocabulary.digest,
        reverie_eval=__version__,
        pointer=pointer.digest if pointer else "",
        words=coder.vocabulary.words,
        remembered=coder.remembered,
    )
    files = _Files(folder)
    with made_folder(folder), locked_folder(folder):
        if (done := files.finished(card)) is not None:
            return done
        torch.manual_seed(plan.seed)
        model = recipe.build(coder)
        optimizer = torch.optim.Adam(model.parameters(), lr=recipe.learning_rate)
        card = files.resume(card, model, optimizer)
        if pointer and recipe.inputs.top:
            world: World = AdvisedWorld(truth, coder, pointer.model, pointer.coder)
        else:
            world = World(truth, coder)
        while len(card.curve) < recipe.epochs and len(card.curve) - card.best < PATIENCE:
            number = len(card.curve) + 1
            rng = np.random.default_rng([plan.seed, number])
            torch.manual_seed(int(rng.integers(2**63)))
            shown = _shuffled(world, parts.trained, rng)
            loss = _train_epoch(
                model, optimizer, shown, _loss_of(recipe, model, world, number, rng)
            )
            rate = _rate_of(model, world)
            epoch = Epoch(loss=loss, seen=rate(parts.seen), unseen=rate(parts.unseen))
            curve = [*card.curve, epoch]
            best = best_epoch(curve, recipe.reinforced_from or 1)
            card = msgspec.structs.replace(card, curve=curve, best=best)
            files.keep(card, model, optimizer)
            on_epoch(number, epoch)
        files.finish(card, plan.pointer)
        return card


def _input_class(
    recipe: Recipe, truth: GroundTruth, pointer: LoadedPointer | None
) -> Sequence[str]:
    """Return the parts of observations that a model reads, with its pointer."""
    reads_objects = recipe.reads_objects or pointer is not None
    objects = ["boxes", "names"] if reads_objects and truth.task.has_targets else []
    return sorted(["instruction", *objects, *([] if recipe.is_pointer else ["geometry"])])


def best_epoch(curve: Sequence[Epoch], first: int) -> int:
    """Return the epoch with the best sum of both shares, from 1; of equal ones, the earliest.

    Those before ``first`` only prepare, and count as long as there are no others: the last of them.
    """
    numbers = range(min(first, len(curve)), len(curve) + 1)
    return max(numbers, key=lambda number: curve[number - 1].seen + curve[number - 1].unseen)


def _train_epoch(
    model: nn.Module,
    optimizer: torch.optim.Optimizer,
    shown: Iterable[IntArray],
    loss_of: Callable[[IntArray], Tensor],
) -> float:
    """Learn from some batches, and return the mean of their losses."""
    losses = []
    for rows in shown:
        optimizer.zero_grad()
        loss = loss_of(rows)
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(model.parameters(), _LARGEST_GRADIENT)
        optimizer.step()
        losses.append(loss.item())
    return float(np.mean(losses))


def _shuffled(world: World, rows: IntArray, rng: np.random.Generator) -> Iterator[IntArray]:
    """Yield each episode once, in batches."""
    drawn = list(batches(world, rng.permutation(rows), BATCH_SIZE))
    for index in rng.permutation(len(drawn)):
        yield drawn[index]


def _loss_of(
    recipe: Recipe, model: nn.Module, world: World, epoch: int, rng: np.random.Generator
) -> Callable[[IntArray], Tensor]:
    """Return the loss of batches in an epoch."""
    if isinstance(model, Pointer):
        return partial(ranking_loss, model, world, erases=recipe.erases)
    assert isinstance(model, Navigator)  # noqa: S101  # recipes have no others

    def loss_of(rows: IntArray) -> Tensor:
        is_student = bool(rng.random() < recipe.student)
        if is_student and recipe.reinforced_from and epoch >= recipe.reinforced_from:
            return policy_loss(model, world, rows)
        return imitation_loss(model, world, rows, is_student=is_student)

    return loss_of


def _rate_of(model: nn.Module, world: World) -> Callable[[IntArray], float]:
    """Return what says how good a model is."""
    if isinstance(model, Pointer):
        return partial(pointing_rate, model, world)
    assert isinstance(model, Navigator)  # noqa: S101
    return partial(success_rate, model, world)


class _Files:
    """The files of a training in its folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def finished(self, card: ModelCard) -> ModelCard | None:
        """Return the card of a finished training; None if it has not ended."""
        path = self._folder / MODEL
        if not path.exists():
            return None
        done = read_model_card(path)
        self._check_same(card, done)
        return done

    def resume(
        self, card: ModelCard, model: nn.Module, optimizer: torch.optim.Optimizer
    ) -> ModelCard:
        """Go on where a training was interrupted, if it was, and return its card."""
        path = self._folder / _LATEST
        if not path.exists():
            if any(not each.name.startswith(".") for each in self._folder.iterdir()):
                raise ReverieEvalError(f"{self._folder} is not empty; choose a new folder")
            return card
        begun = read_model_card(path)
        self._check_same(card, begun)
        tensors = load_file(path)
        kept = {name: tensors.pop(name) for name in model.state_dict()}
        model.load_state_dict(kept)
        state = optimizer.state_dict()
        for name, tensor in tensors.items():
            _, parameter, key = name.split(".")
            state["state"].setdefault(int(parameter), {})[key] = tensor
        optimizer.load_state_dict(state)
        return begun

    def _check_same(self, card: ModelCard, begun: ModelCard) -> None:
        differences = changes(_facts(begun), _facts(card))
        if differences:
            raise ReverieEvalError(
                f"{self._folder} has another training ({'; '.join(differences)}); go on as it was "
                "begun, or choose a new folder"
            )

    def keep(self, card: ModelCard, model: nn.Module, optimizer: torch.optim.Optimizer) -> None:
        """Keep the last epoch, and its weights if they are the best."""
        moments = {
            f"optimizer.{parameter}.{key}": tensor
            for parameter, its in optimizer.state_dict()["state"].items()
            for key, tensor in its.items()
        }
        if card.best == len(card.curve):
            save_model(self._folder / _BEST, model.state_dict(), card)
        save_model(self._folder / _LATEST, model.state_dict() | moments, card)

    def finish(self, card: ModelCard, pointer: Path | None) -> None:
        """Give the best weights their name, with the whole card, and remove the others."""
        if pointer is not None:
            shutil.copyfile(pointer / MODEL, self._folder / POINTER)
        shown = msgspec.structs.replace(card, words=(), remembered=())
        with staged_file(self._folder / "card.json") as file:
            file.write(msgspec.json.format(encode_card(shown)) + b"\n")
        save_model(self._folder / MODEL, load_file(self._folder / _BEST), card)
        (self._folder / _BEST).unlink()
        (self._folder / _LATEST).unlink()


def _facts(card: ModelCard) -> Mapping[str, Any]:
    """Return what has to be the same when a training goes on."""
    plain = msgspec.to_builtins(card)
    for is_learned_or_has_a_digest in ("curve", "best", "words", "remembered"):
        plain.pop(is_learned_or_has_a_digest, None)
    facts: dict[str, Any] = {}
    for name, value in plain.items():
        parts = value.items() if isinstance(value, dict) else [("", value)]
        facts |= {f"{name} {part}".rstrip(): each for part, each in parts}
    return facts
