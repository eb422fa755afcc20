"""People of a server: requests to join, files of people to add, what is stored of a person."""

from datetime import datetime

from pydantic import Field, model_validator
from typing_extensions import Self

from reverie_eval.schemas.organising import (
    LONGEST_FILE,
    AttemptReport,
    AuditReport,
    NewPerson,
    NewTokenReport,
    PersonReport,
    TokenReport,
)
from reverie_eval.schemas.report import SplitName
from reverie_eval.schemas.service import Method
from reverie_eval.schemas.wire import Email, Line, Name, Sha256, SubmissionId, TeamName, WireModel

MOST_PEOPLE = 10
"""In one request; more can be added later."""


class NewPersonToJoin(WireModel):
    """A person who asks for an account."""

    name: Name = Field(examples=["Ada"])
    email: Email
    """Where the organiser sends the invitation."""


class NewJoinRequest(WireModel):
    """A request for accounts in a new team or an existing one."""

    team: Name = Field(examples=["Blue"])
    people: list[NewPersonToJoin] = Field(min_length=1, max_length=MOST_PEOPLE)
    institution: Name = Field(examples=["University of Adelaide"])
    purpose: Line = Field("", examples=["We work on agents with a map."])
    """What the accounts are for."""

    @model_validator(mode="after")
    def _has_distinct_names(self) -> Self:
        names = [person.name for person in self.people]
        if len(set(names)) < len(names):
            raise ValueError("each person needs a name of their own")
        return self


class JoinReply(WireModel):
    """The reply to every request to join; it does not reveal who is registered."""

    message: str = Field(examples=["The organiser will answer by e-mail."])


class JoinRequestReport(NewJoinRequest):
    """An open request to join, as organisers see it."""

    id: int = Field(examples=[4])
    team: TeamName
    team_exists: bool
    """Whether accepting it adds the people to an existing team."""
    created_at: datetime


class Rejection(WireModel):
    """Why a request to join is rejected."""

    reason: Line = Field("", examples=["Not a research group."])
    """For the audit log."""


class PersonInvitation(NewTokenReport):
    """An invitation for a person, and the address that it can be sent to."""

    email: Email | None


class AcceptedRequest(WireModel):
    """A request that was accepted, with an invitation for each person, shown only once."""

    team: TeamName
    invitations: list[PersonInvitation]


class NewPeopleImport(WireModel):
    """A file of people to be added."""

    text: str = Field(
        min_length=1,
        max_length=LONGEST_FILE,
        examples=["team,person,email,role\nBlue,Dora,dora@example.org,participant\n"],
    )
    """CSV with the columns team, person, email and role; the last two may be left out."""
    invite: bool = False
    """Return an invitation for each person who is added."""
    dry_run: bool = False
    """Change nothing; only report what would be added."""


class PeopleImportReport(WireModel):
    """The people that an import added, or would add."""

    rows: int = Field(examples=[12])
    """People in the file."""
    teams: list[str] = Field(examples=[["Blue"]])
    """Teams that were added."""
    added: list[NewPerson]
    """In the order of the file."""
    known: int = Field(examples=[1])
    """People who already existed; they stay as they are."""
    invitations: list[PersonInvitation]
    """Shown only once."""


class SubmissionRecord(WireModel):
    """A submission that a person sent; its scores are the team's."""

    id: SubmissionId
    split: SplitName
    team: TeamName
    sha256: Sha256
    size: int = Field(examples=[4_204_511])
    """Bytes of the file."""
    received_at: datetime
    published_at: datetime | None
    withdrawn_at: datetime | None
    method: Method


class SessionRecord(WireModel):
    """A browser session."""

    created_at: datetime
    expires_at: datetime


class PersonalData(WireModel):
    """All that the server stores about a person, the oldest first."""

    person: PersonReport
    tokens: list[TokenReport]
    sessions: list[SessionRecord]
    submissions: list[SubmissionRecord]
    attempts: list[AttemptReport]
    """Uploads with their outcomes, of the last 90 days."""
    audit: list[AuditReport]
    """Entries of the audit log: what the person did, and what others did to their account."""
