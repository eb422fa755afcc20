"""Messages between organisers and the server."""

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from reverie_eval.schemas.report import SplitName
from reverie_eval.schemas.service import (
    Accepted,
    BoardName,
    MethodChange,
    Phases,
    ReleaseScores,
    ReportedMethod,
    Role,
    Schedule,
    Verdict,
)
from reverie_eval.schemas.wire import (
    EXAMPLE_INVITATION,
    LONGEST_ID,
    OMITTED,
    Email,
    Instant,
    Line,
    Name,
    OmittedName,
    PartialDate,
    PersonName,
    Reason,
    Sha256,
    Source,
    SubmissionId,
    TeamName,
    WireModel,
)

TokenKind = Literal["access", "invite"]


class NewTeam(WireModel):
    """A team to be added."""

    name: Name = Field(examples=["Blue"])


class TeamReport(WireModel):
    """People who submit together and share a quota."""

    id: int = Field(examples=[2])
    """The team's number, by which the log names it."""
    name: TeamName
    people: list[str] = Field(examples=[["Ada", "Ben"]])
    created_at: datetime


class NewMerge(WireModel):
    """Two teams that become one."""

    team: Name = Field(examples=["Blau"])
    """The team whose people, submissions and grants move; its name cannot be used again."""
    into: Name = Field(examples=["Blue"])


class MergeReport(NewMerge):
    """Two teams that became one."""

    people: int = Field(examples=[2])
    submissions: int = Field(examples=[7])
    """Submissions that were moved to the other team."""
    repeats: int = Field(examples=[1])
    """Files that both teams had submitted; the later submission no longer counts in the quota."""


class NewPerson(WireModel):
    """A person to be added to a team."""

    team: Name = Field(examples=["Blue"])
    name: Name = Field(examples=["Ada"])
    """Nobody else in the team may have it."""
    role: Role = "participant"
    email: Email | None = None
    """Only organisers and the person see it."""


class PersonChange(WireModel):
    """Changes to a person; fields that are left out stay as they are."""

    name: OmittedName = Field("", examples=["Ada Lovelace"])
    email: Email | None = None
    """Null removes it."""
    team: OmittedName = Field("", examples=["Red"])
    """The team to move to. Their submissions stay with their former team."""


class PersonReport(WireModel):
    """A person in a team."""

    id: int = Field(examples=[3])
    name: PersonName
    email: Email | None
    team: TeamName
    role: Role
    created_at: datetime

    @property
    def is_organiser(self) -> bool:
        """Whether the person sees and manages everything."""
        return self.role == "organiser"


class NewToken(WireModel):
    """A token to be created for a person."""

    person: Name = Field(examples=["Ada"])
    team: Name | None = Field(None, examples=["Blue"])
    """Needed only if several teams have a person of that name."""
    kind: TokenKind = "invite"
    """An invitation can be exchanged for an access token once, by anyone who has it."""
    expires_at: Instant | None = Field(None, examples=["2027-07-01T12:00:00Z"])
    """If null, an invitation expires after 14 days, and a token does not expire."""


class KeyRotation(WireModel):
    """The signing key to be replaced by a new one."""

    reason: Reason = Field("changed by the organiser", examples=["the yearly change"])
    """Published with the old key."""


class KeyRevocation(WireModel):
    """A signing key that others may have."""

    since: Instant = Field(examples=["2027-06-01T12:00:00Z"])
    """The key's signatures of submissions received later are not valid."""
    reason: Reason = Field(examples=["a laptop with a backup was stolen"])
    """Published with the key."""


class TokenReport(WireModel):
    """What the server knows about a token, without the token itself."""

    hint: str = Field(examples=[EXAMPLE_INVITATION[:11]])
    """The token's first letters."""
    kind: TokenKind = Field(examples=["invite"])
    person: PersonName
    team: TeamName
    created_at: datetime
    expires_at: datetime | None = Field(examples=["2027-07-01T12:00:00Z"])
    revoked_at: datetime | None
    """When it was revoked, or when an invitation was used."""


class NewTokenReport(TokenReport):
    """A new token, shown only this once."""

    token: str = Field(examples=[EXAMPLE_INVITATION])


MOST_EXTRA = 10_000
"""Extra submissions in one grant: more than any quota, and no more than a database can count."""


class NewGrant(WireModel):
    """Extra submissions for a team, and the reason."""

    team: Name = Field(examples=["Blue"])
    split: SplitName
    extra: int = Field(ge=1, le=MOST_EXTRA, examples=[2])
    """Added to each limit, of the team and of each person in it."""
    reason: Reason = Field(examples=["our disk was full"])
    """For the audit log; one line."""
    expires_at: Instant = Field(examples=["2027-07-01T12:00:00Z"])


