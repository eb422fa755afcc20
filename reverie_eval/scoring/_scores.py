"""Scores: one value per metric and episode, their means, and their signature."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from reverie_eval.arrays import Array, BoolArray
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import METRICS, Metric, units_of
from reverie_eval.scoring._boxes import BOX_OUTCOMES, BoxScores
from reverie_eval.scoring._intervals import Clustering, Intervals, clusters_of
from reverie_eval.scoring._outcomes import OUTCOMES, FailureModes, failure_modes, outcome_indices
from reverie_eval.submissions import AlignedSubmission
from reverie_eval.tasks import DEFAULT_TASK, Protocol
from reverie_eval.text import count_text, first_few
from reverie_eval.version import __version__

if TYPE_CHECKING:
    import pandas as pd

    from reverie_eval.schemas.report import BoxReport, IntervalReport, ScoreReport

_FINGERPRINT_SHOWN = 12


@dataclass(frozen=True, eq=False, repr=False)
class Scores(Mapping[str, float]):
    """The scores of a submission: ``scores["rgspl"]`` is the mean over all episodes.

    Keys and their order are those of the CATALOGUE. Fractions are in [0, 1], lengths in metres,
    and nothing is rounded.
    """

    ground_truth: GroundTruth
    protocol: Protocol
    episodes: Mapping[str, Array]
    """One value per episode for each metric, in the order of the ground truth; read-only."""
    hints: Sequence[str] = ()
    """How the file was read, and what in it looks like a mistake."""
    qualifier: str = ""
    """What the scores depend on besides split, protocol and data: ``track:grounding``."""
    boxes: BoxScores | None = None
    """The predicted boxes, if there are any and the protocol scores them."""
    intervals: Intervals | None = None
    """Confidence intervals of every metric, if :meth:`with_intervals` computed them."""
    submission: AlignedSubmission | None = None
    """The trajectories and answers that were scored; not part of any report."""

    # Set by reverie_eval.notebook, because they need packages above this one.
    breakdown: ClassVar[Any]
    episode: ClassVar[Any]
    plot: ClassVar[Any]
    _repr_html_: ClassVar[Any]

    def __getitem__(self, key: str) -> float:
        return float(self.episodes[key].mean())

    def __iter__(self) -> Iterator[str]:
        return iter(self.episodes)

    def __len__(self) -> int:
        return len(self.episodes)

    @property
    def split(self) -> str:
        """The split that was scored."""
        return self.ground_truth.split

    @property
    def instr_ids(self) -> Sequence[str]:
        """The episodes, in the order of their values in ``episodes``."""
        return self.ground_truth.episodes.instr_ids

    @property
    def signature(self) -> str:
        """Everything that the scores depend on; scores with equal signatures are comparable.

        After sacreBLEU (Post, "A Call for Clarity in Reporting BLEU Scores", WMT 2018).
        """
        return signature_of(self.ground_truth, self.protocol, self.qualifier)

    @property
    def headline(self) -> Sequence[Metric]:
        """The scored metrics that every score table shows, in its order."""
        return [METRICS[key] for key in self.ground_truth.task.headline if key in self.episodes]

    @property
    def notes(self) -> Sequence[str]:
        """What a reader of the scores should know, one sentence each."""
        jumps = self.episodes.get("jumps")
        return [
            *([] if self.boxes is None else [_box_note(self.boxes)]),
            *self.hints,
            *([] if jumps is None else _jump_notes(jumps, self.protocol)),
            *_unscored_notes(self.ground_truth, self.protocol),
        ]

    @property
    def outcomes(self) -> Sequence[str]:
        """The outcome of each episode, one of ``OUTCOMES``.

        Raises
        ------
        ProtocolError
            If success, oracle success or RGS is not scored.
        """
        return [list(OUTCOMES)[index] for index in outcome_indices(self.episodes)]

    @property
    def failure_modes(self) -> FailureModes:
        """How many episodes had each outcome; errors are those of ``outcomes``."""
        return failure_modes(self.episodes)

    @property
    def box_outcomes(self) -> Sequence[str]:
        """The outcome of each predicted box, one of ``BOX_OUTCOMES``; empty without a box."""
        # Of objects, because an array of "" would cut every text to one letter.
        outcome = np.full(len(self.instr_ids), "", dtype=object)
        if self.boxes is not None:
            outcome[self.boxes.row] = np.array(BOX_OUTCOMES, dtype=object)[self.boxes.outcome]
        return outcome.tolist()

    def with_intervals(
        self,
        by: Clustering = "target",
        *,
        confidence: float | None = None,
        resamples: int | None = None,
        seed: int | None = None,
    ) -> Self:
        """Return the same scores with confidence intervals, which tables and reports then show.

        Parameters
        ----------
        by : "target" or "scan"
            Clusters of dependent episodes, which are resampled as a whole: episodes with the same
            target object, or in the same building.
        confidence : float, optional
            In (0, 1); 0.95 if not given.
        resamples : int, optional
            10,000 if not given.
        seed : int, optional
            0 if not given, so that the same scores always have the same intervals.

        Raises
        ------
        ProtocolError
            If there is no such clustering, all episodes are in one cluster, or confidence,
            resamples or seed are out of range.
        """
        intervals = Intervals.of(
            self.episodes,
            clusters_of(self.ground_truth, by),
            by,
            confidence=confidence,
            resamples=resamples,
            seed=seed,
        )
        return replace(self, intervals=intervals)

    def to_dict(self) -> dict[str, float]:
        """Return the means by name, for experiment loggers.

        With intervals, their ends are in ``spl_low``, ``spl_high`` and so on.
        """
        flat = dict(self)
        for key, interval in (self.intervals or {}).items():
            flat |= {f"{key}_low": interval.low, f"{key}_high": interval.high}
        return flat

    def to_pandas(self) -> "pd.DataFrame":
        """Return the episode table: a row per ``instr_id``, a column per metric.

        Values are in the metrics' own units, which ``attrs["units"]`` lists by column. If there are
        predicted boxes, the last column, ``box_outcome``, has their outcomes.
        """
        import pandas as pd

        index = pd.Index(self.instr_ids, name="instr_id")
        table = pd.DataFrame(dict(self.episodes), index=index)
        table.attrs["units"] = units_of(self)
        return table if self.boxes is None else table.assign(box_outcome=self.box_outcomes)

    def to_report(self) -> "ScoreReport":
        """Return the score report, which ``--format json`` prints."""
        from reverie_eval.schemas.report import ScoreReport

        return ScoreReport(
            signature=self.signature,
            split=self.split,
            protocol=self.protocol.name,
            dataset=self.ground_truth.header.dataset,
            fingerprint=self.ground_truth.fingerprint,
            version=__version__,
            episodes=len(self.instr_ids),
            scores=dict(self),
            boxes=None if self.boxes is None else _box_report(self.boxes),
            intervals=None if self.intervals is None else _interval_report(self.intervals),
            notes=list(self.notes),
        )

    def __repr__(self) -> str:
        values = ", ".join(f"{m.heading} {m.display(self[m.key])}" for m in self.headline)
        return f"<Scores {values}; {self.signature}>"


@dataclass(frozen=True, eq=False)
class Validation:
    """The result of checking a valid submission, without using the answers."""

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
        return [*notes, *self.hints, *_jump_notes(self.jumps)]


def signature_of(truth: GroundTruth, protocol: Protocol, qualifier: str) -> str:
    """Return the signature of scores by a protocol and a ground truth, from this version."""
    task = truth.header.task
    parts = [
        *([] if task == DEFAULT_TASK else [f"task:{task}"]),
        f"split:{truth.split}",
        f"protocol:{protocol.name}",
        *([qualifier] if qualifier else []),
        *([f"subset:{truth.subset_digest}"] if truth.subset_digest else []),
        f"data:{truth.fingerprint[:_FINGERPRINT_SHOWN]}",
        f"n:{len(truth.episodes.instr_ids)}",
        f"version:{__version__}",
    ]
    return "|".join(parts)


def _box_report(boxes: BoxScores) -> "BoxReport":
    from reverie_eval.schemas.report import BoxReport

    return BoxReport(
        answers=len(boxes),
        correct=int(boxes.is_correct.sum()),
        mean_iou=boxes.mean_iou,
        whole_image=boxes.whole_image_share,
        ambiguous_views=boxes.ambiguous_share,
        misses=dict(boxes.misses),
    )


def _interval_report(intervals: Intervals) -> "IntervalReport":
    from reverie_eval.schemas.report import IntervalReport

    return IntervalReport(
        by=intervals.by,
        clusters=intervals.n_clusters,
        confidence=intervals.confidence,
        resamples=intervals.resamples,
        seed=intervals.seed,
        intervals={key: (interval.low, interval.high) for key, interval in intervals.items()},
    )


def _box_note(boxes: BoxScores) -> str:
    percent = METRICS["iou"].display
    misses = ", ".join(f"{count:,} {reason}" for reason, count in boxes.misses.items())
    return (
        f"{count_text(len(boxes), 'box', 'boxes')} predicted, {boxes.is_correct.sum():,} correct "
        f"(misses: {misses}), mean IoU {percent(boxes.mean_iou)} %; a box around the whole image "
        f"would be correct in {percent(boxes.whole_image_share)} %; "
        f"{percent(boxes.ambiguous_share)} % of the views that show the target are ambiguous"
    )


def _jump_notes(jumps: Array, rules: Protocol | None = None) -> Sequence[str]:
    if not jumps.any():
        return ()
    episodes = count_text(int((jumps > 0).sum()), "episode")
    remark = ""
    if rules is not None and rules.rejects_jumps:
        remark = f"; {rules.name}'s own evaluator stops at a jump"
    jumps_text = count_text(int(jumps.sum()), "jump")
    return (f"{jumps_text} in {episodes}: {METRICS['jumps'].definition}{remark}",)


def _unscored_notes(truth: GroundTruth, rules: Protocol) -> Iterator[str]:
    """Yield what a protocol leaves out of a split, if it does."""
    if truth.subset_digest or truth.subset_of is None:
        return
    whole, _ = truth.subset_of
    unscored = sorted(whole.episodes.index.keys() - truth.episodes.index.keys())
    yield (
        f"{rules.name} scores the first {rules.scored_instructions} instructions of a path, not "
        f"{first_few(unscored)}"
    )
