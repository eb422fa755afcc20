"""Opening a server: its state, and what the rooms do before each change."""

from reverie_eval.server.audit.transactions import Clock, utc_now
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.scoring.boards import Boards, load_boards
from reverie_eval.server.scoring.processes import ScoringProcesses
from reverie_eval.server.settings import Settings
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.database import Database


def open_server(settings: Settings, clock: Clock = utc_now, workers: int = 0) -> ServerState:
    """Open everything that a server needs, and check it.

    Files are scored in so many processes, which start with the context of ``scoring``; with 0, they
    are scored in this one.

    Raises
    ------
    SettingsError
        If a split cannot be scored, or the database is not up to date.
    ReceiptError
        If the signing key is missing, others can read it, or another one is in use.
    """
    boards = Boards(load_boards(settings))
    scoring = ScoringProcesses(settings, boards, workers) if workers else None
    database = Database(settings.database_url)
    try:
        server = ServerState(settings, boards, database, clock, scoring)
    except BaseException:
        database.close()
        raise
    server.transactions.begins = server.get(Snapshots).take_due
    return server
