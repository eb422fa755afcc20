"""The tables of the database."""

import hashlib
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Literal, TypeVar
from unicodedata import category, normalize

from pydantic import BaseModel, ValidationError
from sqlalchemy import (
    JSON,
    DateTime,
    Dialect,
    ForeignKey,
    Index,
    String,
    TypeDecorator,
    literal,
    text,
)
from sqlalchemy.ext.hybrid import hybrid_property
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship

from reverie_eval.schemas.organising import AttemptReport, TokenKind
from reverie_eval.schemas.service import (
    BoardResult,
    Method,
    ReleaseScores,
    Role,
    ScoredSubmission,
    Verdict,
)
from reverie_eval.server.store.database import UnreadableValueError

Report = TypeVar("Report", bound=BaseModel)


def read_stored(model: type[Report], stored: object) -> Report:
    """Return a stored JSON value, or a row, as a model.

    Raises UnreadableValueError if it is of another shape.
    """
    try:
        return model.model_validate(stored)
    except ValidationError:
        raise UnreadableValueError(f"a stored {model.__name__} cannot be read") from None


class UtcDateTime(TypeDecorator[datetime]):
    """A time, always stored in UTC, because SQLite does not store time zones."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Convert to UTC; times without a time zone are refused."""
        if value is not None and value.tzinfo is None:
            raise ValueError(f"{value} has no time zone")
        return None if value is None else value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Return the time in UTC; PostgreSQL uses the time zone of its settings."""
        if value is None or value.tzinfo is None:
            return value and value.replace(tzinfo=UTC)
        return value.astimezone(UTC)

    def result_processor(self, dialect: Dialect, coltype: object) -> Callable[[Any], Any]:
        """Read a time as the database stores it.

        Raises UnreadableValueError if it is not one, which SQLite does not check.
        """
        process = super().result_processor(dialect, coltype) or _unchanged

        def read(stored: Any) -> Any:
            try:
                return process(stored)
            except (TypeError, ValueError):
                raise UnreadableValueError("a stored time cannot be read") from None

        return read


def _unchanged(value: Any) -> Any:
    return value


class Base(DeclarativeBase):
    """Base of all rows."""

    type_annotation_map = {  # noqa: RUF012  # read by the library's metaclass
        datetime: UtcDateTime(),
        dict[str, Any]: JSON,
        list[dict[str, Any]]: JSON,
        Role: String(16),
        TokenKind: String(16),
        Verdict: String(16),
        ReleaseScores: String(16),
    }

    def as_report(self, model: type[Report], /, **given: Any) -> Report:
        """Return the row as a report, with its columns for all fields that are not given.

        Raises UnreadableValueError if a column has a value that the report may not have.
        """
        columns = {name: getattr(self, name) for name in model.model_fields if name not in given}
        return read_stored(model, columns | given)


def name_key(name: str) -> str:
    """Return the same text for all names of a team that look alike.

    Case, spaces, the width and form of characters, and kinds of dashes make no difference. A digest
    has the same length for every name, which an index needs.

    Examples
    --------
    >>> name_key("Team 01") == name_key("team  01"), name_key("Team 01") == name_key("Team 02")
    (True, False)
    """
    alike = normalize("NFKC", normalize("NFKC", name).casefold())
    plain = "".join("-" if category(each) == "Pd" or each == "\u2212" else each for each in alike)
    return hashlib.sha256(" ".join(plain.split()).encode()).hexdigest()


class Team(Base):
    """People who submit together and share a quota."""

    __tablename__ = "team"

    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(100), unique=True)
    name_key: Mapped[str] = mapped_column(
        String(64), unique=True, default=lambda row: name_key(row.get_current_parameters()["name"])
    )
    """By :func:`name_key`: no other team may have a name that looks the same."""
    created_at: Mapped[datetime]
    merged_at: Mapped[datetime | None]
    merged_into_id: Mapped[int | None] = mapped_column(ForeignKey("team.id"))
    """The team that has had its people, submissions and grants since."""
    people: Mapped[list["Person"]] = relationship(back_populates="team")
    merged_into: Mapped["Team | None"] = relationship(remote_side="Team.id")


class Person(Base):
    """A person in a team, with a quota of their own."""

    __tablename__ = "person"
    __table_args__ = (Index("one_per_name", "team_id", "name", unique=True),)

    id: Mapped[int] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("team.id"))
    name: Mapped[str] = mapped_column(String(100), index=True)
    name_salt: Mapped[str] = mapped_column(String(32), default="")
    """Drawn at random by each entry of the audit log, so nobody can guess the name from digests."""
    email: Mapped[str | None] = mapped_column(String(254))
    """Never shown to others than organisers and the person."""
    role: Mapped[Role]
    created_at: Mapped[datetime]
    deleted_at: Mapped[datetime | None]
    """When the person's name and address were removed; what they did stays."""
    team: Mapped[Team] = relationship(back_populates="people", lazy="joined", innerjoin=True)

    @hybrid_property
    def is_organiser(self) -> bool:
        """Whether the person sees and manages everything; also a condition in statements."""
        return self.role == "organiser"


