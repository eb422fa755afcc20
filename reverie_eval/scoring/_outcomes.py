"""Failure modes: every episode has one of five outcomes.

"The goal" is any goal viewpoint under the protocol; under the official one, any viewpoint from
which the target is visible.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from reverie_eval.arrays import Array, IntArray
from reverie_eval.errors import ProtocolError
from reverie_eval.text import first_few

OUTCOMES: Mapping[str, str] = MappingProxyType(
    {
        "never reached": "never reached the goal",
        "overshot": "reached the goal and moved on",
        "wrong object": "stopped at the goal, but predicted another object or none",
        "correct object at the wrong stop": "predicted the target, but stopped elsewhere",
        "correct": "stopped at the goal and predicted the target",
    }
)
"""The outcomes and their meanings, from worst to best."""

_WRONG_STOP = list(OUTCOMES).index("correct object at the wrong stop")
_NEEDED = ("success", "oracle_success", "rgs")


@dataclass(frozen=True)
class FailureModes:
    """How many episodes had each outcome."""

    counts: Mapping[str, int]
    """Episodes by outcome; every episode is counted once."""
    wrong_stops_after_reaching: int
    """Episodes with the correct object at the wrong stop that reached the goal on the way."""

    @property
    def funnel(self) -> Mapping[str, int]:
        """Progress funnel: the number of episodes that reached each stage.

        The second count is OSR and the third SR, times the number of episodes. The last one is
        the successful part of RGS.
        """
        count = self.counts
        stopped = count["wrong object"] + count["correct"]
        return {
            "all episodes": sum(count.values()),
            "reached the goal": stopped + count["overshot"] + self.wrong_stops_after_reaching,
            "stopped at the goal": stopped,
            "predicted the target": count["correct"],
        }


def outcome_indices(episodes: Mapping[str, Array]) -> IntArray:
    """Return the outcome of each episode.

    Parameters
    ----------
    episodes : mapping
        An episode table with success, oracle success and RGS.

    Returns
    -------
    array of int, shape (n_episodes,)
        Index into ``OUTCOMES``.

    Raises
    ------
    ProtocolError
        If one of the three is not scored.
    """
    succeeded, reached, grounded = _needed_columns(episodes)
    # np.select takes the first condition that holds, so the best outcome comes first.
    return np.select([grounded & succeeded, grounded, succeeded, reached], [4, 3, 2, 1], 0)


def failure_modes(episodes: Mapping[str, Array]) -> FailureModes:
    """Count the outcomes; errors are those of :func:`outcome_indices`."""
    outcome = outcome_indices(episodes)
    counts = np.bincount(outcome, minlength=len(OUTCOMES)).tolist()
    _, reached, _ = _needed_columns(episodes)
    return FailureModes(
        counts=dict(zip(OUTCOMES, counts, strict=True)),
        wrong_stops_after_reaching=int((reached & (outcome == _WRONG_STOP)).sum()),
    )


def _needed_columns(episodes: Mapping[str, Array]) -> Sequence[Array]:
    missing = [key for key in _NEEDED if key not in episodes]
    if missing:
        raise ProtocolError(
            "outcomes need success, oracle success and RGS; not scored here: "
            f"{first_few(missing)}; choose another protocol, or the full track"
        )
    return [episodes[key] > 0 for key in _NEEDED]
