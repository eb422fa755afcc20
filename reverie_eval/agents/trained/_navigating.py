"""What navigators have in common: what they are shown at a step, and what they answer."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from reverie_eval.agents.trained._coding import UNKNOWN, Panorama
from reverie_eval.arrays import FloatArray, IntArray

N_GEOMETRY = 7
N_MATCHES = 3
N_TOP = 3
"""Names of each neighbour's view that the pointer passes on. Source: Qi et al., 2020, section 4."""
DROPOUT = 0.3
"""The share of each vector that is left out while a network is trained."""
FORGETTING = 0.3
"""The share of viewpoints in its memory that a navigator cannot look up while it is trained."""


@dataclass(frozen=True)
class SlotInputs:
    """The parts of observations that a navigator is given; each is concatenated to the others."""

    names: bool = True
    """The mean embedding of the names in a slot."""
    geometry: bool = True
    """Direction and distance of a neighbour."""
    matches: bool = True
    """How well the instruction matches the names in a slot: the best share of a name's words that
    it says, their sum, and the number of names said in full."""
    memory: bool = True
    """An embedding of each viewpoint of the buildings in which it was trained. It stands for
    pictures, by which a known house is recognised, and says nothing in other houses."""
    top: bool = False
    """What a pointer would point at in a slot: a bi-LSTM over the names of its three best objects,
    the interaction module of Qi et al., "REVERIE", CVPR 2020, section 4."""


class Decision(NamedTuple):
    """Where an agent is, for one choice."""

    panorama: Panorama
    heading: float
    """Radians."""
    matches: FloatArray
    """Shape (n_names,): of the instruction with each name."""
    top: IntArray | None = None
    """Shape (n_slots, N_TOP): the names of the objects in each slot that a pointer scores best; -1
    if there are fewer."""


class Slots(NamedTuple):
    """What B decisions show, padded to S slots."""

    valid: Tensor
    """bool (B, S)."""
    geometry: Tensor
    """float (B, S, N_GEOMETRY)."""
    matches: Tensor
    """float (B, S, N_MATCHES)."""
    viewpoint: Tensor
    """int (B, S): indices into the memory."""
    seen: Tensor
    """int (n_seen,): the names in all slots, one after the other."""
    begin: Tensor
    """int (B * S,): where the names of each slot begin."""
    top: Tensor | None
    """int (B, S, N_TOP): the pointer's best names, then -1; None if no pointer is asked."""


def collate(decisions: Sequence[Decision]) -> Slots:
    """Put decisions into tensors."""
    panoramas = [each.panorama for each in decisions]
    n_slots = np.array([len(each.viewpoint) for each in panoramas])
    shape = len(panoramas), int(n_slots.max())
    row = np.repeat(np.arange(shape[0]), n_slots - 1)
    slot = np.concatenate([np.arange(1, number) for number in n_slots])
    heading, elevation, metres = np.concatenate([each.ways for each in panoramas]).T
    relative = heading - np.repeat([each.heading for each in decisions], n_slots - 1)
    geometry = np.zeros((*shape, N_GEOMETRY), dtype=np.float32)
    geometry[row, slot] = np.stack(
        [
            np.sin(relative),
            np.cos(relative),
            np.sin(heading),
            np.cos(heading),
            np.sin(elevation),
            metres / 5,
            np.ones_like(metres),  # not the slot of stopping
        ],
        axis=1,
    )
    viewpoint = np.full(shape, UNKNOWN)
    for index, panorama in enumerate(panoramas):
        viewpoint[index, : n_slots[index]] = panorama.viewpoint
    # The number of each name's slot; ascending.
    at = np.concatenate([each.slot + index * shape[1] for index, each in enumerate(panoramas)])
    size = shape[0] * shape[1]
    share = np.concatenate([each.matches[each.panorama.seen] for each in decisions])
    best = np.zeros(size)
    np.maximum.at(best, at, share)
    said = np.bincount(at, share, minlength=size), np.bincount(at, share == 1, minlength=size)
    matches = np.stack([best, said[0] / 4, said[1] / 4], axis=1).reshape(*shape, N_MATCHES)
    top = None
    if decisions[0].top is not None:
        names = np.full((*shape, N_TOP), -1)
        for index, each in enumerate(decisions):
            names[index, : n_slots[index]] = each.top
        top = torch.from_numpy(names)
    return Slots(
        valid=torch.from_numpy(np.arange(shape[1]) < n_slots[:, None]),
        geometry=torch.from_numpy(geometry),
        matches=torch.from_numpy(matches.astype(np.float32)),
        viewpoint=torch.from_numpy(viewpoint),
        seen=torch.from_numpy(np.concatenate([each.seen for each in panoramas])),
        begin=torch.from_numpy(np.searchsorted(at, np.arange(size))),
        top=top,
    )


class Reading(NamedTuple):
    """What a navigator keeps of an instruction, and the names that it knows."""

    context: Tensor
    """X: float (B, L, H), a vector for each word."""
    names: Tensor
    """float (n_names, E)."""


class State(NamedTuple):
    """What a navigator keeps from step to step."""

    h: Tensor
    """float (B, H)."""
    c: Tensor
    """float (B, H)."""
    action: Tensor
    """a_(t-1): float (B, H), the vector of the action that was taken."""

    def take(self, rows: Tensor) -> "State":
        """Return the states of some episodes."""
        return State(self.h[rows], self.c[rows], self.action[rows])


