"""Telling the organiser that a phase has ended."""

from collections.abc import Mapping
from datetime import datetime, timedelta
from urllib.parse import quote

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.messages.outbox import messages_of
from reverie_eval.server.settings import Channel
from reverie_eval.server.store.tables import Message

RECENT = timedelta(days=1)
"""How long after a phase a server that was off at its end still announces the end."""


def untold_ends(
    session: Session, schedules: Schedules, channels: Mapping[str, Channel], now: datetime
) -> Mapping[str, str]:
    """Return the messages about phases that ended in the last day, each with its split.

    No transaction announces the end of a phase, because nothing is written when it passes.
    """
    if not any(channel.wants("phase-end") for channel in channels.values()):
        return {}
    ends = {
        f"the phase {phase.name} of {split} ended at {phase.closes:%Y-%m-%d %H:%M} UTC": split
        for split, schedule in schedules.in_effect(session).items()
        for phase in schedule.phases
        if phase.closes is not None and phase.closes < now.replace(microsecond=0)
        if now - phase.closes < RECENT
    }
    told = select(Message.text).where(Message.event == "phase-end", Message.text.in_(ends))
    known = set(session.scalars(told))
    return {text: split for text, split in ends.items() if text not in known}


def notify_of_ends(
    session: Session, schedules: Schedules, channels: Mapping[str, Channel], now: datetime
) -> None:
    """Notify the organiser of phases that have ended."""
    for text, split in untold_ends(session, schedules, channels, now).items():
        path = f"/boards/{quote(split)}"
        session.add_all(messages_of(channels, now, "phase-end", text, path))
    session.flush()
