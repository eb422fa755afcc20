"""What the evaluation server and its clients say to each other."""

from datetime import datetime
from typing import Annotated, Literal

from pydantic import AwareDatetime, Field

from reverie_eval.schemas.report import ProblemReport, ScoreReport, ValidationReport
from reverie_eval.schemas.wire import Https, Instant, Name, Said, Secret, Text


class ServerReport(Said):
    """The server itself."""

    title: str
    version: str
    """Of reverie-eval, which scores."""
    banner: str
    """What the organiser has to say to everybody; usually nothing."""
    paused: bool
    """Whether no split takes submissions now, whatever its phases say."""
    key_id: str
    """The first letters of the SHA-256 of the public key that receipts are checked with."""
    required_metadata: list[str]
    """What a submission has to say of its method, besides the name."""


class Me(Said):
    """Who a token belongs to."""

    person: str
    team: str
    role: Literal["participant", "organiser"]


class Invitation(Said):
    """What an organiser sends to somebody new."""

    invitation: Secret


class Welcome(Said):
    """A token, shown this once."""

    person: str
    team: str
    token: str


class SignIn(Said):
    """What a browser's session begins with."""

    token: Secret


class SessionReport(Me):
    """A browser's session; the cookie that comes with it is not for scripts."""

    csrf_token: str
    """To be sent as X-CSRF-Token with whatever changes something."""
    expires_at: datetime
    """When to sign in again, UTC; earlier if the token is revoked."""


class Method(Said):
    """What a team says of its method."""

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
    """Was given the annotated objects of a viewpoint, as the dataset's box files list them."""
    ensemble: bool = False
    """Several models decide together."""


class MethodChange(Method):
    """What is to be said differently of a method; what is left out stays."""

    name: Annotated[Name, Field(json_schema_extra=lambda schema: schema.pop("default"))] = ""
    """Shown on the leaderboard."""


class QuotaWindow(Said):
    """What is left in one rolling window."""

    name: Literal["day", "month", "year"]
    """24 hours, 30 days, 365 days."""
    limit: int
    remaining: int
    resets_at: datetime | None
    """When there will be more than now, UTC; null if there will not."""


class QuotaReport(Said):
    """How many submissions are left, for the tighter of team and person."""

    remaining: int
    """That all windows allow now."""
    next_at: datetime | None
    """When the next one is possible, UTC; null if one is now, or none ever."""
    seconds_to_next: int
    """Until then, rounded up; 0 where that is null."""
    windows: list[QuotaWindow]


class PhaseReport(Said):
    """A time in which submissions are taken."""

    name: str
    opens: datetime | None
    closes: datetime | None
    """The last second of it."""
    is_open: bool


class SplitReport(Said):
    """A split that submissions are taken for."""

    name: str
    episodes: int
    visibility: Literal["private", "open"]
    """Private: only rounded means leave the server."""
    protocol: str
    dataset: str
    fingerprint: str
    """SHA-256 of the ground truth's arrays."""
    public_fingerprint: str
    """The same of its public bundle, which checks submissions at home."""
    phases: list[PhaseReport]
    quota: QuotaReport | None
    """Yours; null for whoever is not signed in."""


class Receipt(Said):
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
    """What was left when it had been counted."""
    key_id: str
    """The first letters of the SHA-256 of the server's public key."""
    proof: str
    """Ed25519 over the canonical JSON of the other fields, in base64."""


class SubmissionReport(Said):
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
    status: Literal["unpublished", "published", "withdrawn"]
    published_at: datetime | None
    withdrawn_at: datetime | None
    anonymous_until: datetime | None


class Checked(ValidationReport):
    """The reply to a check of a sound submission."""

    quota: QuotaReport
    """What is left; a check spends nothing."""


class Accepted(Said):
    """The reply to an upload."""

    submission: SubmissionReport
    quota: QuotaReport
    is_repeat: bool
    """Whether this very file, or this Idempotency-Key, was scored before; nothing was spent."""


class SubmissionChange(Said):
    """What a team may change afterwards; what is left out stays."""

    method: MethodChange | None = None
    published: bool | None = None
    """Whether it is on the leaderboard."""
    withdrawn: bool | None = None
    """Whether it is taken back; it stays counted, and must be restored to be published."""
    anonymous_until: Instant | None = None
    """Until when the leaderboard does not name the team; null names it now."""


class PublicReview(Said):
    """What the organiser says of a published result."""

    verdict: Literal["verified", "baseline", "flagged", "disqualified"]
    reason: str
    reviewer: str
    created_at: datetime


class LeaderboardRow(Said):
    """A published result."""

    rank: int | None
    """Equal for equal values of the metric that the board is sorted by; null without a value."""
    submission_id: str | None
    """Null for a result that is reported, not scored."""
    team: str
    """Empty while the team chose to be anonymous."""
    method: Method
    published_at: datetime
    submissions: int | None
    """How many submissions of the team stand behind this row; null while it is anonymous, whose
    rows the number would bring together."""
    scores: dict[str, float]
    intervals: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """Low and high of the headline metrics' 95 % intervals; for open splits alone."""
    signature: str = ""
    """Everything that the scores depend on; empty for a result that is reported."""
    standing: Literal["ranked", "disqualified", "reported", "other-rules"] = "ranked"
    """Whether it takes part in the ranking, or why it does not: the organiser has disqualified it,
    a paper reports it, or it was scored by another protocol or ground truth than the split's."""
    source: str = ""
    """Where a reported result is from."""
    reviews: list[PublicReview] = Field(default_factory=list)


class Leaderboard(Said):
    """The published results of a split."""

    split: str
    protocol: str
    metric: str
    """What the rows are sorted by; rows without it are not ranked and come last."""
    fingerprint: str
    signature: str = ""
    """Of every ranked row, but for the version that scored it."""
    rows: list[LeaderboardRow]
    apart: list[LeaderboardRow] = Field(default_factory=list)
    """What is shown beside the ranking and takes no part in it."""


class ProblemDocument(Said):
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
    """Where the server failed: by this the organiser finds out why."""


class HealthReport(Said):
    """Whether the server can do its work."""

    status: Literal["ok", "unhealthy"]
    failed: list[str] = Field(default_factory=list)
    """What is not in order: `database`, `uploads`, or the scoring of a split."""
