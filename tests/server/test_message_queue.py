"""Messages to the organiser: whom an event is told, when, how often, and until when."""

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.schemas.service import Phase
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.boards.schedules import Schedules, notify_of_ends, untold_ends
from reverie_eval.server.messages.queue import (
    claim,
    given_up,
    is_any_due,
    notify,
    notify_of_fault,
    settle,
)
from reverie_eval.server.settings import Channel, Mail, Webhook
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Message
from tests.support.acting import AUDIT_LOG, NOON
from tests.support.serving import PRIVATE, adjusted, settings_of

DAILY = Mail(host="x", sender="a@b.org", recipients=("c@b.org",), digest="daily")
HOOK = Webhook.model_validate({"url": "https://b.org", "events": ["phase-end", "unhealthy"]})
OTHERS = Webhook.model_validate({"url": "https://b.org", "events": ["submission"]})
CHANNELS: Mapping[str, Channel] = {"mail": DAILY, "webhook": HOOK}
SECOND, MINUTE, HOUR, DAY = (
    timedelta(**{unit: 1}) for unit in ("seconds", "minutes", "hours", "days")
)


def at(session: Session, now: datetime = NOON) -> Transaction:
    """Return a transaction at a moment."""
    return Transaction(session, "test", now, AUDIT_LOG, CHANNELS)


def rows(session: Session) -> list[tuple[Any, ...]]:
    """Return channel, event, text and path of each message."""
    session.flush()
    columns = (Message.channel, Message.event, Message.text, Message.path)
    return [tuple(row) for row in session.execute(select(*columns).order_by(Message.id))]


def message(**changes: Any) -> Message:
    """Return a message that is due at noon."""
    about = {"channel": "mail", "event": "submission", "text": "", "path": "/", "error": ""}
    return Message(**{**about, "created_at": NOON, "due_at": NOON, "attempts": 0, **changes})


def test_an_event_is_a_message_for_each_channel_that_wants_it(sqlite: Database) -> None:
    with sqlite.writing() as session:
        notify(at(session), "submission", "x" * 501, "/submissions/1")
        notify(at(session), "phase-end", "test ended")
        session.flush()
        found = session.scalars(select(Message).order_by(Message.id)).all()
        assert rows(session) == [
            ("mail", "submission", "x" * 500, "/submissions/1"),
            ("mail", "phase-end", "test ended", "/"),
            ("webhook", "phase-end", "test ended", "/"),
        ]
    midnight = datetime(2026, 3, 3, tzinfo=UTC)
    assert [each.due_at for each in found] == [midnight, midnight, NOON]
    assert {(each.created_at, each.attempts, each.error) for each in found} == {(NOON, 0, "")}
    assert {(each.sent_at, each.given_up_at) for each in found} == {(None, None)}


def test_a_fault_is_told_again_after_an_hour(sqlite: Database) -> None:
    with sqlite.writing() as session:
        notify(at(session), "phase-end", "another event")
        for later, text in ((0 * HOUR, "a"), (HOUR - SECOND, "b"), (HOUR, "c")):
            notify_of_fault(at(session, NOON + later), text)
            session.flush()
        assert rows(session)[2:] == [
            (channel, "unhealthy", text, "/desk") for text in "ac" for channel in CHANNELS
        ]


@pytest.mark.parametrize(
    ("later", "times"),
    [
        pytest.param(SECOND - timedelta(microseconds=1), 0, id="its last second"),
        pytest.param(SECOND, 1, id="just ended"),
        pytest.param(DAY - SECOND, 1, id="a day ago nearly"),
        pytest.param(DAY, 0, id="a day ago"),
    ],
)
def test_the_end_of_a_phase_is_told_for_a_day(
    later: timedelta, times: int, sqlite: Database, made_folder: Path
) -> None:
    phases = (Phase(name="challenge", closes=NOON), Phase(name="next", opens=NOON + HOUR))
    schedules = Schedules(adjusted(settings_of(made_folder), phases=phases).splits)
    text = "the phase challenge of test ended at 2026-03-02 12:00 UTC"
    now = NOON + later
    with sqlite.writing() as session:
        found = untold_ends(session, schedules, CHANNELS, now)
        assert found == ({text: PRIVATE} if times else {})
        assert untold_ends(session, schedules, {"webhook": HOOK}, now) == found
        assert untold_ends(session, schedules, {"webhook": OTHERS}, now) == {}
        notify(at(session), "unhealthy", text)  # no event of a phase
        for _ in range(2):
            notify_of_ends(session, schedules, CHANNELS, now)
        told = [(channel, "phase-end", text, "/splits/test") for channel in CHANNELS]
        assert rows(session)[2:] == times * told


def test_messages_are_claimed_when_they_are_due(sqlite: Database) -> None:
    with sqlite.writing() as session:
        session.add_all(
            [
                message(text="later", due_at=NOON + SECOND),
                message(text="sent", sent_at=NOON),
                message(text="given up", given_up_at=NOON),
                message(text="old", due_at=NOON - 30 * DAY - SECOND, sent_at=NOON),
                message(text="just kept", due_at=NOON - 30 * DAY, sent_at=NOON),
            ]
        )
        assert not is_any_due(session, NOON, "mail")
        session.add_all(
            [message(text="first"), message(text="second", attempts=4, due_at=NOON - SECOND)]
        )
        assert is_any_due(session, NOON, "mail")
        claimed = claim(session, NOON, "mail")
        assert [(each.text, each.attempts) for each in claimed] == [("first", 1), ("second", 5)]
        assert {each.due_at for each in claimed} == {NOON + HOUR}
        kept = [text for _, _, text, _ in rows(session)]
        assert kept == ["later", "sent", "given up", "just kept", "first", "second"]
        assert not is_any_due(session, NOON, "mail")


def test_only_so_many_messages_are_claimed_at_once(sqlite: Database) -> None:
    with sqlite.writing() as session:
        session.add_all(message() for _ in range(201))
        assert [len(claim(session, NOON, "mail")) for _ in range(2)] == [200, 1]


@pytest.mark.parametrize(
    ("attempts", "delay"),
    [(1, MINUTE), (2, 2 * MINUTE), (9, 256 * MINUTE), (10, 6 * HOUR)],
)
def test_each_failure_is_followed_by_a_longer_wait(
    attempts: int, delay: timedelta, sqlite: Database
) -> None:
    with sqlite.writing() as session:
        row = message(attempts=attempts)
        session.add(row)
        settle(session, [row], NOON, "e" * 501)
        assert (row.error, row.due_at, row.sent_at) == ("e" * 500, NOON + delay, None)
        assert row.given_up_at is None


def test_a_message_is_given_up_if_it_would_be_due_after_three_days(sqlite: Database) -> None:
    with sqlite.writing() as session:
        now = NOON + 3 * DAY - 6 * HOUR
        last, late, sent, other, too = mails = [message(attempts=10) for _ in range(5)]
        late.created_at -= SECOND
        other.created_at, other.channel = late.created_at, "webhook"
        session.add_all(mails)
        settle(session, [last, late, other], now, "refused")
        settle(session, [sent, too], now, "")
        assert [each.given_up_at for each in mails] == [None, now, None, now, None]
        assert [each.sent_at for each in mails] == [None, None, now, None, now]
        assert given_up(session) == [("mail", 1, "refused"), ("webhook", 1, "refused")]
