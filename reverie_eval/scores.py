"""Scores: the episode table, the score table made from it, and the signature that names both."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from reverie_eval.alignment import AlignedSubmission
from reverie_eval.anatomy import OUTCOMES, Anatomy, anatomy_of, outcomes_of
from reverie_eval.arrays import Array, BoolArray
from reverie_eval.box_outcomes import OUTCOMES as BOX_OUTCOMES
from reverie_eval.box_outcomes import BoxOutcomes
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.intervals import Clustering, Intervals
from reverie_eval.metrics import CATALOGUE, Metric, units_of
from reverie_eval.protocol import Protocol
from reverie_eval.version import __version__
from reverie_eval.wording import counted

if TYPE_CHECKING:
    import pandas as pd

    from reverie_eval.episode import Episode
    from reverie_eval.reporting.plots import Plots
    from reverie_eval.schemas.report import BoxReport, IntervalReport, ScoreReport

_FINGERPRINT_SHOWN = 12


@dataclass(frozen=True, eq=False, repr=False)
class Scores(Mapping[str, float]):
    """What a submission scores: ``scores["rgspl"]`` is the mean over all episodes.

    Keys and their order are the CATALOGUE's. Fractions are in [0, 1], lengths in metres, and
    nothing is rounded.
    """

    ground_truth: GroundTruth
    protocol: Protocol
    episodes: Mapping[str, Array]
    """Per metric, one value for each episode in the order of the ground truth; read-only."""
    remarks: Sequence[str] = ()
    """How the file was read, and what in it is suspicious."""
    qualifier: str = ""
    """What else the numbers depend on, as the signature has it: ``track:grounding``."""
    boxes: BoxOutcomes | None = None
    """What became of answers that are boxes, if there are any and the protocol scores them."""
    intervals: Intervals | None = None
    """Of every metric, if they were asked for."""
    submission: AlignedSubmission | None = None
    """Where the agent went and what it answered; shown episode by episode, and in no report."""

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
        """Everything that the numbers depend on; numbers of equal signatures compare.

        The idea is sacreBLEU's (Post, "A Call for Clarity in Reporting BLEU Scores", WMT 2018).
        """
        return signature_of(self.ground_truth, self.protocol, self.qualifier)

    @property
    def notes(self) -> Sequence[str]:
        """What a reader of the numbers should know, a sentence each."""
        jumps = self.episodes.get("jumps")
        return [
            *([] if self.boxes is None else [_box_note(self.boxes)]),
            *self.remarks,
            *([] if jumps is None else _jump_notes(jumps)),
        ]

    @property
    def box_outcome(self) -> Sequence[str]:
        """What became of each episode's box: one of ``OUTCOMES``, empty where there is none."""
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
        """Return the same with confidence intervals, which tables and reports then show.

        Parameters
        ----------
        by : "target" or "scan"
            What episodes have in common that are not independent: whole clusters are resampled.
        confidence : float, optional
            In (0, 1); 0.95 if not given.
        resamples : int, optional
            10,000 if not given.
        seed : int, optional
            0 if not given: the same scores have the same intervals.

        Raises
        ------
        ProtocolError
            As :meth:`reverie_eval.intervals.Intervals.of` does.
        """
        drawn = Intervals.of(
            self.episodes,
            self.ground_truth,
            by,
            confidence=confidence,
            resamples=resamples,
            seed=seed,
        )
        return replace(self, intervals=drawn)

    @property
    def outcomes(self) -> Sequence[str]:
        """What became of each episode: one of ``anatomy.OUTCOMES``.

        Raises
        ------
        ProtocolError
            If success, oracle success or RGS is not scored.
        """
        return [list(OUTCOMES)[number] for number in outcomes_of(self.episodes)]

    @property
    def anatomy(self) -> Anatomy:
        """How many episodes came to which outcome; errors are those of ``outcomes``."""
        return anatomy_of(self.episodes)

    def breakdown(self, by: str, *, intervals: bool = False) -> "pd.DataFrame":
        """Score parts of the episodes: a row per ``scan``, ``category`` or another of ``SLICINGS``.

        Parameters, columns, their units and errors are those of :func:`slices.breakdown`.
        """
        from reverie_eval.slices import breakdown

        return breakdown(self, by, intervals=intervals)

    def episode(self, instr_id: str) -> "Episode":
        """Return one episode: what the agent was told, where it went, and what came of it.

        Raises
        ------
        ReverieEvalError
            If the split has no such episode.
        """
        from reverie_eval.episode import episode_of

        return episode_of(self, instr_id)

    @property
    def plot(self) -> "Plots":
        """Figures of these scores: ``scores.plot.funnel()``; they need matplotlib."""
        from reverie_eval.reporting.plots import Plots

        return Plots(self)

    @property
    def headline(self) -> Sequence[Metric]:
        """The metrics that every score table shows, in its order."""
        scored = (CATALOGUE[key] for key in self.episodes)
        return [metric for metric in scored if metric.headline]

    def to_dict(self) -> dict[str, float]:
        """Return plain numbers by name, as loggers of experiments take them.

        With intervals, each metric has its ``_low`` and ``_high`` beside it.
        """
        flat = dict(self)
        for key, interval in (self.intervals or {}).items():
            flat |= {f"{key}_low": interval.low, f"{key}_high": interval.high}
        return flat

    def to_report(self) -> "ScoreReport":
        """Return the score report, the JSON of the command line."""
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

    def to_pandas(self) -> "pd.DataFrame":
        """Return the episode table: a row per ``instr_id``, a column per metric.

        Values are in the metrics' own units, which ``attrs["units"]`` names by column. With answers
        that are boxes, a last column ``box_outcome`` says what became of each.
        """
        import pandas as pd

        index = pd.Index(self.instr_ids, name="instr_id")
        table = pd.DataFrame(dict(self.episodes), index=index)
        table.attrs["units"] = units_of(self)
        return table if self.boxes is None else table.assign(box_outcome=self.box_outcome)

    def __repr__(self) -> str:
        values = ", ".join(f"{m.heading} {m.display(self[m.key])}" for m in self.headline)
        return f"<Scores {values}; {self.signature}>"

    def _repr_html_(self) -> str:
        """Show the score table in a notebook."""
        from reverie_eval.reporting.score_html import scores_html

        return scores_html(self)


