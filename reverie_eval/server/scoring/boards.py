"""The splits that a server scores, with their ground truth in memory.

A split has a leaderboard, and may have others, which rank the same submissions under other
rules. Each of them is a :class:`Board`.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import isnan
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from reverie_eval.errors import GroundTruthError, Problem, ProtocolError, SubmissionError
from reverie_eval.files import is_private
from reverie_eval.ground_truth import Bundle, GroundTruth
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.scoring import (
    PreparedSubmission,
    Scores,
    qualifier_of,
    scored_metrics,
    signature_of,
    why_not,
)
from reverie_eval.server.errors import NotFoundError, no_split
from reverie_eval.server.settings import Settings, SettingsError, Split
from reverie_eval.submissions import check_value_count, parse_predictions
from reverie_eval.tasks import DEFAULT_TASK, Protocol, Task, find_task, name_on_server
from reverie_eval.text import count_text
from reverie_eval.version import __version__

MAX_VALUES = 5_000_000
"""JSON values in an upload, at most: about thirty times as many as in a usual file for the largest
split, and a sixth of the limit outside the server."""

_UNKNOWN: Mapping[str, str] = MappingProxyType({})
_RELEASED = {"signature", "split", "protocol", "dataset", "fingerprint", "version", "episodes"}
"""The fields of a private split's report, besides its scores and notes."""


class Scored(NamedTuple):
    """The result of a submission on a leaderboard."""

    report: ScoreReport
    scores: Scores | None
    """None if the file does not have what is scored there."""


