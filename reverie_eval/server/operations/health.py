"""Whether the server works, checked by doing its work.

For every split, a known submission is read, scored, rounded and signed; the signing key is the one
in use; the rules of all splits are those of the server that started last on the database; the
database writes the rows of an upload, and rolls them back; the folder or store of uploads is
accessed; no job failed the last time, or is overdue. The database's file is the one that the server
has opened, and every leaderboard can be read.
All of this is cached for some seconds, so frequent checks cost nothing. The reply names what failed
and what to do; the log says why.
"""

import asyncio
import json
import logging
import secrets
import time
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from typing import Annotated, Any

from anyio import move_on_after
from anyio.to_thread import run_sync
from fastapi import Depends, Request
from sqlalchemy import insert
from sqlalchemy.exc import DBAPIError

from reverie_eval.metrics import CATALOGUE
from reverie_eval.receipts import ReceiptError, verify
from reverie_eval.runner import run_agent
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import (
    JOB,
    LEADERBOARDS,
    HealthReport,
    JobReport,
    QuotaReport,
    Receipt,
)
from reverie_eval.server.audit.signing import current_key, file_of_key, load_key
from reverie_eval.server.boards.leaderboard import Rankings
from reverie_eval.server.jobs import Jobs
from reverie_eval.server.messages.queue import tell_fault
from reverie_eval.server.operations.checks import try_newest
from reverie_eval.server.scoring.boards import Board, rules_of
from reverie_eval.server.scoring.contexts import score_content
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.damage import damage_in
from reverie_eval.server.store.database import FileReplacedError
from reverie_eval.server.store.tables import Attempt, AuditEntry, Person, Submission, Team
from reverie_eval.server.store.uploads import UploadsError

SECONDS_KEPT = 10
SECONDS_TO_ANSWER = 20
"""A check that takes longer has failed."""

_LOGGER = logging.getLogger("reverie_eval.server")
_AGENT = "stop"
"""The reference agent that never moves: its scores are known in advance."""
_NO_DIGEST = "0" * 64
_NOBODY = -1
_EMPTY: Mapping[str, Any] = {
    **dict.fromkeys(("split", "actor", "action", "row", "row_digest", "subject"), ""),
    **dict.fromkeys(("seal", "outcome"), ""),
    **dict.fromkeys(("size", "problems", "milliseconds"), 0),
    **{name: {} for name in ("method", "report", "receipt", "boards", "details")},
}
"""Values of columns that do not matter here."""


REMEDIES: Mapping[str, str] = {
    "scoring": "a known submission gets wrong scores or none; do not accept results, see the log, "
    "and restart the server",
    "signing key": "the key's file is missing or damaged, or another key is in use; restore the "
    "file from a backup, or restart the server after `server key rotate`",
    "same rules as other servers": "another server of the database scores under other rules; "
    "restart all of them with the same bundles and settings",
    "database": "the database cannot be written; check that it is running and has space, and run "
    "`reverie-eval server doctor`",
    "stored data": "the database's file was removed or replaced; stop the server, and restore the "
    "last backup with `reverie-eval server restore`",
    LEADERBOARDS: "a result on a leaderboard cannot be read, so that leaderboard is not shown; the "
    "log names it, and `reverie-eval server doctor` the row; restore the last backup with "
    "`reverie-eval server restore`",
    JOB: "work that the server does by itself failed the last time, or hangs; the error is in "
    "`jobs`, and in the log",
    "uploads": "files cannot be stored, or the newest one cannot be read; check the folder or "
    "store and its space, and run `reverie-eval server doctor`",
}
"""What a failed check means and what to do, by how its name begins; for everyone to see."""


def remedy_of(check: str) -> str:
    """Return what a failed check means, and what to do."""
    return next(remedy for kind, remedy in REMEDIES.items() if check.startswith(kind))


class UnhealthyError(Exception):
    """Something that the server needs is not as it should be."""


_TELLING = (UnhealthyError, ReceiptError, UploadsError, FileReplacedError)
"""Errors that quote no answer, so the log has their messages."""


