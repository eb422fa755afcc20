"""Messages between the evaluation server and its clients."""

from datetime import datetime
from typing import Annotated, Literal

from pydantic import AwareDatetime, Field

from reverie_eval.schemas.report import ProblemReport, ScoreReport, ValidationReport
from reverie_eval.schemas.wire import Https, Instant, Name, Secret, Text, WireModel

Role = Literal["participant", "organiser"]
Verdict = Literal["verified", "baseline", "flagged", "disqualified"]
Standing = Literal["ranked", "disqualified", "reported", "other-rules"]
"""Of a leaderboard's row: whether it takes part in the ranking, and if not, why."""
WindowName = Literal["day", "month", "year"]


class ServerReport(WireModel):
    """The server itself."""

    title: str
    version: str
    """Of reverie-eval, which scores."""
    banner: str
    """The organiser's message to everyone; usually empty."""
    paused: bool
    """Whether all splits refuse submissions now, whatever their phases say."""
    key_id: str
    """The first letters of the SHA-256 of the public key that receipts are checked with."""
    required_metadata: list[str]
    """What a submission must state about its method, besides the name."""


class Me(WireModel):
    """Who a token belongs to."""

    person: str
    team: str
    role: Role


class Invitation(WireModel):
    """An invitation, to be exchanged for a token."""

    invitation: Secret


class Welcome(WireModel):
    """A token, shown this once."""

    person: str
    team: str
    token: str


class SignIn(WireModel):
    """What a browser sends to sign in."""

    token: Secret


class SessionReport(Me):
    """A browser session; scripts cannot read the cookie that comes with it."""

    csrf_token: str
    """To be sent as X-CSRF-Token with every request that changes something."""
    expires_at: datetime
    """When to sign in again, UTC; earlier if the token is revoked."""


class Method(WireModel):
    """How a team describes its method."""

    name: Name
    """Shown on the leaderboard."""
    description: Text = ""
    paper: Https | None = None
    code: Https | None = None
    extra_data: bool = False
    """Trained on more than the benchmark's training split."""
    pre_exploration: bool = False
    """Saw the test buildings before the instructions."""
    ground_truth_objects: bool = False
    """Used the annotated objects of a viewpoint, as listed in the dataset's box files."""
    ensemble: bool = False
    """Several models decide together."""


class MethodChange(Method):
    """Changes to the description of a method; fields that are left out stay as they are."""

    name: Annotated[Name, Field(json_schema_extra=lambda schema: schema.pop("default"))] = ""
    """Shown on the leaderboard."""


class QuotaWindow(WireModel):
    """The submissions left in one rolling window."""

    name: WindowName
    """24 hours, 30 days, 365 days."""
    limit: int
    remaining: int
    resets_at: datetime | None
    """When more will be left than now, UTC; null if never."""


class QuotaReport(WireModel):
    """How many submissions are left: the smaller number of the team's and the person's."""

    remaining: int
    """Allowed now by all windows."""
    next_at: datetime | None
    """When the next submission is possible, UTC; null if one is possible now, or never will be."""
    seconds_to_next: int
    """Until then, rounded up; 0 where that is null."""
    windows: list[QuotaWindow]


class PhaseReport(WireModel):
    """A period in which submissions are accepted."""

    name: str
    opens: datetime | None
    closes: datetime | None
    """The last second of the phase."""
    is_open: bool


class SplitReport(WireModel):
    """A split that accepts submissions."""

    name: str
    episodes: int
    visibility: Literal["private", "open"]
    """Private: only rounded means leave the server."""
    protocol: str
    dataset: str
    fingerprint: str
    """SHA-256 of the ground truth's arrays."""
    public_fingerprint: str
    """The same for its public bundle, with which participants check submissions themselves."""
    phases: list[PhaseReport]
    release_scores: Literal["at-once", "phase-end"] = "at-once"
    """Phase-end: scores are held back until the phase in which a submission came has ended."""
    quota: QuotaReport | None
    """Yours; null if you are not signed in."""