@dataclass(frozen=True)
class Board:
    """A leaderboard: the settings and the ground truth of its split, and its own rules."""

    split: str
    """The split's name on this server: ``test``, or ``r2r-test``."""
    settings: Split
    """The split's settings, with the protocol and the track of this leaderboard."""
    truth: GroundTruth
    """The ground truth, with the episodes and annotated paths that the protocol uses."""
    public_fingerprint: str
    """Fingerprint of the bundle without its solution, which participants may have."""
    name: str = ""
    """The name of the leaderboard; empty for the main one."""
    others: Mapping[str, "Board"] = field(default_factory=dict)
    """The other leaderboards of the split, by name; only the split's main one has them."""
    main: "Board | None" = None
    """The split's main leaderboard; None if it is this one."""

    @property
    def label(self) -> str:
        """The name for people: the split, or the split and the leaderboard."""
        return f"{self.split}, {self.name}" if self.name else self.split

    @property
    def path(self) -> str:
        """The part of addresses that names it: ``test`` or ``test/boards/grounding``."""
        split = quote(self.split, safe="")
        return f"{split}/boards/{self.name}" if self.name else split

    @property
    def all(self) -> Sequence["Board"]:
        """The split's leaderboards, the main one first."""
        return [self, *self.others.values()]

    @property
    def sample(self) -> str:
        """The name of the declared sample that it ranks; empty for the whole split."""
        if not self.truth.subset_digest:
            return ""
        return self.split.removeprefix(f"{name_on_server(self.task.name, self.truth.split)}-")

    @property
    def n_split(self) -> int:
        """The number of episodes of the split, of which a sample has some."""
        return len(_whole(self.truth).episodes.instr_ids)

    @property
    def title(self) -> str:
        """The heading: ``Val unseen leaderboard``, or ``R2R test leaderboard: strict``."""
        title = self.full_title
        if self.task.name == DEFAULT_TASK:
            title = title.removeprefix(f"{self.task.title} ")
        return title[:1].upper() + title[1:]

    @property
    def full_title(self) -> str:
        """The title where the benchmark must be named: ``REVERIE val unseen leaderboard``."""
        split = self.truth.split.replace("_", " ")
        of_sample = f", sample {self.sample}" if self.sample else ""
        named = f": {self.name}" if self.name else ""
        return f"{self.task.title} {split} leaderboard{of_sample}{named}"

    @property
    def is_private(self) -> bool:
        """Whether only rounded means may leave the server."""
        return self.settings.visibility == "private"

    @property
    def task(self) -> Task:
        """The task that the split is of."""
        return self.truth.task

    @property
    def protocol(self) -> Protocol:
        """The protocol that scores."""
        return self.task.protocol(self.settings.protocol)

    @property
    def signature(self) -> str:
        """Everything that scores depend on, under the current settings."""
        return signature_of(self.truth, self.protocol, qualifier_of(self.settings.track))

    @property
    def metrics(self) -> Sequence[str]:
        """The keys of the metrics that every submission with answers gets."""
        return scored_metrics(self.protocol, self.settings.track)

    @property
    def headline(self) -> Sequence[Metric]:
        """The metrics among them that a score table shows, in its order."""
        return self.task.headline_metrics(self.metrics)

    @property
    def primary(self) -> Metric:
        """The metric that submissions are ranked by, unless another one is requested."""
        return self.task.primary_metric(self.metrics)

    @property
    def sortable(self) -> Sequence[str]:
        """The keys of the metrics with a better direction, by which results can be ranked."""
        return [key for key in self.task.metrics if CATALOGUE[key].better != "neither"]

    def is_on(self, dataset: str) -> bool:
        """Whether a dataset's version may be that of the split: the same one, or unknown (empty).

        ``v2`` and ``reverie-v2`` are ``REVERIE v2``.
        """
        benchmark = re.compile(rf"^{re.escape(self.task.title.lower())}[ -]*")
        own, other = (
            benchmark.sub("", name.lower()) for name in (self.truth.header.dataset, dataset)
        )
        return other in {own, ""}

    def read(self, content: bytes) -> PreparedSubmission:
        """Read a submission's JSON text and align it with the split.

        Raises
        ------
        SubmissionError
            If it is rejected; lists all problems, which reveal nothing about the solution.
        """
        reading = self._prepare(content, self.truth)
        return reading.without_answer_hints() if self.is_private else reading

    def check(self, content: bytes) -> PreparedSubmission:
        """Do what :meth:`read` does, without using the solution."""
        return self._prepare(content, replace(self.truth, solution=None))

    def _prepare(self, content: bytes, truth: GroundTruth) -> PreparedSubmission:
        check_value_count(content, MAX_VALUES)
        answers_only = self.settings.track == "grounding"
        predictions = parse_predictions(content, self.task, truth.graph, answers_only=answers_only)
        try:
            prepared = PreparedSubmission.of(predictions, truth, self.settings.track)
        except SubmissionError as error:
            raise SubmissionError([self._named_here(each) for each in error.problems]) from None
        # Every episode of the sample occurs once by now, so the others are not in it.
        n_episodes = len(truth.episodes.instr_ids)
        others = len(predictions.instr_ids) - n_episodes
        if self.sample and others:
            message = (
                f"{count_text(others, 'record')} of episodes that are not in the sample "
                f"{self.sample}; send those of its {count_text(n_episodes, 'episode')} alone"
            )
            raise SubmissionError([Problem("beyond-sample", "file", message)])
        return prepared

    def _named_here(self, problem: Problem) -> Problem:
        """Return a problem in which the split that the file seems to be for has its name here."""
        if problem.split is None:
            return problem
        return replace(problem, split=name_on_server(self.task.name, problem.split))

    def score(self, reading: PreparedSubmission) -> Scores:
        """Score a submission by the leaderboard's protocol."""
        return reading.score(self.protocol)

    def reports(self, content: bytes, reading: PreparedSubmission) -> Mapping[str, ScoreReport]:
        """Return the reports on a submission that was read, by leaderboard of the split.

        It is read again only for another track, or for other episodes or annotated paths.
        """
        return {
            board.name: board.scored(
                content, reading if board.reads_by == self.reads_by else None
            ).report
            for board in self.all
        }

    @property
    def reads_by(self) -> tuple[object, ...]:
        """What :meth:`read` depends on besides the split."""
        return self.settings.track, *self.protocol.basis

    def scored(
        self,
        content: bytes,
        reading: PreparedSubmission | None = None,
        *,
        has_intervals: bool = False,
    ) -> "Scored":
        """Score a submission's JSON text, which is read unless a reading is given.

        On another leaderboard, a file without the predictions that it scores gets a report
        without scores, whose note says why.

        Raises
        ------
        SubmissionError
            If it does not fit the split at all.
        """
        try:
            reading = reading or self.read(content)
        except SubmissionError as error:
            if self.main is None:
                raise
            self.main.read(content)
            note = f"this file cannot be ranked here: {error.problems[0].message}"
            return Scored(self._without_scores(note), None)
        scores = self.score(reading)
        if has_intervals:
            with suppress(ProtocolError):  # no intervals from a single target
                scores = scores.with_intervals()
        return Scored(self.report(scores, reading), scores)

    def _without_scores(self, note: str) -> ScoreReport:
        return ScoreReport(
            signature=self.signature,
            split=self.truth.split,
            protocol=self.settings.protocol,
            dataset=self.truth.header.dataset,
            fingerprint=self.truth.fingerprint,
            version=__version__,
            episodes=len(self.truth.episodes.instr_ids),
            scores={},
            notes=[note],
        )

    def measures_as(self, report: ScoreReport) -> bool:
        """Whether a report was scored with the current ground truth, protocol and track."""
        return self.is_current(report.signature, report.fingerprint)

    def is_current(self, signature: str, fingerprint: str) -> bool:
        """Whether a report's signature and fingerprint are those of the current rules and data."""
        # The signature has the track, and only the beginning of the fingerprint.
        return fingerprint == self.truth.fingerprint and (
            without_version(signature) == without_version(self.signature)
        )

    def report(self, scores: Scores, reading: PreparedSubmission) -> ScoreReport:
        """Return the report that may leave the server: for a private split, only rounded means.

        These are the headline metrics, to two decimals of the displayed unit. Every further metric
        or digit would reveal more about single episodes. The report of a private split is built
        field by field, so fields that are added to reports later are not released by default.
        """
        if not self.is_private:
            return _with_values(scores.to_report())
        # Other metrics are not computed either: path fidelity takes longer than all the rest.
        shown = {metric.key: scores.episodes[metric.key] for metric in scores.headline}
        report = replace(scores, episodes=MappingProxyType(shown)).to_report()
        return _rounded(_with_values(report), reading.validation().notes)

    def may_keep(self, report: ScoreReport) -> bool:
        """Whether a stored report contains no more than :meth:`report` would return.

        A report on a private split may: it was scored while the split was still open.
        """
        return not self.is_private or report == _rounded(report, report.notes)


