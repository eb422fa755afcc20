"""Merging two teams, as if they had always been one.

A team that was merged stays as a row, because receipts and the audit log have its name. The audit
log also has the ids of all rows that moved; of a great many, their number and digest.
"""

import hashlib
from collections.abc import Mapping, Sequence

from sqlalchemy import Update, select, update
from sqlalchemy.orm import Session, aliased

from reverie_eval.schemas.organising import MergeReport, NewMerge
from reverie_eval.server.accounts.people import team_named
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import ConflictError
from reverie_eval.server.store.tables import Grant, Person, Submission, Team

_MOVED = (Person, Submission, Grant)
"""The tables whose rows belong to a team."""
MOST_LISTED = 200
"""Rows of a table that the entry of a merge lists, at most."""


def merge_teams(transaction: Transaction, new: NewMerge) -> MergeReport:
    """Give one team's people, submissions and grants to another.

    Quotas count the submissions of both from then on. If both have submitted the same file, only
    the earlier submission counts. Receipts keep the name under which they were signed.

    Raises
    ------
    NotFoundError
        If there is no such team.
    ConflictError
        If the teams are the same, or have people with the same name.
    """
    session = transaction.session
    team, into = team_named(session, new.team), team_named(session, new.into)
    if team is into:
        raise ConflictError("a team cannot be merged into itself; name two teams")
    _check_names(team, into)
    ids = {
        table.__tablename__: session.scalars(
            select(table.id).where(table.team_id == team.id).order_by(table.id)
        ).all()
        for table in _MOVED
    }
    marked = _mark_repeats(session, team, into)
    report = MergeReport(
        team=team.name,
        into=into.name,
        people=sum(person.deleted_at is None for person in team.people),
        submissions=len(ids[Submission.__tablename__]),
        repeats=len(marked),
    )
    for table in _MOVED:
        _run(session, update(table).where(table.team_id == team.id).values(team_id=into.id))
    session.expire_all()
    team.merged_into, team.merged_at = into, transaction.now
    transaction.record(
        "team merged",
        team,
        report.team,
        **report.model_dump(exclude={"team"}),
        moved={name: _listed(rows) for name, rows in ids.items() if rows},
        marked=_listed(marked),
    )
    return report


def _listed(ids: Sequence[object]) -> Sequence[object] | Mapping[str, object]:
    """Return ids for the audit log: all, or the number and the digest of very many."""
    if len(ids) <= MOST_LISTED:
        return ids
    digest = hashlib.sha256("\n".join(map(str, ids)).encode()).hexdigest()
    return {"number": len(ids), "sha256": digest}


def _check_names(team: Team, into: Team) -> None:
    shared = {person.name for person in team.people} & {person.name for person in into.people}
    if shared:
        names = ", ".join(map(repr, sorted(shared)))
        raise ConflictError(f"both teams have a person called {names}; rename one of them first")


def _mark_repeats(session: Session, team: Team, into: Team) -> Sequence[str]:
    """Mark the later of two submissions of each file that both teams have; return the marked."""
    first, second = aliased(Submission), aliased(Submission)
    pairs = session.execute(
        select(first.id, first.received_at, second.id, second.received_at)
        .join(second, (first.split == second.split) & (first.sha256 == second.sha256))
        .where(first.team_id == into.id, first.repeat == "")
        .where(second.team_id == team.id, second.repeat == "")
    ).all()
    marked = sorted(
        brought if known_at <= brought_at else known
        for known, known_at, brought, brought_at in pairs
    )
    for later in marked:
        _run(session, update(Submission).where(Submission.id == later).values(repeat=later))
    return marked


def _run(session: Session, statement: Update) -> None:
    session.execute(statement, execution_options={"synchronize_session": False})
