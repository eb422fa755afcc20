"""Scores that are held back until a phase ends.

They are computed and stored when a submission arrives, as usual. Until they are released, nothing
that leaves the server contains them, including the receipt, which is signed without scores each
time. If a phase is extended before it ends, scores are held back until its new end. Scores that
were shown stay visible.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Self, TypeVar

from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import BoardResult, Receipt, ScoredSubmission
from reverie_eval.server.audit.receipts import Signer, read_as
from reverie_eval.server.boards.schedules import Schedules, Timetable
from reverie_eval.server.state import Reading
from reverie_eval.server.store.results import results_of, scored_submission
from reverie_eval.server.store.tables import Submission, read_stored

Result = TypeVar("Result", BoardResult, ScoredSubmission)


@dataclass(frozen=True, slots=True)
class View:
    """What may be seen of submissions at a moment: no scores that are held back."""

    timetables: Mapping[str, Timetable]
    signer: Signer
    now: datetime

    @classmethod
    def of(cls, reading: Reading) -> Self:
        """Return what may be seen in a reading of the database."""
        server = reading.server
        timetables = server.get(Schedules).read(reading.session)
        return cls(timetables, server.signer, reading.now)

    def held_until(self, row: Submission) -> datetime | None:
        """Return the last second in which a submission's scores are held back, if they are now."""
        timetable = self.timetables.get(row.split)
        if timetable is None:
            return None
        return timetable.held_until(row.received_at, row.scored_at, self.now)

    def score_report(self, row: Submission) -> ScoreReport:
        """Return a submission's report, with its scores unless they are held back."""
        known = read_stored(ScoreReport, row.report)
        return known if self.held_until(row) is None else without_scores(known)

    def report(self, row: Submission) -> ScoredSubmission:
        """Return a submission as its team may see it."""
        known, until = scored_submission(row), self.held_until(row)
        if until is None:
            return known
        held = {"boards": self.boards(row), "scores_held_until": until}
        return self._withheld(known).model_copy(update=held)

    def boards(self, row: Submission) -> Mapping[str, BoardResult]:
        """Return a submission's results on other leaderboards, unless scores are held back."""
        known = {name: result for name, result in results_of(row).items() if name}
        if self.held_until(row) is None:
            return known
        return {name: self._withheld(result) for name, result in known.items()}

    def _withheld(self, result: Result) -> Result:
        """Return a result, or a submission with its own result, without scores."""
        known = read_as(Receipt, result.receipt)
        receipt = self.signer.sign(known.model_copy(update={"scores": {}}))
        held = {"report": without_scores(result.report), "receipt": receipt, "earlier": []}
        return result.model_copy(update=held)


def without_scores(report: ScoreReport) -> ScoreReport:
    """Return a private split's report without its scores."""
    return report.model_copy(update={"scores": {}})