class GrantReport(WireModel):
    """Extra submissions that a team was granted."""

    team: TeamName
    split: SplitName
    extra: int = Field(examples=[2])
    reason: str = Field(examples=["our disk was full"])
    created_at: datetime
    expires_at: datetime = Field(examples=["2027-07-01T12:00:00Z"])


class AuditReport(WireModel):
    """An entry of the audit log; each digest covers the entry and the digest before it."""

    id: int = Field(examples=[17])
    at: datetime
    actor: PersonName
    actor_row: str = Field(examples=["person:1"])
    """The person who acted, for programs, because names may change. Empty for the server itself and
    for the command line."""
    action: str = Field(examples=["granted"])
    row: str = Field(examples=["quota_grant:2"])
    """The row that was changed, for programs: `team:3`."""
    subject: str = Field(examples=["Blue"])
    """The row's name at the time."""
    details: dict[str, Any] = Field(
        examples=[{"split": "test", "extra": 2, "reason": "our disk was full"}]
    )
    previous: Sha256
    digest: str = Field(
        examples=["b5d4045c3f466fa91fe2cc6abe79232a1a57cdf104f7a26e716e0a1e2789df78"]
    )


class NewReview(WireModel):
    """A public verdict on a submission."""

    submission_id: SubmissionId = Field(max_length=LONGEST_ID)
    verdict: Verdict
    """Verified, flagged and disqualified replace each other; baseline is independent of them."""
    reason: Reason = Field(examples=["We ran the published code and got the same file."])
    """Public; one line."""


class ReviewEntry(NewReview):
    """A verdict on a submission, lifted or not."""

    id: int = Field(examples=[3])
    created_at: datetime
    lifted_at: datetime | None


_PAPER = "https://arxiv.org/abs/1904.10151"


class ReportedMethodChange(MethodChange, ReportedMethod):
    """Changes to the description of a reported result's method."""


ReportedScores = Annotated[
    dict[str, float], Field(examples=[{"success": 0.1153, "spl": 0.0947, "rgs": 0.0562}])
]
ReportedDate = Annotated[PartialDate | None, Field(examples=["2020-06"])]
Dataset = Annotated[Line, Field(examples=["REVERIE v2"])]
Rates = Literal["percent", "fraction"]
"""How a table prints rates: 59.6 or 0.596."""

LONGEST_FILE = 100_000
"""Characters of a file of reported results: about 1,000 rows."""


class NewReported(WireModel):
    """A result that a paper or another leaderboard reports, for the leaderboard of a split.

    No other may have the same team, method and date.
    """

    split: SplitName
    method: ReportedMethod = Field(
        examples=[{"name": "Interactive Navigator-Pointer", "paper": _PAPER}]
    )
    team: Name = Field(examples=["Qi et al., 2020"])
    """Who reports it, as shown on the leaderboard."""
    scores: ReportedScores = Field(min_length=1)
    """By metric key: fractions from 0 to 1, or metres."""
    source: Source = Field(examples=[_PAPER])
    """Where it is from: a text, or a link that begins with https://."""
    date: ReportedDate = None
    """When it was reported: a day, a month or a year; null if unknown."""
    dataset: Dataset = ""
    """The version of the dataset that it was scored on; empty if unknown. Results on a version
    other than the split's are shown separately."""


class ReportedChange(WireModel):
    """Changes to a reported result; fields that are left out stay as they are."""

    method: ReportedMethodChange | None = Field(None, examples=[{"extra_data": False}])
    team: OmittedName = Field("", examples=["Qi et al., CVPR 2020"])
    scores: dict[str, float | None] = Field(default_factory=dict, examples=[{"rgspl": 0.0309}])
    """Metrics that are left out stay as they are; null removes one."""
    source: Annotated[Source, OMITTED] = Field("", examples=[_PAPER])
    date: ReportedDate = None
    dataset: Dataset = ""


class ReportedEntry(NewReported):
    """A reported result on a leaderboard."""

    id: int = Field(examples=[1])
    created_at: datetime
    """When it was entered."""


class NewImport(WireModel):
    """A file of reported results, for the leaderboard of a split."""

    split: SplitName
    source: Source = Field(examples=[_PAPER])
    """The source of rows that do not name one: a text or a link."""
    date: ReportedDate = None
    """The date of rows that do not name one; null if unknown."""
    dataset: Dataset = ""
    """The dataset version of rows that do not name one."""
    rates: Rates = "percent"
    """How rates are written in the file; lengths are in metres."""
    text: str = Field(
        min_length=1,
        max_length=LONGEST_FILE,
        examples=["team,method,SR,SPL,date\nBlue,Walker,59.64,38.98,01/2026\n"],
    )
    """The file: CSV with a header row, or JSON."""
    human: list[Name] = Field(default_factory=list, examples=[["Human"]])
    """The methods of the file that are people, if it has no column that says so."""
    reference: list[Name] = Field(default_factory=list, examples=[["Random", "Shortest"]])
    """The methods of the file that are references, such as chance or the shortest path."""
    dry_run: bool = False
    """Change nothing; only report what would be added."""