@dataclass(frozen=True, eq=False)
class Validation:
    """What can be said of a sound submission without looking at answers."""

    ground_truth: GroundTruth
    abstained: BoolArray
    """Shape (n_episodes,): whether the answer names no object."""
    jumps: Array
    """Shape (n_episodes,): moves between viewpoints that no edge joins."""
    remarks: Sequence[str] = ()
    """How the file was read, and what in it is suspicious."""

    @property
    def notes(self) -> Sequence[str]:
        """What the participant should know before sending it, a sentence each."""
        silent = int(self.abstained.sum())
        total = counted(len(self.abstained), "answer")
        some_silent = 0 < silent < len(self.abstained)  # of all, a remark speaks
        notes = [f"no object named in {silent:,} of {total}"] if some_silent else []
        return [*notes, *self.remarks, *_jump_notes(self.jumps)]


def signature_of(truth: GroundTruth, protocol: Protocol, qualifier: str = "") -> str:
    """Return the signature of whatever this version scores by these rules on this ground truth."""
    parts = [
        f"split:{truth.split}",
        f"protocol:{protocol.name}",
        *([qualifier] if qualifier else []),
        f"data:{truth.fingerprint[:_FINGERPRINT_SHOWN]}",
        f"n:{len(truth.episodes.instr_ids)}",
        f"version:{__version__}",
    ]
    return "|".join(parts)


def _box_report(boxes: BoxOutcomes) -> "BoxReport":
    from reverie_eval.schemas.report import BoxReport

    return BoxReport(
        answers=len(boxes),
        right=int(boxes.is_right.sum()),
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


def _box_note(boxes: BoxOutcomes) -> str:
    percent = CATALOGUE["iou"].display
    misses = ", ".join(f"{count:,} {reason}" for reason, count in boxes.misses.items())
    return (
        f"{counted(len(boxes), 'answer')} by box, {boxes.is_right.sum():,} right (misses: "
        f"{misses}), mean IoU {percent(boxes.mean_iou)} %; the whole picture in their place would "
        f"be right in {percent(boxes.whole_image_share)} %; {percent(boxes.ambiguous_share)} % of "
        "the views that show the target are ambiguous"
    )


def _jump_notes(jumps: Array) -> Sequence[str]:
    if not jumps.any():
        return ()
    episodes = counted(int((jumps > 0).sum()), "episode")
    counts = f"{counted(int(jumps.sum()), 'jump')} in {episodes}"
    meaning = "moves between viewpoints that no edge joins, priced at their shortest distance"
    return (f"{counts}: {meaning}",)