class Health:
    """Checks a server, at most once every few seconds."""

    def __init__(self, server: ServerState, jobs: Jobs) -> None:
        self.checks: Mapping[str, Callable[[], None]] = {
            # First, because it loads ground truth that was corrected.
            "same rules as other servers": partial(_compare_rules, server),
            **{
                f"scoring of {board.label}": Canary(server, board).score
                for board in server.all_boards
            },
            "signing key": partial(_compare_key, server),
            "stored data": server.database.check_file,
            LEADERBOARDS: partial(_read_leaderboards, server),
            "database": partial(_write, server),
            "uploads": partial(_try_uploads, server),
        }
        self._server, self._jobs = server, jobs
        self._lock = asyncio.Lock()
        self._report = HealthReport(status="ok")
        self._until = 0.0

    async def report(self) -> HealthReport:
        """Return the result of the last check, or of a new one if that is too old."""
        async with self._lock:
            if time.monotonic() >= self._until:
                was_well = self._report.status == "ok"
                self._report = await self._examine()
                if was_well and self._report.failed:
                    text = f"the server is unhealthy: {', '.join(self._report.failed)}"
                    await run_sync(tell_fault, self._server, text)
                self._until = time.monotonic() + SECONDS_KEPT
            return self._report

    async def _examine(self) -> HealthReport:
        passed: dict[str, bool] = {}
        jobs: list[JobReport] = []
        with move_on_after(SECONDS_TO_ANSWER):
            await run_sync(self._run_checks, passed, abandon_on_cancel=True)
            jobs = await run_sync(self._jobs.reports, abandon_on_cancel=True)
        done = dict(passed)  # the thread may go on
        failed = [name for name, is_well in done.items() if not is_well]
        failing = [f"{JOB}{name}" for name in self._jobs.failing()]
        remedies = {
            **{name: remedy_of(name) for name in failed},
            **_late([name for name in self.checks if name not in done]),
            **{name: remedy_of(name) for name in failing},
        }
        return HealthReport.of(remedies, jobs)

    def _run_checks(self, passed: MutableMapping[str, bool]) -> None:
        """Run all checks and record each result at once, because a later check may hang."""
        for name, check in self.checks.items():
            try:
                check()
            except Exception as error:
                reason = str(error) if isinstance(error, _TELLING) else ""
                fields = {"failed": name, "reason": reason}
                _LOGGER.exception("unhealthy", extra={"fields": fields})
                passed[name] = False
            else:
                passed[name] = True


def _late(checks: Sequence[str]) -> Mapping[str, str]:
    """Return what it means for checks that time ran out: during the first, before the others."""
    if not checks:
        return {}
    slow, *others = checks
    reason = f"not done after {SECONDS_TO_ANSWER:g} seconds"
    _LOGGER.error("unhealthy", extra={"fields": {"failed": slow, "reason": reason}})
    return {
        slow: f"{reason}: the machine, the database or the store is too busy, or hangs; see which "
        "before you repair anything",
        **dict.fromkeys(others, f"not checked, because {slow!r} was {reason}"),
    }


class Canary:
    """A known submission to a split."""

    def __init__(self, server: ServerState, board: Board) -> None:
        self._server = server
        self._place = board.split, board.name
        self._content = lru_cache(1)(lambda _signature: self._walk())

    @property
    def _board(self) -> Board:
        return self._server.board(*self._place)

    def _walk(self) -> bytes:
        return json.dumps(run_agent(_AGENT, self._board.truth, 0)).encode()

    def score(self) -> None:
        """Treat it like an upload, but do not store it.

        Raises UnhealthyError if its scores are wrong.
        """
        content = self._content(self._board.signature)
        report = self._server.scoring.run(score_content, *self._place, content)
        scores = report.scores
        # The agent stays where it starts; in the grounding track, no agent moves.
        if scores.get("path_length") or scores.get("success") != scores.get("oracle_success"):
            raise UnhealthyError
        rounded = {key: CATALOGUE[key].rounded(value) for key, value in scores.items()}
        if self._board.is_private and rounded != scores:
            raise UnhealthyError
        self._sign(report)

    def _sign(self, report: ScoreReport) -> None:
        signer = self._server.signer
        receipt = Receipt(
            server=signer.server,
            submission_id=_AGENT,
            team="",
            sha256=_NO_DIGEST,
            received_at=self._server.clock(),
            split=self._board.split,
            signature=report.signature,
            scores=report.scores,
            quota=QuotaReport(remaining=0, next_at=None, seconds_to_next=0, windows=[]),
        )
        verify(signer.sign(receipt), signer.public_pem)


