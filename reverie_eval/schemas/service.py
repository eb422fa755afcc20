"""Messages between the evaluation server and its clients."""

import re
from collections.abc import Mapping, Sequence
from datetime import date, datetime, timedelta, timezone
from itertools import pairwise
from types import MappingProxyType
from typing import Annotated, Literal, get_args

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BeforeValidator,
    ConfigDict,
    Field,
    model_validator,
)
from typing_extensions import Self

from reverie_eval.schemas.report import (
    DatasetName,
    Fingerprint,
    ProblemReport,
    ScoreReport,
    SplitName,
    ValidationReport,
)
from reverie_eval.schemas.wire import (
    EXAMPLE_INVITATION,
    EXAMPLE_KEY,
    EXAMPLE_TOKEN,
    Https,
    Instant,
    KeyId,
    Name,
    OmittedName,
    OrganiserName,
    PersonName,
    Secret,
    Sha256,
    StoredEmail,
    SubmissionId,
    TeamName,
    Text,
    WireModel,
)

Role = Literal["participant", "organiser"]
Verdict = Literal["verified", "baseline", "flagged", "disqualified"]
Standing = Literal["ranked", "reported", "other-dataset", "other-rules", "disqualified"]
"""Whether a row of a leaderboard is ranked, and if not, why."""
WindowName = Literal["day", "month", "year"]
SplitStatus = Literal["open", "paused", "not open yet", "closed"]
"""Whether a split accepts submissions at a time. The status of its phases that comes first here
counts."""
WINDOWS: Mapping[WindowName, timedelta] = MappingProxyType(
    {"day": timedelta(hours=24), "month": timedelta(days=30), "year": timedelta(days=365)}
)
"""The rolling windows of quotas."""

BoardName = Annotated[str, Field(examples=["grounding"])]
"""A leaderboard of a split; empty for the main one."""
SIGNED_VERSION = 1
"""The version of receipts and snapshots. A new field leaves it as it is, because earlier versions
ignore it; it rises if what they know of changes its meaning."""

_DAY = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}")


def _first_second(value: object) -> object:
    return f"{value}T00:00:00Z" if _is_day(value) else value


def _last_second(value: object) -> object:
    return f"{value}T23:59:59Z" if _is_day(value) else value


def _is_day(value: object) -> bool:
    is_date = isinstance(value, date) and not isinstance(value, datetime)
    return is_date or (isinstance(value, str) and _DAY.fullmatch(value) is not None)


class ServerReport(WireModel):
    """The server itself."""

    title: str = Field(examples=["REVERIE evaluation server"])
    version: str
    """The version of reverie-eval that scores."""
    banner: str = Field(examples=["Down for maintenance on 12 June, 08:00-09:00 UTC."])
    """The organiser's message to everyone; usually empty."""
    paused: bool
    """Whether all splits refuse submissions now, whatever their phases say."""
    key_id: KeyId
    """The first digits of the SHA-256 of the public key that verifies receipts."""
    required_metadata: list[str] = Field(examples=[["description"]])
    """What a submission must state about its method besides the name."""
    organiser: OrganiserName
    """The name under which the organiser acts in public."""
    contact: str = Field(examples=["reverie@lab.example.org"])
    """How to reach the organiser: an e-mail address or a link; may be empty."""
    links: dict[str, str] = Field(examples=[{"Paper": "https://arxiv.org/abs/1904.10151"}])
    """Further links, by their text."""


class NewsReport(WireModel):
    """A short dated entry by the organiser."""

    id: int = Field(examples=[3])
    text: str = Field(examples=["The workshop is on 12 June 2027; see you there."])
    created_at: datetime


class Me(WireModel):
    """Who a token belongs to."""

    person: PersonName
    team: TeamName
    role: Role
    email: StoredEmail | None = None
    """Only the person and organisers see it."""


