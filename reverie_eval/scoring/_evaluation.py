"""Prepared submissions: read, aligned with the ground truth, checked, and scored.

We read every form as its authors meant it. Published evaluators read literally: some take only the
first viewpoint of a nested hop, one never matches an object id that is written as text, and all
stop at records that they do not expect. Notes say what they make of a file.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from types import MappingProxyType
from typing import get_args

from typing_extensions import Self

from reverie_eval import metrics
from reverie_eval.arrays import Array, BoolArray
from reverie_eval.errors import GroundTruthError, ProtocolError
from reverie_eval.ground_truth import GroundTruth, find_ground_truth
from reverie_eval.scoring._episode_table import Track, jump_notes, qualifier_of
from reverie_eval.scoring._lookups import Lookups, find_jumps
from reverie_eval.scoring._scores import Scores
from reverie_eval.submissions import (
    Predictions,
    Submission,
    SubmissionColumns,
    align,
    align_answers_only,
    answer_hints,
    read_predictions,
    submission_hints,
)
from reverie_eval.tasks import (
    DEFAULT_PROTOCOL,
    HopReading,
    KnownSplit,
    Protocol,
    Task,
)
from reverie_eval.text import count_text, did_you_mean


@dataclass(frozen=True, eq=False)
class Validation:
    """The result of checking a valid submission, without using the solution."""

    ground_truth: GroundTruth
    abstained: BoolArray
    """Shape (n_episodes,): whether the answer predicts neither an object nor a box."""
    jumps: Array
    """Shape (n_episodes,): moves between unconnected viewpoints."""
    hints: Sequence[str] = ()
    """How the file was read, and what in it looks like a mistake."""

    @property
    def notes(self) -> Sequence[str]:
        """What the participant should know before submitting, one sentence each."""
        abstained, total = int(self.abstained.sum()), len(self.abstained)
        some_abstain = 0 < abstained < total  # if all do, there is a hint already
        answers = count_text(total, "answer")
        notes = [f"{abstained:,} of {answers} predict no object"] if some_abstain else []
        return [*notes, *self.hints, *jump_notes(self.jumps)]


def evaluate_protocols(
    submission: Submission,
    *,
    split: str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    track: Track = "full",
    task: str | None = None,
) -> Mapping[str, Scores]:
    """Score a submission under every protocol that the ground truth supports, by name.

    Parameters and errors are those of :func:`reverie_eval.evaluate`.
    """
    truth = find_ground_truth(ground_truth, split, task)
    truth.require_solution()
    predictions = read_predictions(
        submission, truth.task, truth.graph, answers_only=is_grounding(track)
    )
    protocols = truth.task.protocols
    reasons = {protocol: why_not(protocol, truth, track) for protocol in protocols}
    # A missing row would look like an omission of ours, so every table says why.
    left_out = [f"left out: {reason}" for reason in reasons.values() if reason]
    prepared: dict[object, PreparedSubmission] = {}
    # Protocols that score the same episodes by the same paths share one aligned submission, and its
    # look-ups.
    for protocol in protocols:
        if protocol.basis not in prepared:
            aligned = PreparedSubmission.of(predictions, truth.scored_by(protocol), track)
            prepared[protocol.basis] = replace(aligned, hints=[*aligned.hints, *left_out])
    return {
        protocol.name: prepared[protocol.basis].score(protocol)
        for protocol in protocols
        if not reasons[protocol]
    }


def diagnose(
    submission: Submission,
    *,
    split: KnownSplit | str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    protocol: str = DEFAULT_PROTOCOL,
    task: str | None = None,
) -> tuple[Scores, Scores]:
    """Score a submission as intended, and as evaluators that truncate nested hops would.

    The evaluators of ``official-v1``, ``challenge-2022``, ``airbert`` and ``hamt`` read only the
    first viewpoint of each element of a trajectory. If the elements are hops with several
    viewpoints, they silently lose the others.

    Parameters and errors are those of :func:`reverie_eval.evaluate`. For a protocol whose evaluator
    does not truncate hops, raises ProtocolError.
    """
    truth = find_ground_truth(ground_truth, split, task)
    truth.require_solution()
    # Before the file is read: it depends on the protocol alone.
    check_first_of_hop(protocol, truth.task)
    chosen = truth.task.protocol(protocol)
    predictions = read_predictions(submission, truth.task, truth.graph)
    whole = PreparedSubmission.of(predictions, truth)
    # Without notes on literal readings: the second scores are those.
    truncated = PreparedSubmission.truncated(predictions, truth)
    return replace(whole, predictions=None).score(chosen), truncated.score(chosen)


def validate(
    submission: Submission,
    *,
    split: str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    track: Track = "full",
    subset: Iterable[str] | None = None,
    task: str | None = None,
) -> Validation:
    """Check a submission as :func:`reverie_eval.evaluate` does, but without the solution.

    A public bundle is enough. Parameters and errors are those of ``evaluate``.
    """
    truth = find_ground_truth(ground_truth, split, task, subset)
    default, *_ = truth.task.protocols
    predictions = read_predictions(
        submission, truth.task, truth.graph, answers_only=is_grounding(track)
    )
    return PreparedSubmission.of(predictions, truth.scored_by(default), track).validation()


@dataclass(frozen=True)
class PreparedSubmission:
    """A valid submission, aligned with its ground truth."""

    submission: SubmissionColumns
    ground_truth: GroundTruth
    track: Track = "full"
    qualifier: str = ""
    """What the scores depend on besides split, protocol, data and track; in the signature."""
    hints: Sequence[str] = ()
    """How the file was read, and what looks like a mistake; independent of the solution."""
    answer_hints: Sequence[str] = ()
    """What looks like a mistake given the solution, and so reveals something about it."""
    predictions: Predictions | None = None
    """The file's content, to note what the protocol's own evaluator makes of it; None for no such
    note, because it reveals other scores than those of the submission."""

    @classmethod
    def of(
        cls,
        predictions: Predictions,
        truth: GroundTruth,
        track: Track = "full",
        qualifier: str = "",
    ) -> Self:
        """Align predictions with the ground truth.

        Raises
        ------
        SubmissionError
            If the predictions do not fit; lists every problem.
        """
        grounding = is_grounding(track)
        aligned = (align_answers_only if grounding else align)(predictions, truth)
        return cls(
            submission=aligned,
            ground_truth=truth,
            track=track,
            qualifier=qualifier,
            hints=list(submission_hints(predictions, aligned, answers_only=grounding)),
            answer_hints=list(answer_hints(aligned, truth)),
            predictions=predictions,
        )

    @classmethod
    def truncated(cls, predictions: Predictions, truth: GroundTruth) -> Self:
        """Align predictions as evaluators read them that take only the first of each hop."""
        read = predictions.first_of_hops()
        return replace(cls.of(read, truth, qualifier="reading:first-of-hop"), predictions=None)

    def without_answer_hints(self) -> Self:
        """Return the submission without the hints that reveal something about the solution."""
        return replace(self, answer_hints=(), predictions=None)

    def validation(self) -> Validation:
        """Return the result of checking the submission, which has no scores."""
        aligned = self.submission
        return Validation(
            ground_truth=self.ground_truth,
            abstained=aligned.abstained,
            jumps=metrics.jumps(find_jumps(aligned, self.ground_truth.graph), aligned.offsets),
            hints=[*self.hints, *self.answer_hints],
        )

    def score(self, protocol: Protocol) -> Scores:
        """Score the submission under a protocol.

        Raises
        ------
        GroundTruthError
            If the ground truth or the track does not support the protocol.
        """
        reason = why_not(protocol, self.ground_truth, self.track)
        if reason:
            raise GroundTruthError(reason)
        hints = [*self.hints, *self.answer_hints, *self._literal_reading_notes(protocol)]
        qualifier = qualifier_of(self.track) or self.qualifier
        return Scores.of(self._lookups, protocol, hints=hints, qualifier=qualifier)

    def _literal_reading_notes(self, protocol: Protocol) -> Iterator[str]:
        """Yield a note if the protocol's own evaluator would read the file differently."""
        predictions = self.predictions
        if predictions is None or self.track != "full":
            return
        is_truncated = protocol.nested_hops == "first viewpoint" and predictions.has_long_hops
        if protocol.text_ids_count:
            if is_truncated:
                yield (
                    "evaluators that read only the first viewpoint of each hop give other scores, "
                    "which `reverie-eval --diagnose` shows"
                )
            return
        # Where ids are read literally and hops are not, no evaluator prints the table's scores.
        evaluator = f"{protocol.name}'s own evaluator"
        has_text = bool(predictions.answer_is_text.any())
        stopping = [text for key, text in _STOPPING.items() if predictions.differences.get(key)]
        if stopping:
            yield f"{evaluator} ends with an error for this very file: {' and '.join(stopping)}"
        elif len(predictions.boxes.row):
            yield f"{evaluator} reads no boxes: answers by box are incorrect there"
        elif is_truncated:
            scores = self.truncated(predictions, self.ground_truth).score(protocol)
            values = ", ".join(f"{m.label} {m.display(scores[m.key])}" for m in scores.headline)
            reasons = " and ".join([_FIRST_ONLY, *([_NO_TEXT] if has_text else [])])
            yield f"{evaluator} gives this very file {values}: {reasons}"
        elif has_text:
            yield f"{evaluator} gives this very file the same scores: {_NO_TEXT}"

    @cached_property
    def _lookups(self) -> Lookups:
        return Lookups(self.submission, self.ground_truth)


