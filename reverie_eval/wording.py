"""Counting, naming, listing and dating in sentences."""

from collections.abc import Iterable
from datetime import UTC, datetime, timedelta


def counted(number: int, noun: str) -> str:
    """Put a number before a noun.

    >>> counted(1, "jump"), counted(1200, "jump")
    ('1 jump', '1,200 jumps')
    """
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def category_in_words(name: str) -> str:
    """Write a category as people do: in the dataset's names ``#`` stands for a space [1]_.

    References
    ----------
    .. [1] ``category_mapping.tsv`` of Matterport3D, whose raw categories the names are.

    Examples
    --------
    >>> category_in_words("end#table")
    'end table'
    """
    return name.replace("#", " ")


def printable(text: str) -> str:
    r"""Write what would move a terminal's cursor, or hide there, as escapes.

    >>> printable("Team \x1b[2J"), printable("Équipe 蓝")
    ('Team \\x1b[2J', 'Équipe 蓝')
    """
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in text
    )


def some(names: Iterable[object], limit: int = 3) -> str:
    """Name the first few of many.

    >>> some("abcde")
    'a, b, c and 2 more'
    """
    listed = [str(name) for name in names]
    more = f" and {len(listed) - limit} more" if len(listed) > limit else ""
    return ", ".join(listed[:limit]) + more


def from_when(instant: datetime) -> str:
    """Write as :func:`dated` does from which second on something is possible: rounded up.

    >>> from_when(datetime(2027, 6, 1, 21, 59, 59, 1, tzinfo=UTC)).count("2027-06-01 22:00:00 UTC")
    1
    """
    return dated(instant + timedelta(microseconds=999_999))


def dated(instant: datetime) -> str:
    """Write the second of an instant in local time and, where that is another, in UTC.

    >>> dated(datetime(2027, 6, 1, 21, 59, 59, 999_999, tzinfo=UTC)).count("21:59:59 UTC")
    1
    """
    whole = instant.replace(microsecond=0)
    local, utc = whole.astimezone(), f"{whole.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"
    return f"{local:%Y-%m-%d %H:%M:%S %Z} ({utc})" if local.utcoffset() else utc
