"""Sweeps: which of many checkpoints or settings is best, and how much of that is luck."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from typing_extensions import Self

from reverie_eval.analysis._ranks import covariance_of_rows, largest_error, rank_intervals
from reverie_eval.analysis._runs import Runs
from reverie_eval.errors import ProtocolError, naming_missing_parts
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import Metric, units_of
from reverie_eval.scoring import (
    DEFAULT_PROTOCOL,
    Clustering,
    Executor,
    Failure,
    Scored,
    ScoredFiles,
    Scores,
    Track,
    clusters_of,
    evaluate_many,
    shared_keys,
)
from reverie_eval.submissions import find_fields
from reverie_eval.tasks import KnownSplit
from reverie_eval.text import first_few

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

SEED_FIELD = "seed"
"""The field of a pattern in which the runs of a row differ."""
SPLIT_FIELD = "{split}"
"""What stands for the split in a pattern."""


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Mapping[str, Scored]):
    """The results of a sweep, a row for each checkpoint or setting: ``sweep["40000"]``.

    A row is the :class:`Runs` of its seeds or, if it has one file, its :class:`Scores`. Rows are
    sorted by their fields, numbers by size.
    """

    pattern: str
    rows: Mapping[str, Mapping[str, Scores]]
    """The scores of each row by their seeds."""
    fields: Mapping[str, Mapping[str, str]]
    """What the fields of the pattern, except the seed, stand for in each row."""
    failures: Mapping[str, Failure]
    """Why other files have no scores, by path."""

    @classmethod
    def of(cls, pattern: str, scored: ScoredFiles, split: str) -> Self:
        """Arrange the scores of the files of a pattern in rows; see :func:`sweep`."""
        rows: defaultdict[tuple[str, ...], dict[str, Scores]] = defaultdict(dict)
        names: Sequence[str] = ()
        for file, fields in find_fields(pattern.replace(SPLIT_FIELD, split)).items():
            if file in scored:
                names = [name for name in fields if name != SEED_FIELD]
                row = rows[tuple(fields[name] for name in names)]
                row[fields.get(SEED_FIELD, "")] = scored[file]
        # By size where all parts are numbers: 9000 before 10000.
        by_size = [all(map(_is_number, parts)) for parts in zip(*rows, strict=True)]
        ordered = sorted(
            rows,
            key=lambda parts: [
                (float(part) if is_size else 0.0, part)
                for part, is_size in zip(parts, by_size, strict=True)
            ],
        )
        name_of = {parts: _name(names, parts) for parts in ordered}
        return cls(
            pattern,
            {name: rows[parts] for parts, name in name_of.items()},
            {name: dict(zip(names, parts, strict=True)) for parts, name in name_of.items()},
            scored.failures,
        )

    def __getitem__(self, name: str) -> Scored:
        first, *others = self.rows[name].values()
        return self.with_intervals(name) if others else first

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def with_intervals(
        self, name: str, cluster: Clustering = "target", *, confidence: float | None = None
    ) -> Scored:
        """Return a row with its confidence intervals; as :class:`Runs`, or as :class:`Scores`."""
        runs = {f"{SEED_FIELD} {seed}": scores for seed, scores in self.rows[name].items()}
        if len(runs) > 1:
            return Runs.of(runs, cluster, confidence=confidence)
        return next(iter(runs.values())).with_intervals(cluster, confidence=confidence)

    @property
    def first(self) -> Scores:
        """The scores of the first file; all are of the same episodes by the same protocol.

        Raises
        ------
        ProtocolError
            If no file could be scored.
        """
        if not self._files:
            raise ProtocolError(f"{self.pattern}: no file could be scored")
        return self._files[0]

    @property
    def n_runs(self) -> int:
        """The number of runs that most rows have."""
        numbers = Counter(map(len, self.rows.values()))
        return max(numbers, key=lambda number: (numbers[number], number))

    @property
    def candidates(self) -> Sequence[str]:
        """The rows that have as many runs as most: means of fewer vary more, and win by luck."""
        return [name for name, runs in self.rows.items() if len(runs) >= self.n_runs]

    @property
    def metrics(self) -> Sequence[Metric]:
        """The metrics of a score table that all files have."""
        task, keys = self.first.ground_truth.task, shared_keys(self._files)
        return [metric for metric in task.table_metrics(keys) if metric.key in keys]

    @property
    def primary(self) -> Metric:
        """The metric that ranks rows; for REVERIE RGSPL, else RGS or SPL."""
        task = self.first.ground_truth.task
        return task.primary_metric([metric.key for metric in self.metrics])

    def mean(self, name: str, key: str) -> float:
        """Return the mean of a row over its seeds and over episodes, in the metric's own unit."""
        runs = list(self.rows[name].values())
        if len(runs) == 1:
            return runs[0][key]
        # As Runs computes it, to the last bit.
        return float(np.mean([scores.episodes[key] for scores in runs], axis=0).mean())

    @cached_property
    def best(self) -> str:
        """The candidate with the highest mean of :attr:`primary`; of equal ones, the first.

        Raises
        ------
        ProtocolError
            If no file could be scored.
        """
        key = self.primary.key
        return max(self.candidates, key=lambda name: self.mean(name, key))

    @property
    def best_pattern(self) -> str:
        """The pattern of the best row alone: ``runs/seed{seed}/40000_{split}.json``."""
        pattern = self.pattern
        for name, part in self.fields[self.best].items():
            pattern = pattern.replace(f"{{{name}}}", part)
        return pattern

    @property
    def contenders(self) -> Sequence[str]:
        """The candidates that are not significantly worse than any other, the best among them."""
        return [name for name, is_one in zip(self.candidates, self._luck[0], strict=True) if is_one]

    @property
    def excess(self) -> float:
        """By how much the best row is expected to exceed its own true mean, at most.

        The best of several rows is partly chosen for its luck: the error of its mean, which would
        differ with other episodes and other seeds. The error of the chosen row is at most the
        largest of all. This is the expected largest error among :attr:`contenders`, for normal
        errors with the rows' covariances: rows share episodes and seeds, and luck that all rows
        share does not affect the choice. If all rows are equally good, the best exceeds their true
        mean by this much [1]_: by 0.56 standard errors for two independent rows, 0.85 for three,
        1.54 for ten.

        In the unit of :attr:`primary`; 0 for a single contender.

        References
        ----------
        .. [1] Smith and Winkler, "The Optimizer's Curse: Skepticism and Postdecision Surprise in
           Decision Analysis", Management Science 52(3), 2006, section 2.
        """
        return self._luck[1]

    @cached_property
    def _luck(self) -> tuple[Sequence[bool], float]:
        """Whether each candidate is a contender, and the excess of the best one."""
        cluster = clusters_of(self.first.ground_truth, "target")
        n_clusters, key = len(np.unique(cluster)), self.primary.key
        if n_clusters < 2:  # nothing shows how much errors may be
            return [True] * len(self.candidates), 0.0
        # The same number of runs of each: means over more of them would count as more certain.
        rows = [list(self.rows[name].values())[: self.n_runs] for name in self.candidates]
        values = np.array([[scores.episodes[key] for scores in runs] for runs in rows])
        covariance = covariance_of_rows(values, cluster)
        means = np.array([self.mean(name, key) for name in self.candidates])
        ranks = rank_intervals(-means, covariance, n_clusters)
        is_contender = ranks.low == 1
        return is_contender.tolist(), largest_error(covariance[np.ix_(is_contender, is_contender)])

    @property
    def sentence(self) -> str:
        """Which row is best, and how many runs that was measured in."""
        metric, n_runs = self.primary, len(self.rows[self.best])
        value = metric.display(self.mean(self.best, metric.key))
        best = f"{self.best} is best of {len(self.candidates)} by " if len(self) > 1 else ""
        runs = f", the mean of {n_runs} runs" if n_runs > 1 else ""
        return f"{best}{metric.label} on {self.split}: {value}{runs}"

    @property
    def caution(self) -> str:
        """By how much the score of the best row may be luck; empty if no other comes close."""
        contenders = len(self.contenders)
        if not self.excess:
            return ""
        return (
            f"on {self.split}, {contenders} of {len(self.candidates)} are not significantly "
            f"different, and the best of {contenders} is expected to be up to "
            f"{self.primary.display(self.excess)} {self.primary.label} above what other episodes "
            f"{'and seeds ' if self.n_runs > 1 else ''}would give"
        )

    @property
    def split(self) -> str:
        """The split that was scored."""
        return self.first.split

    @property
    def notes(self) -> Sequence[str]:
        """What a reader of the rows should know, one sentence each."""
        partial = [name for name in self if name not in self.candidates]
        missing = f"not candidates, because they have fewer runs: {first_few(partial)}"
        noted = {note for scores in self._files for note in scores.notes}
        more = f"some files have notes, which `reverie-eval FILE` shows: {first_few(sorted(noted))}"
        return [*([missing] if partial else []), *([more] if noted else [])]

    def plot(self, metrics: Sequence[str] | None = None, ax: "Axes | None" = None) -> "Axes":
        """Draw the rows as a curve over their numbers, with intervals over seeds.

        Parameters are those of :func:`reverie_eval.reporting.plot_curve`.

        Raises
        ------
        ProtocolError
            If rows do not have exactly one field, a number, besides the seed.
        """
        from reverie_eval.reporting.figures import plot_curve

        steps = _steps(self.pattern, self.fields.values())
        return plot_curve(dict(zip(steps, self.values(), strict=True)), metrics, ax)

    def to_pandas(self) -> "pd.DataFrame":
        """Return a line per row, with its fields, its number of runs and the means of its metrics.

        Values are in the metrics' own units, which ``attrs["units"]`` lists by column.
        """
        with naming_missing_parts():
            import pandas as pd

        keys = [metric.key for metric in self.metrics]
        rows = [
            {**fields, "runs": len(self.rows[name]), **{key: self.mean(name, key) for key in keys}}
            for name, fields in self.fields.items()
        ]
        frame = pd.DataFrame(rows, index=pd.Index(list(self), name="row"))
        frame.attrs["units"] = {"runs": "count", **units_of(keys)}
        return frame

    @property
    def _files(self) -> Sequence[Scores]:
        return [scores for runs in self.rows.values() for scores in runs.values()]

    def _repr_html_(self) -> str:
        """Show the rows in a notebook, the best marked."""
        from reverie_eval.reporting.scores import sweep_table

        return sweep_table(self).to_html()

    def __repr__(self) -> str:
        told = "; ".join(filter(None, [self.sentence, self.caution])) if self else "none scored"
        return f"<Sweep of {len(self)}: {told}>"


