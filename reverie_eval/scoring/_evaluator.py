"""Scoring by an evaluator: one file, batches as in training, and many files in processes."""

import math
import os
import typing
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

from typing_extensions import Self

from reverie_eval.errors import GroundTruthError, SubmissionError, naming_missing_parts
from reverie_eval.ground_truth import GroundTruth, find_ground_truth
from reverie_eval.metrics import CATALOGUE, Metric, units_of
from reverie_eval.processes import can_start_processes, map_in_processes
from reverie_eval.scoring._episode_table import EpisodeTable, Track, qualifier_of
from reverie_eval.scoring._evaluation import PreparedSubmission, is_grounding, why_not
from reverie_eval.scoring._lookups import Lookups
from reverie_eval.scoring._scored import signature_of
from reverie_eval.scoring._scores import Scores
from reverie_eval.submissions import (
    Content,
    Records,
    Submission,
    are_records,
    check_batch,
    read_predictions,
)
from reverie_eval.tasks import DEFAULT_PROTOCOL, DEFAULT_TASK, KnownSplit, find_task

if TYPE_CHECKING:
    import pandas as pd

    from reverie_eval.submissions import SubmissionColumns


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
        If there is no valid ground truth with a solution for the split, protocol and track.
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
        protocol: str = DEFAULT_PROTOCOL,
        track: Track = "full",
        subset: Iterable[str] | None = None,
        task: str | None = None,
    ) -> None:
        # Unusable settings must raise here, and not after the first epoch of training.
        is_grounding(track)
        self.track = track
        truth = find_ground_truth(ground_truth, split, task, subset)
        truth.require_solution()
        self.protocol = truth.task.protocol(protocol)
        self.ground_truth = truth.scored_by(self.protocol)
        reason = why_not(self.protocol, self.ground_truth, track)
        if reason:
            raise GroundTruthError(reason)
        self._records: dict[str, Mapping[str, Any]] = {}
        self._contents: dict[str, Content] = {}

    def __call__(self, predictions: Submission) -> Scores:
        """Score a submission; argument and errors are those of :func:`reverie_eval.evaluate`."""
        truth = self.ground_truth
        read = read_predictions(
            predictions, truth.task, truth.graph, answers_only=is_grounding(self.track)
        )
        return PreparedSubmission.of(read, truth, self.track).score(self.protocol)

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
        # Checked at once: a wrong record is named while the batch that made it is at hand.
        predictions = read_predictions(
            records, self.ground_truth.task, answers_only=is_grounding(self.track)
        )
        self._contents |= check_batch(predictions, self.ground_truth, self._contents)
        listed = list(_listed(records))
        for row, instr_id in enumerate(predictions.instr_ids):
            location = predictions.location(row)
            if not location.trajectory:  # one of several, if not the first, is not a record
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
        qualifier = qualifier_of(self.track)
        return f"<Evaluator {signature_of(self.ground_truth, self.protocol, qualifier)}>"


def _listed(records: Records) -> Iterable[Mapping[str, Any]]:
    """Return records with their ids in them, which may be their keys only."""
    if isinstance(records, Mapping):
        return ({"instr_id": key, **record} for key, record in records.items())
    return records


def evaluate(
    submission: Submission,
    *,
    split: KnownSplit | str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    protocol: str = DEFAULT_PROTOCOL,
    track: Track = "full",
    subset: Iterable[str] | None = None,
    task: str | None = None,
) -> Scores:
    """Score a submission.

    Parameters
    ----------
    submission : path, bytes, open file, or sequence of records
        The result file (plain, gzip or zip; ``-`` for standard input), its contents, or its records
        as Python objects: ``{"instr_id", "trajectory", "predObjId"}``, or any other form that
        public codebases write.
    split : str
        ``train``, ``val_seen``, ``val_unseen`` or ``test``.
    ground_truth : path or GroundTruth, optional
        A bundle, or a folder of bundles. By default, the path in the environment variable
        ``REVERIE_EVAL_GROUND_TRUTH``, or else the synthetic demo world that ships with the package.
    protocol : str
        A name in ``PROTOCOLS``, or an alias; for another task, one of its protocols.
    track : "full" or "grounding"
        In the grounding track the agent answers from the end of the annotated path: trajectories
        are ignored and may be missing, and RGS is the only score.
    subset : instr_ids, optional
        The episodes to score; by default all. Predictions for other episodes of the split are
        checked and left out. Scores are comparable only with those on the same subset.
    task : str, optional
        The benchmark: ``reverie``, ``r2r``, ... By default that of the bundle, or REVERIE.

    Returns
    -------
    Scores
        One value per metric and episode, and their means.

    Raises
    ------
    SubmissionError
        If the submission is invalid; lists every problem and its location.
    GroundTruthError
        If there is no valid ground truth with a solution for the split and protocol.
    ProtocolError
        If there is no such task, protocol or track.
    SubsetError
        If episodes of the subset are unknown or listed twice; lists every problem.
    OSError
        If a file cannot be read.

    Examples
    --------
    >>> scores = evaluate("demo/good.json", split="val_unseen")
    >>> round(scores["success"], 2)
    0.81
    """
    evaluator = Evaluator(
        split=split,
        ground_truth=ground_truth,
        protocol=protocol,
        track=track,
        subset=subset,
        task=task,
    )
    return evaluator(submission)


