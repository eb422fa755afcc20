"""The splits that a server scores, with their ground truth in memory."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from types import MappingProxyType

from reverie_eval.errors import GroundTruthError, Problem
from reverie_eval.ground_truth import Bundle, GroundTruth
from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.scoring import PreparedSubmission, Scores, find_protocol, signature_of, why_not
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.settings import Settings, SettingsError, Split
from reverie_eval.submissions import Predictions, parse_predictions
from reverie_eval.submissions._document import check_value_count

MAX_VALUES = 5_000_000
"""JSON values in an upload: about thirty times as many as in a usual file for the largest split,
and a sixth of the limit outside the server."""

_OTHERS_MAY_READ = 0o077


@dataclass(frozen=True)
class Board:
    """A split: its settings and its ground truth."""

    name: str
    split: Split
    truth: GroundTruth
    public_fingerprint: str
    """Of the bundle without its answers, which participants may have."""

    @property
    def is_private(self) -> bool:
        """Whether only rounded means may leave the server."""
        return self.split.visibility == "private"

    @property
    def signature(self) -> str:
        """Everything that scores depend on, under the current settings."""
        return signature_of(self.truth, find_protocol(self.split.protocol))

    def is_open(self, now: datetime) -> bool:
        """Whether the split accepts submissions at a time."""
        return any(phase.is_open(now) for phase in self.split.phases)

    def read(self, content: bytes) -> PreparedSubmission:
        """Read a submission's JSON text and align it with the split.

        Raises
        ------
        SubmissionError
            Listing all problems; they reveal nothing about the answers.
        """
        reading = PreparedSubmission.of(_predictions(content), self.truth)
        return reading.without_answer_hints() if self.is_private else reading

    def check(self, content: bytes) -> PreparedSubmission:
        """Do what :meth:`read` does, without using the answers."""
        return PreparedSubmission.of(_predictions(content), replace(self.truth, answers=None))

    def score(self, reading: PreparedSubmission) -> Scores:
        """Score a submission by the split's protocol."""
        return reading.score(find_protocol(self.split.protocol))

    def measures_as(self, report: ScoreReport) -> bool:
        """Whether a report was scored with the current ground truth and protocol."""
        return (report.fingerprint, report.protocol) == (
            self.truth.fingerprint,
            self.split.protocol,
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


def _predictions(content: bytes) -> Predictions:
    check_value_count(content, MAX_VALUES)
    return parse_predictions(content)


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
            boards[name] = _load(name, split, path)
        except (GroundTruthError, OSError) as error:
            missing = "; put it there, or make it with `reverie-eval compile`"
            reason = f"{error.strerror}{missing}" if isinstance(error, OSError) else error
            where = f"splits.{name}.bundle"
            problems.append(Problem("no-ground-truth", where, f"{path}: {reason}"))
    if problems:
        raise SettingsError(problems)
    return MappingProxyType(boards)


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


def _load(name: str, split: Split, path: Path) -> Board:
    bundle = Bundle.load(path)
    truth = GroundTruth.from_bundle(bundle, origin=str(path))
    truth.require_answers()
    if truth.split != name:
        raise GroundTruthError(f"this is the ground truth of {truth.split}, not of {name}")
    reason = why_not(find_protocol(split.protocol), truth)
    if reason:
        raise GroundTruthError(reason)
    mode = path.stat().st_mode
    if split.visibility == "private" and mode & _OTHERS_MAY_READ:
        raise GroundTruthError(f"others can read these answers; run `chmod 600 {path}`")
    public_fingerprint = bundle.public().header.fingerprint
    return Board(name, split, replace(truth, origin=name), public_fingerprint)