Decision = Literal["request accepted", "request rejected"]


class JoinRequest(Base):
    """A request for accounts; what it says of people is removed once it was answered."""

    __tablename__ = "join_request"

    id: Mapped[int] = mapped_column(primary_key=True)
    team: Mapped[str] = mapped_column(String(100))
    people: Mapped[list[dict[str, Any]]]
    """Names and addresses, as in the request."""
    institution: Mapped[str] = mapped_column(String(100))
    purpose: Mapped[str] = mapped_column(String(500))
    digest: Mapped[str] = mapped_column(String(64), index=True)
    """SHA-256 of all of it, to recognise the same request."""
    created_at: Mapped[datetime]
    decision: Mapped[Decision | None] = mapped_column(String(20))
    """None while it is open."""
    decided_at: Mapped[datetime | None]


class Token(Base):
    """A token or invitation of a person; only its digest is stored."""

    __tablename__ = "token"

    id: Mapped[int] = mapped_column(primary_key=True)
    person_id: Mapped[int] = mapped_column(ForeignKey("person.id"), index=True)
    kind: Mapped[TokenKind]
    digest: Mapped[str] = mapped_column(String(64), unique=True)
    hint: Mapped[str] = mapped_column(String(16))
    """The token's first characters, to identify it."""
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]
    """When it was revoked, or when an invitation was used."""
    person: Mapped[Person] = relationship(lazy="joined", innerjoin=True)


class BrowserSession(Base):
    """A browser that signed in with a token."""

    __tablename__ = "browser_session"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    """In the cookie it is signed, so reading this is not enough to forge one."""
    token_id: Mapped[int] = mapped_column(ForeignKey("token.id"), index=True)
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)
    token: Mapped[Token] = relationship(lazy="joined", innerjoin=True)


_SHOWN = text("published_at IS NOT NULL AND withdrawn_at IS NULL")