# Files that are sent to an executor together: scoring them takes about half a second. A process of
# our own gets only a few, so that all end together.
_CHUNK = 50
_FEW = 10
# Files for which one more process pays: to start it takes about as long as to score them.
_FOR_ONE = 50

TABLE_KEYS = frozenset(metric.key for metric in find_task(DEFAULT_TASK).table_metrics(CATALOGUE))
"""The metrics that a score table may show."""

Failure: TypeAlias = SubmissionError | OSError
"""Why a file has no scores: it is invalid, or cannot be read."""


class Executor(typing.Protocol):
    """Runs functions elsewhere, as the executors of ``concurrent.futures`` and Dask do."""

    def submit(self, function: Any, argument: Any, /) -> Any:
        """Start a call, and return a future whose ``result()`` waits for it."""


@dataclass(frozen=True, eq=False, repr=False)
class ScoredFiles(Mapping[str, Scores]):
    """The scores of many files by their paths, best first.

    The best has the highest RGSPL, or RGS or SPL if RGSPL is not scored. Files without answers come
    last.
    """

    scores: Mapping[str, Scores]
    failures: Mapping[str, Failure]
    """Why the other files have no scores, by path."""

    @classmethod
    def of(cls, results: Iterable[tuple[str, Scores | Failure]]) -> Self:
        """Rank results, by path; of equal ones, the earlier is first."""
        found = dict(results)
        scores = {file: each for file, each in found.items() if isinstance(each, Scores)}
        failures = {file: each for file, each in found.items() if not isinstance(each, Scores)}
        key = _ranking_key(scores)
        ranked = sorted(scores, key=lambda file: -scores[file].get(key, -math.inf))
        return cls({file: scores[file] for file in ranked}, failures)

    def __getitem__(self, file: str) -> Scores:
        return self.scores[file]

    def __iter__(self) -> Iterator[str]:
        return iter(self.scores)

    def __len__(self) -> int:
        return len(self.scores)

    # Kept, because it looks at all files, and tables ask for it with each of them.
    @cached_property
    def metrics(self) -> Sequence[Metric]:
        """The metrics of a score table that has any of them."""
        first = next(iter(self.values()), None)
        return first.ground_truth.task.table_metrics(_keys(self)) if first else []

    @property
    def ranks(self) -> Mapping[str, int | None]:
        """The rank of each file: equal for equal values, None for files without the metric."""
        if not self:
            return {}
        key = _ranking_key(self)
        values = {file: each[key] for file, each in self.items() if key in each}
        rank_of: dict[float, int] = {}
        for index, value in enumerate(values.values(), start=1):
            # Equal values share the better rank, and the next rank is left out.
            rank_of.setdefault(value, index)
        return {file: rank_of[values[file]] if file in values else None for file in self}

    def to_pandas(self) -> "pd.DataFrame":
        """Return a row per file, best first, with every metric of the score table.

        Values are in the metrics' own units, which ``attrs["units"]`` lists by column.
        """
        with naming_missing_parts():
            import pandas as pd

        keys = [metric.key for metric in self.metrics]
        rows = [{key: each[key] for key in keys if key in each} for each in self.values()]
        frame = pd.DataFrame(rows, index=pd.Index(list(self), name="file"), columns=keys)
        frame.attrs["units"] = units_of(keys)
        return frame

    def __repr__(self) -> str:
        return f"<ScoredFiles: {len(self)} scored, {len(self.failures)} failed>"


def _ranking_key(scores: Mapping[str, Scores]) -> str:
    """Return the metric that ranks; empty if there are no scores."""
    first = next(iter(scores.values()), None)
    return first.ground_truth.task.primary_metric(_keys(scores)).key if first else ""


def _keys(scores: Mapping[str, Scores]) -> set[str]:
    return {key for each in scores.values() for key in each}


