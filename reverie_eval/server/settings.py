"""An organiser's settings: ``reverie-eval.toml`` and ``REVERIE_EVAL_*`` environment variables.

Relative paths are relative to the server's folder, which contains the file. Environment variables
override the file: ``REVERIE_EVAL_DATABASE``, ``REVERIE_EVAL_SPLITS__test__protocol``. Secrets are
files or environment variables, never arguments.
"""

import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, time, timedelta
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeAlias, get_args, get_origin
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    HttpUrl,
    IPvAnyNetwork,
    NonNegativeInt,
    PositiveInt,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict
from pydantic_settings import SettingsError as UnreadableVariableError

from reverie_eval.errors import Problem, ProtocolError, RejectedError
from reverie_eval.ground_truth import GROUND_TRUTH_VARIABLE
from reverie_eval.reporting.skyboxes import PANORAMAS_VARIABLE
from reverie_eval.schemas.service import Phase, Phases, ReleaseScores, first_overlap
from reverie_eval.schemas.wire import (
    SERVER_VARIABLE,
    TOKEN_VARIABLE,
    Email,
    Https,
    Line,
    Name,
    wrong_value,
)
from reverie_eval.scoring import DEFAULT_PROTOCOL, Track
from reverie_eval.tasks import DEFAULT_TASK, Task, find_task
from reverie_eval.text import did_you_mean

if TYPE_CHECKING:
    from sqlalchemy import URL

SETTINGS_FILE = "reverie-eval.toml"
_PREFIX = "REVERIE_EVAL_"
_NO_SETTINGS = frozenset(
    {GROUND_TRUTH_VARIABLE, PANORAMAS_VARIABLE, SERVER_VARIABLE, TOKEN_VARIABLE}
)
"""Environment variables of other commands."""
_SET_BY_COMMANDS: Mapping[str | int, str] = {
    "banner": "reverie-eval server news banner",
    "paused": "reverie-eval server phase pause",
}
"""What may be looked for in the settings, but is changed without a restart."""
_POSTGRESQL = "postgresql+psycopg://USER:PASSWORD@HOST/NAME"
_DATABASES = f"must be an SQLite file, sqlite:///FILE, or PostgreSQL, {_POSTGRESQL}"

Metadata: TypeAlias = Literal[
    "description",
    "paper",
    "code",
    "extra_data",
    "pre_exploration",
    "ground_truth_objects",
    "ensemble",
]
"""Fields of a method that can be required; a required flag must be declared true or false."""


class SettingsError(RejectedError):
    """The settings of a server are invalid."""

    subject = "settings"


def _known_task(name: str) -> str:
    try:
        return find_task(name).name
    except ProtocolError as error:
        raise ValueError(str(error)) from None


def _known_protocol(name: str, info: ValidationInfo) -> str:
    """Check the name of a protocol of the split's task, and replace an alias."""
    if "task" not in info.data:  # there is no such task, which is reported
        return name
    try:
        return find_task(info.data["task"]).protocol(name).name
    except ProtocolError as error:
        raise ValueError(str(error)) from None


def _plain_name(name: str) -> str:
    """Check the name of another leaderboard, which is part of addresses and of file names."""
    if not _PLAIN_NAME.fullmatch(name):
        raise ValueError(
            f"{name!r} must have up to 40 lower-case letters, digits, - and _, and begin with a "
            "letter"
        )
    return name


def _known_database(address: str) -> str:
    """Check the URL of a database.

    A password is allowed only before the ``@``: it is hidden in messages, and checked for being
    easy to guess, only there.
    """
    from sqlalchemy import make_url  # which takes a tenth of a second, and scoring does not need
    from sqlalchemy.exc import ArgumentError

    try:
        url = make_url(address)
    except (ArgumentError, ValueError):  # whose message may contain a part of the password
        raise ValueError(_DATABASES) from None
    if not _is_file(address) and url.drivername != "postgresql+psycopg":
        raise ValueError(_DATABASES)
    if {"user", "password"} & url.query.keys():
        raise ValueError(f"user and password must come before the @: {_POSTGRESQL}")
    return address


def _is_file(address: str) -> bool:
    name = address.removeprefix("sqlite:///")
    return name != address and name not in ("", ":memory:") and "?" not in name


def _known_store(place: str) -> str:
    """Check the place of uploads."""
    address = urlsplit(place)
    is_folder = "://" not in place and address.scheme != "s3"
    if not is_folder and not (address.scheme == "s3" and address.netloc):
        raise ValueError("must be a folder, or an S3-compatible store, s3://BUCKET/PREFIX")
    return place