class Submission(Base):
    """A submission; all stored submissions are scored."""

    __tablename__ = "submission"
    __table_args__ = (
        Index("one_per_file", "split", "team_id", "sha256", "repeat", unique=True),
        Index("one_per_key", "person_id", "idempotency_key", unique=True),
        # Quotas, and the lists of a team; with the size, how much all teams have sent.
        Index("by_team", "team_id", "received_at", "size"),
        Index("by_person", "person_id", "received_at"),
        Index("by_split", "split", "received_at"),
        Index("by_time", "received_at"),
        # The same file from other teams.
        Index("by_file", "split", "sha256"),
        # Leaderboards, which show few of the submissions.
        Index("shown", "split", "published_at", sqlite_where=_SHOWN, postgresql_where=_SHOWN),
    )

    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    split: Mapped[str] = mapped_column(String(64))
    team_id: Mapped[int] = mapped_column(ForeignKey("team.id"))
    person_id: Mapped[int] = mapped_column(ForeignKey("person.id"))
    sha256: Mapped[str] = mapped_column(String(64))
    """The digest of the unpacked submission, which is stored under it."""
    size: Mapped[int]
    received_at: Mapped[datetime]
    """When its last byte arrived; or the e-mail with it, which may be long before it was scored."""
    scored_at: Mapped[datetime]
    """When it was stored with its scores."""
    idempotency_key: Mapped[str | None] = mapped_column(String(200))
    method: Mapped[dict[str, Any]]
    """The team's description of its method."""
    report: Mapped[dict[str, Any]]
    """The score report; for private splits, with rounded means only."""
    receipt: Mapped[dict[str, Any]]
    """An envelope: the bytes that were signed, and their signature."""
    rescored_at: Mapped[datetime | None]
    """When it was last scored again, after a correction."""
    earlier: Mapped[list[dict[str, Any]]] = mapped_column(default=list)
    """The submission's reports and receipts before that, the earliest first."""
    boards: Mapped[dict[str, Any]] = mapped_column(default=dict)
    """On the split's other leaderboards, by name: report, receipt, and those before."""
    published_at: Mapped[datetime | None]
    withdrawn_at: Mapped[datetime | None]
    anonymous_until: Mapped[datetime | None]
    shows_episodes: Mapped[bool] = mapped_column(default=False)
    """Whether everyone may look at its episodes while it is published."""
    upload_deleted_at: Mapped[datetime | None]
    """When its file was deleted, because it was old and not published."""
    repeat: Mapped[str] = mapped_column(String(32), default="")
    """The submission's own id if its team has an earlier submission of the file, else empty.

    Only merging two teams makes repeats; they use no quota. Of the others, the index allows one.
    """
    team: Mapped[Team] = relationship(lazy="joined", innerjoin=True)
    person: Mapped[Person] = relationship(lazy="joined", innerjoin=True)

    @property
    def status(self) -> Literal["unpublished", "published", "withdrawn"]:
        """Whether everyone sees it."""
        if self.withdrawn_at:
            return "withdrawn"
        return "published" if self.published_at else "unpublished"

    @property
    def results(self) -> Mapping[str, BoardResult]:
        """All results by leaderboard, that on the split's main one, which is "", first.

        On another leaderboard, a submission that was received before the leaderboard was added has
        no result until it is scored again.
        """
        own = {"report": self.report, "receipt": self.receipt, "earlier": self.earlier}
        return {
            name: read_stored(BoardResult, stored)
            for name, stored in {"": own, **self.boards}.items()
        }

    def store_result(self, name: str, result: BoardResult) -> None:
        """Store the result on a leaderboard, in place of an earlier one."""
        stored = result.model_dump(mode="json")
        if name:
            self.boards = {**self.boards, name: stored}
        else:
            self.report, self.receipt = stored["report"], stored["receipt"]
            self.earlier = stored["earlier"]

    def as_scored(self) -> ScoredSubmission:
        """Return everything stored about it, including what its team may not see yet."""
        boards = dict(self.results)
        own = boards.pop("")
        return self.as_report(
            ScoredSubmission,
            team=self.team.name,
            person=self.person.name,
            method=read_stored(Method, self.method),
            **dict(own),
            boards=boards,
            scores_held_until=None,
        )


IS_SHOWN = Submission.published_at.is_not(None) & Submission.withdrawn_at.is_(None)
"""Whether everyone sees a submission, for statements."""


class ClusterSums(Base):
    """The sums of a published result over clusters of episodes, from which ranks are compared.

    Of open splits only.
    """

    __tablename__ = "cluster_sums"

    submission_id: Mapped[str] = mapped_column(ForeignKey("submission.id"), primary_key=True)
    board: Mapped[str] = mapped_column(String(64), primary_key=True)
    """Empty for the split's main leaderboard, or the name of another one."""
    sums: Mapped[dict[str, Any]]
    """A list of numbers by metric, in the order of the clusters' numbers."""


class Correction(Base):
    """A change of a split's ground truth or rules, for which its submissions are scored again."""

    __tablename__ = "correction"

    id: Mapped[int] = mapped_column(primary_key=True)
    split: Mapped[str] = mapped_column(String(64), index=True)
    board: Mapped[str] = mapped_column(String(40))
    """A leaderboard of the split; empty for the main one."""
    signature: Mapped[str] = mapped_column(String(500))
    """What scores depend on since."""
    reason: Mapped[str] = mapped_column(String(500))
    created_at: Mapped[datetime]