class ActionScores(NamedTuple):
    """What a navigator says about B decisions."""

    logits: Tensor
    """float (B, S): -inf where there is no slot."""
    h: Tensor
    """float (B, H)."""
    c: Tensor
    """float (B, H)."""
    actions: Tensor
    """float (B, S, H): the vector of each action."""
    progress: Tensor | None
    """float (B,): the part of the way that is done, in [-1, 1]; None without a progress monitor."""
    value: Tensor | None = None
    """float (B,): the reward that is still to come; None without a critic."""

    def after(self, action: Tensor) -> State:
        """Return the state after an action, int (B,)."""
        return State(self.h, self.c, self.actions[torch.arange(len(action)), action])


class Sizes(NamedTuple):
    """How large a network is."""

    n_words: int
    """Words that it knows, and one for all others."""
    embedding: int
    """E."""
    hidden: int
    """H, an even number."""


class WordEncoder(nn.Module):
    """A bidirectional LSTM over the words of an instruction, whose words are also those of names.

    All instructions of a batch have the same number of words, so nothing is padded.
    """

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.embedding = nn.Embedding(sizes.n_words, sizes.embedding)
        half = sizes.hidden // 2  # of each direction
        self.lstm = nn.LSTM(sizes.embedding, half, batch_first=True, bidirectional=True)
        self.dropout = nn.Dropout(DROPOUT)

    def forward(self, words: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return X (B, L, H) and the last states h and c (B, H), of words (B, L)."""
        context, (h, c) = self.lstm(self.dropout(self.embedding(words)))
        return self.dropout(context), _both(h), _both(c)

    def names(self, tokens: Tensor) -> Tensor:
        """Return the mean of the words of each name, (n_names, E), of tokens (n_names, T)."""
        is_word = tokens >= 0
        vectors = self.embedding(tokens.clamp(min=0)) * is_word[..., None]
        means: Tensor = vectors.sum(dim=1) / is_word.sum(dim=1, keepdim=True)
        return means


def _both(states: Tensor) -> Tensor:
    """Return the states of both directions, (2, B, H / 2), as (B, H)."""
    return torch.cat([*states], dim=-1)


class Attention(nn.Module):
    """Soft dot attention: weights softmax((W q) . x) of some vectors x, and their weighted sum."""

    def __init__(self, query: int, size: int) -> None:
        super().__init__()
        self.linear = nn.Linear(query, size, bias=False)

    def forward(
        self, query: Tensor, vectors: Tensor, valid: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return the sum (B, H) and the weights (B, N), of a query (B, Q) and vectors (B, N, H)."""
        logits = (vectors @ self.linear(query)[..., None])[..., 0]
        if valid is not None:
            logits = logits.masked_fill(~valid, -torch.inf)
        weights = logits.softmax(dim=-1)
        return (weights[:, None] @ vectors)[:, 0], weights


class SlotEncoder(nn.Module):
    """g(v): the vector of each slot, of its names, geometry, matches and viewpoint."""

    def __init__(self, sizes: Sizes, inputs: SlotInputs, n_remembered: int) -> None:
        super().__init__()
        self._inputs = inputs
        embedding = sizes.embedding
        memory = embedding // 2
        width = (
            embedding * inputs.names
            + N_GEOMETRY * inputs.geometry
            + N_MATCHES * inputs.matches
            + memory * inputs.memory
            + embedding * inputs.top
        )
        if inputs.top:
            self.top = nn.LSTM(embedding, embedding // 2, batch_first=True, bidirectional=True)
        if inputs.memory:
            self.memory = nn.Embedding(n_remembered + 1, memory, padding_idx=UNKNOWN)
        self.linear = nn.Linear(width + 1, sizes.hidden)  # whether it is the slot of stopping

    def forward(self, slots: Slots, names: Tensor) -> Tensor:
        """Return g(v), (B, S, H)."""
        shape = slots.valid.shape
        is_stop = torch.zeros(*shape, 1)
        is_stop[:, 0] = 1
        parts = [is_stop]
        if self._inputs.names:
            bags = functional.embedding_bag(slots.seen, names, slots.begin, mode="mean")
            parts.append(bags.view(*shape, -1))
        if self._inputs.geometry:
            parts.append(slots.geometry)
        if self._inputs.matches:
            parts.append(slots.matches)
        if self._inputs.memory:
            known = slots.viewpoint
            if self.training:
                known = known.masked_fill(torch.rand(shape) < FORGETTING, UNKNOWN)
            parts.append(self.memory(known))
        if slots.top is not None and self._inputs.top:
            parts.append(self._interaction(slots.top, names))
        vectors: Tensor = self.linear(torch.cat(parts, dim=-1).to(names)).tanh()
        return vectors

    def _interaction(self, top: Tensor, names: Tensor) -> Tensor:
        """Return the mean state (B, S, E) of a bi-LSTM over the pointer's names (B, S, N_TOP)."""
        is_name = (top >= 0)[..., None]
        read, _ = self.top((names[top.clamp(min=0)] * is_name).flatten(0, 1))
        states = read.view(*top.shape, -1) * is_name
        means: Tensor = states.sum(dim=2) / is_name.sum(dim=2).clamp(min=1)
        return means


class Navigator(nn.Module, ABC):
    """A model that scores actions; it neither acts nor searches nor decides when to stop."""

    def __init__(self, sizes: Sizes, inputs: SlotInputs, n_remembered: int) -> None:
        super().__init__()
        self.encoder = WordEncoder(sizes)
        self.slots = SlotEncoder(sizes, inputs, n_remembered)
        self.dropout = nn.Dropout(DROPOUT)

    def read(self, words: Tensor, tokens: Tensor) -> tuple[Reading, State]:
        """Read instructions (B, L), and the words of all names (n_names, T)."""
        context, h, c = self.encoder(words)
        return Reading(context, self.encoder.names(tokens)), State(h, c, torch.zeros_like(h))

    @abstractmethod
    def forward(self, reading: Reading, state: State, slots: Slots) -> ActionScores:
        """Score the actions of B decisions."""