def _known_address(address: str) -> str:
    """Check the server's public address; empty if it is not set."""
    if not address:
        return address
    url = _URL.validate_python(address)
    is_plain = _PLAIN_PATH.fullmatch((url.path or "").rstrip("/"))
    if url.username or url.password or url.query or url.fragment or not is_plain:
        raise ValueError(
            "must be a scheme and a host, https://eval.example.org, or also a path of letters, "
            "digits and -._~, https://lab.example.org/reverie"
        )
    return str(url).rstrip("/")


_URL: TypeAdapter[HttpUrl] = TypeAdapter(HttpUrl)
_EMAIL: TypeAdapter[str] = TypeAdapter(Email)
_PLAIN_NAME = re.compile(r"[a-z][a-z0-9_-]{0,39}")
_PLAIN_PATH = re.compile(r"(/[A-Za-z0-9._~-]+)*")
"""Written in the same way in a browser's address, an HTTP request, HTML and a proxy's settings."""


def _known_contact(text: str) -> str:
    """Check how to reach the organiser; empty if it is not set."""
    try:
        if text.startswith("https://"):
            return str(_URL.validate_python(text))
        return text and _EMAIL.validate_python(text)
    except ValidationError:
        message = "must be an e-mail address, or a link that begins with https://"
        raise ValueError(message) from None


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class Quota(_Section):
    """Scored submissions of a team, and of each person in it, in rolling windows."""

    day: NonNegativeInt = 2
    """Scored submissions in 24 hours, for a team and for each person in it; 200 for open splits."""
    month: NonNegativeInt = 10
    """In 30 days; 2,000 for open splits."""
    year: NonNegativeInt = 40
    """In 365 days; 10,000 for open splits."""


OPEN_QUOTA = Quota(day=200, month=2000, year=10000)
"""For splits with a public solution: limits scripts, not people."""


class BoardRules(_Section):
    """Another leaderboard of a split: the same submissions, ranked under other rules."""

    protocol: str | None = None
    """The rules of another leaderboard of the same uploads; by default the split's."""
    track: Track | None = None
    """The leaderboard's track; by default the split's."""


class Split(_Section):
    """A split that accepts submissions."""

    bundle: Path
    """The split's ground truth, with the solution."""
    task: Annotated[str, AfterValidator(_known_task)] = DEFAULT_TASK
    """The benchmark that the split belongs to. Unless it is REVERIE, the split's name begins with
    the task: ``r2r-val_unseen``."""
    visibility: Literal["private", "open"] = "private"
    """``private``: only means rounded to two decimals are released, never values of single
    episodes. ``open``: the solution is public, and the values of every episode are released."""
    protocol: Annotated[str, AfterValidator(_known_protocol)] = DEFAULT_PROTOCOL
    """The rules to score by."""
    track: Track = "full"
    """``grounding``: answers alone are scored, with the agent placed at the goal, and leaderboards
    rank by RGS. After a change, earlier results are listed separately, as after a change of the
    protocol."""
    quota: Quota | None = None
    phases: Phases = (Phase(name="always"),)
    """The phases, until others are set at the desk. They must not overlap."""
    release_scores: ReleaseScores = "at-once"
    """``phase-end``: nobody sees the scores of a private split, on its leaderboard or elsewhere,
    before the end of the phase in which the submission was received. Every phase needs
    ``closes``."""
    one_per_team: bool = False
    """Publishing a submission takes the team's earlier one off the leaderboard."""
    boards: dict[Annotated[str, AfterValidator(_plain_name)], BoardRules] = {}  # pydantic copies it
    """Other leaderboards, by name."""

    @field_validator("boards")
    @classmethod
    def _boards_by_known_protocols(
        cls, boards: Mapping[str, BoardRules], info: ValidationInfo
    ) -> Mapping[str, BoardRules]:
        return {
            name: rules.model_copy(
                update={"protocol": rules.protocol and _known_protocol(rules.protocol, info)}
            )
            for name, rules in boards.items()
        }

    @model_validator(mode="after")
    def _each_board_has_rules_of_its_own(self) -> Self:
        known = {(self.protocol, self.track): "the split"}
        for name in self.boards:
            ranked = self.ranked_on(name)
            other = known.setdefault((ranked.protocol, ranked.track), f"boards.{name}")
            if other != f"boards.{name}":
                raise ValueError(
                    f"boards.{name} has the protocol and the track of {other}; give it another "
                    "protocol or track, or remove it"
                )
        return self

    def ranked_on(self, name: str) -> Self:
        """Return the split with the rules of another leaderboard."""
        rules = self.boards[name]
        changed = {"protocol": rules.protocol or self.protocol, "track": rules.track or self.track}
        return self.model_copy(update={**changed, "boards": {}})

    @model_validator(mode="after")
    def _phases_can_apply(self) -> Self:
        self.check_phases(self.phases, self.release_scores)
        return self

    def check_phases(self, phases: Sequence[Phase], release_scores: ReleaseScores) -> None:
        """Check that each submission is in one phase, and that scores are held back until an end.

        Raises
        ------
        ValueError
            If phases overlap, one has no end that needs one, or the solution is public anyway.
        """
        if release_scores == "phase-end" and self.visibility == "open":
            raise ValueError("scores of an open split cannot be held back; its solution is public")
        for phase in phases if release_scores == "phase-end" else ():
            if phase.closes is None:
                message = "scores can be held back only if every phase has `closes`"
                raise ValueError(f"{message}, and {phase.name!r} has none")
        if pair := first_overlap(phases):
            told = " and ".join(f"{each.name!r} ({each.period or 'always open'})" for each in pair)
            first, second = pair
            remedy = f"{first.name!r} must close before {second.name!r} opens"
            raise ValueError(f"the phases {told} overlap; {remedy}")

    @property
    def effective_quota(self) -> Quota:
        """The limits that were set, and defaults by visibility for the others."""
        default = Quota() if self.visibility == "private" else OPEN_QUOTA
        decided = self.quota.model_dump(exclude_unset=True) if self.quota else {}
        return default.model_copy(update=decided)


