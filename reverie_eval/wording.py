"""Counting and listing in sentences."""

from collections.abc import Iterable


def counted(number: int, noun: str) -> str:
    """Put a number before a noun.

    >>> counted(1, "jump"), counted(1200, "jump")
    ('1 jump', '1,200 jumps')
    """
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def some(names: Iterable[object], limit: int = 3) -> str:
    """Name the first few of many.

    >>> some("abcde")
    'a, b, c and 2 more'
    """
    listed = [str(name) for name in names]
    more = f" and {len(listed) - limit} more" if len(listed) > limit else ""
    return ", ".join(listed[:limit]) + more