def sweep(
    pattern: str,
    *,
    split: KnownSplit | str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    protocol: str = DEFAULT_PROTOCOL,
    track: Track = "full",
    subset: Iterable[str] | None = None,
    task: str | None = None,
    jobs: int | None = None,
    executor: Executor | None = None,
) -> Sweep:
    """Score the files of a sweep, and average the seeds of each checkpoint or setting.

    Parameters
    ----------
    pattern : str
        Paths with fields in braces, such as ``runs/seed{seed}/{checkpoint}.json``. Files that
        differ in ``{seed}`` alone are runs of one row; ``{split}`` is the split that is scored.
    split, ground_truth, protocol, track, subset, task, jobs, executor
        As for :func:`reverie_eval.evaluate_many`.

    Raises
    ------
    GroundTruthError, ProtocolError, SubsetError
        As :func:`reverie_eval.evaluate` does; and if no file fits the pattern.

    Examples
    --------
    Choose on one split, and report on another::

        seen = rv.sweep("runs/seed{seed}/{checkpoint}_{split}.json", split="val_seen")
        ((name, ours),) = rv.sweep(seen.best_pattern, split="val_unseen").items()
    """
    scored = evaluate_many(
        sweep_files(pattern, split),
        split=split,
        ground_truth=ground_truth,
        protocol=protocol,
        track=track,
        subset=subset,
        task=task,
        jobs=jobs,
        executor=executor,
    )
    return Sweep.of(pattern, scored, split)


