"""Requests to join: anyone may send one, and an organiser accepts or rejects it.

Receiving one reveals nothing about teams and people, and stores little: identical requests are
stored once, texts have bounded lengths, and the number of open requests is limited. Once a request
is answered, its names, addresses and texts are removed.
"""

import hashlib
from collections.abc import Callable, Iterable, Sequence

import msgspec
from sqlalchemy import exists, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import NewPerson, NewTeam, NewToken
from reverie_eval.schemas.people import (
    AcceptedRequest,
    JoinReply,
    JoinRequestReport,
    NewJoinRequest,
    PersonInvitation,
    Rejection,
)
from reverie_eval.server.accounts import people
from reverie_eval.server.accounts.tokens import create_token
from reverie_eval.server.audit.transactions import Transaction, Transactions
from reverie_eval.server.errors import ConflictError, NotAllowedError, NotFoundError
from reverie_eval.server.messages.queue import notify
from reverie_eval.server.store.database import count_rows
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import Decision, JoinRequest, name_key
from reverie_eval.text import count_text

MOST_OPEN = 200
"""Requests that may wait for an answer, at most."""
_STRANGER = ""
"""The actor who sends a request: nobody that the server knows."""
RECEIVED = JoinReply(message="Your request was received. The organiser will answer by e-mail.")


def receive_request(
    transactions: Transactions,
    new: NewJoinRequest,
    *,
    are_accepted: bool,
    count: Callable[[], None],
) -> JoinReply:
    """Store a request for the organiser; repeating the same request changes nothing.

    ``count`` is called before a request is stored, and may refuse it. The audit log has no entry
    about a request before it is answered, so that strangers cannot fill the log.

    Raises
    ------
    NotAllowedError
        If this server does not accept requests.
    ConflictError
        If too many wait for an answer.
    """
    if not are_accepted:
        raise NotAllowedError(
            "this server does not accept requests to join; write to the organiser"
        )
    content = new.model_dump()
    digest = hashlib.sha256(msgspec.json.encode(content)).hexdigest()
    with transactions.begin(_STRANGER) as transaction:
        session = transaction.session
        if session.scalar(select(exists().where(_IS_OPEN, JoinRequest.digest == digest))):
            return RECEIVED
        if count_open(session) >= MOST_OPEN:
            raise ConflictError("too many requests to join are waiting; try again next week")
        count()
        session.add(JoinRequest(**content, digest=digest, created_at=transaction.now))
        who = count_text(len(new.people), "person", "people")
        text = f"{who} of {new.institution} asked to join as {new.team}"
        notify(transaction, "join-request", text, "/desk/requests")
    return RECEIVED


def list_requests(session: Session, page: Page) -> Listed[JoinRequestReport]:
    """List the open requests, the earliest first."""
    requests = select(JoinRequest).where(_IS_OPEN)

    names = people.names_by_key(session)

    def report(row: JoinRequest) -> JoinRequestReport:
        known = names.get(name_key(row.team))
        about = {"team": known or row.team, "team_exists": known is not None}
        return row.as_report(JoinRequestReport, **about)

    return list_page(session, requests, JoinRequest.id, page, report)


def count_open(session: Session) -> int:
    """Return the number of requests that wait for an answer."""
    return count_rows(session, JoinRequest, _IS_OPEN)


def accept_request(transaction: Transaction, request_id: int) -> AcceptedRequest:
    """Add the people of a request to its team, and the team if it is new.

    Strangers cannot know how a team writes its name, so one that looks the same is meant.

    Returns an invitation for each, with the address that it can be sent to.

    Raises
    ------
    NotFoundError
        If there is no such open request.
    ConflictError
        If the team already has a person with one of these names.
    """
    request = _open_request(transaction.session, request_id)
    known = people.same_name(transaction.session, request.team)
    team = request.team if known is None else known.name
    if known is None:
        people.add_team(transaction, NewTeam(name=team))
    invitations = []
    for asking in request.people:
        new = NewPerson(team=team, name=asking["name"], email=asking["email"])
        people.add_person(transaction, new)
        invitations.append(invite(transaction, new))
    _answer(transaction, request, "request accepted", people=len(invitations))
    return AcceptedRequest(team=team, invitations=invitations)


def accept_requests(
    transaction: Transaction, request_ids: Iterable[int]
) -> Sequence[AcceptedRequest]:
    """Accept several requests, as :func:`accept_request` does; after an error, none is accepted."""
    return [accept_request(transaction, each) for each in dict.fromkeys(request_ids)]


def reject_request(transaction: Transaction, request_id: int, rejection: Rejection) -> None:
    """Reject a request. Raises NotFoundError if there is no such open request."""
    request = _open_request(transaction.session, request_id)
    _answer(transaction, request, "request rejected", reason=rejection.reason)


def reject_requests(
    transaction: Transaction, request_ids: Iterable[int], rejection: Rejection
) -> None:
    """Reject several requests; if one is unknown, none is rejected."""
    for each in dict.fromkeys(request_ids):
        reject_request(transaction, each, rejection)


def invite(transaction: Transaction, person: NewPerson) -> PersonInvitation:
    """Create an invitation for a person who was just added."""
    new = NewToken(person=person.name, team=person.team, kind="invite")
    created = create_token(transaction, new)
    return PersonInvitation(**created.model_dump(), email=person.email)


def _open_request(session: Session, request_id: int) -> JoinRequest:
    request = session.get(JoinRequest, request_id)
    if request is None or request.decision is not None:
        raise NotFoundError(
            f"there is no open request number {request_id}; see the list of requests"
        )
    return request


def _answer(
    transaction: Transaction, request: JoinRequest, decision: Decision, **details: object
) -> None:
    """Log an answer, and remove the data that is no longer needed."""
    request.decision, request.decided_at = decision, transaction.now
    request.people, request.institution, request.purpose = [], "", ""
    transaction.record(decision, request, request.team, **details)


_IS_OPEN = JoinRequest.decision.is_(None)