class Limits(_Section):
    """Limits on requests."""

    upload_mebibytes: PositiveInt = 32
    """Size of a request's body."""
    unpacked_mebibytes: PositiveInt = 64
    """Size of the submission in it."""
    mebibytes_per_day: PositiveInt = 1024
    """Total size of the submissions that a team may send in 24 hours, unpacked, to all splits."""
    seconds_for_body: PositiveInt = 60
    """Time for an upload to arrive."""
    kibibytes_per_second: PositiveInt = 16
    """The slowest that an upload may be sent on average, after its first 10 seconds."""
    requests_per_minute: PositiveInt = 120
    """Requests from each address, with each token, and in each browser session."""
    uploads_at_once: PositiveInt = 32
    """Uploads in memory: arriving, waiting to be scored, or being scored."""
    uploads_waiting: NonNegativeInt = 500
    """Uploads waiting to be read; beyond that, clients are told to try again later."""


Event: TypeAlias = Literal["submission", "same-file", "join-request", "phase-end", "unhealthy"]
"""What the organiser can be notified of."""


class Channel(_Section):
    """A way to notify the organiser of events."""

    events: tuple[Event, ...] = ()
    """The events to report: ``submission``, ``same-file``, ``join-request``, ``phase-end``,
    ``unhealthy``; if empty, all of them."""

    def wants(self, event: Event) -> bool:
        """Whether the organiser is notified of an event."""
        return not self.events or event in self.events

    def due(self, now: datetime) -> datetime:
        """Return when to send a message about what happens now."""
        return now


class Mail(Channel):
    """E-mail, by SMTP."""

    host: Name
    """The SMTP server. Without a section ``[mail]``, no mail is sent."""
    port: PositiveInt = 587
    """The SMTP server's port."""
    security: Literal["starttls", "tls", "none"] = "starttls"
    """``tls``: encrypted from the first byte, usually on port 465. ``none``: for a mail server on
    the same machine."""
    user: str = ""
    """The user name; empty if the mail server does not need one."""
    password: Annotated[str, Field(repr=False)] = ""
    """The password; set it in ``REVERIE_EVAL_MAIL__PASSWORD``, or use ``password_file``."""
    password_file: Path | None = None
    """A file that contains only the password and that only its owner can read. Backups leave it
    out."""
    sender: Email
    """The address that mails are sent from."""
    recipients: Annotated[tuple[Email, ...], Field(min_length=1)]
    """The addresses that mails are sent to."""
    digest: Literal["none", "daily"] = "none"
    """``daily``: one mail a day, after midnight UTC."""

    def due(self, now: datetime) -> datetime:
        """Return when to send a message about what happens now: maybe at midnight."""
        if self.digest == "none":
            return now
        return datetime.combine(now.date() + timedelta(days=1), time(), tzinfo=UTC)


class Webhook(Channel):
    """A program that is notified over HTTP."""

    url: HttpUrl
    """Where to send events as JSON. Without a section ``[webhook]``, nothing is sent."""
    secret: Annotated[str, Field(repr=False)] = ""
    """Signs each request; belongs in ``REVERIE_EVAL_WEBHOOK__SECRET``. Not signed if empty."""