def _read_leaderboards(server: ServerState) -> None:
    """Check that every leaderboard can be read from the database.

    A database that does not answer is reported by another check.

    Raises UnhealthyError, which names the leaderboards that cannot be read.
    """
    boards = server.all_boards
    try:
        with server.database.reading() as session:
            rankings = server.get(Rankings).rankings(session, boards)
    except DBAPIError as error:
        if damage_in(error) is not None:
            raise
        return
    unread = [
        board.label for board, ranking in zip(boards, rankings, strict=True) if ranking is None
    ]
    if unread:
        raise UnhealthyError(f"results that cannot be read are on: {'; '.join(unread)}")


def _compare_key(server: ServerState) -> None:
    """Check that the signing key is in use, and its file in its place.

    A database that cannot be read is reported by another check.

    Raises
    ------
    UnhealthyError
        If another key is in use.
    ReceiptError
        If the file cannot be used.
    """
    own = server.signer.key_id
    with suppress(DBAPIError), server.database.reading() as session:
        current = current_key(session)
        if current is not None and current.key_id != own:
            raise UnhealthyError(
                f"this server signs with {own}, which {current.key_id} has replaced; restart it"
            )
    load_key(file_of_key(server.settings.path(server.settings.signing_key), own))


def _try_uploads(server: ServerState) -> None:
    """Check that uploads can be stored and read.

    A database that cannot be read is reported by another check.
    """
    server.uploads.try_out()
    with suppress(DBAPIError), server.database.reading() as session:
        try_newest(session, server.uploads)


def _compare_rules(server: ServerState) -> None:
    """Check that no other server of the database has started since with other rules.

    A database that cannot be read is not reported here; the next check does that.
    """
    splits: Sequence[str] = ()
    with suppress(DBAPIError), server.database.reading() as session:
        splits = server.rules.follow(session)
    if splits:
        rules = rules_of(server.boards)
        _LOGGER.error(
            "another server on this database started later and uses other rules",
            extra={"fields": {"splits": splits, "rules": rules, "other": server.rules.recorded}},
        )
        raise UnhealthyError


def _write(server: ServerState) -> None:
    """Write the rows of an upload, and of what it refers to, in a transaction that is rolled back.

    The numbers are negative: PostgreSQL does not reuse numbers after a rollback.
    """
    now, unique = server.clock(), secrets.token_hex(16)
    times = {"received_at": now, "scored_at": now}
    someone = {"id": _NOBODY, "name": unique, "created_at": now}
    theirs = {"team_id": _NOBODY, "person_id": _NOBODY}
    digests = {"sha256": unique, "previous": unique, "digest": unique}
    rows = (
        (Team, someone),
        (Person, {**someone, "team_id": _NOBODY, "role": "participant"}),
        (Submission, {**_EMPTY, **theirs, **digests, "id": unique, **times}),
        (AuditEntry, {**_EMPTY, **digests, "id": _NOBODY, "at": now}),
        (Attempt, {**_EMPTY, **theirs, "id": _NOBODY, "at": now}),
    )
    with server.database.trying() as session:
        for table, values in rows:
            known = {name: value for name, value in values.items() if name in table.__table__.c}
            session.execute(insert(table).values(known))


def health_of(request: Request) -> Health:
    """Return what checks the application that answers a request."""
    health: Health = request.app.state.health
    return health


Examined = Annotated[Health, Depends(health_of)]
