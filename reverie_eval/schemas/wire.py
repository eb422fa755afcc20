"""Messages between servers and clients: their base class, their fields, and wrong values."""

import re
from collections.abc import Mapping
from contextlib import suppress
from datetime import date, datetime, timezone
from typing import Annotated, Any
from unicodedata import normalize

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BeforeValidator,
    ConfigDict,
    Field,
    HttpUrl,
    StringConstraints,
    TypeAdapter,
    UrlConstraints,
    ValidationError,
)

from reverie_eval.schemas.report import ProblemReport, Report

SERVER_VARIABLE = "REVERIE_EVAL_SERVER"
"""The environment variable with the URL of the evaluation server."""
TOKEN_VARIABLE = "REVERIE_EVAL_TOKEN"  # noqa: S105  # the name of a variable, not a token
"""The environment variable with the token for it."""
LONGEST_NAME = 100
LONGEST_EMAIL = 254
LONGEST_SECRET = 200
LONGEST_ID = 32
LONGEST_LINE = 500
LONGEST_LINK = 500
LONGEST_TEXT = 2000

# Characters that are printable to Python but invisible: fillers and variation selectors (Unicode's
# property `Default_Ignorable_Code_Point`), and the braille pattern without dots.
_BLANK = re.compile(
    r"[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u3164\ufe00-\ufe0f\uffa0\U000e0100-\U000e01ef\u2800]"
)
# The beginning of a link: a scheme (RFC 3986, section 3.1) without a space after the colon.
_LINK = re.compile(r"[a-z][a-z0-9+.-]*:(?=\S)", re.IGNORECASE)
_NAMED_ADDRESS = re.compile(r"[^<>]*<([^<>]*)>")
_MONTH_AND_YEAR = re.compile(r"([0-9]{1,2})/([0-9]{4})")
_DAY_MONTH_OR_YEAR = re.compile(r"2[0-9]{3}(-[0-9]{2}){0,2}")


class WireModel(Report):
    """Base of all messages between servers and clients; they are read from any object's fields."""

    model_config = ConfigDict(from_attributes=True)


def one_line(text: str) -> str:
    r"""Return text in composed form (NFC), if it is safe to show in a line, a table or a log.

    Control characters, line breaks, invisible characters and changes of the writing direction could
    make a name look like another one, like two lines, or empty.

    Raises
    ------
    ValueError
        If the text contains such a character.

    Examples
    --------
    >>> one_line("E\u0301quipe")
    'Équipe'
    """
    if not text.isprintable() or _BLANK.search(text):
        raise ValueError("must be one line without invisible characters")
    return normalize("NFC", text)


def _line(value: object) -> object:
    return one_line(value.strip()) if isinstance(value, str) else value


def _lines(value: object) -> object:
    if not isinstance(value, str):
        return value
    try:
        return "\n".join(one_line(line) for line in value.strip().splitlines())
    except ValueError:
        raise ValueError("must not contain invisible characters") from None


def _plain(url: HttpUrl) -> HttpUrl:
    if url.username or url.password:  # https://github.com@example.org leads to example.org
        raise ValueError("must not contain a user name or a password")
    if len(str(url)) > LONGEST_LINK:  # in the normalised form that is stored
        raise ValueError(f"must have at most {LONGEST_LINK} characters")
    return url


def _source(text: str) -> str:
    if not _LINK.match(text):
        return text
    try:
        return str(_HTTPS.validate_python(text))
    except ValidationError:
        raise ValueError("must be a text, or a link that begins with https://") from None


def _partial_date(text: str) -> str:
    month_and_year = _MONTH_AND_YEAR.fullmatch(text)
    iso = f"{month_and_year[2]}-{month_and_year[1]:0>2}" if month_and_year else text
    if _DAY_MONTH_OR_YEAR.fullmatch(iso):
        with suppress(ValueError):
            date.fromisoformat(f"{iso}-01-01"[:10])  # any month and day, where they are missing
            return iso
    raise ValueError("must be a day, a month or a year: 2026-01-15, 2026-01, 01/2026 or 2026")