class Receipt(WireModel):
    """What proves a result: every field but the last is signed."""

    schema_version: Literal[1] = 1
    server: str
    """The server's title."""
    submission_id: str
    team: str
    sha256: str
    """Of the submission's JSON text."""
    received_at: AwareDatetime
    split: str
    signature: str
    """Everything that the scores depend on, as the score table has it."""
    scores: dict[str, float]
    quota: QuotaReport
    """The quota after this submission."""
    key_id: str
    """The first letters of the SHA-256 of the server's public key."""
    proof: str
    """Ed25519 over the canonical JSON of the other fields, in base64."""


class SubmissionReport(WireModel):
    """A scored submission."""

    id: str
    split: str
    team: str
    person: str
    sha256: str
    received_at: datetime
    method: Method
    report: ScoreReport
    receipt: Receipt
    """Without scores while these are held back."""
    scores_held_until: datetime | None = None
    """When the phase ends until which nobody sees the scores, UTC; null if they are released."""
    status: Literal["unpublished", "published", "withdrawn"]
    published_at: datetime | None
    withdrawn_at: datetime | None
    anonymous_until: datetime | None


class Checked(ValidationReport):
    """The reply to a check of a valid submission."""

    quota: QuotaReport
    """The submissions left; a check does not use one."""


class Accepted(WireModel):
    """The reply to an upload."""

    submission: SubmissionReport
    quota: QuotaReport
    is_repeat: bool
    """Whether this file or Idempotency-Key was scored before; then no submission was used."""


class SubmissionChange(WireModel):
    """What a team may change afterwards; fields that are left out stay as they are."""

    method: MethodChange | None = None
    published: bool | None = None
    """Whether it is on the leaderboard."""
    withdrawn: bool | None = None
    """Whether it is withdrawn; it still counts, and must be restored before it can be published."""
    anonymous_until: Instant | None = None
    """Until when the leaderboard does not name the team; null names it now."""


class PublicReview(WireModel):
    """The organiser's verdict on a published result."""

    verdict: Verdict
    reason: str
    reviewer: str
    created_at: datetime


class LeaderboardRow(WireModel):
    """A published result."""

    rank: int | None
    """Equal for equal values of the metric that the rows are sorted by; null without a value."""
    submission_id: str | None
    """Null for a result that is reported, not scored."""
    team: str
    """Empty while the team chose to be anonymous."""
    method: Method
    published_at: datetime
    submissions: int | None
    """Number of the team's submissions; null while it is anonymous, because the number would
    reveal which rows belong to one team."""
    scores: dict[str, float]
    intervals: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """Low and high of the headline metrics' 95 % intervals; for open splits alone."""
    signature: str = ""
    """Everything that the scores depend on; empty for a reported result."""
    standing: Standing = "ranked"
    """Whether it takes part in the ranking, or why it does not: the organiser has disqualified it,
    a paper reports it, or it was scored by another protocol or ground truth than the split's."""
    source: str = ""
    """Where a reported result is from."""
    reviews: list[PublicReview] = Field(default_factory=list)


class Leaderboard(WireModel):
    """The published results of a split."""

    split: str
    protocol: str
    metric: str
    """What the rows are sorted by; rows without it are not ranked and come last."""
    fingerprint: str
    signature: str = ""
    """The signature of every ranked row, except for the version that scored it."""
    rows: list[LeaderboardRow]
    apart: list[LeaderboardRow] = Field(default_factory=list)
    """Rows that are not ranked."""


class ProblemDocument(WireModel):
    """An error, as RFC 9457 has it."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    code: str
    """Stable, for programs."""
    problems: list[ProblemReport] = Field(default_factory=list)
    """What is wrong with the submission, each with its place."""
    quota: QuotaReport | None = None
    request_id: str | None = None
    """Given if the server failed: the organiser finds the cause by it."""


class HealthReport(WireModel):
    """Whether the server can do its work."""

    status: Literal["ok", "unhealthy"]
    failed: list[str] = Field(default_factory=list)
    """What does not work: `database`, `uploads`, or the scoring of a split."""
