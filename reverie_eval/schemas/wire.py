"""What everything that goes over the wire has in common."""

import re
from datetime import UTC, datetime
from typing import Annotated
from unicodedata import normalize

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    HttpUrl,
    StringConstraints,
    UrlConstraints,
)

LONGEST_NAME = 100
LONGEST_LINE = 500
LONGEST_LINK = 500

_BLANK = re.compile(
    r"[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u3164\ufe00-\ufe0f\uffa0\U000e0100-\U000e01ef\u2800]"
)
"""What Python takes for printable, though it shows as nothing: fillers and variation selectors, by
Unicode's property ``Default_Ignorable_Code_Point``, and the braille pattern without a dot."""


class Said(BaseModel):
    """Base of what servers and clients say: immutable, and nothing in it that is not declared."""

    model_config = ConfigDict(
        frozen=True, use_attribute_docstrings=True, extra="forbid", from_attributes=True
    )


def one_line(text: str) -> str:
    r"""Return text in its one composed form, if it shows as it is in a line, a cell or a log.

    Control characters, line breaks, what turns the direction of writing and what shows as nothing
    would make a name look like another's, like two lines, or like none.

    Raises
    ------
    ValueError
        If there is such a character in it.

    Examples
    --------
    >>> one_line("E\u0301quipe")
    'Équipe'
    """
    if not text.isprintable() or _BLANK.search(text):
        raise ValueError("takes letters that can be seen, in one line")
    return normalize("NFC", text)


def _line(value: object) -> object:
    return one_line(value.strip()) if isinstance(value, str) else value


def _lines(value: object) -> object:
    if not isinstance(value, str):
        return value
    return "\n".join(one_line(line) for line in value.strip().splitlines())


def _short(url: HttpUrl) -> HttpUrl:
    if len(str(url)) > LONGEST_LINK:  # in the one form in which it is kept
        raise ValueError(f"takes up to {LONGEST_LINK} letters")
    return url


def _instant(value: datetime) -> datetime:
    if not 2000 <= value.year < 3000:
        raise ValueError("is no date between the years 2000 and 3000")
    return value.astimezone(UTC)


# Texts are brought into the form in which they are kept before their length is looked at: what was
# taken once is taken again when it is read.
Name = Annotated[
    str, StringConstraints(min_length=1, max_length=LONGEST_NAME), BeforeValidator(_line)
]
Line = Annotated[str, Field(max_length=LONGEST_LINE), BeforeValidator(_line)]
Text = Annotated[str, Field(max_length=2000), BeforeValidator(_lines)]
Https = Annotated[
    HttpUrl,
    UrlConstraints(allowed_schemes=["https"], max_length=LONGEST_LINK),
    AfterValidator(_short),
]
Instant = Annotated[AwareDatetime, AfterValidator(_instant)]
Secret = Annotated[str, Field(min_length=1, max_length=200)]