def sweep_files(pattern: str, split: str) -> Sequence[str]:
    """Return the files of a sweep on a split; errors are those of :func:`sweep`."""
    of_split = pattern.replace(SPLIT_FIELD, split)
    files = list(find_fields(of_split))
    if not files:
        raise ProtocolError(
            f"{of_split}: no submission found; each {{name}} stands for a part of one file's or "
            "folder's name"
        )
    return files


def check_curve(pattern: str, split: str) -> None:
    """Check, before anything is scored, that :meth:`Sweep.plot` can draw the files of a sweep.

    Raises
    ------
    ProtocolError
        As :meth:`Sweep.plot` does.
    """
    _steps(pattern, find_fields(pattern.replace(SPLIT_FIELD, split)).values())


def _steps(pattern: str, rows: Iterable[Mapping[str, str]]) -> Sequence[float]:
    """Return the numbers over which a curve is drawn: the only field of each row but the seed."""
    parts = [[part for name, part in row.items() if name != SEED_FIELD] for row in rows]
    wrong = [it for it in parts if len(it) != 1 or not _is_number(it[0])]
    if wrong:
        raise ProtocolError(
            f"{pattern}: a curve needs one field of numbers besides {{{SEED_FIELD}}}, such as "
            f"{{checkpoint}}; got {first_few(' '.join(it) or 'none' for it in wrong)}"
        )
    return [float(part) for (part,) in parts]


def _is_number(text: str) -> bool:
    try:
        return isfinite(float(text))
    except ValueError:
        return False


def _name(names: Sequence[str], parts: Sequence[str]) -> str:
    """Return the name of a row: what its only field stands for, or all fields with their names."""
    if len(parts) == 1:
        return parts[0]
    return " ".join(f"{name}={part}" for name, part in zip(names, parts, strict=True)) or "all"
