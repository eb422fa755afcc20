"""The state of a running server, opened once and shared by all requests.

It knows nothing of the rooms. Their services are made from it when they are first needed, and kept:
``server.get(Intake)``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from threading import Event, RLock
from typing import Any, Protocol, Self, TypeVar

from sqlalchemy.orm import Session

from reverie_eval.server.audit.log import AuditLog
from reverie_eval.server.audit.signing import Signer, current_key, open_key
from reverie_eval.server.audit.transactions import Clock, Transactions
from reverie_eval.server.scoring.boards import Board, Boards, all_boards, find_board, tasks_of
from reverie_eval.server.scoring.contexts import Scoring, ScoringHere
from reverie_eval.server.scoring.rules import RulesInForce
from reverie_eval.server.settings import Settings
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.uploads import open_uploads
from reverie_eval.tasks import Task


class Service(Protocol):
    """What a room offers: made from the state of a server, once."""

    @classmethod
    def of(cls, server: "ServerState", /) -> Self:
        """Return the service of a server."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The database of a server at a moment."""

    server: "ServerState"
    session: Session
    now: datetime


AnyService = TypeVar("AnyService", bound=Service)


class ServerState:
    """Settings, ground truth, database and key of a server, and the services that use them."""

    def __init__(
        self,
        settings: Settings,
        boards: Boards,
        database: Database,
        clock: Clock,
        scoring: Scoring | None = None,
    ) -> None:
        self.settings, self.database, self.clock = settings, database, clock
        self.boards = boards
        self.rules = RulesInForce(boards, settings)
        self.signer = signer_of(settings, database)
        self.audit_log = AuditLog(self.signer)
        self.transactions = Transactions(database, self.audit_log, clock, settings.channels)
        self.uploads = open_uploads(settings.uploads, settings.folder)
        self.scoring = scoring or ScoringHere(boards, self.uploads)
        self.warming = Event()
        """Set while a job computes what pages keep; meanwhile, they do without."""
        self.services: dict[type, Any] = {}
        """The services that were made so far, by their class."""
        self._lock = RLock()  # services are made of others

    def get(self, kind: type[AnyService]) -> AnyService:
        """Return the service of this kind, which is made when it is first asked for."""
        with self._lock:
            if kind not in self.services:
                self.services[kind] = kind.of(self)
            service: AnyService = self.services[kind]
            return service

    def board(self, split: str, name: str = "") -> Board:
        """Return a split's main leaderboard, or another one, as :func:`find_board`."""
        return find_board(self.boards, split, name)

    @property
    def all_boards(self) -> Sequence[Board]:
        """The leaderboards of all splits."""
        return all_boards(self.boards)

    @property
    def tasks(self) -> Sequence[Task]:
        """The tasks that the splits are of."""
        return tasks_of(self.boards)


def signer_of(settings: Settings, database: Database) -> Signer:
    """Return what signs a server's receipts; raises the errors of :func:`open_key`."""
    with database.reading() as session:
        current = current_key(session)
    key_id = None if current is None else current.key_id
    return Signer(open_key(settings.path(settings.signing_key), key_id), settings.title)
