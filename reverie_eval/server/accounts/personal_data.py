"""A person's data: all of it in one report, and its deletion.

The audit log refers to persons by number, so deleting a name changes nothing in it, and the doctor
finds the log unbroken. Results, and the log of what the person did, stay under a neutral name.
"""

from sqlalchemy import delete, or_, select
from sqlalchemy.orm import Session, lazyload

from reverie_eval.schemas.organising import PersonReport
from reverie_eval.schemas.people import PersonalData, SessionRecord, SubmissionRecord
from reverie_eval.schemas.service import Method
from reverie_eval.server.accounts.people import find_person, organisers, person_report
from reverie_eval.server.accounts.tokens import revoke_all, token_report
from reverie_eval.server.audit.log import audit_reports, entries, row_name
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import ConflictError
from reverie_eval.server.store.tables import (
    Attempt,
    AuditEntry,
    BrowserSession,
    Message,
    Person,
    Submission,
    Token,
    read_stored,
)


def personal_data(session: Session, person_id: int, organiser: str) -> PersonalData:
    """Return everything stored about a person; raise NotFoundError if there is no such person.

    It may be sent to them, so what others did has the public name of the organiser.
    """
    rows = session.execute(
        select(Person, Token, BrowserSession)
        .outerjoin(Token, Token.person_id == Person.id)
        .outerjoin(BrowserSession, BrowserSession.token_id == Token.id)
        .where(Person.id == person_id)
        .order_by(Token.id)
        # The rows have both already, so reading them takes no statement.
        .options(lazyload(Token.person), lazyload(BrowserSession.token))
    ).all()
    person = find_person(session, person_id)
    tokens = dict.fromkeys(row.Token for row in rows if row.Token is not None)
    sessions = [row.BrowserSession for row in rows if row.BrowserSession is not None]
    submissions = select(Submission).where(Submission.person_id == person.id)
    attempts = select(Attempt).where(Attempt.person_id == person.id).order_by(Attempt.id)
    name = row_name(person)
    logged = entries(session, or_(AuditEntry.actor == name, AuditEntry.subject == name))
    return PersonalData(
        person=person_report(person),
        tokens=list(map(token_report, tokens)),
        sessions=[
            read_stored(SessionRecord, row)
            for row in sorted(sessions, key=lambda each: each.created_at)
        ],
        submissions=[
            _submission_record(row)
            for row in session.scalars(submissions.order_by(Submission.received_at))
        ],
        attempts=list(map(Attempt.as_seen, session.scalars(attempts))),
        audit=[
            each
            if each.actor_row == name
            else each.model_copy(update={"actor": organiser, "actor_row": ""})
            for each in audit_reports(session, logged)
        ],
    )


def delete_person(transaction: Transaction, person_id: int) -> PersonReport:
    """Replace a person's name with a neutral one, remove their address, and revoke their tokens.

    Results and the audit log stay.

    Raises
    ------
    NotFoundError
        If there is no such person, or they were deleted before.
    ConflictError
        If they are the only organiser.
    """
    session = transaction.session
    person = find_person(session, person_id)
    if organisers(session) == [person]:
        raise ConflictError(
            f"{person.name} is the only organiser; first add another, and create a token for them"
        )
    revoke_all(transaction, person)
    owned = select(Token.id).where(Token.person_id == person.id)
    session.execute(delete(BrowserSession).where(BrowserSession.token_id.in_(owned)))
    old_name, person.name = person.name, f"deleted person {person.id}"
    person.email = None
    person.deleted_at = transaction.now
    # Messages about submissions name the person in brackets.
    for message in session.scalars(select(Message).where(Message.path.startswith("/submissions/"))):
        message.text = message.text.replace(f"({old_name})", f"({person.name})")
    transaction.record("person deleted", person, person)
    return person_report(person)


def _submission_record(row: Submission) -> SubmissionRecord:
    method = read_stored(Method, row.method)
    return row.as_report(SubmissionRecord, team=row.team.name, method=method)
