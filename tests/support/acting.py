"""Doing what organisers do, in as few words as a test wants."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from sqlalchemy import select

from reverie_eval.schemas.organising import (
    NewPerson,
    NewReview,
    NewTeam,
    NewToken,
    NewTokenReport,
    ReviewEntry,
    TokenKind,
)
from reverie_eval.schemas.people import NewJoinRequest, NewPersonToJoin
from reverie_eval.schemas.service import Role, Verdict
from reverie_eval.server.accounts import people, tokens
from reverie_eval.server.accounts.joining import receive_request
from reverie_eval.server.audit.log import AuditLog
from reverie_eval.server.audit.signing import Signer
from reverie_eval.server.audit.transactions import Transaction, Transactions
from reverie_eval.server.boards import reviews
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import JoinRequest

NOON = datetime(2026, 3, 2, 12, tzinfo=UTC)
"""When every test begins."""
AUDIT_LOG = AuditLog(Signer(Ed25519PrivateKey.from_private_bytes(bytes(32)), "tests"))


@contextmanager
def acting(database: Database, actor: str = "test") -> Iterator[Transaction]:
    """Change a database that no server has."""
    with Transactions(database, AUDIT_LOG, lambda: NOON).begin(actor) as transaction:
        yield transaction


def ask_to_join(transactions: Transactions, team: str = "Green", *names: str) -> int:
    """Send a request to join, and return its number."""
    people = [NewPersonToJoin(name=name, email=f"{name}@example.org") for name in names or ["Dora"]]
    new = NewJoinRequest(team=team, people=people, institution="Somewhere", purpose="Maps")
    receive_request(transactions, new, are_accepted=True, count=lambda: None)
    with transactions.database.reading() as session:
        return session.scalars(select(JoinRequest.id).order_by(JoinRequest.id.desc())).first() or 0


def add_team(transaction: Transaction, name: str) -> None:
    people.add_team(transaction, NewTeam(name=name))


def add_person(
    transaction: Transaction,
    team: str,
    name: str,
    role: Role = "participant",
    email: str | None = None,
) -> None:
    people.add_person(transaction, NewPerson(team=team, name=name, role=role, email=email))


def create_token(
    transaction: Transaction,
    person: str,
    kind: TokenKind = "access",
    expires_at: datetime | None = None,
) -> NewTokenReport:
    return tokens.create_token(
        transaction, NewToken(person=person, kind=kind, expires_at=expires_at)
    )


def review(
    transaction: Transaction, submission_id: str, verdict: Verdict, reason: str = "checked"
) -> ReviewEntry:
    new = NewReview(submission_id=submission_id, verdict=verdict, reason=reason)
    return reviews.review(transaction, new)
