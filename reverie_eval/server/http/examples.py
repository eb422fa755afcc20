"""Examples for the API's description; together they tell the story of one submission."""

from datetime import UTC, datetime

from reverie_eval.metrics import CATALOGUE, PRIMARY_METRIC
from reverie_eval.schemas.organising import (
    AttemptReport,
    AuditReport,
    GrantReport,
    NewGrant,
    NewNotice,
    NewPerson,
    NewReported,
    NewReview,
    NewTeam,
    NewToken,
    NewTokenReport,
    NoticeReport,
    PersonReport,
    ReportedEntry,
    ReviewEntry,
    TeamReport,
    TokenReport,
)
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import (
    Accepted,
    Checked,
    HealthReport,
    Invitation,
    Leaderboard,
    LeaderboardRow,
    Me,
    Method,
    MethodChange,
    PhaseReport,
    QuotaReport,
    QuotaWindow,
    Receipt,
    ServerReport,
    SessionReport,
    SignIn,
    SplitReport,
    SubmissionChange,
    SubmissionReport,
    Welcome,
)
from reverie_eval.schemas.wire import Https
from reverie_eval.scoring import DEFAULT_PROTOCOL
from reverie_eval.server.errors import EXAMPLE_NOW
from reverie_eval.version import __version__

_NOON = EXAMPLE_NOW
_TOMORROW = datetime(2027, 6, 2, 12, tzinfo=UTC)
_NEXT_MONTH = datetime(2027, 7, 1, 12, tzinfo=UTC)
_NEXT_YEAR = datetime(2028, 5, 31, 12, tzinfo=UTC)
_TOKEN = "rv_" + "3Zk0b9Xw" + 35 * "."  # not a real one
_INVITATION = "rv_" + "Yq71mPaa" + 35 * "."
_ID = "5f2b0c9a4d7e1f36"
_SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
_FINGERPRINT = "6f9511abdb3f6c1d8e0a2b4c5d7f9e1032547698badcfe10f0e1d2c3b4a59687"
_SIGNATURE = (
    f"split:test|protocol:{DEFAULT_PROTOCOL}|data:6f9511abdb3f|n:6292|version:{__version__}"
)
_PEOPLE = {"person": "Ada", "team": "Blue"}

_FIGURES = {
    "path_length": 13.47,
    "success": 0.5451,
    "oracle_success": 0.6198,
    "spl": 0.4712,
    "rgs": 0.3605,
    "rgspl": 0.3102,
}
_SCORES = {
    key: _FIGURES.get(key, 0.5)  # valid for every metric
    for key, metric in CATALOGUE.items()
    if metric.headline
}

_QUOTA = QuotaReport(
    remaining=1,
    next_at=None,
    seconds_to_next=0,
    windows=[
        QuotaWindow(name="day", limit=2, remaining=1, resets_at=_TOMORROW),
        QuotaWindow(name="month", limit=10, remaining=9, resets_at=_NEXT_MONTH),
        QuotaWindow(name="year", limit=40, remaining=39, resets_at=_NEXT_YEAR),
    ],
)
_METHOD = Method(
    name="Walker",
    description="A transformer over panoramas, with a pointer to objects.",
    paper=Https("https://example.org/walker.pdf"),
    code=Https("https://example.org/walker"),
    extra_data=True,
)
_REPORT = ScoreReport(
    signature=_SIGNATURE,
    split="test",
    protocol=DEFAULT_PROTOCOL,
    dataset="reverie-v1",
    fingerprint=_FINGERPRINT,
    version=__version__,
    episodes=6292,
    scores=_SCORES,
)
_RECEIPT = Receipt(
    server="REVERIE evaluation server",
    submission_id=_ID,
    team="Blue",
    sha256=_SHA256,
    received_at=_NOON,
    split="test",
    signature=_SIGNATURE,
    scores=_SCORES,
    quota=_QUOTA,
    key_id="0d1c2b3a4f5e6d7c",
    proof="p2l5c2JhZGx5IHNpZ25lZA==",
)
_SUBMISSION = SubmissionReport(
    id=_ID,
    split="test",
    **_PEOPLE,
    sha256=_SHA256,
    received_at=_NOON,
    method=_METHOD,
    report=_REPORT,
    receipt=_RECEIPT,
    status="published",
    published_at=_TOMORROW,
    withdrawn_at=None,
    anonymous_until=_NEXT_MONTH,
)
_TOKEN_REPORT = TokenReport(
    hint=_INVITATION[:11],
    kind="invite",
    person="Ada",
    created_at=_NOON,
    expires_at=_NEXT_MONTH,
    revoked_at=None,
)

