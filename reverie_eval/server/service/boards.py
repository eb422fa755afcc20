"""The splits that a server scores, with their ground truth in memory."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from reverie_eval.errors import GroundTruthError, Problem
from reverie_eval.ground_truth import Bundle, GroundTruth
from reverie_eval.metrics import CATALOGUE, Metric, primary_metric
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.scoring import (
    PreparedSubmission,
    Scores,
    find_protocol,
    qualifier_of,
    scored_metrics,
    signature_of,
    why_not,
)
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.settings import Settings, SettingsError, Split
from reverie_eval.submissions import parse_predictions
from reverie_eval.submissions._document import check_value_count

MAX_VALUES = 5_000_000
"""JSON values in an upload: about thirty times as many as in a usual file for the largest split,
and a sixth of the limit outside the server."""

_OTHERS_MAY_READ = 0o077
_BENCHMARK = re.compile(r"^reverie[ -]*")


@dataclass(frozen=True)
class Board:
    """A split: its settings and its ground truth."""

    name: str
    split: Split
    truth: GroundTruth
    public_fingerprint: str
    """Of the bundle without its answers, which participants may have."""

    @property
    def title(self) -> str:
        """What its leaderboard is called: ``Val unseen leaderboard``."""
        name = self.name.replace("_", " ")
        return f"{name[:1].upper()}{name[1:]} leaderboard"

    @property
    def is_private(self) -> bool:
        """Whether only rounded means may leave the server."""
        return self.split.visibility == "private"

    @property
    def signature(self) -> str:
        """Everything that scores depend on, under the current settings."""
        rules = find_protocol(self.split.protocol)
        return signature_of(self.truth, rules, qualifier_of(self.split.track))

    @property
    def metrics(self) -> Sequence[str]:
        """The keys of the metrics that every submission with answers gets."""
        return scored_metrics(find_protocol(self.split.protocol), self.split.track)

    @property
    def primary(self) -> Metric:
        """The metric that submissions are ranked by unless another is asked for."""
        return primary_metric(self.metrics)

    def is_on(self, dataset: str) -> bool:
        """Whether a dataset's version may be that of the split: the same, or empty for unknown.

        ``v2`` and ``reverie-v2`` are ``REVERIE v2``.
        """
        own, other = (
            _BENCHMARK.sub("", name.lower()) for name in (self.truth.header.dataset, dataset)
        )
        return other in {own, ""}

    def read(self, content: bytes) -> PreparedSubmission:
        """Read a submission's JSON text and align it with the split.

        Raises
        ------
        SubmissionError
            Listing all problems; they reveal nothing about the answers.
        """
        reading = self._prepare(content, self.truth)
        return reading.without_answer_hints() if self.is_private else reading

    def check(self, content: bytes) -> PreparedSubmission:
        """Do what :meth:`read` does, without using the answers."""
        return self._prepare(content, replace(self.truth, answers=None))

    def _prepare(self, content: bytes, truth: GroundTruth) -> PreparedSubmission:
        check_value_count(content, MAX_VALUES)
        predictions = parse_predictions(content, answers_only=self.split.track == "grounding")
        return PreparedSubmission.of(predictions, truth, self.split.track)

    def score(self, reading: PreparedSubmission) -> Scores:
        """Score a submission by the split's protocol."""
        return reading.score(find_protocol(self.split.protocol))

    def measures_as(self, report: ScoreReport) -> bool:
        """Whether a report was scored with the current ground truth, protocol and track."""
        return self.is_current(report.signature, report.fingerprint)

    def is_current(self, signature: str, fingerprint: str) -> bool:
        """Whether these are of the current ground truth, protocol and track."""
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
            return scores.to_report()
        # Other metrics are not computed either: path fidelity takes longer than all the rest.
        shown = {metric.key: scores.episodes[metric.key] for metric in scores.headline}
        report = replace(scores, episodes=MappingProxyType(shown)).to_report()
        return _rounded(report, reading.validation().notes)

    def may_keep(self, report: ScoreReport) -> bool:
        """Whether a stored report contains no more than :meth:`report` would return.

        A report on a private split may: it was scored while the split was still open.
        """
        return not self.is_private or report == _rounded(report, report.notes)


