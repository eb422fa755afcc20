"""How far long work is: what shows it wraps the items that are worked on."""

from collections.abc import Iterable
from typing import Protocol, TypeVar

T = TypeVar("T")


class Progress(Protocol):
    """Wraps the items that are about to be worked on, and may show how far that is."""

    def __call__(self, items: Iterable[T], description: str, total: int, /) -> Iterable[T]:
        """Return the items, ``total`` of them, one after another."""


def no_progress(items: Iterable[T], description: str, total: int, /) -> Iterable[T]:  # noqa: ARG001
    """Return the items, and show nothing."""
    return items
