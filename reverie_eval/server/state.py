"""The state of a running server, opened once and shared by all requests."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from threading import Event
from typing import Self

from sqlalchemy.orm import Session

from reverie_eval.errors import Problem
from reverie_eval.server.service.attempts import Attempts
from reverie_eval.server.service.audit import AuditLog
from reverie_eval.server.service.boards import (
    Board,
    Boards,
    board_named,
    leaderboards,
    load_boards,
    tasks_of,
)
from reverie_eval.server.service.emailed_files import EmailedFiles
from reverie_eval.server.service.entries import EntriesCache
from reverie_eval.server.service.episodes import EpisodeService
from reverie_eval.server.service.evidence import EvidenceService
from reverie_eval.server.service.intake import Clock, Intake
from reverie_eval.server.service.keys import current_key, open_key
from reverie_eval.server.service.leaderboard import Ranking, leaderboard
from reverie_eval.server.service.notices import Notices
from reverie_eval.server.service.rank_intervals import RankIntervals
from reverie_eval.server.service.receipts import Signer
from reverie_eval.server.service.rescoring import Rescoring
from reverie_eval.server.service.retention import Retention
from reverie_eval.server.service.rules import RulesInForce
from reverie_eval.server.service.schedules import Schedules
from reverie_eval.server.service.scoring import Scoring, ScoringHere
from reverie_eval.server.service.scoring_processes import ScoringProcesses
from reverie_eval.server.service.snapshots import Snapshots
from reverie_eval.server.service.soundness import DatabaseWatch, UploadsWatch, read_each
from reverie_eval.server.service.submissions import SubmissionService
from reverie_eval.server.service.tokens import Sessions
from reverie_eval.server.service.transactions import Transactions
from reverie_eval.server.settings import Settings, SettingsError
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.uploads import open_uploads
from reverie_eval.tasks import Task


def utc_now() -> datetime:
    """Return the current time."""
    return datetime.now(UTC)


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
        if not database.is_current():
            remedy = f"is not of this version; run `reverie-eval server upgrade {settings.folder}`"
            raise SettingsError([Problem("old-database", "database", remedy)])
        self.settings, self.database, self.clock = settings, database, clock
        self.boards = boards
        self.rules = rules = RulesInForce(boards, settings)
        self.database_watch = DatabaseWatch(database)
        self.signer = signer_of(settings, database)
        self.uploads = uploads = open_uploads(settings.uploads, settings.folder)
        self.uploads_watch = UploadsWatch(database, uploads)
        self.scoring = scoring = scoring or ScoringHere(boards, uploads)
        self.notices = Notices(settings.banner, paused=settings.paused)
        self.audit_log = AuditLog(self.signer)
        self.schedules = schedules = Schedules(settings.splits)
        self.snapshots = Snapshots(lambda: boards, schedules, settings.organiser)
        self.transactions = transactions = Transactions(
            database, self.audit_log, clock, settings.channels, self.snapshots.take_due
        )
        attempts = Attempts(database, clock)
        self.intake = Intake(
            boards,
            uploads,
            scoring,
            rules,
            transactions,
            self.notices,
            attempts,
            schedules,
            settings,
        )
        self.submissions = SubmissionService(
            boards, uploads, scoring, rules, transactions, schedules, settings.required_metadata
        )
        self.emailed_files = EmailedFiles(self.intake, self.submissions)
        self.rescoring = Rescoring(boards, scoring, transactions)
        self.evidence = EvidenceService(boards, database, scoring, self.signer)
        self.retention = Retention(uploads, transactions, settings.keep_uploads_days)
        self.sessions = Sessions(self.signer.secret_for("browser sessions"))
        self.entries = EntriesCache(schedules)
        self.episodes = EpisodeService(boards, scoring, self.submissions)
        self.rank_intervals = RankIntervals()
        self.warming = Event()
        """Set while a job computes what pages keep; meanwhile, they do without."""

    @classmethod
    def open(cls, settings: Settings, clock: Clock = utc_now, workers: int = 0) -> Self:
        """Open everything that a server needs, and check it.

        Files are scored in so many processes, which start with the context of ``scoring``; with 0,
        they are scored in this one.

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
            return cls(settings, boards, database, clock, scoring)
        except BaseException:
            database.close()
            raise

    def board(self, split: str, further: str = "") -> Board:
        """Return a split's own leaderboard, or a further one, as :func:`board_named`."""
        return board_named(self.boards, split, further)

    @property
    def leaderboards(self) -> Sequence[Board]:
        """The leaderboards of all splits."""
        return leaderboards(self.boards)

    @property
    def tasks(self) -> Sequence[Task]:
        """The tasks that the splits are of."""
        return tasks_of(self.boards)

    def ranking(self, session: Session, board: Board, metric: str | None = None) -> Ranking:
        """Return a leaderboard as it is now; raises the errors of :func:`leaderboard`.

        Without a metric, it is ranked by its primary one.
        """
        (ranking,) = self._rankings(session, [board], metric)
        return ranking

    def rankings(self, session: Session, boards: Sequence[Board]) -> Sequence[Ranking | None]:
        """Return leaderboards of several splits, all with the same name; None if rows are damaged.

        This takes as many statements as reading the one that takes most, unless rows are damaged.
        """
        return read_each(boards, partial(self._rankings, session))

    def _rankings(
        self, session: Session, boards: Sequence[Board], metric: str | None = None
    ) -> Sequence[Ranking]:
        now = self.clock()
        self.rules.follow(session)
        boards = [self.board(board.name, board.further) for board in boards]
        self.entries.entries_of_all(session, boards, now)  # each is in the cache then
        return [
            leaderboard(
                session,
                self.entries,
                board,
                board.primary.key if metric is None else metric,
                now,
            )
            for board in boards
        ]

    def with_details(self, session: Session, ranking: Ranking) -> Ranking:
        """Add how often each team has submitted, and which ranks each result may have."""
        board, metric, rows = ranking.board, ranking.metric, ranking.rows
        return replace(
            ranking,
            counts=self.entries.submissions_of_teams(session, board.name),
            rank_intervals=self.rank_intervals.compute(session, board, metric, rows),
        )


def signer_of(settings: Settings, database: Database) -> Signer:
    """Return what signs a server's receipts; raises the errors of :func:`open_key`."""
    with database.reading() as session:
        current = current_key(session)
    return Signer(open_key(settings.path(settings.signing_key), current), settings.title)
