"""What happened to a submission, as its team reads it: the audit log, in words."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.server.store.tables import AuditEntry

_SWITCHES = {
    ("withdrawn", True): "withdrawn",
    ("withdrawn", False): "restored",
    ("published", True): "published",
    ("published", False): "taken off the leaderboard",
}


@dataclass(frozen=True, slots=True)
class Event:
    """Something that somebody did."""

    at: datetime
    actor: str
    what: str
    why: str
    """Empty if nobody had to say."""


def history(session: Session, submission_id: str) -> Sequence[Event]:
    """Return what happened to a submission, the earliest first."""
    chosen = select(AuditEntry).where(AuditEntry.subject == submission_id).order_by(AuditEntry.id)
    return [_event(entry) for entry in session.scalars(chosen)]


def _event(entry: AuditEntry) -> Event:
    changes = list(_changes(entry.details)) if entry.action == "changed" else []
    what = "; ".join(changes) or entry.action.replace("submitted", "received and scored")
    if entry.action == "review lifted":
        what = f"no longer {entry.details.get('verdict', 'reviewed')}"
    return Event(entry.at, entry.actor, what, str(entry.details.get("reason", "")))


def _changes(details: Mapping[str, Any]) -> Iterator[str]:
    for switch, words in _SWITCHES.items():
        if (switch[0], details.get(switch[0])) == switch:
            yield words
    if "anonymous_until" in details:
        until = details["anonymous_until"]
        yield f"team hidden until {until[:10]}" if until else "team named"
    if details.get("method"):
        said = ", ".join(name.replace("_", " ") for name in details["method"])
        yield f"edited: {said}"