def evaluate_many(
    files: Iterable[str | PathLike[str]],
    *,
    split: KnownSplit | str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    protocol: str = DEFAULT_PROTOCOL,
    track: Track = "full",
    subset: Iterable[str] | None = None,
    task: str | None = None,
    jobs: int | None = None,
    executor: Executor | None = None,
) -> ScoredFiles:
    """Score many files; an invalid file does not stop the others.

    Parameters
    ----------
    files : paths
        The result files. A path that is given twice is scored once.
    split, ground_truth, protocol, track, subset, task
        As for :func:`reverie_eval.evaluate`.
    jobs : int, optional
        Number of processes; by default as many as are useful, up to the number of processors, or
        one in a script without ``if __name__ == "__main__"``, which each process would run again.
    executor : optional
        Scores the files instead of processes on this machine: anything with ``submit(function,
        argument)``, such as an executor of ``concurrent.futures`` or submitit, or Dask's client. It
        gets fifty paths at a time, which must name the same files there.

    Returns
    -------
    ScoredFiles
        The scores by path, best first, and ``failures``.

    Raises
    ------
    GroundTruthError, ProtocolError, SubsetError
        As :func:`reverie_eval.evaluate` does.

    Examples
    --------
    >>> files = [f"demo/{name}.json" for name in ("mediocre", "good", "broken")]
    >>> scored = evaluate_many(files, split="val_unseen")
    >>> list(scored)
    ['demo/good.json', 'demo/mediocre.json']
    >>> list(scored.failures)
    ['demo/broken.json']
    """
    evaluator = Evaluator(
        split=split,
        ground_truth=ground_truth,
        protocol=protocol,
        track=track,
        subset=subset,
        task=task,
    )
    names = list(dict.fromkeys(os.fspath(file) for file in files))
    return ScoredFiles.of(score_files(names, evaluator, jobs=jobs, executor=executor))


def score_files(
    files: Sequence[str],
    evaluator: Evaluator,
    *,
    jobs: int | None = None,
    executor: Executor | None = None,
    keys: Collection[str] = TABLE_KEYS,
) -> Iterator[tuple[str, Scores | Failure]]:
    """Yield the result of each file, in their order, as soon as it is available.

    Parameters are those of :func:`evaluate_many`; ``keys`` are the metrics that are computed at
    once, where the file is read. All others are computed here, on first access.
    """
    useful = min(os.cpu_count() or 1, 1 + len(files) // _FOR_ONE) if can_start_processes() else 1
    jobs = jobs or useful
    truth, track = evaluator.ground_truth, evaluator.track
    if executor is None and jobs == 1:
        for file in files:
            yield file, _received(_result(evaluator, file, keys), truth, track)
        return
    protocol = evaluator.protocol.name
    # A path is a short message, and a process elsewhere may read the bundle faster than receive it.
    given = truth.origin if Path(truth.origin).is_file() else truth
    size = min(_FEW, math.ceil(len(files) / jobs)) if executor is None else _CHUNK
    subset = truth.episodes.instr_ids if truth.subset_digest else None
    chunks = [
        _Chunk(files[begin : begin + size], given, truth.split, protocol, track, subset, keys)
        for begin in range(0, len(files), size)
    ]
    if executor is None:
        results = map_in_processes(_score_chunk, chunks, jobs)
    else:
        futures = [executor.submit(_score_chunk, chunk) for chunk in chunks]
        results = (future.result() for future in futures)
    with closing(results):
        for chunk, (fingerprint, found) in zip(chunks, results, strict=True):
            if fingerprint != truth.fingerprint:
                raise GroundTruthError(
                    f"a process found a different ground truth in {truth.origin}; give all "
                    "processes the same file"
                )
            for file, each in zip(chunk.files, found, strict=True):
                yield file, _received(each, truth, track)


class _Chunk(NamedTuple):
    """Files for a process to score."""

    files: Sequence[str]
    ground_truth: str | GroundTruth
    """The path of a bundle, or the ground truth itself if it was not read from a file."""
    split: str
    protocol_name: str
    track: Track
    subset: tuple[str, ...] | None
    keys: Collection[str]


def _score_chunk(chunk: _Chunk) -> tuple[str, list[Scores | Failure]]:
    """Score files in a process of its own; return the ground truth's fingerprint as well."""
    files, *settings, keys = chunk
    evaluator = _evaluator(*settings)
    found = [_result(evaluator, file, keys) for file in files]
    return evaluator.ground_truth.fingerprint, found


@lru_cache(maxsize=1)
def _evaluator(
    ground_truth: str | GroundTruth,
    split: str,
    protocol_name: str,
    track: Track,
    subset: tuple[str, ...] | None,
) -> Evaluator:
    return Evaluator(
        split=split, ground_truth=ground_truth, protocol=protocol_name, track=track, subset=subset
    )


def _result(evaluator: Evaluator, file: str, keys: Collection[str]) -> Scores | Failure:
    """Return scores as a process sends them: without the ground truth, which the receiver has.

    What else was looked up for them is left out too: it takes twice the memory of the rest.
    """
    try:
        scores = evaluator(file)
    except (SubmissionError, OSError) as error:
        return error
    columns = {key: scores.episodes[key] for key in scores if key in keys}
    return replace(scores, ground_truth=None, episodes=columns)  # type: ignore[arg-type]


def _received(result: Scores | Failure, truth: GroundTruth, track: Track) -> Scores | Failure:
    """Return scores as they were before they were sent."""
    if not isinstance(result, Scores):
        return result
    lookups = Lookups(cast("SubmissionColumns", result.submission), truth)
    table = EpisodeTable(lookups, result.protocol, track, result.episodes)
    return replace(result, ground_truth=truth, episodes=table)
