"""What an organiser decides, in ``reverie-eval.toml`` and ``REVERIE_EVAL_*`` variables.

Relative paths are below the server's folder, where the file lies. Variables win over the file:
``REVERIE_EVAL_DATABASE``, ``REVERIE_EVAL_SPLITS__test__protocol``. Secrets are files or variables,
never arguments.
"""

import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    ConfigDict,
    Field,
    IPvAnyNetwork,
    NonNegativeInt,
    PositiveInt,
    ValidationError,
    model_validator,
)
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict
from pydantic_settings import SettingsError as UnreadableVariableError
from sqlalchemy import URL, make_url
from sqlalchemy.exc import ArgumentError

from reverie_eval.client._logins import SERVER_VARIABLE, TOKEN_VARIABLE
from reverie_eval.errors import Problem, ProtocolError, RejectedError
from reverie_eval.ground_truth import GROUND_TRUTH_VARIABLE
from reverie_eval.schemas.wire import Line, Name
from reverie_eval.scoring import DEFAULT_PROTOCOL, find_protocol

SETTINGS_FILE = "reverie-eval.toml"
_PREFIX = "REVERIE_EVAL_"
_NO_SETTINGS = frozenset({GROUND_TRUTH_VARIABLE, SERVER_VARIABLE, TOKEN_VARIABLE})
"""Variables that mean something elsewhere."""
_POSTGRESQL = "postgresql+psycopg://USER:PASSWORD@HOST/NAME"
_DATABASES = f"takes a file of SQLite, sqlite:///FILE, or PostgreSQL, {_POSTGRESQL}"

Metadata: TypeAlias = Literal[
    "description",
    "paper",
    "code",
    "extra_data",
    "pre_exploration",
    "ground_truth_objects",
    "ensemble",
]
"""What a submission may say of its method; its flags, if asked for, as true or as false."""


class SettingsError(RejectedError):
    """The settings of a server are wrong."""

    subject = "settings"


def _known_protocol(name: str) -> str:
    try:
        return find_protocol(name).name
    except ProtocolError as error:
        raise ValueError(str(error)) from None


def _known_database(address: str) -> str:
    """Return the address of a database that a server can keep its rows in.

    A password is looked for in its own place only, to hide it and to try whether it is a good one;
    so it may stand in no other.
    """
    try:
        url = make_url(address)
    except (ArgumentError, ValueError):  # which may repeat a part of the password
        raise ValueError(_DATABASES) from None
    if not _is_file(address) and url.drivername != "postgresql+psycopg":
        raise ValueError(_DATABASES)
    if {"user", "password"} & url.query.keys():
        raise ValueError(f"a user and a password stand before the @: {_POSTGRESQL}")
    return address


def _is_file(address: str) -> bool:
    name = address.removeprefix("sqlite:///")
    return name != address and name not in ("", ":memory:") and "?" not in name


def _known_store(place: str) -> str:
    """Return the place of uploads, if it is a folder's or one that a server can use."""
    address = urlsplit(place)
    is_folder = "://" not in place and address.scheme != "s3"
    if not is_folder and not (address.scheme == "s3" and address.netloc):
        raise ValueError("takes a folder, or an S3-compatible store, s3://BUCKET/PREFIX")
    return place


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class Quota(_Section):
    """How many scored submissions a team, and each person in it, has in rolling windows."""

    day: NonNegativeInt = 2
    """In 24 hours."""
    month: NonNegativeInt = 10
    """In 30 days."""
    year: NonNegativeInt = 40
    """In 365 days."""


OPEN_QUOTA = Quota(day=200, month=2000, year=10000)
"""For splits whose answers everybody has: it keeps scripts in bounds, not people."""


class Phase(_Section):
    """A time in which a split takes submissions."""

    name: Name
    opens: AwareDatetime | None = None
    closes: AwareDatetime | None = None
    """The last second in which submissions are taken, all of it."""

    @model_validator(mode="after")
    def _opens_before_it_closes(self) -> Self:
        if self.opens and self.closes and self.opens >= self.closes:
            raise ValueError("a phase opens before it closes")
        return self

    def is_open(self, now: datetime) -> bool:
        """Whether submissions are taken at this time."""
        has_begun = self.opens is None or self.opens <= now
        return has_begun and (self.closes is None or now.replace(microsecond=0) <= self.closes)


