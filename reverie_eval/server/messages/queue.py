"""Messages to the organiser, by mail and to a webhook.

An event is written as a row for each channel, in the transaction that it is about, so a message is
sent if and only if the event happened. A job for each channel sends the messages: a mail server
that is slow or dead delays nothing. It claims rows before it sends them, so if several servers use
a database, only one sends each. If that server is killed meanwhile, the row is claimed again later,
so a message may arrive twice, but is not lost.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, Select, delete, func, or_, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from reverie_eval.server.audit.log import SERVER
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import RequestError
from reverie_eval.server.settings import Channel, Event
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.database import count_rows
from reverie_eval.server.store.tables import Message

LEASE = timedelta(hours=1)
"""How long other servers leave a claimed message alone."""
PATIENCE = timedelta(days=3)
"""How long a message is retried before it is given up."""
KEPT = timedelta(days=30)
"""How long messages stay in the database after they were sent or given up."""
_FIRST_DELAY = timedelta(minutes=1)
_LONGEST_DELAY = timedelta(hours=6)
_QUIET = timedelta(hours=1)
"""How long a fault is not reported again."""
_AT_ONCE = 200
_LONGEST_LINE = 500


def notify(transaction: Transaction, event: Event, text: str, path: str = "/") -> None:
    """Notify the organiser of an event, if the settings say so and the transaction is committed.

    ``text`` is one line for the organiser, without scores and tokens; ``path`` is the page of the
    server that has more about it.
    """
    messages = messages_of(transaction.channels, transaction.now, event, text, path)
    transaction.session.add_all(messages)


def notify_of_fault(transaction: Transaction, text: str) -> None:
    """Notify the organiser that the server is unhealthy, at most once an hour."""
    recent = select(Message.id).where(
        Message.event == "unhealthy", Message.created_at > transaction.now - _QUIET
    )
    if transaction.session.scalars(recent.limit(1)).first() is None:
        notify(transaction, "unhealthy", text, "/desk")


def tell_fault(server: ServerState, text: str) -> None:
    """Notify the organiser of a fault, unless the fault prevents it, or no channel is set up."""
    if not server.settings.channels:
        return
    with (
        suppress(SQLAlchemyError, RequestError),
        server.transactions.begin(SERVER) as transaction,
    ):
        notify_of_fault(transaction, text)


def is_any_due(session: Session, now: datetime, channel: str) -> bool:
    """Whether a message has to be sent through a channel now."""
    return session.scalars(_due(now, channel).limit(1)).first() is not None


def claim(session: Session, now: datetime, channel: str) -> Sequence[Message]:
    """Return messages that the caller has to send now, the earliest first, and delete old ones."""
    is_done = or_(Message.sent_at.is_not(None), Message.given_up_at.is_not(None))
    session.execute(delete(Message).where(is_done, Message.due_at < now - KEPT))
    messages = session.scalars(_due(now, channel).order_by(Message.id).limit(_AT_ONCE)).all()
    for message in messages:
        message.attempts += 1
        message.due_at = now + LEASE
    return messages


def settle(session: Session, messages: Sequence[Message], now: datetime, error: str) -> None:
    """Record that messages were sent, or why not; in that case, retry later or give up."""
    for message in messages:
        row = session.merge(message)
        if not error:
            row.sent_at = now
            continue
        row.error = error[:_LONGEST_LINE]
        row.due_at = now + min(_FIRST_DELAY * 2 ** (row.attempts - 1), _LONGEST_DELAY)
        if row.due_at - row.created_at > PATIENCE:
            row.given_up_at = now


def unsent_errors(session: Session, channel: str) -> Sequence[str]:
    """Return why messages could not be sent that are still tried, the earliest first."""
    chosen = select(Message.error).where(*_is_unsent(channel), Message.error != "")
    return session.scalars(chosen.order_by(Message.id)).all()


def backlog_of(channel: str, session: Session, _: datetime) -> Mapping[str, int]:
    """Count the messages of a channel that wait, and those that were given up."""
    is_given_up = Message.channel == channel, Message.given_up_at.is_not(None)
    return {
        "waiting": count_rows(session, Message, *_is_unsent(channel)),
        "given_up": count_rows(session, Message, *is_given_up),
    }


def given_up(session: Session) -> Sequence[tuple[str, int, str]]:
    """Count the messages that could not be sent: channel, number, an error."""
    chosen = select(Message.channel, func.count(), func.max(Message.error))
    rows = session.execute(chosen.where(Message.given_up_at.is_not(None)).group_by(Message.channel))
    return [(channel, number, error) for channel, number, error in rows]


def messages_of(
    channels: Mapping[str, Channel], now: datetime, event: Event, text: str, path: str
) -> Iterator[Message]:
    """Yield a message for each channel that reports an event of this kind."""
    for name, channel in channels.items():
        if channel.wants(event):
            yield Message(
                channel=name,
                event=event,
                text=text[:_LONGEST_LINE],
                path=path,
                created_at=now,
                due_at=channel.due(now),
                attempts=0,
                error="",
            )


def _due(now: datetime, channel: str) -> Select[Message]:
    return select(Message).where(*_is_unsent(channel), Message.due_at <= now)


def _is_unsent(channel: str) -> Sequence[ColumnElement[bool]]:
    return Message.channel == channel, Message.sent_at.is_(None), Message.given_up_at.is_(None)