_WHY = "We ran the published code and got the same file."
_PAPER = Https("https://arxiv.org/abs/1904.10151")
_PUBLISHED = {"success": 0.1153, "spl": 0.0947, "rgs": 0.0562}
_REVIEW = NewReview(submission_id=_ID, verdict="verified", reason=_WHY)
_REPORTED = NewReported(
    split="test",
    method=Method(name="Interactive Navigator-Pointer", paper=_PAPER),
    team="Qi et al., 2020",
    scores=_PUBLISHED,
    source=_PAPER,
)
_GRANT = NewGrant(
    team="Blue", split="test", extra=2, reason="our disk was full", expires_at=_NEXT_MONTH
)
_NOTICE = NewNotice(banner="Down for maintenance until 09:00 UTC.", paused=True)

_MESSAGES = (
    HealthReport(status="ok"),
    ServerReport(
        title="REVERIE evaluation server",
        version=__version__,
        banner="Down for maintenance on 12 June, 08:00-09:00 UTC.",
        paused=False,
        key_id="0d1c2b3a4f5e6d7c",
        required_metadata=["description"],
    ),
    Me(**_PEOPLE, role="participant"),
    Invitation(invitation=_INVITATION),
    Welcome(**_PEOPLE, token=_TOKEN),
    SignIn(token=_TOKEN),
    SessionReport(**_PEOPLE, role="participant", csrf_token=_ID, expires_at=_TOMORROW),
    SplitReport(
        name="test",
        episodes=6292,
        visibility="private",
        protocol=DEFAULT_PROTOCOL,
        dataset="reverie-v1",
        fingerprint=_FINGERPRINT,
        public_fingerprint=_SHA256,
        phases=[PhaseReport(name="2027", opens=_NOON, closes=_NEXT_YEAR, is_open=True)],
        quota=_QUOTA,
    ),
    Checked(split="test", valid=True, notes=["3 jumps between viewpoints"], quota=_QUOTA),
    _SUBMISSION,
    _RECEIPT,
    Accepted(
        submission=_SUBMISSION.model_copy(
            update={"status": "unpublished", "published_at": None, "anonymous_until": None}
        ),
        quota=_QUOTA,
        is_repeat=False,
    ),
    SubmissionChange(
        method=MethodChange(name="Walker 2"), published=True, anonymous_until=_NEXT_MONTH
    ),
    Leaderboard(
        split="test",
        protocol=DEFAULT_PROTOCOL,
        metric=PRIMARY_METRIC,
        fingerprint=_FINGERPRINT,
        rows=[
            LeaderboardRow(
                rank=1,
                submission_id=_ID,
                team="",
                method=_METHOD,
                published_at=_TOMORROW,
                submissions=None,
                scores=_SCORES,
            )
        ],
    ),
    NewTeam(name="Blue"),
    TeamReport(name="Blue", people=["Ada", "Ben"], created_at=_NOON),
    NewPerson(team="Blue", name="Ada"),
    PersonReport(name="Ada", team="Blue", role="participant", created_at=_NOON),
    NewToken(person="Ada", expires_at=_NEXT_MONTH),
    _TOKEN_REPORT,
    NewTokenReport(**_TOKEN_REPORT.model_dump(), token=_INVITATION),
    _GRANT,
    GrantReport(**_GRANT.model_dump(), created_at=_NOON),
    AuditReport(
        id=17,
        at=_NOON,
        actor="Olga",
        action="granted",
        row="quota_grant:2",
        subject="Blue",
        details={"split": "test", "extra": 2, "reason": "our disk was full"},
        previous=_SHA256,
        digest=_FINGERPRINT,
    ),
    _REVIEW,
    ReviewEntry(**_REVIEW.model_dump(), id=3, reviewer="Olga", created_at=_NOON, lifted_at=None),
    _REPORTED,
    ReportedEntry(
        **_REPORTED.model_dump(mode="json", exclude_unset=True),
        id=1,
        added_by="Olga",
        created_at=_NOON,
    ),
    _NOTICE,
    NoticeReport(**_NOTICE.model_dump(), posted_by="Olga", created_at=_NOON),
    AttemptReport(
        id=41,
        at=_NOON,
        **_PEOPLE,
        split="test",
        outcome="submission-rejected",
        problems=12,
        size=4_204_511,
        milliseconds=38,
    ),
)

EXAMPLES = {
    type(message).__name__: message.model_dump(mode="json", exclude_unset=True)
    for message in _MESSAGES
}
"""By the name of the model."""

BOARD_CSV = (
    "rank,submission_id,team,published_at,...\n1,5f2b0c9a4d7e1f36,Blue,2027-06-02T12:00:00Z,...\n"
)
EPISODES_CSV = "instr_id,path_length,success,...\n4774_267_1,12.5,1.0,...\n"
METRICS = "# TYPE reverie_eval_requests_total counter\n..."
KEY_PEM = "-----BEGIN PUBLIC KEY-----\nMCow...\n-----END PUBLIC KEY-----\n"
SUBMISSION = [
    {"instr_id": "4774_267_1", "trajectory": [["a68b5ae6571e", 3.14, 0.0]], "predObjId": 402}
]

FORM = {"file": "(the result file)", "name": "Walker", "extra_data": True}
