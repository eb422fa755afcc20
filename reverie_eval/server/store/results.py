"""The results of a submission as they are stored: one on each leaderboard of its split.

The split's main leaderboard has the name "". On another leaderboard, a submission that was
received before the leaderboard was added has no result until it is scored again.
"""

from collections.abc import Mapping

from sqlalchemy import ColumnElement

from reverie_eval.schemas.organising import AttemptReport
from reverie_eval.schemas.service import BoardResult, Method, ScoredSubmission
from reverie_eval.server.store.tables import Attempt, Submission, read_stored


def results_of(row: Submission) -> Mapping[str, BoardResult]:
    """Return all results of a submission by leaderboard, that on the split's main one first."""
    own = {"report": row.report, "receipt": row.receipt, "earlier": row.earlier}
    return {
        name: read_stored(BoardResult, stored) for name, stored in {"": own, **row.boards}.items()
    }


def scored_submission(row: Submission) -> ScoredSubmission:
    """Return everything stored about a submission, including what its team may not see yet."""
    boards = dict(results_of(row))
    own = boards.pop("")
    return row.as_report(
        ScoredSubmission,
        team=row.team.name,
        person=row.person.name,
        method=read_stored(Method, row.method),
        **dict(own),
        boards=boards,
        scores_held_until=None,
    )


def store_result(row: Submission, name: str, result: BoardResult) -> None:
    """Store a submission's result on a leaderboard, in place of an earlier one."""
    stored = result.model_dump(mode="json")
    if name:
        row.boards = {**row.boards, name: stored}
    else:
        row.report, row.receipt = stored["report"], stored["receipt"]
        row.earlier = stored["earlier"]


def stored_in_report(name: str, field: str) -> ColumnElement[str | None]:
    """Return a field of a leaderboard's reports for an SQL statement; NULL without a result."""
    found: ColumnElement[str | None] = (
        Submission.boards[(name, "report", field)] if name else Submission.report[field]
    ).as_string()
    return found


def attempt_report(attempt: Attempt) -> AttemptReport:
    """Return what organisers see of an upload."""
    person = attempt.person
    return attempt.as_report(AttemptReport, person=person.name, team=person.team.name)
