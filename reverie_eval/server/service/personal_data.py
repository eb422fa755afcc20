"""A person's data: all of it in one report, and its deletion.

The audit log refers to persons by number, so deleting a name changes nothing in it, and the doctor
finds the log unbroken. Results, and the log of what the person did, stay under a neutral name.
"""

from sqlalchemy import delete, or_, select, update
from sqlalchemy.orm import Session, lazyload

from reverie_eval.schemas.organising import PersonReport
from reverie_eval.schemas.personal_data import PersonalData, SessionRecord, SubmissionRecord
from reverie_eval.schemas.service import Method
from reverie_eval.server.errors import ConflictError
from reverie_eval.server.service.attempts import attempt_report
from reverie_eval.server.service.audit import audit_reports, entries, row_name
from reverie_eval.server.service.people import find_person, organisers, person_report
from reverie_eval.server.service.tokens import revoke_all, token_report
from reverie_eval.server.service.transactions import Transaction
from reverie_eval.server.store.tables import (
    Attempt,
    AuditEntry,
    BrowserSession,
    Message,
    News,
    Notice,
    Person,
    ReportedResult,
    Review,
    SetSchedule,
    Submission,
    Token,
)

_SIGNATURES = (
    Review.reviewer,
    ReportedResult.added_by,
    Notice.posted_by,
    News.posted_by,
    SetSchedule.set_by,
)
"""Columns with the name of the organiser who wrote a row."""


def personal_data(session: Session, person_id: int) -> PersonalData:
    """Return everything stored about a person; raise NotFoundError if there is no such person."""
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
            SessionRecord.model_validate(row)
            for row in sorted(sessions, key=lambda each: each.created_at)
        ],
        submissions=[
            _submission_record(row)
            for row in session.scalars(submissions.order_by(Submission.received_at))
        ],
        attempts=list(map(attempt_report, session.scalars(attempts))),
        audit=audit_reports(session, logged),
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
    _sign_anew(session, person)
    # Messages about submissions name the person in brackets.
    for message in session.scalars(select(Message).where(Message.path.startswith("/submissions/"))):
        message.text = message.text.replace(f"({old_name})", f"({person.name})")
    name = transaction.audit_log.name_digest(person)
    transaction.record("person deleted", person, person, name_digest=name)
    return person_report(person)


def _sign_anew(session: Session, person: Person) -> None:
    """Put a person's current name on the rows that they wrote, according to the audit log."""
    for signature in _SIGNATURES:
        table = signature.class_
        rows = AuditEntry.row.startswith(f"{table.__tablename__}:", autoescape=True)
        written = select(AuditEntry.row).where(AuditEntry.actor == row_name(person), rows)
        numbers = {int(row.partition(":")[2]) for row in session.scalars(written)}
        changed = update(table).where(table.id.in_(numbers)).values({signature: person.name})
        session.execute(changed, execution_options={"synchronize_session": False})


def _submission_record(row: Submission) -> SubmissionRecord:
    method = Method.model_validate(row.method)
    return row.as_report(SubmissionRecord, team=row.team.name, method=method)