class Invitation(WireModel):
    """An invitation, which can be exchanged for a token."""

    invitation: Secret = Field(examples=[EXAMPLE_INVITATION])


class Welcome(WireModel):
    """A token, shown only once."""

    person: PersonName
    team: TeamName
    token: str = Field(examples=[EXAMPLE_TOKEN])


InputClass = Literal["geometry", "objects", "views", "other"]
SampleSize = Annotated[int, Field(ge=1, le=1_000_000)]
Amount = Annotated[float, Field(ge=0, le=1e12, allow_inf_nan=False)]


class Method(WireModel):
    """The description of a method by its team, or by the source of a reported result.

    Whether a property applies to it is true, false, or null: nobody has declared it. So is null
    what it was shown, and what an episode cost.
    """

    name: Name = Field(examples=["Walker"])
    """Shown on the leaderboard."""
    description: Text = Field(
        "", examples=["A transformer over panoramas, with a pointer to objects."]
    )
    paper: Https | None = Field(None, examples=["https://example.org/walker.pdf"])
    code: Https | None = Field(None, examples=["https://example.org/walker"])
    extra_data: bool | None = Field(None, examples=[True])
    """Trained on more than the benchmark's training split."""
    pre_exploration: bool | None = None
    """Saw the test buildings before the instructions."""
    ground_truth_objects: bool | None = None
    """Used the annotated objects of a viewpoint, as listed in the dataset's box files."""
    ensemble: bool | None = None
    """Several models decide together."""
    navigation_only: bool | None = None
    """Only navigates: the file has no answers. Must be declared for such a file."""
    human: bool | None = None
    """People walked the episodes, not a program."""
    input_class: InputClass | None = Field(None, examples=["views"])
    """What the agent was shown of a place: geometry alone, the annotators' objects (perfect
    perception), views, or something else."""
    sample_size: SampleSize | None = Field(None, examples=[500])
    """Number of episodes that it was run on, if answers to the others were filled in without it."""
    actions_per_episode: Amount | None = Field(None, examples=[12.5])
    """Mean number of actions that it chose in an episode."""
    seconds_per_episode: Amount | None = Field(None, examples=[41.3])
    """Mean time that an episode took, in seconds."""
    input_tokens_per_episode: Amount | None = Field(None, examples=[18250.0])
    """Mean number of tokens sent to models in an episode, cached ones included."""
    output_tokens_per_episode: Amount | None = Field(None, examples=[640.0])
    """Mean number of tokens that came back in an episode, those of reasoning included."""
    money_per_episode: Amount | None = Field(None, examples=[0.04])
    """Mean price of an episode, in US dollars; 0 if it was free."""


class ReportedMethod(Method):
    """The description of a reported result's method."""

    reference: bool | None = None
    """Not a competing method but something to compare with, such as chance or the shortest path."""


class MethodChange(Method):
    """Changes to the description of a method; fields that are left out stay as they are.

    Null takes a link or a declaration back.
    """

    name: OmittedName = Field("", examples=["Walker 2"])
    """Shown on the leaderboard."""


class QuotaWindow(WireModel):
    """The submissions left in one rolling window."""

    name: WindowName
    """24 hours, 30 days, 365 days."""
    limit: int = Field(examples=[2])
    remaining: int = Field(examples=[1])
    resets_at: datetime | None = Field(examples=["2027-06-02T12:00:00Z"])
    """When more submissions will be left than now, UTC; null if never."""


class QuotaReport(WireModel):
    """The submissions left to the team or to the person, whichever are fewer."""

    remaining: int = Field(examples=[1])
    """Submissions that all windows allow now."""
    next_at: datetime | None
    """When the next submission is possible, UTC; null if one is possible now, or never will be."""
    seconds_to_next: int = Field(examples=[0])
    """Seconds until ``next_at``, rounded up; 0 if it is null."""
    windows: list[QuotaWindow]