class Grant(Base):
    """Extra submissions that the organiser granted a team."""

    __tablename__ = "quota_grant"

    id: Mapped[int] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("team.id"), index=True)
    split: Mapped[str] = mapped_column(String(64))
    extra: Mapped[int]
    reason: Mapped[str] = mapped_column(String(500))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime]
    team: Mapped[Team] = relationship(lazy="joined", innerjoin=True)


SUBMITTED, SNAPSHOT_TAKEN, SAME_FILE = "submitted", "snapshot taken", "same file"
UPLOAD_DELETED = "upload deleted"
"""Actions in the audit log that change no leaderboard, or that the desk looks for."""
_CHANGES = text(f"action <> '{SUBMITTED}'")


class AuditEntry(Base):
    """An action; each entry's digest covers the entry and the digest before it."""

    __tablename__ = "audit"
    # Uploads change no leaderboard, and may be most of the entries.
    __table_args__ = (Index("changes", "id", sqlite_where=_CHANGES, postgresql_where=_CHANGES),)

    id: Mapped[int] = mapped_column(primary_key=True)
    at: Mapped[datetime]
    actor: Mapped[str] = mapped_column(String(200), index=True)
    action: Mapped[str] = mapped_column(String(64))
    row: Mapped[str] = mapped_column(String(64))
    """The row that was changed, for programs: ``team:3``."""
    row_digest: Mapped[str] = mapped_column(String(64))
    """The digest of the row since then; empty if the entry does not change one."""
    subject: Mapped[str] = mapped_column(String(200), index=True)
    """The name of the row for people, at that time."""
    details: Mapped[dict[str, Any]]
    previous: Mapped[str] = mapped_column(String(64))
    digest: Mapped[str] = mapped_column(String(64), unique=True)
    seal: Mapped[str] = mapped_column(String(128))
    """The signature of the digest, in hexadecimal digits, with the key that was in use."""


IS_CHANGE = AuditEntry.action != literal(SUBMITTED, literal_execute=True)
"""Whether an entry is not about an upload alone, for statements. The value is written into them, so
that databases recognise the index that has only these."""


class SigningKey(Base):
    """A key that signs receipts, or did; its private part is a file."""

    __tablename__ = "signing_key"

    id: Mapped[int] = mapped_column(primary_key=True)
    key_id: Mapped[str] = mapped_column(String(16), unique=True)
    public_key: Mapped[str] = mapped_column(String(200))
    """In PEM form."""
    valid_from: Mapped[datetime]
    valid_until: Mapped[datetime | None]
    """The key's signatures of submissions that were received later do not count."""
    replaced_at: Mapped[datetime | None]
    """None for the key in use."""
    revoked_at: Mapped[datetime | None]
    """When ``valid_until`` was set to a time before it was replaced."""
    reason: Mapped[str] = mapped_column(String(500))
    """Why it was replaced or revoked."""


class Review(Base):
    """The organiser's public verdict on a submission, until it is lifted."""

    __tablename__ = "review"

    id: Mapped[int] = mapped_column(primary_key=True)
    submission_id: Mapped[str] = mapped_column(ForeignKey("submission.id"), index=True)
    verdict: Mapped[Verdict]
    reason: Mapped[str] = mapped_column(String(500))
    created_at: Mapped[datetime]
    lifted_at: Mapped[datetime | None]
    submission: Mapped[Submission] = relationship()


