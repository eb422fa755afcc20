"""Messages between organisers and the server."""

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field

from reverie_eval.schemas.service import Method, PublicReview, Role, Verdict
from reverie_eval.schemas.wire import Https, Instant, Line, Name, Reason, WireModel

TokenKind = Literal["access", "invite"]


class NewTeam(WireModel):
    """A team to be added."""

    name: Name


class TeamReport(WireModel):
    """People who submit together and share a quota."""

    name: str
    people: list[str]
    created_at: datetime


class NewPerson(WireModel):
    """A person to be added to a team."""

    team: Name
    name: Name
    role: Role = "participant"


class PersonReport(WireModel):
    """A person in a team."""

    name: str
    team: str
    role: Role
    created_at: datetime


class NewToken(WireModel):
    """A token to be created for a person."""

    person: Name
    kind: TokenKind = "invite"
    """An invitation can be exchanged for an access token once, by anyone who has it."""
    expires_at: Instant | None = None


class TokenReport(WireModel):
    """What the server knows about a token, without the token itself."""

    hint: str
    """Its first letters."""
    kind: TokenKind
    person: str
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    """When it was revoked, or when an invitation was used."""


class NewTokenReport(TokenReport):
    """A new token, shown only this once."""

    token: str


MOST_EXTRA = 10_000
"""Further submissions in one grant: more than any quota, and no more than a database can count."""


class NewGrant(WireModel):
    """Further submissions for a team, and why."""

    team: Name
    split: str
    extra: Annotated[int, Field(ge=1, le=MOST_EXTRA)]
    """By how much each limit is raised, the team's and that of each person in it."""
    reason: Reason
    """For the audit log; one line."""
    expires_at: Instant


class GrantReport(WireModel):
    """Further submissions that a team was given."""

    team: str
    split: str
    extra: int
    reason: str
    created_at: datetime
    expires_at: datetime


class AuditReport(WireModel):
    """An entry of the audit log; each digest covers the entry and the digest before it."""

    id: int
    at: datetime
    actor: str
    action: str
    row: str
    """What it was done to, for programs: `team:3`."""
    subject: str
    """What people called it then."""
    details: dict[str, Any]
    previous: str
    digest: str


class NewReview(WireModel):
    """A public verdict on a submission."""

    submission_id: Annotated[str, Field(max_length=32)]
    verdict: Verdict
    """Verified, flagged and disqualified replace each other; baseline is independent of them."""
    reason: Reason
    """Public; one line."""


class ReviewEntry(PublicReview):
    """A verdict on a submission, lifted or not."""

    id: int
    submission_id: str
    lifted_at: datetime | None


class NewReported(WireModel):
    """A result that a paper reports, for the leaderboard of a split."""

    split: str
    method: Method
    team: Name
    """Who reports it, as shown on the leaderboard."""
    scores: Annotated[dict[str, float], Field(min_length=1)]
    """By metric key: fractions from 0 to 1, or metres."""
    source: Https


class ReportedEntry(WireModel):
    """A result that a paper reports and no server has scored."""

    id: int
    split: str
    method: Method
    team: str
    scores: dict[str, float]
    source: str
    added_by: str
    created_at: datetime


class NewNotice(WireModel):
    """A message to everyone, and whether submissions are paused."""

    banner: Line = ""
    """One line; if empty, the banner in the settings is shown."""
    paused: bool = False


class NoticeReport(WireModel):
    """The current message to everyone: the settings' own if nothing was posted."""

    banner: str
    paused: bool
    """Also true if the settings say so, whatever was posted."""
    posted_by: str | None
    """Null if only the settings apply."""
    created_at: datetime | None


class AttemptReport(WireModel):
    """An upload and its outcome."""

    id: int
    at: datetime
    person: str
    team: str
    split: str
    outcome: str
    """`scored`, `repeat`, or the code of the problem."""
    problems: int
    """Number of problems in the file."""
    size: int
    """Bytes; after unpacking, if the server got that far."""
    milliseconds: int
