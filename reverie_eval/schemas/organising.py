"""What the organiser and the server say to each other."""

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field

from reverie_eval.schemas.service import Method, PublicReview
from reverie_eval.schemas.wire import LONGEST_LINE, Https, Instant, Name, Said


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


MOST_EXTRA = 10_000
"""Further submissions in one grant: more than any quota, and no more than a database can count."""


class NewGrant(Said):
    """Further submissions for a team, and why."""

    team: Name
    split: str
    extra: Annotated[int, Field(ge=1, le=MOST_EXTRA)]
    """By which each limit is raised, the team's and each person's in it."""
    reason: Annotated[str, Field(min_length=1, max_length=LONGEST_LINE)]
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


class NewReview(Said):
    """Something to be said of a submission, for everybody to read."""

    submission_id: Annotated[str, Field(max_length=32)]
    verdict: Literal["verified", "baseline", "flagged", "disqualified"]
    """Verified, flagged and disqualified take each other's place; baseline stands beside them."""
    reason: Annotated[str, Field(min_length=1, max_length=LONGEST_LINE)]
    """Public; a line."""


class ReviewEntry(PublicReview):
    """What was said of a submission, lifted or not."""

    id: int
    submission_id: str
    lifted_at: datetime | None


class NewReported(Said):
    """A result that a paper reports, for the board of a split."""

    split: str
    method: Method
    team: Name
    """Who reports it, as the board is to call them."""
    scores: Annotated[dict[str, float], Field(min_length=1)]
    """By the keys of metrics: fractions from 0 to 1, and metres."""
    source: Https


class ReportedEntry(Said):
    """A result that a paper reports and no server has scored."""

    id: int
    split: str
    method: Method
    team: str
    scores: dict[str, float]
    source: str
    added_by: str
    created_at: datetime


class NewNotice(Said):
    """What is to be said to everybody, and whether submissions are taken."""

    banner: Annotated[str, Field(max_length=500)] = ""
    """A line; empty for the settings' own."""
    paused: bool = False


class NoticeReport(Said):
    """What is said to everybody now, the settings' own where nothing was posted."""

    banner: str
    paused: bool
    """Also while the settings say so, whatever was posted."""
    posted_by: str | None
    """Null while the settings alone hold."""
    created_at: datetime | None


class AttemptReport(Said):
    """An upload and what it came to."""

    id: int
    at: datetime
    person: str
    team: str
    split: str
    outcome: str
    """`scored`, `repeat`, or the code of the problem."""
    problems: int
    """How many there were with the file."""
    size: int
    """Bytes, unpacked if it came to that."""
    milliseconds: int
