"""The rooms of the server, and what each adds to the application.

A room is a subpackage with a module ``room``, whose ``ROOM`` declares this. Rooms are found, not
listed: a server whose folder lacks one starts without it.
"""

import pkgutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import NamedTuple, Protocol

from fastapi import APIRouter

from reverie_eval import server as package
from reverie_eval.server.jobs import Job
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.state import ServerState, Service

DESK = ("Today", "Results", "Participants", "In public", "Records")
"""The groups of tabs at the organiser's desk, in their order."""


class Tab(NamedTuple):
    """A page of the desk."""

    group: str
    """One of :data:`DESK`."""
    place: int
    """Where it is in the group, which several rooms may share."""
    name: str
    path: str


class Showcase(Service, Protocol):
    """What a room shows on the first page."""

    def example(self) -> object | None:
        """Return an example episode, as the page's template reads it; None if no split has any."""

    def references(self, board: Board) -> Sequence[object]:
        """Return scores of reference agents on a split without results."""


def _none(_: ServerState) -> Iterable[Job]:
    return ()


@dataclass(frozen=True)
class Room:
    """What a room adds."""

    routes: Sequence[APIRouter] = ()
    """Routes of the API."""
    pages: Sequence[APIRouter] = ()
    """Routes for browsers, which the description of the API leaves out."""
    desk: Sequence[Tab] = ()
    showcase: type[Showcase] | None = None
    jobs: Callable[[ServerState], Iterable[Job]] = _none
    """Returns the work that a running server does by itself."""


def desk_of(all_rooms: Mapping[str, Room]) -> Mapping[str, Sequence[Tab]]:
    """Return the pages of the desk by group."""
    tabs = [tab for room in all_rooms.values() for tab in room.desk]
    return {group: sorted(tab for tab in tabs if tab.group == group) for group in DESK}


@cache
def rooms() -> Mapping[str, Room]:
    """Return what each room declares, in the order of their names."""
    folders = [each.name for each in pkgutil.iter_modules(package.__path__) if each.ispkg]
    modules = {folder: f"{package.__name__}.{folder}.room" for folder in folders}
    return {
        folder: import_module(module).ROOM
        for folder, module in modules.items()
        if find_spec(module)
    }