class Settings(BaseSettings):
    """All settings of a server."""

    model_config = SettingsConfigDict(
        frozen=True,
        extra="forbid",
        env_prefix=_PREFIX,
        env_nested_delimiter="__",
        use_attribute_docstrings=True,
    )

    title: Name = "REVERIE evaluation server"
    """The server's name, also on receipts."""
    organiser: Name = "the organiser"
    """The name under which you act in public, for example on reviews: that of a lab or a workshop.
    After a change and a restart, everything has the new name, except snapshots that were signed
    with the earlier one."""
    public_address: Annotated[str, AfterValidator(_known_address)] = ""
    """How people reach the server: ``https://eval.example.org``, or with a path if all its
    addresses are below one, ``https://lab.example.org/reverie``. Printed in citations and
    instructions. If empty, the address that the server listens at is printed."""
    contact: Annotated[Line, AfterValidator(_known_contact)] = ""
    """How to reach the organiser: an e-mail address, or a link that begins with ``https://``. Shown
    at the end of all pages, where people sign in, and with errors."""
    links: dict[Name, Https] = {}  # pydantic copies it
    """Links at the end of all pages, by their text: paper, data, code, licence. *Get the data* on
    the first page leads to the link called ``Data``, or else to the published repository."""
    database: Annotated[str, AfterValidator(_known_database)] = "sqlite:///server.db"
    """An SQLite file, or PostgreSQL, ``postgresql+psycopg://user@host/name``; a password comes
    before the ``@``."""
    uploads: Annotated[str, AfterValidator(_known_store)] = "uploads"
    """A folder, or an S3-compatible store, ``s3://bucket/prefix``."""
    keep_uploads_days: PositiveInt | None = None
    """Files of unpublished submissions are deleted after this many days; scores and receipts stay.
    If not set, all files are kept."""
    signing_key: Path = Path("signing-key.pem")
    """The key that signs receipts; ``server init`` creates it. Keep a copy elsewhere. Anyone can
    verify receipts with the public key that the server publishes."""
    accept_requests_to_join: bool = True
    """Let anyone request an account at ``/join``; an organiser decides."""
    splits: Annotated[dict[str, Split], Field(min_length=1)]
    required_metadata: tuple[Metadata, ...] = ()
    """What a submission must state about its method besides the name: ``description``, ``paper``,
    ``code``, ``extra_data``, ``pre_exploration``, ``ground_truth_objects``, ``ensemble``. The last
    four must be declared as true or false."""
    limits: Limits = Limits()
    mail: Mail | None = None
    webhook: Webhook | None = None
    trusted_proxies: tuple[IPvAnyNetwork, ...] = ()
    """Addresses and networks of the proxies in front of the server, whose ``X-Forwarded-For`` is
    trusted."""
    _folder: Path

    @classmethod
    def of(cls, folder: Path, content: Mapping[str, Any]) -> Self:
        """Check the settings of the server in a folder.

        Raises
        ------
        SettingsError, ValidationError
            If a key is unknown or a value invalid.
        """
        hidden = [key for key in content if key.startswith("_")]
        if hidden:  # pydantic would treat them as options of its own
            raise SettingsError([_no_setting([key]) for key in hidden])
        settings = cls(**content)
        # Path.resolve() would fail at a link that leads to itself.
        settings._folder = Path(os.path.realpath(folder))
        if settings._folder.is_relative_to(os.path.realpath(settings.path(settings.uploads))):
            remedy = "is the server's folder or contains it; choose a separate folder for uploads"
            raise SettingsError([Problem("wrong-setting", "uploads", remedy)])
        return settings

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],  # noqa: ARG003  # the library's signature
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003
        file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Let environment variables override the file."""
        return env_settings, init_settings

    @property
    def folder(self) -> Path:
        """The server's folder, which contains the settings file."""
        return self._folder

    def path(self, relative: Path | str) -> Path:
        """Return a path in the settings relative to the server's folder."""
        return self.folder / relative

    @property
    def tasks(self) -> Mapping[str, Task]:
        """The task of each split, by the split's name."""
        return {name: find_task(split.task) for name, split in self.splits.items()}

    @property
    def path_prefix(self) -> str:
        """The path of the public address: ``/reverie``; empty if the server has its own host."""
        return urlsplit(self.public_address).path

    @property
    def channels(self) -> Mapping[str, Channel]:
        """The ways to notify the organiser of events, by name."""
        known = {"mail": self.mail, "webhook": self.webhook}
        return {name: channel for name, channel in known.items() if channel is not None}

    @property
    def mail_password(self) -> str:
        """The password of the mail server; raises OSError if its file cannot be read."""
        if self.mail is None:
            return ""
        if self.mail.password_file is None:
            return self.mail.password
        return self.path(self.mail.password_file).read_text(encoding="utf-8").strip()

    @property
    def database_url(self) -> "URL":
        """The database's URL; the path of an SQLite file is relative to the server's folder."""
        from sqlalchemy import make_url

        url = make_url(self.database)
        if url.drivername != "sqlite":
            return url
        # Set as a part, not parsed: a "?" in the folder's name would begin the query.
        return url.set(database=str(self.path(str(url.database))))


