"""What a running server holds; opened once, given to every request."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Self

from fastapi import Request

from reverie_eval.errors import Problem
from reverie_eval.server.service.boards import Board, load_boards
from reverie_eval.server.service.receipts import Signer, load_key
from reverie_eval.server.service.sessions import Sessions
from reverie_eval.server.service.submissions import Clock, SubmissionService
from reverie_eval.server.settings import Settings, SettingsError
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.uploads import Uploads, open_uploads


def utc_now() -> datetime:
    """Return the time."""
    return datetime.now(UTC)


@dataclass(frozen=True)
class ServerState:
    """Settings, ground truth, database and key of a server."""

    settings: Settings
    boards: Mapping[str, Board]
    database: Database
    uploads: Uploads
    signer: Signer
    submissions: SubmissionService
    sessions: Sessions
    clock: Clock

    @classmethod
    def open(cls, settings: Settings, clock: Clock = utc_now) -> Self:
        """Open everything, or refuse with everything that is wrong.

        Raises
        ------
        SettingsError
            If a split cannot be scored or the database is not ready.
        ReceiptError
            If the signing key is missing or others can read it.
        """
        boards = load_boards(settings)
        signer = Signer(load_key(settings.path(settings.signing_key)), settings.title)
        database = Database(settings.database_url)
        if not database.is_current():
            remedy = f"is not of this version; run `reverie-eval server upgrade {settings.folder}`"
            raise SettingsError([Problem("old-database", "database", remedy)])
        uploads = open_uploads(settings.uploads, settings.folder)
        submissions = SubmissionService(
            boards,
            database,
            uploads,
            signer,
            clock,
            required_metadata=settings.required_metadata,
            paused=settings.paused,
        )
        sessions = Sessions(signer.secret_for("browser sessions"))
        return cls(settings, boards, database, uploads, signer, submissions, sessions, clock)


def state_of(request: Request) -> ServerState:
    """Return the server that answers a request."""
    state: ServerState = request.app.state.server
    return state
