"""Scores: one value per metric and episode, their means, and their signature."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import Array, FloatArray
from reverie_eval.errors import (
    LogError,
    Problem,
    ProtocolError,
    ReverieEvalError,
    naming_missing_parts,
)
from reverie_eval.ground_truth import GroundTruth, find_words
from reverie_eval.logs import COSTS, RunLog, mean_costs
from reverie_eval.metrics import CATALOGUE, units_of
from reverie_eval.scoring._episode_table import (
    OUTCOMES,
    EpisodeTable,
    FailureModes,
    failure_modes,
    jump_notes,
    outcome_indices,
    track_of,
    unscored_notes,
)
from reverie_eval.scoring._intervals import Clustering, Intervals, clusters_of
from reverie_eval.scoring._lookups import BOX_OUTCOMES, BoxScores, Lookups
from reverie_eval.scoring._saved import (
    SavedHeader,
    find_saved_truth,
    join_parts,
    read_saved,
    write_saved,
)
from reverie_eval.scoring._scored import Scored
from reverie_eval.submissions import SubmissionColumns
from reverie_eval.tasks import Protocol, find_task
from reverie_eval.version import __version__

if TYPE_CHECKING:
    import pandas as pd

    from reverie_eval.analysis import BudgetCurve, Episode
    from reverie_eval.reporting.figures import Plots
    from reverie_eval.schemas.report import ScoreReport


@dataclass(frozen=True, eq=False, repr=False)
class Scores(Scored):
    """The scores of a submission: ``scores["rgspl"]`` is the mean over all episodes."""

    intervals: Intervals | None = None
    """Confidence intervals of every metric, if :meth:`with_intervals` computed them."""
    hints: Sequence[str] = ()
    """How the file was read, and what in it looks like a mistake."""
    boxes: BoxScores | None = None
    """The predicted boxes, if there are any and the protocol scores them."""
    submission: SubmissionColumns | None = None
    """The trajectories and answers that were scored; not part of any report."""
    run: RunLog | None = None
    """The log of the run that made the submission, if :meth:`with_run` read it; never scored."""

    @classmethod
    def of(
        cls,
        lookups: Lookups,
        protocol: Protocol,
        *,
        hints: Sequence[str],
        qualifier: str,
    ) -> Self:
        """Score an aligned submission; a metric's values are computed when they are needed."""
        table = EpisodeTable(lookups, protocol, track_of(qualifier))
        return cls(
            ground_truth=lookups.ground_truth,
            protocol=protocol,
            episodes=table,
            hints=hints,
            qualifier=qualifier,
            # A protocol that scores no boxes has no note on them either.
            boxes=lookups.boxes if "iou" in table else None,
            submission=lookups.submission,
        )

    @classmethod
    def load(
        cls,
        file: str | PathLike[str],
        *,
        ground_truth: str | PathLike[str] | GroundTruth | None = None,
    ) -> Self:
        """Read scores that :meth:`save` wrote.

        Parameters
        ----------
        file : path
        ground_truth : path or GroundTruth, optional
            The ground truth that the scores were computed with, as for
            :func:`reverie_eval.evaluate`.

        Raises
        ------
        ReverieEvalError
            If the file has no saved scores, is damaged, or was written by a later version.
        GroundTruthError
            If the ground truth is missing, or is not the same.
        ProtocolError
            If the scores' task or protocol is not installed.
        OSError
            If the file cannot be read.
        """
        header, submission = read_saved(file)
        protocol = find_task(header.task).protocol(header.protocol)
        truth = find_saved_truth(file, header, ground_truth)
        scores = cls.of(
            Lookups(submission, truth.scored_by(protocol)),
            protocol,
            hints=header.hints,
            qualifier=header.qualifier,
        )
        return scores.with_intervals(**asdict(header.intervals)) if header.intervals else scores

    @classmethod
    def concatenate(cls, parts: Iterable["Scores"]) -> Self:
        """Join the scores of several parts of a split.

        If the parts cover the split, the result equals the scores of the whole split, digit for
        digit. Otherwise it is that of a declared subset.

        Parameters
        ----------
        parts : Scores
            Scores of declared subsets that share no episode, under the same protocol.

        Raises
        ------
        ProtocolError
            If there are none, they were scored differently, or they share episodes.
        ReverieEvalError
            If some have no trajectories.
        """
        listed = list(parts)
        lookups = join_parts(listed, [part.require_submission() for part in listed])
        return cls.of(
            lookups,
            listed[0].protocol,
            hints=list(dict.fromkeys(hint for part in listed for hint in part.hints)),
            qualifier=listed[0].qualifier,
        )

    def __getitem__(self, key: str) -> float:
        values = self.episodes[key]  # which tells a wrong key
        return CATALOGUE[key].mean(values)

    @property
    def notes(self) -> Sequence[str]:
        """What a reader of the scores should know, one sentence each."""
        jumps = self.episodes.get("jumps")
        return [
            *([] if self.boxes is None else [self.boxes.note]),
            *self.hints,
            *([] if self.run is None else self._notes_of_run(self.run)),
            *([] if jumps is None else jump_notes(jumps, self.protocol)),
            *unscored_notes(self.ground_truth, self.protocol),
        ]

    def _notes_of_run(self, run: RunLog) -> Iterable[str]:
        submission, ids = self.require_submission(), self.ground_truth.graph.viewpoint_ids
        ends = (ids[each] for each in submission.stop.tolist())
        stops = dict(zip(self.instr_ids, ends, strict=True))
        return run.notes(stops, self.ground_truth.whole.episodes.index)

    @cached_property
    def costs(self) -> Mapping[str, FloatArray]:
        """What each episode cost, by the keys of :data:`reverie_eval.logs.COSTS`.

        All attempts together, as arrays of shape (n_episodes,); NaN is unknown. Empty without
        :meth:`with_run`.
        """
        return {} if self.run is None else self.run.costs(self.instr_ids)

    @property
    def outcomes(self) -> Sequence[str]:
        """The outcome of each episode, one of ``OUTCOMES``.

        Raises
        ------
        ProtocolError
            If success, oracle success or RGS is not scored.
        """
        return [list(OUTCOMES)[index] for index in outcome_indices(self._with_answers)]

    @property
    def failure_modes(self) -> FailureModes:
        """How many episodes had each outcome; errors are those of ``outcomes``."""
        return failure_modes(self._with_answers)

    @property
    def _with_answers(self) -> Mapping[str, Array]:
        """The episode table of a task whose outcomes are those of answers."""
        task = self.ground_truth.task
        if not task.has_targets:
            raise ProtocolError(
                f"{task.title} has no target objects, on which outcomes depend; to find failures, "
                "sort scores.to_pandas() by navigation_error, and show one with scores.episode(id)"
            )
        return self.episodes

    @property
    def box_outcomes(self) -> Sequence[str]:
        """The outcome of each predicted box, one of ``BOX_OUTCOMES``; empty without a box."""
        # Of objects, because an array of "" would cut every text to one letter.
        outcome = np.full(len(self.instr_ids), "", dtype=object)
        if self.boxes is not None:
            outcome[self.boxes.row] = np.array(BOX_OUTCOMES, dtype=object)[self.boxes.outcome]
        return outcome.tolist()

    @property
    def texts(self) -> Mapping[str, Sequence[str]]:
        """What is known of each episode besides its values, by column.

        The columns are ``outcome``, ``box_outcome``, ``scan``, ``category``, ``language`` and
        ``instruction``, without those that the protocol or the task does not define.
        """
        truth = self.ground_truth
        # Read one by one, because any of them may be missing.
        columns: Mapping[str, Callable[[], Sequence[str]]] = {
            "outcome": lambda: self.outcomes,
            **({} if self.boxes is None else {"box_outcome": lambda: self.box_outcomes}),
            "scan": lambda: truth.scans,
            "category": lambda: truth.categories,
            **({"language": lambda: truth.episodes.languages} if truth.episodes.languages else {}),
            "instruction": lambda: truth.episodes.instructions,
        }
        found = {}
        for name, read in columns.items():
            # A column that cannot be read is left out, so that a table has what there is.
            with suppress(ProtocolError):
                found[name] = read()
        return found

    def with_intervals(
        self,
        cluster: Clustering = "target",
        *,
        confidence: float | None = None,
        resamples: int | None = None,
        seed: int | None = None,
    ) -> Self:
        """Return the same scores with confidence intervals, which tables and reports then show.

        Parameters
        ----------
        cluster : "target" or "scan"
            What dependent episodes share; they are resampled together: the target object, or the
            building.
        confidence : float, optional
            In (0, 1); by default 0.95.
        resamples : int, optional
            By default 10,000.
        seed : int, optional
            By default 0, so that the same scores always have the same intervals.

        Raises
        ------
        ProtocolError
            If there is no such clustering, all episodes are in one cluster, or confidence,
            resamples or seed are out of range.
        """
        # Importing scipy would double the start-up time of commands that show no intervals.
        from reverie_eval.metrics.engine import IntervalEngine

        # How many episodes a partial mean is over varies too, which these intervals leave out.
        whole = {key: self.episodes[key] for key in self if not CATALOGUE[key].is_partial}
        intervals = Intervals.of_several(
            {"": whole},
            clusters_of(self.ground_truth, cluster),
            cluster,
            IntervalEngine.of(confidence, resamples, seed),
        )
        return replace(self, intervals=intervals[""])

    def with_run(self, folder: str | PathLike[str]) -> Self:
        """Return the same scores with what their run logged: what it cost, and its steps.

        Parameters
        ----------
        folder : path
            A folder that ``reverie-eval run`` wrote, or one with an ``episodes.jsonl``, and a
            ``steps.jsonl``, of the same form.

        Raises
        ------
        LogError
            If lines are invalid, or no episode is one of the split; lists every problem.
        OSError
            If there is no ``episodes.jsonl``, or it cannot be read.
        """
        log = RunLog.read(folder)
        if log.attempts.keys().isdisjoint(self.ground_truth.whole.episodes.index):
            message = f"it has no episode of {self.split}; give the run of this submission"
            raise LogError([Problem("log-of-others", str(folder), message)])
        return replace(self, run=log)

    def subset(self, instr_ids: Iterable[str]) -> Self:
        """Return the scores of some of the episodes, as for a declared subset.

        Raises
        ------
        SubsetError
            If there are none, or some are unknown or listed twice; lists every problem.
        ReverieEvalError
            If these scores have no trajectories.
        """
        truth = self.ground_truth.subset(instr_ids)
        index = self.ground_truth.episodes.index
        # In the order of the subset, which is that of the ground truth.
        rows = np.array([index[instr_id] for instr_id in truth.episodes.instr_ids])
        scores = self.of(
            Lookups(self.require_submission().take(rows), truth),
            self.protocol,
            hints=self.hints,
            qualifier=self.qualifier,
        )
        return replace(scores, run=self.run)

    def with_words(self, *words: str) -> Self:
        """Return the scores of the episodes whose instruction has all of these words.

        Words are compared whole and without case: ``towel`` is not in "the towels".

        Raises
        ------
        ProtocolError
            If no word is given, or no instruction has them all.
        """
        instructions = self.ground_truth.episodes.instructions
        return self.subset(find_words(words, dict(zip(self.instr_ids, instructions, strict=True))))

    def save(self, file: str | PathLike[str]) -> None:
        """Write these scores to a file, which :meth:`load` reads; without answers and logs of runs.

        Raises
        ------
        ReverieEvalError
            If these scores have no trajectories.
        OSError
            If the file cannot be written.
        """
        submission = self.require_submission()
        write_saved(file, SavedHeader.of(self, submission, self.hints), submission)

    def require_submission(self) -> SubmissionColumns:
        """Return the trajectories and answers that were scored.

        Raises
        ------
        ReverieEvalError
            If these scores have none.
        """
        if self.submission is None:
            raise ReverieEvalError("these scores have no trajectories; evaluate the file")
        return self.submission

    # Conveniences by what is above this package; the import contract lists them.

    def success_within(
        self,
        cost: str | None = None,
        metric: str | None = None,
        cluster: Clustering = "target",
        *,
        confidence: float | None = None,
    ) -> "BudgetCurve":
        """Return what share of the episodes the run solved within a budget, for all budgets.

        Parameters
        ----------
        cost : str, optional
            A key of :attr:`costs`; by default money, input tokens or actions, the first that is
            known and not 0.
        metric : str, optional
            What a solved episode is, a metric that is 0 or 1; by default success.
        cluster : "target" or "scan"
            What dependent episodes share.
        confidence : float, optional
            Of the interval at each budget, in (0, 1); by default 0.95.

        Raises
        ------
        ProtocolError
            If there is no such cost or metric, or the cost is unknown for some episodes.
        """
        from reverie_eval.analysis import success_within

        return success_within(self, cost, metric, cluster, confidence=confidence)

    def episode(self, instr_id: str) -> "Episode":
        """Return one episode of the submission that was scored.

        Raises
        ------
        ReverieEvalError
            If the split has no such episode, or the scores have no trajectories.
        """
        from reverie_eval.analysis import episode

        return episode(self, instr_id)

    @property
    def plot(self) -> "Plots":
        """Figures of these scores, ``scores.plot.funnel()``; they need matplotlib."""
        from reverie_eval.reporting.figures import Plots

        return Plots(self)

    def _repr_html_(self) -> str:
        """Show the score table in a notebook."""
        from reverie_eval.reporting.scores import score_table

        return score_table([self]).to_html()

    def to_dict(self) -> dict[str, float]:
        """Return the means by name, for experiment loggers.

        With intervals, their ends are in ``spl_low``, ``spl_high`` and so on.
        """
        flat = dict(self)
        for key, interval in (self.intervals or {}).items():
            flat |= {f"{key}_low": interval.low, f"{key}_high": interval.high}
        return flat

    def to_pandas(self) -> "pd.DataFrame":
        """Return a row per ``instr_id``: a column per metric and cost, and those of :attr:`texts`.

        Values are in the metrics' own units, which ``attrs["units"]`` lists by column.
        """
        with naming_missing_parts():
            import pandas as pd

        index = pd.Index(self.instr_ids, name="instr_id")
        table = pd.DataFrame({**self.episodes, **self.costs}, index=index)
        table.attrs["units"] = units_of(self) | {key: COSTS[key] for key in self.costs}
        return table.assign(**self.texts)

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
            boxes=None if self.boxes is None else self.boxes.to_report(),
            intervals=None if self.intervals is None else self.intervals.to_report(),
            costs=None if self.run is None else dict(mean_costs(self.costs)),
            notes=list(self.notes),
        )
