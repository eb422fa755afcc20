"""Navigators: what they are shown at a step and what they answer, and the networks of the papers.

Where the papers' networks see pictures, these are given the vectors of slots: names, geometry,
matches, memory. E is the size of an embedding, and H that of a hidden state.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from reverie_eval.agents.trained._coding import MAX_WORDS, UNKNOWN, Panorama
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


class Follower(Navigator):
    """The sequence-to-sequence follower of R2R: R2R-TF and R2R-SF.

    Anderson et al., "Vision-and-Language Navigation", CVPR 2018, section 4: an LSTM reads the
    instruction, a second one attends to its words and chooses actions. Actions are neighbours, as
    in Fried et al., "Speaker-Follower Models", NeurIPS 2018, section 3.3, and as REVERIE's code has
    them. In place of the picture that the agent faces, the second LSTM is given the vectors of all
    slots, attended to by its last state.
    """

    def __init__(self, sizes: Sizes, inputs: SlotInputs, n_remembered: int) -> None:
        super().__init__(sizes, inputs, n_remembered)
        hidden = sizes.hidden
        self.see = Attention(hidden, hidden)
        self.lstm = nn.LSTMCell(2 * hidden, hidden)
        self.listen = Attention(hidden, hidden)
        self.combine = nn.Linear(2 * hidden, hidden, bias=False)
        self.score = nn.Linear(hidden, hidden, bias=False)

    def forward(self, reading: Reading, state: State, slots: Slots) -> ActionScores:
        """Score the actions of B decisions."""
        u = self.dropout(self.slots(slots, reading.names))  # (B, S, H)
        v, _ = self.see(state.h, u, slots.valid)  # (B, H)
        h, c = self.lstm(torch.cat([v, state.action], dim=-1), (state.h, state.c))
        x, _ = self.listen(self.dropout(h), reading.context)  # c_t of the paper, (B, H)
        h_tilde = self.combine(torch.cat([x, self.dropout(h)], dim=-1)).tanh()
        logits: Tensor = (u @ self.score(self.dropout(h_tilde))[..., None])[..., 0]  # (B, S)
        return ActionScores(logits.masked_fill(~slots.valid, -torch.inf), h, c, u, None)


class Rcm(Follower):
    """RCM: the follower, with a critic that says what reward is still to come, b.

    Wang et al., "Reinforced Cross-Modal Matching and Self-Supervised Imitation Learning for
    Vision-Language Navigation", CVPR 2019, section 3: the policy gradient whose loss is
    ``policy_loss``. The intrinsic reward, by which a second network says how well a trajectory
    tells the instruction, is left out, and so is the self-supervised imitation, which walks in the
    buildings of the evaluation.
    """

    def __init__(self, sizes: Sizes, inputs: SlotInputs, n_remembered: int) -> None:
        super().__init__(sizes, inputs, n_remembered)
        hidden = sizes.hidden
        self.critic = nn.Sequential(nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, 1))

    def forward(self, reading: Reading, state: State, slots: Slots) -> ActionScores:
        """Score the actions of B decisions."""
        scores = super().forward(reading, state, slots)
        # The critic judges states; it does not shape them.
        return scores._replace(value=self.critic(scores.h.detach())[..., 0])


def positions(n_words: int, size: int) -> Tensor:
    """Return PE, float (n_words, size): sines and cosines of each word's number.

    Vaswani et al., "Attention Is All You Need", 2017, section 3.5.
    """
    rate = torch.exp(torch.arange(0, size, 2) * (-math.log(10_000) / size))
    angle = torch.arange(n_words)[:, None] * rate
    return torch.stack([angle.sin(), angle.cos()], dim=-1).flatten(1)


class SelfMonitor(Navigator):
    """The self-monitoring agent: SelfMonitor, and the network of FAST and Interactive.

    Ma et al., "Self-Monitoring Navigation Agent via Auxiliary Progress Estimation", ICLR 2019:
    co-grounding of words and views, and a progress monitor (section 3). v_k, the feature of a view,
    is the vector of a slot.
    """

    def __init__(self, sizes: Sizes, inputs: SlotInputs, n_remembered: int) -> None:
        super().__init__(sizes, inputs, n_remembered)
        hidden = sizes.hidden
        self.positions: Tensor
        self.register_buffer("positions", positions(MAX_WORDS, hidden), persistent=False)
        self.text = Attention(hidden, hidden)
        self.visual = Attention(hidden, hidden)
        self.lstm = nn.LSTMCell(3 * hidden, hidden)
        self.action = nn.Linear(2 * hidden, hidden)
        self.monitor = nn.Linear(2 * hidden, hidden)
        self.progress = nn.Linear(MAX_WORDS + hidden, 1)

    def forward(self, reading: Reading, state: State, slots: Slots) -> ActionScores:
        """Score the actions of B decisions."""
        g = self.dropout(self.slots(slots, reading.names))  # (B, S, H)
        n_words = reading.context.shape[1]
        # The words are told apart by position; the sum is of the words themselves.
        _, alpha = self.text(state.h, reading.context + self.positions[:n_words])  # (B, L)
        x = (alpha[:, None] @ reading.context)[:, 0]  # (B, H)
        v, _ = self.visual(state.h, g, slots.valid)  # (B, H)
        h, c = self.lstm(torch.cat([x, v, state.action], dim=-1), (state.h, state.c))
        # The score o of each action: of W_a [h, x] with its vector g(v).
        o = (g @ self.action(self.dropout(torch.cat([h, x], dim=-1)))[..., None])[..., 0]
        # alpha, of a varying number of words, is padded to the longest instruction.
        h_pm = c.sigmoid() * self.monitor(torch.cat([state.h, v], dim=-1)).tanh()
        padded = functional.pad(alpha, (0, MAX_WORDS - n_words))
        p_pm = self.progress(torch.cat([padded, h_pm], dim=-1)).tanh()[..., 0]
        return ActionScores(o.masked_fill(~slots.valid, -torch.inf), h, c, g, p_pm)