def _rounded(report: ScoreReport, notes: Iterable[str]) -> ScoreReport:
    return ScoreReport(
        signature=report.signature,
        split=report.split,
        protocol=report.protocol,
        dataset=report.dataset,
        fingerprint=report.fingerprint,
        version=report.version,
        episodes=report.episodes,
        scores={key: CATALOGUE[key].rounded(value) for key, value in report.scores.items()},
        notes=list(notes),
    )


def without_version(signature: str) -> str:
    """Return what scores compare by: a released protocol's numbers are those of every version."""
    return signature.rpartition("|version:")[0]


def load_boards(settings: Settings) -> Mapping[str, Board]:
    """Load every split's ground truth, by the split's name.

    Raises
    ------
    SettingsError
        Naming each split that cannot be scored, and why.
    """
    boards, problems = {}, []
    for name, split in settings.splits.items():
        path = settings.path(split.bundle)
        try:
            boards[name] = load_board(name, split, path)
        except (GroundTruthError, OSError) as error:
            missing = "; put it there, or make it with `reverie-eval compile`"
            reason = f"{error.strerror}{missing}" if isinstance(error, OSError) else error
            where = f"splits.{name}.bundle"
            problems.append(Problem("no-ground-truth", where, f"{path}: {reason}"))
    problems += _public_answers(boards, settings)
    if problems:
        raise SettingsError(problems)
    return MappingProxyType(boards)


def _public_answers(boards: Mapping[str, Board], settings: Settings) -> Iterator[Problem]:
    """Report private splits whose answers an open split shows."""
    for private in filter(lambda board: board.is_private, boards.values()):
        for other in boards.values():
            if not other.is_private and _have_same_answers(private, other):
                path = settings.path(private.split.bundle)
                remedy = (
                    f"{path}: has the answers of the open split {other.name}; compile the private "
                    "annotations (`reverie-eval compile --annotations`), or do not open "
                    f"{other.name}"
                )
                yield Problem("public-answers", f"splits.{private.name}.bundle", remedy)


def _have_same_answers(board: Board, other: Board) -> bool:
    """Whether two splits have the same targets and paths, whatever they are called."""
    one, two = board.truth.require_answers(), other.truth.require_answers()
    return np.array_equal(one.target_object, two.target_object) and np.array_equal(
        one.path, two.path
    )


def board_named(boards: Mapping[str, Board], split: str) -> Board:
    """Return a split's board.

    Raises
    ------
    NotFoundError
        If the server has no such split.
    """
    board = boards.get(split)
    if board is None:
        raise NotFoundError(f"there is no split {split!r} here; there are: {', '.join(boards)}")
    return board


def load_board(name: str, split: Split, path: Path) -> Board:
    """Load a split's ground truth.

    Raises
    ------
    GroundTruthError
        If the split cannot be scored with it.
    OSError
        If it cannot be read.
    """
    bundle = Bundle.load(path)
    truth = GroundTruth.from_bundle(bundle, origin=str(path))
    truth.require_answers()
    if truth.split != name:
        raise GroundTruthError(f"this is the ground truth of {truth.split}, not of {name}")
    reason = why_not(find_protocol(split.protocol), truth, split.track)
    if reason:
        raise GroundTruthError(reason)
    mode = path.stat().st_mode
    if split.visibility == "private" and mode & _OTHERS_MAY_READ:
        raise GroundTruthError(f"others can read these answers; run `chmod 600 {path}`")
    public_fingerprint = bundle.public().header.fingerprint
    return Board(name, split, replace(truth, origin=name), public_fingerprint)