def _email(text: str) -> str:
    from email_validator import EmailNotValidError, validate_email  # only servers check addresses

    try:
        return validate_email(_bare_address(text), check_deliverability=False).normalized
    except EmailNotValidError:
        raise ValueError("must be an e-mail address, such as ada@example.org") from None


def _bare_address(text: str) -> str:
    """Return an address without the name that mail programs copy with it.

    RFC 5322 wants quotes around a name such as ``Ada L.``, which mail programs leave out; so the
    name is not read at all.

    >>> _bare_address("Ada L. <ada@example.org>")
    'ada@example.org'
    """
    named = _NAMED_ADDRESS.fullmatch(text)
    return named[1] if named else text


def _without_default(schema: dict[str, Any]) -> None:
    schema.pop("default")


def _instant(value: datetime) -> datetime:
    if not 2000 <= value.year < 3000:
        raise ValueError("must be in the years 2000 to 2999")
    return value.astimezone(timezone.utc)


# Texts are normalised before their length is checked, so a stored text is still valid when it is
# read.
Name = Annotated[
    str, StringConstraints(min_length=1, max_length=LONGEST_NAME), BeforeValidator(_line)
]
Line = Annotated[str, Field(max_length=LONGEST_LINE), BeforeValidator(_line)]
Reason = Annotated[
    str, StringConstraints(min_length=1, max_length=LONGEST_LINE), BeforeValidator(_line)
]
Text = Annotated[str, Field(max_length=LONGEST_TEXT), BeforeValidator(_lines)]
Https = Annotated[
    HttpUrl,
    UrlConstraints(allowed_schemes=["https"], max_length=LONGEST_LINK),
    AfterValidator(_plain),
]
_HTTPS: TypeAdapter[HttpUrl] = TypeAdapter(Https)
Source = Annotated[Reason, AfterValidator(_source)]
"""Where a result is from: a text, or a link in its normalised form."""
PartialDate = Annotated[str, BeforeValidator(_line), AfterValidator(_partial_date)]
"""A day, a month or a year in ISO 8601; unknown parts are left out, not made up."""
OMITTED = Field(json_schema_extra=_without_default)
"""For a field in a request for changes: its default means no change, and may not be sent."""
OmittedName = Annotated[Name, OMITTED]
StoredEmail = Annotated[
    str,
    Field(
        max_length=LONGEST_EMAIL,
        json_schema_extra={"format": "email"},
        examples=["ada@example.org"],
    ),
]
"""An address in a reply, which the server has checked: a client cannot."""
Email = Annotated[StoredEmail, BeforeValidator(_line), AfterValidator(_email)]
Instant = Annotated[AwareDatetime, AfterValidator(_instant)]
Secret = Annotated[str, Field(min_length=1, max_length=LONGEST_SECRET)]

# Fields of several messages, each with an example.
PersonName = Annotated[str, Field(examples=["Ada"])]
OrganiserName = Annotated[str, Field(examples=["REVERIE team, Example Lab"])]
TeamName = Annotated[str, Field(examples=["Blue"])]
SubmissionId = Annotated[str, Field(examples=["5f2b0c9a4d7e1f36"])]
KeyId = Annotated[str, Field(examples=["0d1c2b3a4f5e6d7c"])]
Sha256 = Annotated[
    str,
    Field(examples=["9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"]),
]
EXAMPLE_TOKEN = "rv_3Zk0b9Xw" + 35 * "."  # a real one has no dots
EXAMPLE_KEY = "-----BEGIN PUBLIC KEY-----\nMCow...\n-----END PUBLIC KEY-----\n"
EXAMPLE_INVITATION = "rv_Yq71mPaa" + 35 * "."


