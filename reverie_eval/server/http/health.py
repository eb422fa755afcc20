"""Whether the server works, checked by doing its work.

For every split, a known submission is read, scored, rounded and signed; the signing key is the one
in use; the rules of all splits are those of the server that started last on the database; the
database writes the rows of an upload, and rolls them back; the folder or store of uploads is
accessed; no job failed the last time, or is overdue. The result is cached for some seconds, so
frequent checks cost nothing. The reply names what failed; the log says why.
"""

import asyncio
import json
import logging
import secrets
import time
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from typing import Any

from anyio import move_on_after
from anyio.to_thread import run_sync
from sqlalchemy import insert
from sqlalchemy.exc import DBAPIError

from reverie_eval.agents import run_agent
from reverie_eval.metrics import METRICS
from reverie_eval.receipts import verify
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import JOB, HealthReport, JobReport, QuotaReport, Receipt
from reverie_eval.server.jobs.runner import Jobs
from reverie_eval.server.jobs.work import tell_fault
from reverie_eval.server.service.boards import Board, board_named
from reverie_eval.server.service.keys import current_key
from reverie_eval.server.service.rules import rules_of
from reverie_eval.server.service.scoring import Context
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import Attempt, AuditEntry, Person, Submission, Team

SECONDS_KEPT = 10
SECONDS_TO_ANSWER = 20
"""A check that takes longer has failed."""

_LOGGER = logging.getLogger("reverie_eval.server")
_AGENT = "stop"
"""The reference agent that never moves: its scores are known in advance."""
_NO_DIGEST = "0" * 64
_NOBODY = -1
_EMPTY: Mapping[str, Any] = {
    **dict.fromkeys(("split", "actor", "action", "row", "subject", "key_id", "outcome"), ""),
    **dict.fromkeys(("size", "problems", "milliseconds"), 0),
    **{name: {} for name in ("method", "report", "receipt", "also", "details")},
}
"""Values of columns that do not matter here."""


class UnhealthyError(Exception):
    """The known submission got wrong scores, or another server has other rules or another key."""


class Health:
    """Checks a server, at most once every few seconds."""

    def __init__(self, server: ServerState, jobs: Jobs) -> None:
        self._checks: Mapping[str, Callable[[], None]] = {
            **{
                f"scoring of {board.label}": Canary(server, board).score
                for board in server.leaderboards
            },
            "signing key": partial(_compare_key, server),
            "same rules as other servers": partial(_compare_rules, server),
            "database": partial(_write, server),
            "uploads": server.uploads.try_out,
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
        failed = [name for name in self._checks if not passed.get(name)]
        return HealthReport.of([*failed, *(f"{JOB}{name}" for name in self._jobs.failing())], jobs)

    def _run_checks(self, passed: MutableMapping[str, bool]) -> None:
        """Run all checks and record each result at once, because a later check may hang."""
        for name, check in self._checks.items():
            try:
                check()
            except Exception:
                _LOGGER.exception("unhealthy", extra={"fields": {"failed": name}})
                passed[name] = False
            else:
                passed[name] = True


def score_content(context: Context, split: str, further: str, content: bytes) -> ScoreReport:
    """Score a JSON text on a leaderboard."""
    return board_named(context.boards, split, further).scored(content).report


class Canary:
    """A known submission to a split."""

    def __init__(self, server: ServerState, board: Board) -> None:
        self._server = server
        self._place = board.name, board.further
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
        rounded = {key: METRICS[key].rounded(value) for key, value in scores.items()}
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
            split=self._board.name,
            signature=report.signature,
            scores=report.scores,
            quota=QuotaReport(remaining=0, next_at=None, seconds_to_next=0, windows=[]),
        )
        verify(signer.sign(receipt), signer.public_pem)


def _compare_key(server: ServerState) -> None:
    """Check that the signing key was not replaced since this server started.

    A database that cannot be read is reported by another check.
    """
    current = None
    with suppress(DBAPIError), server.database.reading() as session:
        current = current_key(session)
    if current is not None and current.key_id != server.signer.key_id:
        fields = {"key": server.signer.key_id, "current": current.key_id}
        _LOGGER.error("the signing key was replaced; restart this server", extra={"fields": fields})
        raise UnhealthyError


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