def _some(phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
    if not phases:
        raise ValueError("name a phase, or leave phases out: then submissions are always taken")
    return phases


class Split(_Section):
    """A split that submissions are taken for."""

    bundle: Path
    """The ground truth, with answers."""
    visibility: Literal["private", "open"] = "private"
    """Private: only rounded means leave the server. Open: every episode's values do."""
    protocol: Annotated[str, AfterValidator(_known_protocol)] = DEFAULT_PROTOCOL
    quota: Quota | None = None
    phases: Annotated[tuple[Phase, ...], AfterValidator(_some)] = (Phase(name="always"),)

    @property
    def effective_quota(self) -> Quota:
        """What was set, and the defaults of the visibility for what was not."""
        default = Quota() if self.visibility == "private" else OPEN_QUOTA
        decided = self.quota.model_dump(exclude_unset=True) if self.quota else {}
        return default.model_copy(update=decided)


class Limits(_Section):
    """What a request may cost."""

    upload_mebibytes: PositiveInt = 32
    """Of a request's body."""
    unpacked_mebibytes: PositiveInt = 64
    """Of the submission in it."""
    seconds_for_body: PositiveInt = 60
    """Until an upload must have arrived."""
    requests_per_minute: PositiveInt = 120
    """Of one address, of one token, and of one browser session."""
    uploads_at_once: PositiveInt = 32
    """That are held in memory: coming in, waiting to be scored, or being scored."""
    uploads_waiting: NonNegativeInt = 500
    """That have not been taken in yet; whoever comes then is asked to come again."""


class Settings(BaseSettings):
    """Everything an organiser decides."""

    model_config = SettingsConfigDict(
        frozen=True,
        extra="forbid",
        env_prefix=_PREFIX,
        env_nested_delimiter="__",
        use_attribute_docstrings=True,
    )

    title: Name = "REVERIE evaluation server"
    banner: Line = ""
    """Shown to everybody: maintenance, deadlines."""
    paused: bool = False
    """Take no submissions; everything else goes on."""
    database: Annotated[str, AfterValidator(_known_database)] = "sqlite:///server.db"
    """A file of SQLite, or ``postgresql+psycopg://...``."""
    uploads: Annotated[str, AfterValidator(_known_store)] = "uploads"
    """A folder, or ``s3://bucket/prefix``."""
    signing_key: Path = Path("signing-key.pem")
    """Signs receipts; made by ``server init``, and worth a backup of its own."""
    splits: Annotated[dict[str, Split], Field(min_length=1)]
    required_metadata: tuple[Metadata, ...] = ()
    """What a submission has to say of its method, besides the name."""
    limits: Limits = Limits()
    trusted_proxies: tuple[IPvAnyNetwork, ...] = ()
    """Whose ``X-Forwarded-For`` is believed."""
    metrics_readers: tuple[IPvAnyNetwork, ...] = ()
    """Who may read ``/metrics`` without an organiser's token."""
    _folder: Path

    @classmethod
    def of(cls, folder: Path, content: Mapping[str, Any]) -> Self:
        """Check what was decided for the server in a folder.

        Raises
        ------
        SettingsError, ValidationError
            If anything is no setting, or a wrong one.
        """
        hidden = [key for key in content if key.startswith("_")]
        if hidden:  # the library would take them for its own
            raise SettingsError([_no_setting(key) for key in hidden])
        settings = cls(**content)
        settings._folder = folder.resolve()
        if settings._folder.is_relative_to(settings.path(settings.uploads).resolve()):
            remedy = "is the server's own folder, or around it; name one for uploads alone"
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
        """Let variables win over the file."""
        return env_settings, init_settings

    @property
    def folder(self) -> Path:
        """Where the settings file lies; what is relative is below it."""
        return self._folder

    def path(self, relative: Path | str) -> Path:
        """Return where a path of the settings is."""
        return self.folder / relative

    @property
    def database_url(self) -> URL:
        """The URL, with a file of SQLite below the server's folder."""
        url = make_url(self.database)
        if url.drivername != "sqlite":
            return url
        # Set as a name: in a URL, a folder's "?" would begin the query.
        return url.set(database=str(self.path(str(url.database))))


def variables_set() -> Sequence[str]:
    """Return the names of the variables that are set and change a setting."""
    return sorted(filter(_is_setting, os.environ))


def variables_ignored() -> Sequence[str]:
    """Return the names of the variables that look like ours and change nothing.

    They may be misspelt; but orchestrators set variables too, named after a service, so they are
    no fault.
    """
    ours = {name for name in os.environ if name.startswith(_PREFIX)} - _NO_SETTINGS
    return sorted(name for name in ours if not _is_setting(name))


def _is_setting(variable: str) -> bool:
    name, _, _ = variable.lower().removeprefix(_PREFIX.lower()).partition("__")
    return variable.lower().startswith(_PREFIX.lower()) and name in Settings.model_fields


def load_settings(folder: Path) -> Settings:
    """Read the settings of the server in a folder.

    Raises
    ------
    SettingsError
        Listing everything that is wrong, with its key.
    """
    file = folder / SETTINGS_FILE
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
        return Settings.of(folder, content)
    except FileNotFoundError:
        remedy = f"there is no {SETTINGS_FILE} here; `reverie-eval server init {folder}` makes one"
        raise SettingsError([Problem("no-settings", str(folder), remedy)]) from None
    except OSError as error:
        raise SettingsError([Problem("no-settings", str(file), f"{error.strerror}")]) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError([Problem("not-toml", str(file), str(error))]) from None
    except UnreadableVariableError as error:
        raise SettingsError([Problem("wrong-setting", _PREFIX, str(error))]) from None
    except ValidationError as error:
        raise SettingsError(list(_problems(error))) from None


def _problems(error: ValidationError) -> Iterator[Problem]:
    for detail in error.errors(include_url=False):
        key = ".".join(map(str, detail["loc"]))
        if detail["type"] == "extra_forbidden":
            yield _no_setting(key)
            continue
        said = detail["msg"].removeprefix("Value error, ")
        message = said[0].lower() + said[1:]
        # A database's address may hold a password, so it is not repeated.
        is_shown = isinstance(detail["input"], str | int | float) and key != "database"
        found = f"got {detail['input']!r}; " if is_shown else ""
        yield Problem("wrong-setting", key, found + message)


def _no_setting(key: str) -> Problem:
    return Problem("wrong-setting", key, "is no setting; look for a spelling mistake")
