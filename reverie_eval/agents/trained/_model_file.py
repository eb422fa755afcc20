"""A trained model in a file without code: weights, and all that is needed to use them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import safetensors
import torch
from safetensors.torch import load_file, save
from torch import Tensor, nn

from reverie_eval.agents.trained._coding import Coder, Vocabulary
from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import staged_file

FORMAT_VERSION = 1
# The one key of the metadata, because safetensors keeps texts alone.
_KEY = "reverie_eval"


class Epoch(msgspec.Struct, frozen=True, kw_only=True):
    """A point of the curve that was recorded in training."""

    loss: float
    """The mean over the batches."""
    seen: float
    """The share of held-back episodes in known buildings that end in success."""
    unseen: float
    """The share of held-back episodes in buildings of their own that end in success."""


class ModelCard(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a model is, and how it came to be. ``card.json`` has it without the words."""

    format_version: int
    """The version of this form."""
    name: str
    """The recipe, such as ``r2r-sf``."""
    options: Mapping[str, Any]
    """Options of the recipe that were chosen differently."""
    seed: int
    """Seed of all random choices."""
    input_class: Sequence[str]
    """The parts of observations that it reads. ``names`` and ``boxes`` are those of annotators, so
    its numbers are not comparable with those of agents that see pictures."""
    task: str
    """The benchmark of the training data."""
    split: str
    """The split that it was trained on."""
    sources: Mapping[str, str]
    """SHA-256 of the training data, by kind of file."""
    left_out: int
    """Items that were left out because their target is not visible at the goal."""
    episodes: Mapping[str, int]
    """Episodes trained on, and those held back in seen and in unseen buildings."""
    curve: Sequence[Epoch]
    """After each epoch."""
    best: int
    """The epoch, counted from 1, whose weights these are: the best sum of both shares."""
    vocabulary_digest: str
    """SHA-256 of the words in their order."""
    reverie_eval: str
    """The version that trained it."""
    pointer: str = ""
    """SHA-256 of the pointer that answers for a navigator; empty if there is none."""
    words: Sequence[str] = ()
    """The vocabulary."""
    remembered: Sequence[str] = ()
    """The viewpoints that it has an embedding of."""


def encode_card(card: ModelCard) -> bytes:
    """Return a card as JSON, the same bytes for the same card."""
    return msgspec.json.encode(card, order="deterministic")


def save_model(path: Path, tensors: Mapping[str, Tensor], card: ModelCard) -> None:
    """Write weights and their card. The same ones give the same bytes."""
    content = encode_card(card).decode()
    with staged_file(path) as file:
        file.write(save(dict(tensors), metadata={_KEY: content}))


def read_model_card(path: Path) -> ModelCard:
    """Read what is said about a model, and check that its words are those that it learned.

    Raises
    ------
    ReverieEvalError
        If the file is not a model of this package, or another program wrote it again without its
        metadata.
    """
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
    except FileNotFoundError:
        raise ReverieEvalError(f"there is no file {path}") from None
    except safetensors.SafetensorError as error:
        raise ReverieEvalError(f"{path} is not a safetensors file: {error}") from None
    if _KEY not in metadata:
        raise ReverieEvalError(
            f"{path} has no metadata {_KEY!r}, without which its weights mean nothing; use the "
            "file that `reverie-eval train` wrote"
        )
    try:
        version = json.loads(metadata[_KEY])["format_version"]
        if version != FORMAT_VERSION:
            raise ReverieEvalError(
                f"{path} has version {version} of the form, and this is version {FORMAT_VERSION}; "
                "use the release that trained the model"
            )
        card = msgspec.json.decode(metadata[_KEY], type=ModelCard)
    except (KeyError, TypeError, ValueError) as error:
        raise ReverieEvalError(f"{path}: its metadata cannot be read: {error}") from None
    if Vocabulary(tuple(card.words)).digest != card.vocabulary_digest:
        raise ReverieEvalError(f"{path}: its words are not those that it learned")
    return card


def load_weights(path: Path, model: nn.Module) -> None:
    """Put the weights of a file into a model.

    Raises
    ------
    ReverieEvalError
        If they are not those of such a model.
    """
    try:
        model.load_state_dict(load_file(path))
    except RuntimeError as error:
        raise ReverieEvalError(f"{path}: {error}") from None


def coder_of(card: ModelCard, *, reads_objects: bool = True) -> Coder:
    """Return the coder of a model."""
    return Coder(Vocabulary(tuple(card.words)), card.remembered, reads_objects=reads_objects)


def set_threads() -> None:
    """Use one thread: the sums of several depend on how many there are, and small models lose."""
    torch.set_num_threads(1)
