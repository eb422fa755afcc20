"""Evaluate: the one place that joins reading, aligning, looking up and judging."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import Literal, Self, get_args

from reverie_eval import metrics
from reverie_eval.alignment import AlignedSubmission, align, place_at_goal
from reverie_eval.episode_table import EpisodeTable
from reverie_eval.errors import GroundTruthError, ProtocolError
from reverie_eval.facts import Facts, find_jumps
from reverie_eval.ground_truth import GroundTruth, find_ground_truth
from reverie_eval.metrics import BOX_METRICS, CATALOGUE
from reverie_eval.protocol import DEFAULT_PROTOCOL, PROTOCOLS, Protocol, protocol_named
from reverie_eval.reading import Predictions, Submission, read_predictions
from reverie_eval.remarks import (
    about_answers,
    about_candidates,
    about_trajectories,
    how_it_was_read,
)
from reverie_eval.scores import Scores, Validation

Track = Literal["full", "grounding"]
"""What an agent had to do: find its way and name the object, or name it from the goal."""


def evaluate(
    submission: Submission,
    *,
    split: str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    protocol: str = DEFAULT_PROTOCOL,
    track: Track = "full",
) -> Scores:
    """Score a submission.

    Parameters
    ----------
    submission : path, bytes, open file, or sequence of records
        The result file (plain or gzip, ``-`` for standard input), its content, or its records as
        Python objects: ``{"instr_id", "trajectory", "predObjId"}``, or any form that public
        codebases write.
    split : str
        ``train``, ``val_seen``, ``val_unseen`` or ``test``.
    ground_truth : path or GroundTruth, optional
        A bundle, or a folder of bundles. Without it, what ``REVERIE_EVAL_GROUND_TRUTH`` names,
        and failing that the synthetic demo world that ships with the package.
    protocol : str
        A name in ``PROTOCOLS``, or an alias.
    track : "full" or "grounding"
        In the grounding track the agent stands at the end of the annotated path: trajectories are
        not looked at and may be left out, and RGS is the only score.

    Returns
    -------
    Scores
        One value per metric and episode, and their means.

    Raises
    ------
    SubmissionError
        If the submission is wrong; lists every problem with its place.
    GroundTruthError
        If there is no sound ground truth with answers for the split and the protocol.
    ProtocolError
        If there is no such protocol.
    OSError
        If a file cannot be read.

    Examples
    --------
    >>> scores = evaluate("fixtures/submissions/good.json", split="val_unseen")
    >>> round(scores["success"], 2)
    0.81
    """
    rules = protocol_named(protocol)
    truth = _with_answers(ground_truth, split)
    return _read(submission, truth, track).score(rules)


def evaluate_protocols(
    submission: Submission,
    *,
    split: str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    track: Track = "full",
) -> Mapping[str, Scores]:
    """Score a submission under every protocol that the ground truth can serve, by name.

    Parameters and errors are those of :func:`evaluate`.
    """
    truth = _with_answers(ground_truth, split)
    reading = _read(submission, truth, track)
    obstacles = {name: reading.obstacle(rules) for name, rules in PROTOCOLS.items()}
    left_out = [f"left out: {obstacle}" for obstacle in obstacles.values() if obstacle]
    reading = replace(reading, remarks=[*reading.remarks, *left_out])
    return {name: reading.score(rules) for name, rules in PROTOCOLS.items() if not obstacles[name]}


def diagnose(
    submission: Submission,
    *,
    split: str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    protocol: str = DEFAULT_PROTOCOL,
) -> tuple[Scores, Scores]:
    """Score a submission as it was meant, and as a reader of each hop's first viewpoint would.

    Evaluators that read only the first viewpoint of every element of a trajectory (the dataset's
    own, the 2022 challenge's) cut nested hops without a word. Parameters and errors are those of
    :func:`evaluate`.
    """
    rules = protocol_named(protocol)
    truth = _with_answers(ground_truth, split)
    predictions = read_predictions(submission)
    whole = Reading.of(predictions, truth)
    cut = Reading.of(predictions.first_of_hops(), truth, qualifier="reading:first-of-hop")
    return whole.score(rules), cut.score(rules)


def validate(
    submission: Submission,
    *,
    split: str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
) -> Validation:
    """Check a submission as :func:`evaluate` does, without looking at goals or targets.

    A public bundle is enough. Parameters and errors are those of :func:`evaluate`.
    """
    truth = find_ground_truth(ground_truth, split)
    return _read(submission, truth, "full").validation()


def _with_answers(
    ground_truth: str | PathLike[str] | GroundTruth | None, split: str
) -> GroundTruth:
    """Find the ground truth and make sure that it can score, before anything is read."""
    truth = find_ground_truth(ground_truth, split)
    _ = truth.secret
    return truth


def _read(submission: Submission, truth: GroundTruth, track: Track) -> "Reading":
    if track not in get_args(Track):
        raise ProtocolError(f"no track {track!r}; choose one of: {', '.join(get_args(Track))}")
    if track == "full":
        return Reading.of(read_predictions(submission), truth)
    return Reading.placed(read_predictions(submission, answers_only=True), truth)


@dataclass(frozen=True)
class Reading:
    """A sound submission beside the ground truth that it is held against."""

    submission: AlignedSubmission
    ground_truth: GroundTruth
    remarks: Sequence[str]
    """What may be said without looking at answers."""
    insights: Sequence[str] = ()
    """What may not."""
    qualifier: str = ""
    scored: Collection[str] = tuple(CATALOGUE)

    @classmethod
    def of(cls, predictions: Predictions, truth: GroundTruth, qualifier: str = "") -> Self:
        """Take trajectories and answers as they are."""
        aligned = align(predictions, truth)
        remarks = [
            *how_it_was_read(predictions),
            *about_answers(aligned),
            *about_trajectories(predictions, aligned),
        ]
        insights = list(about_candidates(aligned, truth))
        return cls(aligned, truth, remarks, insights, qualifier)

    @classmethod
    def placed(cls, predictions: Predictions, truth: GroundTruth) -> Self:
        """Take the answers alone, with every agent at its goal."""
        aligned = place_at_goal(predictions, truth)
        remarks = [*how_it_was_read(predictions), *about_answers(aligned)]
        insights = list(about_candidates(aligned, truth))
        scored = {"rgs", *BOX_METRICS}
        return cls(aligned, truth, remarks, insights, "track:grounding", scored)

    @cached_property
    def _facts(self) -> Facts:
        return Facts(self.submission, self.ground_truth)

    def validation(self) -> Validation:
        """Say what can be said without a score."""
        aligned = self.submission
        return Validation(
            ground_truth=self.ground_truth,
            abstained=aligned.abstained,
            jumps=metrics.jumps(find_jumps(aligned, self.ground_truth.graph), aligned.offsets),
            remarks=[*self.remarks, *self.insights],
        )

    def discreet(self) -> Self:
        """Return the same, saying nothing that tells of answers."""
        return replace(self, insights=())

    def obstacle(self, rules: Protocol) -> str | None:
        """Say what keeps a protocol from judging the submission, if anything does."""
        truth = self.ground_truth
        if not truth.secret.serves(rules):
            return (
                f"{rules.name} needs object positions, which {truth.origin} was compiled without; "
                "compile it again with --object-positions"
            )
        if not EpisodeTable(self._facts, rules, self.scored):
            return f"{rules.name} does not score grounding, which is all of this track"
        return None

    def score(self, rules: Protocol) -> Scores:
        """Judge the submission by a protocol."""
        obstacle = self.obstacle(rules)
        if obstacle:
            raise GroundTruthError(obstacle)
        table = EpisodeTable(self._facts, rules, self.scored)
        boxes = self._facts.boxes if "iou" in table else None
        remarks = [*self.remarks, *self.insights]
        return Scores(
            ground_truth=self.ground_truth,
            protocol=rules,
            episodes=table,
            remarks=remarks,
            qualifier=self.qualifier,
            boxes=boxes,
            submission=self.submission,
        )