# Messages for invalid values, one for each kind of error that pydantic reports: the API, forms, the
# query parameters of pages and the options of commands use the same ones. Pydantic's own are for
# programmers.

_LINK_MESSAGE = "must be a link that begins with https://"
_WHOLE_NUMBER = "must be a whole number"
_NUMBER = "must be a number"
_DATE = "must be a date, such as 2027-06-01"
_INSTANT = "must be a time with its time zone, such as 2027-06-01T12:00:00Z"
_YES_OR_NO = "must be true or false"
_OBJECT = "must be an object"
_LIST = "must be a list"

_SENTENCES: Mapping[str, str] = {
    "missing": "required but missing",
    "extra_forbidden": "unknown field; remove it",
    "value_error": "{error}",
    "string_type": "must be text",
    "string_unicode": "must be text",
    "string_pattern_mismatch": "must match the pattern {pattern}",
    "string_too_short": "must have {min_length:,} or more characters",
    "string_too_long": "must have at most {max_length:,} characters",
    "too_short": "must have {min_length:,} or more entries",
    "too_long": "must have at most {max_length:,} entries",
    "url_type": _LINK_MESSAGE,
    "url_parsing": _LINK_MESSAGE,
    "url_scheme": _LINK_MESSAGE,
    "url_too_long": "must have at most {max_length:,} characters",
    "literal_error": "must be {expected}",
    "bool_type": _YES_OR_NO,
    "bool_parsing": _YES_OR_NO,
    "int_type": _WHOLE_NUMBER,
    "int_parsing": _WHOLE_NUMBER,
    "int_parsing_size": "the number is too large",
    "int_from_float": _WHOLE_NUMBER,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "finite_number": _NUMBER,
    "greater_than_equal": "must be {ge:,} or more",
    "greater_than": "must be more than {gt:,}",
    "less_than": "must be less than {lt:,}",
    "less_than_equal": "must be {le:,} or less",
    "date_type": _DATE,
    "date_parsing": _DATE,
    "date_from_datetime_parsing": _DATE,
    "date_from_datetime_inexact": _DATE,
    "datetime_type": _INSTANT,
    "datetime_parsing": _INSTANT,
    "datetime_from_date_parsing": _INSTANT,
    "datetime_object_invalid": _INSTANT,
    "timezone_aware": _INSTANT,
    "dict_type": _OBJECT,
    "model_type": _OBJECT,
    "model_attributes_type": _OBJECT,
    "list_type": _LIST,
    "tuple_type": _LIST,
    "path_type": "must be a path",
    "json_invalid": "invalid JSON from here",
}
"""By pydantic's error type; the braces take values from the error's context."""

_CARRIERS = frozenset({"body", "query", "path", "header", "cookie"})
"""Parts of a request, which are not part of a field's name."""


def wrong_value(detail: Mapping[str, Any]) -> ProblemReport:
    """Return one of pydantic's errors as a problem, located by the name of the field."""
    loc = [str(part) for part in detail["loc"]]
    where = ".".join(loc[1:] if loc and loc[0] in _CARRIERS else loc)
    if detail["type"] == "json_invalid":  # located by a bare number
        where = f"character {where}"
    sentence = _SENTENCES.get(detail["type"])
    message = sentence.format_map(detail.get("ctx", {})) if sentence else str(detail["msg"])
    return wrong_field(where, message)


def unreadable_json(error: RecursionError | ValueError) -> ProblemReport:
    """Return why a body cannot be read as JSON, and from which byte on."""
    if isinstance(error, UnicodeDecodeError):
        return wrong_field(f"byte {error.start}", "invalid UTF-8 from here")
    if isinstance(error, RecursionError):
        return wrong_field("", "nested too deeply")
    return wrong_field("", "contains a number with too many digits")


def wrong_field(where: str, message: str) -> ProblemReport:
    """Return what is wrong with the value of a field."""
    return ProblemReport(code="wrong-value", where=where, message=message)
