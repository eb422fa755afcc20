"""The evaluator: scores many submissions, or one in batches, as in a training loop."""

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from typing import Any

from reverie_eval.errors import GroundTruthError
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.scoring._episode_table import Track, qualifier_of
from reverie_eval.scoring._evaluation import check_track, evaluate, find_answers, why_not
from reverie_eval.scoring._protocol import scored_by
from reverie_eval.scoring._scores import Scores, signature_of
from reverie_eval.submissions import (
    Content,
    Records,
    Submission,
    are_records,
    check_batch,
    read_predictions,
)
from reverie_eval.tasks import DEFAULT_PROTOCOL, KnownProtocol, KnownSplit


class Evaluator:
    """Scores many submissions, as in a training loop: ``evaluator(predictions)["rgspl"]``.

    The ground truth is read once, so each call takes milliseconds. As in torchmetrics,
    :meth:`update` collects batches of predictions and :meth:`compute` scores them. The scores equal
    those of one submission with all predictions, digit for digit.

    Parameters
    ----------
    split, ground_truth, protocol, track, subset, task
        As for :func:`reverie_eval.evaluate`.

    Raises
    ------
    GroundTruthError
        If there is no valid ground truth with answers for the split, protocol and track.
    ProtocolError
        If there is no such task, protocol or track.
    SubsetError
        If episodes of the subset are unknown or listed twice; lists every problem.

    Examples
    --------
    >>> evaluator = Evaluator(split="val_unseen")
    >>> evaluator("demo/good.json")["success"] > 0.8
    True
    """

    def __init__(
        self,
        *,
        split: KnownSplit | str,
        ground_truth: str | PathLike[str] | GroundTruth | None = None,
        protocol: KnownProtocol | str = DEFAULT_PROTOCOL,
        track: Track = "full",
        subset: Iterable[str] | None = None,
        task: str | None = None,
    ) -> None:
        # Unusable settings must raise here, and not after the first epoch of training.
        self.track = check_track(track)
        truth = find_answers(ground_truth, split, subset, task)
        rules = truth.task.protocol(protocol)
        self.protocol = rules.name
        self.ground_truth = scored_by(rules, truth)
        reason = why_not(rules, self.ground_truth, track)
        if reason:
            raise GroundTruthError(reason)
        self._records: dict[str, Mapping[str, Any]] = {}
        self._contents: dict[str, Content] = {}

    def __call__(self, predictions: Submission) -> Scores:
        """Score a submission; argument and errors are those of :func:`reverie_eval.evaluate`."""
        truth = self.ground_truth
        return evaluate(
            predictions,
            split=truth.split,
            ground_truth=truth,
            protocol=self.protocol,
            track=self.track,
        )

    def update(self, records: Records) -> None:
        """Collect predictions of some episodes, until :meth:`compute` scores all of them.

        An episode that is repeated with the same prediction counts once, because samplers of
        distributed training repeat a few so that all processes have equally many.

        Parameters
        ----------
        records : sequence of records, or records by instr_id
            In any form that :func:`reverie_eval.evaluate` takes. Records are not copied, so do not
            change them before the scores are computed.

        Raises
        ------
        SubmissionError
            If records are invalid, or a different prediction for their episode was collected
            before; lists every problem. Then none of them is collected.
        TypeError
            If these are not records.
        """
        if not are_records(records):
            kind = type(records).__name__
            raise TypeError(
                f"update takes a list of records, got {kind}; to score a file, call the evaluator "
                "with its path"
            )
        if not records:  # the share of a process may be empty
            return
        predictions = read_predictions(
            records, self.ground_truth.task, answers_only=self.track == "grounding"
        )
        self._contents |= check_batch(predictions, self.ground_truth, self._contents)
        listed = list(_listed(records))
        for row, instr_id in enumerate(predictions.instr_ids):
            location = predictions.location(row)
            if not location.place:  # of an item's several trajectories, the first stands for all
                self._records.setdefault(str(instr_id), listed[location.row])

    def compute(self) -> Scores:
        """Score the predictions collected so far; errors are those of a call.

        Every episode of the split, or of the subset, needs a prediction.
        """
        return self(self.records)

    def reset(self) -> None:
        """Forget the collected predictions, for example before the next epoch."""
        self._records.clear()
        self._contents.clear()

    @property
    def records(self) -> Sequence[Mapping[str, Any]]:
        """The collected predictions, to send to the process that computes the scores."""
        return list(self._records.values())

    def __repr__(self) -> str:
        rules = self.ground_truth.task.protocol(self.protocol)
        return f"<Evaluator {signature_of(self.ground_truth, rules, qualifier_of(self.track))}>"


def _listed(records: Records) -> Iterable[Mapping[str, Any]]:
    """Return records with their ids in them, which may be their keys only."""
    if isinstance(records, Mapping):
        return ({"instr_id": key, **record} for key, record in records.items())
    return records