class Phase(WireModel):
    """A period in which a split accepts submissions; dates without a time are days in UTC."""

    name: Name = Field(examples=["challenge 2027"])
    """The name of a period in which submissions are accepted; without phases, they always are."""
    opens: Annotated[Instant | None, BeforeValidator(_first_second)] = Field(
        None, examples=["2027-01-01T00:00:00Z"]
    )
    """The first second of the phase: ``2027-01-01T00:00:00Z``, or ``2027-01-01``, a day in UTC."""
    closes: Annotated[Instant | None, BeforeValidator(_last_second)] = Field(
        None, examples=["2027-06-01T23:59:59Z"]
    )
    """The last second of the phase: ``2027-06-01T23:59:59Z``, or ``2027-06-01``, which includes all
    of 1 June. An upload counts from the moment its last byte arrives."""

    @property
    def last_moment(self) -> datetime | None:
        """The phase's last moment, None if it has no end: a phase may be closed within a second."""
        return None if self.closes is None else last_moment(self.closes)

    @model_validator(mode="after")
    def _opens_before_it_closes(self) -> Self:
        if self.opens and self.closes and self.opens >= self.closes:
            raise ValueError("a phase must open before it closes")
        return self

    def is_open(self, now: datetime) -> bool:
        """Whether submissions are accepted at this time."""
        has_begun = self.opens is None or self.opens <= now
        return has_begun and (self.last_moment is None or now <= self.last_moment)

    def status(self, now: datetime, *, is_paused: bool) -> SplitStatus:
        """Return whether submissions are accepted at this time, and if not, why not."""
        if self.is_open(now):
            return "paused" if is_paused else "open"
        return "not open yet" if self.opens is not None and now < self.opens else "closed"

    @property
    def period(self) -> str:
        """The phase's first and last second, in words; empty if it is always open."""
        sides = {"from": self.opens, "until": self.closes}
        return " ".join(
            f"{word} {moment:%Y-%m-%dT%H:%M:%SZ}" for word, moment in sides.items() if moment
        )


def last_moment(closes: datetime) -> datetime:
    """Return the last moment of a whole second, which all belongs to a phase; others are their own.

    >>> last_moment(datetime(2027, 6, 1, 23, 59, 59)).microsecond
    999999
    """
    return closes if closes.microsecond else closes.replace(microsecond=999_999)


def first_overlap(phases: Sequence[Phase]) -> tuple[Phase, Phase] | None:
    """Return two phases to which the same submission could belong, the earlier one first.

    A phase that opens in the last second of another overlaps it, because both include that second.
    """
    earliest, latest = (
        datetime.min.replace(tzinfo=timezone.utc),
        datetime.max.replace(tzinfo=timezone.utc),
    )
    in_order = sorted(phases, key=lambda each: (each.opens or earliest, each.closes or latest))
    for first, second in pairwise(in_order):
        if (second.opens or earliest) <= (first.last_moment or latest):
            return first, second
    return None


