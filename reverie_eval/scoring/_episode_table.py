"""The episode table: every metric's value for every episode under a protocol, and its outcome.

An episode has one of five outcomes. "The goal" is any goal viewpoint under the protocol; under the
official one, any viewpoint from which the target is visible.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Literal

import numpy as np

from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray, frozen
from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import CATALOGUE, Need, candidate_match
from reverie_eval.scoring._lookups import Lookups
from reverie_eval.tasks import Protocol
from reverie_eval.text import count_text, did_you_mean, first_few

Track = Literal["full", "grounding"]
"""What the agent does: navigate and ground the object, or ground it from the goal."""


def scored_metrics(
    protocol: Protocol,
    track: Track,
    *,
    has_boxes: bool = False,
    has_answers: bool = True,
) -> Sequence[str]:
    """Return the keys of the metrics that a protocol scores, in CATALOGUE order."""
    given: Mapping[Need, bool] = {
        "trajectory": track == "full",
        "answer": has_answers and protocol.grounding != "not scored",
        "box": has_boxes,
    }
    available = protocol.measures.union(need for need, is_given in given.items() if is_given)
    return tuple(key for key, metric in CATALOGUE.items() if metric.needs <= available)


def qualifier_of(track: Track) -> str:
    """Return the part of a signature that names the track; empty for the full one."""
    return "" if track == "full" else f"track:{track}"


def track_of(qualifier: str) -> Track:
    """Return the track that a part of a signature names."""
    return "grounding" if qualifier == qualifier_of("grounding") else "full"


class EpisodeTable(Mapping[str, Array]):
    """One value per episode for every scored metric, as read-only columns of floats.

    Keys and their order are those of the CATALOGUE. A metric is scored if the submission contains
    what it needs and the protocol scores it. Columns are computed on first access, from the
    :class:`reverie_eval.metrics.Inputs` that this table is. Columns that were computed before can
    be given.
    """

    def __init__(
        self,
        lookups: Lookups,
        protocol: Protocol,
        track: Track,
        columns: Mapping[str, Array] = MappingProxyType({}),
    ) -> None:
        self.lookups = lookups.measured_by(protocol.goal)
        self.protocol = protocol
        # Which metrics are scored is known before any is computed, so a table's keys cost nothing.
        self._keys = scored_metrics(
            protocol,
            track,
            has_boxes=lookups.has_boxes,
            has_answers=not lookups.submission.is_navigation_only,
        )
        # Two caches: metrics that depend on others take booleans as they are, users get floats.
        self._values: dict[str, Array] = {}
        self._columns: dict[str, Array] = dict(columns)

    def __getitem__(self, key: str) -> Array:
        if key not in CATALOGUE:
            # Tables have labels, so a reader of one looks for SR.
            keys = {CATALOGUE[each].label.casefold(): each for each in self._keys}
            meant = keys.get(str(key).casefold(), key)
            raise KeyError(f"no metric has the key {key!r}{did_you_mean(meant, self._keys)}")
        if key not in self._keys:
            raise KeyError(f"{key} is not scored; the scored metrics are {', '.join(self._keys)}")
        if key not in self._columns:
            self._columns[key] = frozen(self.metric(key).astype(np.float64))
        return self._columns[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)

    @property
    def at_goal(self) -> BoolArray:
        """Shape (n_poses,): whether each pose is at a goal viewpoint of its episode."""
        return self.lookups.at_goal(self.protocol.goal)

    @property
    def oracle_at_goal(self) -> BoolArray:
        """Shape (n_poses,): whether a stop at each pose would be a success of an oracle."""
        return self.lookups.oracle_at_goal(self.protocol.goal)

    @cached_property
    def outline(self) -> FloatArray:
        """Shape (n_episodes, 5, 2): the target as seen from the stop; NaN if not visible."""
        return self.lookups.outline(self.protocol.repeated_outlines)

    @cached_property
    def is_answer_correct(self) -> BoolArray:
        """Shape (n_episodes,): whether the answer is correct, wherever the agent stopped."""
        lookups, submission = self.lookups, self.lookups.submission
        correct = candidate_match(submission.predicted_object, lookups.target_object)
        if not self.protocol.text_ids_count:
            correct &= ~submission.answer_is_text
        # The published evaluators compare ids as text: "007" is not "7".
        correct &= ~submission.has_leading_zeros
        if lookups.has_boxes:
            correct[lookups.boxes.row] = lookups.boxes.is_correct
        return correct

    @property
    def needs_success(self) -> bool:
        """Whether a correct answer counts only with success."""
        return self.protocol.grounding == "only with success"

    @property
    def reference_length(self) -> FloatArray:
        """Shape (n_episodes,): metres with which SPL compares the walked length."""
        match self.protocol.spl_numerator:
            case "shortest":
                return self.lookups.shortest_length
            case "annotated":
                return self.lookups.annotated_length
            case "nearest goal":
                return self.lookups.start_to_goals

    def metric(self, key: str) -> Array:
        """Shape (n_episodes,): a metric by its key, in the type that its function returns."""
        if key not in self._values:
            self._values[key] = CATALOGUE[key].compute(self)
        return self._values[key]


def jump_notes(jumps: Array, protocol: Protocol | None = None) -> Sequence[str]:
    """Count the moves between unconnected viewpoints, and say how a protocol treats them."""
    if not jumps.any():
        return ()
    episodes = count_text(int((jumps > 0).sum()), "episode")
    treatment = ""
    if protocol is not None and protocol.rejects_jumps:
        treatment = f"; {protocol.name}'s own evaluator stops at a jump"
    jumps_text = count_text(int(jumps.sum()), "jump")
    return (f"{jumps_text} in {episodes}: {CATALOGUE['jumps'].definition}{treatment}",)


def unscored_notes(truth: GroundTruth, protocol: Protocol) -> Iterator[str]:
    """Yield what a protocol leaves out of a split, if it does."""
    if truth.subset_digest or truth.subset_of is None:
        return
    whole, _ = truth.subset_of
    unscored = sorted(whole.episodes.index.keys() - truth.episodes.index.keys())
    yield (
        f"{protocol.name} scores the first {protocol.scored_instructions} instructions of a path, "
        f"not {first_few(unscored)}"
    )


OUTCOMES: Mapping[str, str] = MappingProxyType(
    {
        "never reached": "did not get to the goal",
        "overshot": "reached the goal and moved on",
        "wrong object": "stopped at the goal, but predicted another object or none",
        "correct object at the wrong stop": "predicted the target, but stopped elsewhere",
        "correct": "stopped at the goal and predicted the target",
    }
)
"""The outcomes and their meanings, from worst to best."""

CORRECT = list(OUTCOMES).index("correct")
"""The index of ``correct`` in ``OUTCOMES``."""
OUTCOME_METRICS = ("success", "oracle_success", "rgs")
"""The metrics that outcomes are computed from."""
_WRONG_STOP = list(OUTCOMES).index("correct object at the wrong stop")


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
    missing = [key for key in OUTCOME_METRICS if key not in episodes]
    if missing:
        raise ProtocolError(
            "outcomes need success, oracle success and RGS; not scored here: "
            f"{first_few(missing)}; choose another protocol, or the full track"
        )
    return [episodes[key] > 0 for key in OUTCOME_METRICS]
