"""What the organiser and the server say to each other."""

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field

from reverie_eval.schemas.wire import Instant, Name, Said


class NewTeam(Said):
    """A team to be added."""

    name: Name


class TeamReport(Said):
    """Who submits together and shares a quota."""

    name: str
    people: list[str]
    created_at: datetime


class NewPerson(Said):
    """A person to be added to a team."""

    team: Name
    name: Name
    role: Literal["participant", "organiser"] = "participant"


class PersonReport(Said):
    """Somebody in a team."""

    name: str
    team: str
    role: Literal["participant", "organiser"]
    created_at: datetime


class NewToken(Said):
    """A token to be made for somebody."""

    person: Name
    kind: Literal["access", "invite"] = "invite"
    """An invitation is turned into a token of access once, by whoever has it."""
    expires_at: Instant | None = None


class TokenReport(Said):
    """What is known of a token; the token itself is not."""

    hint: str
    """Its first letters."""
    kind: Literal["access", "invite"]
    person: str
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    """When it was revoked, or when an invitation was used."""


class MintedReport(TokenReport):
    """A token that was made, shown this once."""

    token: str


class NewGrant(Said):
    """Further submissions for a team, and why."""

    team: Name
    split: str
    extra: Annotated[int, Field(ge=1, le=10_000)]
    """By which each limit is raised, the team's and each person's in it."""
    reason: Annotated[str, Field(min_length=1, max_length=500)]
    """For the audit log; a line."""
    expires_at: Instant


class GrantReport(Said):
    """Further submissions that a team was given."""

    team: str
    split: str
    extra: int
    reason: str
    created_at: datetime
    expires_at: datetime


class AuditReport(Said):
    """What somebody did; each entry's digest covers the one before."""

    id: int
    at: datetime
    actor: str
    action: str
    subject: str
    details: dict[str, Any]
    previous: str
    digest: str
