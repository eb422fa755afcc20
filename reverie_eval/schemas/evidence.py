"""Evidence about submissions, for organisers: numbers, not a verdict."""

from datetime import datetime
from typing import Annotated

from pydantic import Field

from reverie_eval.schemas.report import SplitName
from reverie_eval.schemas.wire import Sha256, SubmissionId, TeamName, WireModel

Share = Annotated[float, Field(examples=[0.42])]
"""A fraction in [0, 1]."""


class NamedSubmission(WireModel):
    """A submission and its team."""

    id: SubmissionId
    team: TeamName
    method: str = Field(examples=["Walker"])


class SameFile(WireModel):
    """A file that several teams have sent."""

    sha256: Sha256
    submissions: list[NamedSubmission]


class SimilarPair(WireModel):
    """The most similar files of two teams."""

    first: NamedSubmission
    second: NamedSubmission
    equal: Share
    """Share of the episodes in which both predict the same answer and stop at the same
    viewpoint."""
    equal_answers: Share
    equal_stops: Share
    equal_paths: Share


class SpreadReport(WireModel):
    """How unevenly a team's changes are spread over the episodes that changed."""

    files: int = Field(examples=[20])
    """Files that change at most half of the team's most frequent predictions."""
    value: float = Field(examples=[3.1])
    """1 if changes are unrelated to where the method is uncertain; above 1.5 for changes of
    methods."""
    standard_error: float = Field(examples=[0.1])
    p_value: float = Field(examples=[0.99])
    """Probability of a value as low as this, if the true one is at least 1.5."""


class WalkReport(WireModel):
    """What is unusual in the trajectories of a submission."""

    jumps: int = Field(examples=[0])
    """Moves between unconnected viewpoints."""
    episodes_with_jumps: int = Field(examples=[0])
    longest_jump: float = Field(examples=[0.0])
    """Metres along the graph."""
    mean_viewpoints: float = Field(examples=[6.4])
    """Different viewpoints in a trajectory, on average."""
    most_viewpoints: int = Field(examples=[16])
    longest_walk: float = Field(examples=[48.2])
    """Metres."""
    exact_stops: Share | None
    """Share of the successful episodes that stop at the last viewpoint of the annotated path."""
    exact_by_chance: Share | None
    """The share that stopping at any goal viewpoint would give."""


class SubmissionEvidence(NamedSubmission):
    """The evidence about one submission."""

    received_at: datetime
    nearest: SubmissionId | None
    """The most similar earlier submission of the team."""
    changed: int | None = Field(examples=[120])
    """Episodes in which it differs from that submission in answer or stop."""
    walks: WalkReport


class TeamEvidence(WireModel):
    """The evidence about all files of a team."""

    team: TeamName
    submissions: int = Field(examples=[20])
    median_changed: float | None = Field(examples=[410.0])
    """Episodes in which a file differs from the nearest earlier one: the median over the team's
    files."""
    spread: SpreadReport | None
    """Null with fewer than 15 files that can be compared."""
    jumps: int = Field(examples=[0])
    """The largest number of jumps in one of the team's files."""


class EvidenceReport(WireModel):
    """The evidence about the submissions to a split; nobody but the organiser sees it."""

    split: SplitName
    submissions: int = Field(examples=[200])
    unreadable: dict[str, str]
    """Submissions that cannot be read, and why."""
    same_files: list[SameFile]
    usual_similarity: Share | None
    """The median similarity of the most similar files, over all pairs of teams."""
    similar: list[SimilarPair]
    """The pairs of teams with the most similar files, the most similar first."""
    teams: list[TeamEvidence]
    """The lowest p-value first."""
    history: list[SubmissionEvidence]
    """The submissions of the requested team, the earliest first."""