class ImportReport(WireModel):
    """The results that an import added, or would add."""

    rows: int = Field(examples=[83])
    """Results in the file."""
    added: list[NewReported]
    """In the order of the file."""
    known: int = Field(examples=[1])
    """Results that were already on the leaderboard."""
    repeated: list[str] = Field(examples=[["line 32 repeats line 29"]])
    """Rows that repeat an earlier row of the file."""
    unread: list[str] = Field(examples=[["dataset"]])
    """Parts of a JSON file that contain no results."""


class NewCorrection(WireModel):
    """Why the submissions to a split are scored again."""

    split: SplitName
    reason: Reason = Field(examples=["Targets of 40 episodes were corrected."])
    """Public; one line. If a correction to the current ground truth and rules was already
    announced, that correction is continued and keeps its reason."""


class ResultChange(WireModel):
    """How a correction changed a result."""

    board: BoardName = ""
    submission_id: SubmissionId
    team: TeamName
    method: str = Field(examples=["Walker"])
    before: dict[str, float]
    after: dict[str, float]
    """Empty if it could not be scored again."""
    rank_before: int | None
    """By the primary metric; null if it is not on the leaderboard."""
    rank_after: int | None
    problem: str
    """Why it could not be scored again; empty if it could."""

    def difference(self, metric: str) -> float:
        """Return by how much a metric grew; 0 if a value is missing."""
        if metric not in self.before or metric not in self.after:
            return 0.0
        return self.after[metric] - self.before[metric]


class NewNotice(WireModel):
    """A message to everyone, and whether submissions are paused."""

    banner: Line = Field("", examples=["Down for maintenance until 09:00 UTC."])
    """One line; empty for no banner."""
    paused: bool = Field(default=False, examples=[True])


class NewNews(WireModel):
    """A news entry to be posted."""

    text: Reason = Field(examples=["The workshop is on 12 June 2027; see you there."])


class NoticeReport(WireModel):
    """The current message to everyone."""

    banner: str = Field(examples=["Down for maintenance until 09:00 UTC."])
    paused: bool = Field(examples=[True])
    created_at: datetime | None = Field(examples=["2027-06-01T12:00:00Z"])
    """When it was posted; null if nothing was."""


class NewSchedule(WireModel):
    """What the desk sets for a split; replaces everything that it set before."""

    phases: Phases | None = None
    """Null: use the phases and the release of scores of the settings file."""
    release_scores: ReleaseScores | None = Field(None, examples=["phase-end"])
    """Set together with phases. Scores that were shown before stay visible."""
    paused: bool = Field(default=False, examples=[True])

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if (self.phases is None) is not (self.release_scores is None):
            raise ValueError("set phases and release_scores together, or neither")
        return self


class ScheduleReport(WireModel):
    """When a split accepts submissions: as set in the file, as set at the desk, and in effect."""

    split: SplitName
    settings: Schedule
    """What the settings file says."""
    desk: NewSchedule | None
    """Null if nothing was set."""
    in_effect: Schedule
    set_at: datetime | None
    """When it was set at the desk; null if nothing was set."""


class NewSnapshot(WireModel):
    """A snapshot to be taken of a leaderboard."""

    split: Name = Field(examples=["test"])
    title: Name = Field(examples=["CVPR 2027 challenge"])


class EmailedFile(WireModel):
    """A file that a person sent to the organiser, by e-mail for example."""

    split: SplitName
    team: Name = Field(examples=["Blue"])
    person: Name = Field(examples=["Ada"])
    """Who sent it."""
    received_at: Instant = Field(examples=["2027-06-01T12:00:00Z"])
    """When the organiser received it."""
    publish: bool = False
    """Put the result on the leaderboard at once."""


class EmailedFileReport(Accepted):
    """The reply to an upload, and a text to send back to the person who sent the file."""

    reply: str = Field(
        examples=["Dear Blue,\n\nYour file submit.json, received 2027-06-01 12:00:00 UTC, was ..."]
    )
    """Plain text, to send with the receipt."""


class AttemptReport(WireModel):
    """An upload and its outcome."""

    id: int = Field(examples=[41])
    at: datetime
    person: PersonName
    team: TeamName
    split: SplitName
    outcome: str = Field(examples=["submission-rejected"])
    """`scored`, `repeat`, or the code of the problem."""
    problems: int = Field(examples=[12])
    """Number of problems in the file."""
    size: int = Field(examples=[4_204_511])
    """Bytes; after unpacking, if the server got that far."""
    milliseconds: int = Field(examples=[38])


# Evidence about submissions: numbers, not a verdict.

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