class ReportedResult(Base):
    """A result that others report and this server has not scored, entered by the organiser."""

    __tablename__ = "reported_result"

    id: Mapped[int] = mapped_column(primary_key=True)
    split: Mapped[str] = mapped_column(String(64), index=True)
    method: Mapped[dict[str, Any]]
    team: Mapped[str] = mapped_column(String(100))
    """Who reports it, as shown on the leaderboard."""
    scores: Mapped[dict[str, Any]]
    """By metric key: fractions in [0, 1] or metres, with the digits that were reported."""
    source: Mapped[str] = mapped_column(String(500))
    date: Mapped[str | None] = mapped_column(String(10))
    """The day, month or year of the result, in ISO 8601; None if it is not known."""
    dataset: Mapped[str] = mapped_column(String(500))
    """The version of the dataset that it is on; empty if it is not known."""
    created_at: Mapped[datetime]
    removed_at: Mapped[datetime | None]


class Notice(Base):
    """A banner, and whether submissions are paused; the latest notice applies."""

    __tablename__ = "notice"

    id: Mapped[int] = mapped_column(primary_key=True)
    banner: Mapped[str] = mapped_column(String(500))
    paused: Mapped[bool]
    created_at: Mapped[datetime]


class SetSchedule(Base):
    """When a split accepts submissions and shows scores, as set at the desk; the latest applies."""

    __tablename__ = "schedule"

    id: Mapped[int] = mapped_column(primary_key=True)
    split: Mapped[str] = mapped_column(String(64), index=True)
    phases: Mapped[list[dict[str, Any]] | None]
    """None: those of the settings."""
    release_scores: Mapped[ReleaseScores | None]
    paused: Mapped[bool]
    created_at: Mapped[datetime]


class StoredSnapshot(Base):
    """A state of a leaderboard, which never changes."""

    __tablename__ = "snapshot"
    __table_args__ = (
        Index("one_per_number", "split", "number", unique=True),
        Index("one_per_closing", "split", "phase", "as_of", unique=True),
    )

    id: Mapped[int] = mapped_column(primary_key=True)
    split: Mapped[str] = mapped_column(String(64))
    number: Mapped[int]
    title: Mapped[str] = mapped_column(String(100))
    phase: Mapped[str | None] = mapped_column(String(100))
    """The phase after which it was taken; None if the organiser took it."""
    as_of: Mapped[datetime]
    envelope: Mapped[dict[str, Any]]
    """The bytes that were signed, and their signature."""
    created_at: Mapped[datetime]


class News(Base):
    """A short dated entry by the organiser, for everyone."""

    __tablename__ = "news"

    id: Mapped[int] = mapped_column(primary_key=True)
    text: Mapped[str] = mapped_column(String(500))
    created_at: Mapped[datetime]
    removed_at: Mapped[datetime | None]


class Message(Base):
    """A message to the organiser, until some time after it was sent."""

    __tablename__ = "message"

    id: Mapped[int] = mapped_column(primary_key=True)
    channel: Mapped[str] = mapped_column(String(16))
    event: Mapped[str] = mapped_column(String(32))
    text: Mapped[str] = mapped_column(String(500))
    path: Mapped[str] = mapped_column(String(200))
    created_at: Mapped[datetime]
    due_at: Mapped[datetime] = mapped_column(index=True)
    """When to send it, or to try again."""
    attempts: Mapped[int]
    sent_at: Mapped[datetime | None]
    given_up_at: Mapped[datetime | None]
    error: Mapped[str] = mapped_column(String(500))
    """Why it could not be sent the last time."""


class Attempt(Base):
    """An upload and its outcome, for the organiser."""

    __tablename__ = "attempt"

    id: Mapped[int] = mapped_column(primary_key=True)
    at: Mapped[datetime] = mapped_column(index=True)
    person_id: Mapped[int] = mapped_column(ForeignKey("person.id"), index=True)
    split: Mapped[str] = mapped_column(String(64))
    outcome: Mapped[str] = mapped_column(String(64))
    """``scored``, ``repeat``, or the code of the problem."""
    problems: Mapped[int]
    """Number of problems in the file."""
    size: Mapped[int]
    """Bytes; after unpacking, if the server got that far."""
    milliseconds: Mapped[int]
    person: Mapped[Person] = relationship(lazy="joined", innerjoin=True)

    def as_seen(self) -> AttemptReport:
        """Return what organisers see of it."""
        return self.as_report(AttemptReport, person=self.person.name, team=self.person.team.name)