def is_grounding(track: Track) -> bool:
    """Whether a track scores answers alone; raise ProtocolError if there is no such track."""
    if track not in get_args(Track):
        raise ProtocolError(f"unknown track {track!r}{did_you_mean(track, get_args(Track))}")
    return track == "grounding"


def why_not(protocol: Protocol, truth: GroundTruth, track: Track) -> str | None:
    """Return why a protocol cannot score submissions of a split; None if it can."""
    solution = truth.require_solution()
    measured = {
        "visible and near the object": solution.candidate_distance,
        "at most 3 m from the object": solution.target_position,
    }
    if protocol.goal in measured and measured[protocol.goal] is None:
        return (
            f"{protocol.name} needs object positions, which {truth.origin} was compiled without; "
            "compile it again with --object-positions"
        )
    if track == "grounding" and protocol.grounding == "not scored":
        return f"{protocol.name} does not score grounding, the only score of this track"
    return None


_FIRST_ONLY = "it reads only the first viewpoint of each hop"
_NO_TEXT = "no object id written as text is correct"

# The differences from the official form at which the 2022 challenge's script fails.
_STOPPING: Mapping[str, str] = MappingProxyType(
    {
        "keyed": "it expects a list of records",
        "prefixed": 'it knows no instr_id with the prefix "reverie_"',
        "bare viewpoints": "it expects each pose to be a list",
        "empty hops": "it expects a viewpoint in each hop",
        "other key": "it reads only predObjId",
        "navigation only": "it expects predObjId in each record",
    }
)

_NOT_DIAGNOSED: Mapping[HopReading, str] = MappingProxyType(
    {
        "every viewpoint": "its evaluators read every viewpoint of a nested hop, as reverie-eval "
        "does",
        "rejected": "its evaluator rejects trajectories with skipped viewpoints",
        "no evaluator": "it is the text of a paper, and has no evaluator",
    }
)


def check_first_of_hop(name: str, task: Task) -> None:
    """Raise ProtocolError if a protocol's evaluator does not truncate nested hops."""
    names = [name, *(protocol.name for protocol in task.protocols), *task.aliases]
    readings = {each: task.hop_reading(each) for each in names}
    if readings[name] != "first viewpoint":
        found = [each for each, reading in readings.items() if reading == "first viewpoint"]
        others = ", ".join(found) or "none of its protocols"
        raise ProtocolError(
            f"{name} has nothing to diagnose: {_NOT_DIAGNOSED[readings[name]]}; evaluators that "
            f"read only the first viewpoint of a hop are those of {others}"
        )
