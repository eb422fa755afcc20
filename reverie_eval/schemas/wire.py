"""The base class and the field types of all messages between servers and clients."""

import re
from datetime import UTC, datetime
from typing import Annotated
from unicodedata import normalize

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BeforeValidator,
    ConfigDict,
    Field,
    HttpUrl,
    StringConstraints,
    UrlConstraints,
)

from reverie_eval.schemas.report import Report

LONGEST_NAME = 100
LONGEST_LINE = 500
LONGEST_LINK = 500
LONGEST_TEXT = 2000

_BLANK = re.compile(
    r"[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u3164\ufe00-\ufe0f\uffa0\U000e0100-\U000e01ef\u2800]"
)
"""Characters that are printable to Python but invisible: fillers and variation selectors (Unicode's
property ``Default_Ignorable_Code_Point``), and the braille pattern without dots."""


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


def _instant(value: datetime) -> datetime:
    if not 2000 <= value.year < 3000:
        raise ValueError("must be in the years 2000 to 2999")
    return value.astimezone(UTC)


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
Instant = Annotated[AwareDatetime, AfterValidator(_instant)]
Secret = Annotated[str, Field(min_length=1, max_length=200)]

# What several messages hold, each with an example.
PersonName = Annotated[str, Field(examples=["Ada"])]
OrganiserName = Annotated[str, Field(examples=["Olga"])]
TeamName = Annotated[str, Field(examples=["Blue"])]
SubmissionId = Annotated[str, Field(examples=["5f2b0c9a4d7e1f36"])]
KeyId = Annotated[str, Field(examples=["0d1c2b3a4f5e6d7c"])]
Sha256 = Annotated[
    str,
    Field(examples=["9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"]),
]
EXAMPLE_TOKEN = "rv_3Zk0b9Xw" + 35 * "."  # a real one has no dots
EXAMPLE_INVITATION = "rv_Yq71mPaa" + 35 * "."
