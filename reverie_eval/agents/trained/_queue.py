"""The queue of FAST-Short, which decides where to go next among all that was seen so far.

Ke et al., "Tactical Rewind: Self-Correction via Backtracking in Vision-and-Language Navigation",
CVPR 2019, section 3: every action that was scored and not taken stays in the queue, with the sum of
the logits along its way; the best one is taken next, wherever it is. The agent walks there. It
stops when the best action is to stop: *short*, because no other end is looked for after the first.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from typing import Any

MOST_EXPANDED = 40
"""Viewpoints whose actions are scored, after which the best of the known ends is taken."""


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
    """The actions that were scored and not taken."""

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
