"""All that a server stores about a person."""

from datetime import datetime

from pydantic import Field

from reverie_eval.schemas.organising import AttemptReport, AuditReport, PersonReport, TokenReport
from reverie_eval.schemas.report import SplitName
from reverie_eval.schemas.service import Method
from reverie_eval.schemas.wire import Sha256, SubmissionId, TeamName, WireModel


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
    """What they did, and what was done to them."""
