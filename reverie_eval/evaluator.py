"""An evaluator to call again and again: after a training loop's every epoch."""

from os import PathLike

from reverie_eval.evaluation import evaluate
from reverie_eval.ground_truth import GroundTruth, find_ground_truth
from reverie_eval.protocol import DEFAULT_PROTOCOL, protocol_named
from reverie_eval.reading import Submission
from reverie_eval.scores import Scores


class Evaluator:
    """Scores one submission after another: ``evaluator(predictions)["rgspl"]``.

    The ground truth is read once, so a call takes milliseconds.

    Parameters
    ----------
    split, ground_truth, protocol
        As :func:`reverie_eval.evaluate` takes them.

    Raises
    ------
    GroundTruthError
        If there is no sound ground truth with answers for the split.
    ProtocolError
        If there is no such protocol.

    Examples
    --------
    >>> evaluator = Evaluator(split="val_unseen")
    >>> evaluator("fixtures/submissions/good.json")["success"] > 0.8
    True
    """

    def __init__(
        self,
        *,
        split: str,
        ground_truth: str | PathLike[str] | GroundTruth | None = None,
        protocol: str = DEFAULT_PROTOCOL,
    ) -> None:
        self.protocol = protocol_named(protocol).name
        self.ground_truth = find_ground_truth(ground_truth, split)
        _ = self.ground_truth.secret  # refuse a public bundle now, not after the first epoch

    def __call__(self, predictions: Submission) -> Scores:
        """Score a submission; parameter and errors are those of :func:`reverie_eval.evaluate`."""
        truth = self.ground_truth
        return evaluate(predictions, split=truth.split, ground_truth=truth, protocol=self.protocol)