class Boards(Mapping[str, Board]):
    """The leaderboards of a server by split, which a correction replaces while the server runs.

    Looking one up twice may give two; each is complete and never changes.
    """

    def __init__(self, boards: Mapping[str, Board]) -> None:
        self._boards = boards

    def __getitem__(self, split: str) -> Board:
        return self._boards[split]

    def __iter__(self) -> Iterator[str]:
        return iter(self._boards)

    def __len__(self) -> int:
        return len(self._boards)

    def replace(self, boards: Mapping[str, Board]) -> None:
        """Use other ground truth from now on, of the same splits."""
        self._boards = boards


def _with_values(report: ScoreReport) -> ScoreReport:
    """Leave out metrics without a value, as JSON has no NaN.

    In SOON, the error of a direction is a mean over detected targets, and there may be none.
    """
    scores = {key: value for key, value in report.scores.items() if not isnan(value)}
    return report.model_copy(update={"scores": scores})


def _rounded(report: ScoreReport, notes: Iterable[str]) -> ScoreReport:
    scores = {key: CATALOGUE[key].rounded(value) for key, value in report.scores.items()}
    return ScoreReport(**report.model_dump(include=_RELEASED), scores=scores, notes=list(notes))


def without_version(signature: str) -> str:
    """Return a signature without the version: a released protocol scores alike in all versions."""
    return signature.rpartition("|version:")[0]


def rules_of(boards: Mapping[str, Board]) -> Mapping[str, str]:
    """Return what scores depend on, by leaderboard: signatures without the version."""
    return {board.label: without_version(board.signature) for board in all_boards(boards)}


def load_boards(settings: Settings, in_force: Mapping[str, str] = _UNKNOWN) -> Mapping[str, Board]:
    """Load every split's ground truth, by the split's name.

    Parameters
    ----------
    settings : Settings
        Settings of the server.
    in_force : mapping
        The rules that were recorded last, by leaderboard. If a correction was killed after it had
        recorded its rules, its ground truth still waits beside its place, and is put there.

    Raises
    ------
    SettingsError
        If a split cannot be scored; it names each, and why.
    """
    boards, problems = {}, []
    for name, split in settings.splits.items():
        path = settings.path(split.bundle)
        try:
            boards[name] = _load_corrected(name, split, path, in_force) or load_board(
                name, split, path
            )
        except (GroundTruthError, OSError) as error:
            missing = "; put it there, or create it with `reverie-eval compile`"
            reason = f"{error.strerror}{missing}" if isinstance(error, OSError) else str(error)
            named = reason if str(path) in reason else f"{path}: {reason}"
            problems.append(Problem("no-ground-truth", f"splits.{name}.bundle", named))
    problems += _public_solution(boards, settings)
    if problems:
        raise SettingsError(problems)
    return MappingProxyType(boards)


def waiting_beside(bundle: Path) -> Path:
    """Return where a split's corrected ground truth waits until its results are stored."""
    return bundle.with_name(f"{bundle.stem}.next{bundle.suffix}")