def _some_phases(phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
    if not phases:
        raise ValueError("add a phase, or leave phases out to accept submissions at any time")
    return phases


Phases = Annotated[tuple[Phase, ...], AfterValidator(_some_phases)]
ReleaseScores = Literal["at-once", "phase-end"]


class Schedule(WireModel):
    """When a split accepts submissions and shows their scores."""

    phases: Phases
    release_scores: ReleaseScores = "at-once"
    """Phase-end: scores are held back until the end of the phase of the submission."""
    paused: bool = False
    """Whether submissions are refused for now, whatever the phases say."""

    def is_open(self, now: datetime) -> bool:
        """Whether a phase is open at a time; the split may be paused nevertheless."""
        return any(phase.is_open(now) for phase in self.phases)

    def is_paused_on(self, *, paused_server: bool) -> bool:
        """Whether the split is paused, by itself or with all others of its server."""
        return self.paused or paused_server

    def status(self, now: datetime, *, paused_server: bool) -> SplitStatus:
        """Return whether submissions are accepted at a time, and if not, why not."""
        statuses = self.phase_statuses(now, paused_server=paused_server).values()
        return min(statuses, key=get_args(SplitStatus).index)

    def phase_statuses(self, now: datetime, *, paused_server: bool) -> Mapping[Phase, SplitStatus]:
        """Return the status of every phase at a time."""
        is_paused = self.is_paused_on(paused_server=paused_server)
        return {phase: phase.status(now, is_paused=is_paused) for phase in self.phases}

    def opens_at(self, now: datetime) -> datetime | None:
        """Return when the next phase opens; None if there is none."""
        coming = [phase.opens for phase in self.phases if phase.opens and phase.opens > now]
        return min(coming, default=None)

    def closed_at(self, now: datetime) -> datetime | None:
        """Return the last second of the phase that closed last; None if none has."""
        over = [
            phase.closes
            for phase in self.phases
            if phase.closes and last_moment(phase.closes) < now
        ]
        return max(over, default=None)

    def closes_at(self, now: datetime) -> datetime | None:
        """Return when the open phases close; None if none is open, or one has no end."""
        ends = [phase.closes for phase in self.phases if phase.is_open(now)]
        closing = [closes for closes in ends if closes is not None]
        return max(closing) if closing and len(closing) == len(ends) else None

    @property
    def holds_scores_back(self) -> bool:
        """Whether nobody sees scores before the end of a phase."""
        return self.release_scores == "phase-end"

    def held_until(self, received_at: datetime) -> datetime | None:
        """Return the end of the phase of a submission; None if scores are not held back.

        If several phases are open, the one that ends last counts.
        """
        if not self.holds_scores_back:
            return None
        ends = [phase.closes for phase in self.phases if phase.is_open(received_at)]
        return max((end for end in ends if end is not None), default=None)


class PhaseReport(WireModel):
    """A period in which submissions are accepted."""

    name: str = Field(examples=["2027"])
    opens: datetime | None = Field(examples=["2027-06-01T12:00:00Z"])
    closes: datetime | None = Field(examples=["2028-05-31T12:00:00Z"])
    """The last second of the phase."""
    is_open: bool = Field(examples=[True])


class BoardRules(WireModel):
    """The rules of another leaderboard of a split."""

    protocol: str
    track: Literal["full", "grounding"] = "full"


class SplitReport(WireModel):
    """A split that accepts submissions."""

    name: SplitName
    """Begins with the task, as in ``r2r-test``, unless that is REVERIE."""
    task: str = Field("reverie", examples=["reverie"])
    """The benchmark that it belongs to."""
    episodes: int = Field(examples=[6292])
    """Number of episodes that are scored; a declared sample has fewer than the split."""
    subset: str = Field("", examples=["3ccb750a9648"])
    """The digest of the episodes of a declared sample; empty for a whole split. The list itself is
    at ``/api/v1/splits/{split}/episodes.txt``."""
    split_episodes: int = Field(examples=[6292])
    """All episodes of the split."""
    visibility: Literal["private", "open"]
    """Private: only rounded means leave the server."""
    protocol: str
    track: Literal["full", "grounding"] = "full"
    """Grounding: answers alone are scored, with the agent placed at the goal."""
    dataset: DatasetName
    fingerprint: Fingerprint
    """SHA-256 of the ground truth's arrays."""
    public_fingerprint: str = Field(
        examples=["9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"]
    )
    """The fingerprint of the public bundle, with which participants can check submissions
    themselves."""
    phases: list[PhaseReport]
    release_scores: ReleaseScores = "at-once"
    """Phase-end: scores are held back until the end of the phase of the submission."""
    paused: bool = False
    """Whether the organiser has paused submissions to this split, or to all."""
    one_per_team: bool = False
    """Whether publishing a submission takes the team's earlier one off the leaderboard."""
    boards: dict[str, BoardRules] = Field(
        default_factory=dict, examples=[{"grounding": {"protocol": "paper", "track": "grounding"}}]
    )
    """The split's other leaderboards, by name; every submission is scored for these too."""
    quota: QuotaReport | None
    """Yours; null if you are not signed in."""


class Receipt(WireModel):
    """What a server says of a submission's result; it is signed in an envelope."""

    schema_version: int = SIGNED_VERSION
    server: str = Field(examples=["REVERIE evaluation server"])
    """The server's title."""
    submission_id: SubmissionId
    team: TeamName
    sha256: Sha256
    """SHA-256 of the submission's JSON text."""
    received_at: AwareDatetime
    split: SplitName
    signature: str
    """Everything that the scores depend on, as in the score table."""
    scores: dict[str, float]
    quota: QuotaReport
    """The quota after this submission."""


class EnvelopeSignature(WireModel):
    """A signature of an envelope's payload."""

    keyid: KeyId
    """The first letters of the SHA-256 of the server's public key."""
    sig: str = Field(examples=["p2l5c2JhZGx5IHNpZ25lZA=="])
    """Ed25519, in base64, over the payload and its type as DSSE combines them."""


class Envelope(WireModel):
    """A signed receipt, or a signed snapshot: the bytes that were signed, in a DSSE envelope."""

    model_config = ConfigDict(serialize_by_alias=True)

    payload_type: str = Field(alias="payloadType", examples=["application/vnd.in-toto+json"])
    """A receipt is an in-toto statement; a snapshot is
    ``application/vnd.reverie-eval.snapshot+json``."""
    payload: str = Field(examples=["eyJfdHlwZSI6Imh0dHBzOi8vaW4tdG90by5pby9TdGF0ZW1lbnQvdjEifQ=="])
    """The bytes, in base64. Of a receipt, the submitted file is the statement's subject, and the
    other fields are its predicate."""
    signatures: list[EnvelopeSignature] = Field(min_length=1)
    """The server's; it has one."""

    @property
    def key_ids(self) -> Sequence[str]:
        """The ids of the keys that it says it was signed with."""
        return [each.keyid for each in self.signatures]


class KeyReport(WireModel):
    """A key that signs a server's receipts, or did so earlier."""

    key_id: KeyId
    public_key: str = Field(examples=[EXAMPLE_KEY])
    """Ed25519, in PEM form."""
    valid_from: datetime
    valid_until: datetime | None = Field(examples=["2027-07-01T12:00:00Z"])
    """Receipts of submissions received later are not valid; null for the key in use."""
    reason: str = Field(examples=["the yearly change"])
    """Why it ended; empty for the key in use."""


class EarlierResult(WireModel):
    """A submission's result before a correction of the ground truth or the rules."""

    report: ScoreReport
    receipt: Envelope
    replaced_at: datetime
    reason: str = Field(examples=["Targets of 40 episodes were corrected."])


class BoardResult(WireModel):
    """A submission's result on a leaderboard of its split."""

    report: ScoreReport
    """Without scores if the file cannot be ranked there; a note then says why."""
    receipt: Envelope
    earlier: list[EarlierResult] = Field(default_factory=list)
    """Results from before it was scored again, the earliest first; empty while scores are held
    back."""


class ScoredSubmission(WireModel):
    """A scored submission."""

    id: SubmissionId
    split: SplitName
    team: TeamName
    person: PersonName
    sha256: Sha256
    received_at: datetime
    method: Method
    report: ScoreReport
    receipt: Envelope
    """Signed; it has no scores while these are held back."""
    earlier: list[EarlierResult] = Field(default_factory=list)
    """Results from before it was scored again, the earliest first; empty while scores are held
    back."""
    boards: dict[str, BoardResult] = Field(default_factory=dict, examples=[{}])
    """Results on the other leaderboards of the split, by name."""
    scores_held_until: datetime | None = None
    """When the scores are released, UTC: the end of the phase. Null if they already are."""
    status: Literal["unpublished", "published", "withdrawn"]
    published_at: datetime | None
    withdrawn_at: datetime | None
    anonymous_until: datetime | None
    shows_episodes: bool = False
    """Whether everyone may look at its episodes while it is published."""
    upload_deleted_at: datetime | None = None
    """When the file was deleted, if the server deletes unpublished files after a while."""

    @property
    def results(self) -> Mapping[str, BoardResult]:
        """All its results by leaderboard; the split's main leaderboard is first and named ""."""
        main = BoardResult(report=self.report, receipt=self.receipt, earlier=self.earlier)
        return {"": main, **self.boards}


class Checked(ValidationReport):
    """The reply to a check of a valid submission."""

    quota: QuotaReport
    """The submissions left; a check does not use one."""


class Accepted(WireModel):
    """The reply to an upload."""

    submission: ScoredSubmission
    quota: QuotaReport
    is_repeat: bool
    """Whether this file or Idempotency-Key was scored before; then no submission was used."""
    ignored: list[str] = Field([], examples=[["name", "extra_data"]])
    """After a repeat, what this upload says otherwise than what is stored. The stored values stay;
    ``PATCH /api/v1/submissions/{submission_id}`` changes those of the method."""


class SubmissionChange(WireModel):
    """What a team may change later; fields that are left out stay as they are."""

    method: MethodChange | None = Field(None, examples=[{"name": "Walker 2"}])
    published: bool | None = Field(None, examples=[True])
    """Whether it is on the leaderboard."""
    withdrawn: bool | None = None
    """Whether it is withdrawn; it still counts, and must be restored before it can be published."""
    anonymous_until: Instant | None = Field(None, examples=["2027-07-01T12:00:00Z"])
    """Until when the leaderboard hides the team's name; null shows it now."""
    shows_episodes: bool | None = None
    """Whether everyone may look at its episodes while it is published; for open splits only."""


class PublicReview(WireModel):
    """The organiser's verdict on a published result."""

    verdict: Verdict
    reason: str = Field(examples=["We ran the published code and got the same file."])
    reviewer: OrganiserName
    """The organiser, under the public name that the server has now."""
    created_at: datetime


class LeaderboardRow(WireModel):
    """A published result."""

    rank: int | None = Field(examples=[1])
    """Equal for equal values of the metric that rows are sorted by; null without a value, and for a
    reported result."""
    rank_interval: tuple[int, int] | None = Field(None, examples=[[1, 3]])
    """The best and the worst rank that it may have, with 95 % confidence for all rows at once. Null
    in snapshots, without a rank, and if more than 100 results are ranked."""
    group: int | None = Field(None, examples=[1])
    """From 1; no result of a group is significantly worse than the group's best. Null whenever the
    rank interval is."""
    submission_id: SubmissionId | None
    """Null for a reported result."""
    team: TeamName
    """Empty while the team is anonymous."""
    method: ReportedMethod
    """``reference`` is null for a submission."""
    published_at: datetime
    """When it was published on this leaderboard."""
    submissions: int | None = Field(examples=[3])
    """Number of the team's submissions to the split, even while it is anonymous: a result may be
    the best of many. Null for a reported result."""
    scores: dict[str, float]
    intervals: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """Lower and upper ends of the headline metrics' 95 % intervals; only for open splits."""
    signature: str = ""
    """Everything that the scores depend on; empty for a reported result."""
    standing: Standing = "ranked"
    """Whether it is ranked, or why not: it is reported and was not scored here, perhaps on another
    version of the dataset; it was scored under another protocol or ground truth than the split's;
    or the organiser has disqualified it."""
    source: str = ""
    """Where a reported result is from: a link or a text."""
    reported_date: str | None = None
    """The day, month or year of a reported result; null if unknown."""
    dataset: str = ""
    """The version of the dataset that a reported result is on; empty if unknown."""
    reviews: list[PublicReview] = Field(default_factory=list)


class CorrectionReport(WireModel):
    """A change of a split's ground truth or rules, after which its submissions are scored again."""

    split: SplitName
    board: BoardName = ""
    created_at: datetime
    reason: str = Field(examples=["Targets of 40 episodes were corrected."])
    signature: str
    """The signature of scores since then."""


class Leaderboard(WireModel):
    """The published results of a split."""

    split: SplitName
    board: BoardName = ""
    protocol: str
    metric: str
    """The metric that rows are sorted by; rows without it come last."""
    fingerprint: Fingerprint
    signature: str = ""
    """The signature of every ranked row, without the version that scored it."""
    rows: list[LeaderboardRow]
    """The best first. Reported results are among the others, without a rank."""
    apart: list[LeaderboardRow] = Field(default_factory=list)
    """Rows that are not comparable with the others, or disqualified."""
    corrections: list[CorrectionReport] = Field(default_factory=list)
    """The latest first."""


class SnapshotEntry(WireModel):
    """A snapshot of a leaderboard, without its results."""

    split: SplitName
    number: int = Field(examples=[1])
    """From 1, by split."""
    title: str = Field(examples=["CVPR 2027 challenge"])
    as_of: AwareDatetime
    """The time of the copy."""


class Snapshot(SnapshotEntry):
    """A copy of a leaderboard, which never changes; it is signed in an envelope."""

    schema_version: int = SIGNED_VERSION
    server: str = Field(examples=["REVERIE evaluation server"])
    """The server's title."""
    leaderboard: Leaderboard


class ProblemDocument(WireModel):
    """An error, as defined in RFC 9457."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    code: str
    """Stable, for programs."""
    problems: list[ProblemReport] = Field(default_factory=list)
    """What is wrong with the submission, each with its location."""
    quota: QuotaReport | None = None
    reply: str | None = None
    """For organisers only: the text to send to the person whose file was refused."""
    request_id: str | None = None
    """Set if the server failed: with it, the organiser can find the cause in the log."""


class JobReport(WireModel):
    """Work that the server does by itself."""

    name: str
    """`snapshots`, `tidying`, `phase ends`, `mail`, `webhook`, `warm-up` or `methods`."""
    runs: int
    """How often it has run since the server started."""
    failures: int
    """How many of these runs failed."""
    last_run_at: datetime | None
    last_success_at: datetime | None
    error: str
    """Why the last run failed, in one line; empty if it did not."""
    is_overdue: bool
    """Whether it is still running, longer than it may."""
    backlog: dict[str, int]
    """What is still to do, by kind; empty if that is not known."""


JOB = "job "
"""Before the name of a job among the checks that failed."""
LEADERBOARDS = "leaderboards"
"""The check that every leaderboard can be shown."""


class HealthReport(WireModel):
    """Whether the server can do its work."""

    status: Literal["ok", "unhealthy"]
    failed: list[str] = Field(default_factory=list)
    """What does not work: `database`, `uploads`, the scoring of a split, or a job: `job mail`."""
    jobs: list[JobReport] = Field(default_factory=list)
    """What the server does by itself; the jobs that `failed` names failed last time, or hang."""
    remedies: dict[str, str] = Field(default_factory=dict)
    """What each of them means, and what the organiser can do."""

    @classmethod
    def of(cls, remedies: dict[str, str], jobs: list[JobReport]) -> Self:
        """Return a report on the checks that failed, with what to do about each."""
        status: Literal["ok", "unhealthy"] = "unhealthy" if remedies else "ok"
        return cls(status=status, failed=list(remedies), remedies=remedies, jobs=jobs)

    def readiness(self) -> Self:
        """Return the report of what requests need.

        Without jobs, and single results that are damaged.
        """
        remedies, others = self.remedies.items(), (JOB, LEADERBOARDS)
        own = {name: text for name, text in remedies if not name.startswith(others)}
        return self.of(own, [])