def variables_set() -> Sequence[str]:
    """Return the names of environment variables that override a setting."""
    return sorted(filter(_is_setting, os.environ))


def variables_ignored() -> Sequence[str]:
    """Return the names of environment variables with our prefix that are not settings.

    They may be misspelt. They are not a fault, because orchestrators also set variables that begin
    with the name of a service.
    """
    ours = {name for name in os.environ if name.startswith(_PREFIX)} - _NO_SETTINGS
    return sorted(name for name in ours if not _is_setting(name))


def _is_setting(variable: str) -> bool:
    name, _, _ = variable.lower().removeprefix(_PREFIX.lower()).partition("__")
    return variable.lower().startswith(_PREFIX.lower()) and name in Settings.model_fields


def load_settings(folder: Path) -> Settings:
    """Read the settings of the server in a folder.

    SettingsError lists all problems with their keys.
    """
    file = folder / SETTINGS_FILE
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
        return Settings.of(folder, content)
    except FileNotFoundError:
        remedy = f"there is no {SETTINGS_FILE}; create one with `reverie-eval server init {folder}`"
        raise SettingsError([Problem("no-settings", str(folder), remedy)]) from None
    except OSError as error:
        raise SettingsError([Problem("no-settings", str(file), f"{error.strerror}")]) from None
    except UnicodeDecodeError as error:
        reason = f"invalid UTF-8 from byte {error.start} on; restore it from a backup"
        raise SettingsError([Problem("not-toml", str(file), reason)]) from None
    except tomllib.TOMLDecodeError as error:
        raise SettingsError([Problem("not-toml", str(file), str(error))]) from None
    except UnreadableVariableError as error:
        raise SettingsError([Problem("wrong-setting", _PREFIX, str(error))]) from None
    except ValidationError as error:
        raise SettingsError(list(_problems(error))) from None


def _problems(error: ValidationError) -> Iterator[Problem]:
    for detail in error.errors(include_url=False):
        # A wrong name of a leaderboard is at "[key]" below itself.
        key = ".".join(str(part) for part in detail["loc"] if part != "[key]")
        if detail["type"] == "extra_forbidden":
            yield _no_setting(detail["loc"])
            continue
        message = wrong_value(detail).message.replace("an object", "a table")  # as TOML calls it
        # The database's URL may contain a password, so it is not repeated.
        is_secret = key.rpartition(".")[2] in {"database", "password", "secret"}
        given = detail["input"]
        is_repeated = isinstance(given, str) and repr(given) in message
        is_shown = isinstance(given, str | int | float) and not (is_secret or is_repeated)
        found = f"got {given!r}; " if is_shown else ""
        yield Problem("wrong-setting", key, found + message)


def _no_setting(place: Sequence[str | int]) -> Problem:
    *parents, name = place
    command = _SET_BY_COMMANDS.get(name)
    hint = (
        f"; remove it, and use `{command}`"
        if command
        else did_you_mean(name, _settings_in(parents))
    )
    return Problem("wrong-setting", ".".join(map(str, place)), f"is not a setting{hint}")


def _settings_in(place: Iterable[str | int]) -> Iterable[str]:
    """Return the names of the settings in a section: ``splits``, ``test``, ``quota``."""
    kind: Any = Settings
    for part in place:
        fields = getattr(kind, "model_fields", None)
        kind = _without_none(fields[part].annotation if fields else _entry_of(kind))
    names: Iterable[str] = kind.model_fields
    return names


def _entry_of(kind: Any) -> Any:
    """Return the type of the values of a dict, or of the entries of a tuple."""
    arguments = get_args(kind)
    return arguments[1] if get_origin(kind) is dict else arguments[0]


def _without_none(kind: Any) -> Any:
    """Return the section that ``Section | None`` allows."""
    return get_args(kind)[0] if isinstance(kind, UnionType) else kind
