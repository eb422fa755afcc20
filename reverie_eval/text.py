"""Helpers for wording: counts, lists, names, times, and the words of an instruction."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime, timedelta, timezone
from typing import TypeVar

T = TypeVar("T")

_WORD = re.compile(r"\w+")


def count_text(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun; the plural ends in s unless another one is given.

    >>> count_text(1, "jump"), count_text(1200, "jump"), count_text(2, "box", "boxes")
    ('1 jump', '1,200 jumps', '2 boxes')
    """
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"


def first_few(
    names: Iterable[T], limit: int = 3, text: Callable[[T], str] = str, *, of: int = 0
) -> str:
    """List the first few names and count the rest; there may be more than are given.

    >>> first_few("abcde"), first_few("abcde", of=700)
    ('a, b, c and 2 more', 'a, b, c and 697 more')
    """
    listed = list(names)
    count = max(of, len(listed))
    more = f" and {count - limit:,} more" if count > limit else ""
    return ", ".join(map(text, listed[:limit])) + more


def amount_text(value: float) -> str:
    """Format an amount with three digits, or all of those before the point.

    >>> [amount_text(value) for value in (0, 0.01234, 12.0, 18250.4)]
    ['0', '0.0123', '12', '18,250']
    """
    return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: the closest known name, then all.

    >>> did_you_mean("offical-v1", ["official-v1", "paper"])
    '; did you mean official-v1? Choose one of: official-v1, paper'
    >>> did_you_mean("Val_Unseen", ["val_seen", "val_unseen"])
    '; did you mean val_unseen? Choose one of: val_seen, val_unseen'
    """
    from difflib import get_close_matches  # slow to import, and only needed in errors

    listed = list(known)
    by_folded = {each.casefold(): each for each in listed}
    close = get_close_matches(str(name).casefold(), by_folded, n=1)
    guess = f"did you mean {by_folded[close[0]]}? Choose" if close else "choose"
    return f"; {guess} one of: {', '.join(listed)}"


def damage_text(error: Exception) -> str:
    """Say why a packed file does not unpack: what libraries say is about markers and checksums."""
    return "it was cut short" if isinstance(error, EOFError) else "some of its bytes are wrong"


def category_text(name: str) -> str:
    """Return a category for people: the dataset's names have ``#`` for a space [1]_.

    References
    ----------
    .. [1] ``category_mapping.tsv`` of Matterport3D, which lists these raw categories.

    Examples
    --------
    >>> category_text("end#table")
    'end table'
    """
    return name.replace("#", " ")


def printable(text: str) -> str:
    r"""Escape characters that are invisible or would control a terminal.

    >>> printable("Team \x1b[2J"), printable("Équipe 蓝")
    ('Team \\x1b[2J', 'Équipe 蓝')
    """
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in text
    )


def short_digest(digest: str) -> str:
    """Return as many digits of a SHA-256 as signatures and messages have.

    >>> short_digest("2cf24dba5fb0a30e26e83b2ac5b9e29e1b161e5c1fa7425e73043362938b9824")
    '2cf24dba5fb0'
    """
    return digest[:12]


def changes(before: Mapping[str, object], now: Mapping[str, object]) -> Sequence[str]:
    """Return a text for each value that is another now.

    Examples
    --------
    >>> changes({"seed": 0, "task": "reverie"}, {"seed": 1, "task": "reverie", "option rnn": "gru"})
    ['seed: 0, now 1', 'option rnn: not given, now gru']
    """
    return [
        f"{title}: {_shown(before, title)}, now {_shown(now, title)}"
        for title in [*now, *(each for each in before if each not in now)]
        if _shown(before, title) != _shown(now, title)
    ]


def _shown(values: Mapping[str, object], title: str) -> str:
    """Return a value as text; of a SHA-256, as much as a signature has."""
    value = values.get(title, "not given")
    text = "none" if value in (None, "") else str(value)
    return short_digest(text) if re.fullmatch("[0-9a-f]{64}", text) else text


def whole_letters(text: str) -> str:
    r"""Replace halves of characters, which JSON can have and UTF-8 cannot.

    >>> whole_letters("\ud83d! \ud83d\ude00 é")
    '�! 😀 é'
    """
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def time_text(instant: datetime) -> str:
    """Format a time to the second: in local time, and in UTC if that is different.

    >>> instant = datetime(2027, 6, 1, 21, 59, 59, 999_999, tzinfo=timezone.utc)
    >>> time_text(instant).count("21:59:59 UTC")
    1
    """
    whole = instant.replace(microsecond=0)
    local, utc = whole.astimezone(), f"{whole.astimezone(timezone.utc):%Y-%m-%d %H:%M:%S} UTC"
    return f"{local:%Y-%m-%d %H:%M:%S %Z} ({utc})" if local.utcoffset() else utc


def earliest_time_text(instant: datetime) -> str:
    """Format the earliest time at which something is possible: as :func:`time_text`, rounded up.

    >>> instant = datetime(2027, 6, 1, 21, 59, 59, 1, tzinfo=timezone.utc)
    >>> earliest_time_text(instant).count("2027-06-01 22:00:00 UTC")
    1
    """
    return time_text(instant + timedelta(microseconds=999_999))


def tokenize(instruction: str) -> Sequence[str]:
    """Return the words of an instruction, in order and in lower case.

    A word is a run of letters, digits and underscores. Everything else, including apostrophes and
    hyphens, separates words.

    References
    ----------
    .. [1] ``Tokenizer.split_sentence`` in ``tasks/REVERIE/utilsFast.py`` of the dataset's
       repository splits at the same places, but keeps punctuation marks as tokens.

    Examples
    --------
    >>> tokenize("Go to level 2; don't touch the T-shirt")
    ['go', 'to', 'level', '2', 'don', 't', 'touch', 'the', 't', 'shirt']
    """
    return _WORD.findall(instruction.lower())
