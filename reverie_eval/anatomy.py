"""Anatomy of failure: what became of every episode, in five outcomes.

An episode comes to exactly one of them. "The goal" is what counts as success under the protocol;
under the official one, every viewpoint that sees the target.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from reverie_eval.arrays import Array, IntArray
from reverie_eval.errors import ProtocolError
from reverie_eval.wording import some

OUTCOMES: Mapping[str, str] = MappingProxyType(
    {
        "never near": "never came to the goal",
        "passed by": "came to the goal and went on",
        "wrong object": "stopped at the goal, and named another object or none",
        "right from afar": "stopped elsewhere, and still named the target",
        "right": "stopped at the goal and named the target",
    }
)
"""The outcomes, from the worst to the best, with what they mean."""

_AFAR = list(OUTCOMES).index("right from afar")
_NEEDED = ("success", "oracle_success", "rgs")


@dataclass(frozen=True)
class Anatomy:
    """How many episodes came to which outcome."""

    counts: Mapping[str, int]
    """By outcome; they add up to all episodes."""
    afar_after_passing: int
    """Of those right from afar, how many had come to the goal on their way."""

    @property
    def funnel(self) -> Mapping[str, int]:
        """How many episodes came so far: all, to the goal, to a stop there, to the right answer.

        The second is OSR and the third SR, times the number of episodes. The last is those of RGS
        that are also a success.
        """
        count = self.counts
        stopped = count["wrong object"] + count["right"]
        return {
            "all episodes": sum(count.values()),
            "came to the goal": stopped + count["passed by"] + self.afar_after_passing,
            "stopped there": stopped,
            "named the target": count["right"],
        }


def outcomes_of(episodes: Mapping[str, Array]) -> IntArray:
    """Tell what became of each episode.

    Parameters
    ----------
    episodes : mapping
        An episode table, with success, oracle success and RGS.

    Returns
    -------
    array of int, shape (n_episodes,)
        The number of the outcome in ``OUTCOMES``.

    Raises
    ------
    ProtocolError
        If one of the three is not scored.
    """
    succeeded, came, grounded = _judged(episodes)
    from_the_best = [grounded & succeeded, grounded, succeeded, came]
    return np.select(from_the_best, [4, 3, 2, 1], 0)


def anatomy_of(episodes: Mapping[str, Array]) -> Anatomy:
    """Count the outcomes; errors are those of :func:`outcomes_of`."""
    outcome = outcomes_of(episodes)
    counts = np.bincount(outcome, minlength=len(OUTCOMES)).tolist()
    _, came, _ = _judged(episodes)
    afar = outcome == _AFAR
    return Anatomy(dict(zip(OUTCOMES, counts, strict=True)), int((afar & came).sum()))


def _judged(episodes: Mapping[str, Array]) -> Sequence[Array]:
    missing = [key for key in _NEEDED if key not in episodes]
    if missing:
        raise ProtocolError(
            f"outcomes need success, oracle success and RGS, and {some(missing)} is not scored "
            "here; choose another protocol, or the full track"
        )
    return [episodes[key] > 0 for key in _NEEDED]