def _load_corrected(
    name: str, split: Split, path: Path, in_force: Mapping[str, str]
) -> Board | None:
    """Load ground truth that still waits, and put it in its place; None unless it is in force."""
    waiting = waiting_beside(path)
    try:
        board = load_board(name, split, waiting)
    except (GroundTruthError, OSError):  # usually there is none
        return None
    if not rules_of({name: board}).items() <= in_force.items():
        return None
    with suppress(OSError):  # another process has moved it, or the folder cannot be written
        waiting.replace(path)
    return board


def _public_solution(boards: Mapping[str, Board], settings: Settings) -> Iterator[Problem]:
    """Report private splits whose solution an open split shows."""
    for private in filter(lambda board: board.is_private, boards.values()):
        for other in boards.values():
            if not other.is_private and _have_same_solution(private, other):
                path = settings.path(private.settings.bundle)
                remedy = (
                    f"{path}: has the solution of the open split {other.split}; compile the "
                    "private annotations (`reverie-eval compile --annotations`), or do not open "
                    f"{other.split}"
                )
                yield Problem("public-solution", f"splits.{private.split}.bundle", remedy)


def _have_same_solution(board: Board, other: Board) -> bool:
    """Whether two splits have the same targets and paths, whatever they are called."""
    one, two = (_whole(each.truth).require_solution() for each in (board, other))
    return np.array_equal(one.target_object, two.target_object) and np.array_equal(
        one.path, two.path
    )


def _whole(truth: GroundTruth) -> GroundTruth:
    """Return the ground truth of the split that a declared sample is of."""
    return truth.subset_of[0] if truth.subset_digest and truth.subset_of else truth


def tasks_of(boards: Mapping[str, Board]) -> Sequence[Task]:
    """Return the tasks that the splits are of, each once; REVERIE first."""
    named = {board.task.name: board.task for board in boards.values()}
    return [named[name] for name in sorted(named, key=lambda name: name != DEFAULT_TASK)]


def all_boards(boards: Mapping[str, Board]) -> Sequence[Board]:
    """Return the leaderboards of all splits."""
    return [board for main in boards.values() for board in main.all]


def find_board(boards: Mapping[str, Board], split: str, name: str = "") -> Board:
    """Return a leaderboard of a split, the main one or another.

    Raises NotFoundError if the split has no such leaderboard.
    """
    board = boards.get(split)
    if board is None:
        raise no_split(split, boards)
    if not name:
        return board
    if name not in board.others:
        others = ", ".join(board.others)
        known = f"its other leaderboards: {others}" if others else "it has only its main one"
        raise NotFoundError(f"{split} has no leaderboard {name!r}; {known}")
    return board.others[name]


def load_board(name: str, split: Split, path: Path) -> Board:
    """Load a split's ground truth.

    Raises
    ------
    GroundTruthError
        If the split cannot be scored with it.
    OSError
        If the file cannot be read.
    """
    bundle = Bundle.load(path)
    truth = GroundTruth.from_bundle(bundle, origin=str(path))
    truth.require_solution()
    if truth.task.name != split.task:
        raise GroundTruthError(
            f"this is the ground truth of {truth.task.title}, but the split is of "
            f'{find_task(split.task).title}; set task = "{truth.task.name}", or use another bundle'
        )
    known = name_on_server(split.task, truth.split)
    if truth.subset_digest and not re.fullmatch(rf"{re.escape(known)}-[a-z0-9_-]{{1,40}}", name):
        raise GroundTruthError(
            f"this is the ground truth of a sample of {known}; call it {known}- and a name of "
            f"lower-case letters, digits, - and _, such as {known}-{truth.subset_digest}"
        )
    if known != name and not truth.subset_digest:
        raise GroundTruthError(f"this is the ground truth of {known}, not of {name}")
    if split.visibility == "private" and not is_private(path):
        raise GroundTruthError(f"others can read the solution; run `chmod 600 {path}`")
    public_fingerprint = bundle.public().header.fingerprint
    board = _board(name, split, replace(truth, origin=name), public_fingerprint)
    for each in board.all:
        reason = why_not(each.protocol, each.truth, each.settings.track)
        if reason:
            raise GroundTruthError(f"boards.{each.name}: {reason}" if each.name else reason)
    return board


def _board(name: str, split: Split, truth: GroundTruth, public_fingerprint: str) -> Board:
    """Return a split's main leaderboard, which has the others."""

    def scored(split: Split) -> GroundTruth:
        return truth.scored_by(truth.task.protocol(split.protocol))

    main = Board(name, split, scored(split), public_fingerprint)
    others = {
        each: replace(main, settings=chosen, truth=scored(chosen), name=each, main=main)
        for each in split.boards
        if (chosen := split.ranked_on(each))
    }
    return replace(main, others=MappingProxyType(others))
