"""Submissions: scored in the request that brings them, kept in one transaction, or not at all.

Scoring comes before the transaction and needs no lock. What the transaction decides - is this a
repeat, is anything left of the quota - is decided on what is there when it is this one's turn.
"""

import hashlib
import secrets
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from functools import lru_cache
from types import MappingProxyType
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.errors import ProtocolError
from reverie_eval.reading.unpacking import unpack
from reverie_eval.schemas.report import ValidationReport
from reverie_eval.schemas.service import (
    Accepted,
    Method,
    QuotaReport,
    SubmissionChange,
    SubmissionReport,
)
from reverie_eval.scores import Scores
from reverie_eval.server.errors import (
    ConflictError,
    MalformedError,
    NotFoundError,
    NotOpenError,
    QuotaSpentError,
)
from reverie_eval.server.service.attempts import Attempts
from reverie_eval.server.service.audit import record
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.notices import Notices
from reverie_eval.server.service.quotas import QuotaUsage, quota_usage
from reverie_eval.server.service.receipts import Signer
from reverie_eval.server.service.reports import quota_report, submission_report
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Person, Submission
from reverie_eval.server.store.uploads import Uploads

Clock = Callable[[], datetime]

RECENT = 8
"""Submissions whose episodes are kept at hand: somebody who looks at one looks at the next."""


class SubmissionService:
    """What can be done with submissions."""

    def __init__(
        self,
        boards: Mapping[str, Board],
        database: Database,
        uploads: Uploads,
        signer: Signer,
        clock: Clock,
        *,
        notices: Notices,
        attempts: Attempts,
        required_metadata: Collection[str],
        most_bytes: int,
    ) -> None:
        self._boards = boards
        self._database = database
        self._uploads = uploads
        self._signer = signer
        self._clock = clock
        self._notices = notices
        self._attempts = attempts
        self._required_metadata = required_metadata
        self._scored = lru_cache(RECENT)(self._score_again)
        self._most_bytes = most_bytes

    def board(self, split: str) -> Board:
        """Return a split's board; NotFoundError if the server has no such split."""
        board = self._boards.get(split)
        if board is None:
            known = ", ".join(self._boards)
            raise NotFoundError(f"there is no split {split!r} here; there are: {known}")
        return board

    def validate(self, split: str, content: bytes) -> ValidationReport:
        """Check a submission without looking at answers; nothing is spent or kept.

        Raises
        ------
        SubmissionError
            Listing everything that is wrong.
        """
        validation = self.board(split).check(content).validation()
        return ValidationReport(split=split, valid=True, notes=list(validation.notes))

    def quota(self, person: Person, split: str) -> QuotaReport:
        """Return what somebody has left on a split."""
        now = self._clock()
        with self._database.reading() as session:
            return quota_report(
                self._usage(session, person, self.board(split), now).state(now), now
            )

    def submit(
        self, person: Person, split: str, packed: bytes, method: Method, key: str | None
    ) -> Accepted:
        """Unpack a submission, score it and keep it; whatever comes of that is noted.

        A file that the team has sent to the split before, and a key that the person has used for
        it, get the earlier receipt, whatever has changed since: what is left of the quota, whether
        the split is open, or what it is scored by, which the receipt's signature tells.

        Raises
        ------
        SubmissionError
            Listing everything that is wrong with it. Nothing is spent.
        QuotaSpentError
            If nothing is left.
        NotOpenError
            If the split takes no submissions now.
        ConflictError
            If the key was used for another file.
        MalformedError
            If something is not said of the method that the organiser asks for.
        """
        board = self.board(split)
        with self._attempts.noting(person, split, len(packed)) as noted:
            content = unpack(packed, self._most_bytes)
            noted.size = len(content)
            accepted = self._submit(person, board, content, method, key)
            noted.outcome = "repeat" if accepted.is_repeat else "scored"
        return accepted

    def _submit(
        self, person: Person, board: Board, content: bytes, method: Method, key: str | None
    ) -> Accepted:
        split, sha256 = board.name, hashlib.sha256(content).hexdigest()
        with self._database.reading() as session:
            known = self._known(session, person, split, sha256, key)
            if known is not None:
                return self._repeated(session, known, board, person)
            self._demand_metadata(method)
            self._demand_open(session, board)
            self._demand_quota(session, person, board, self._clock())
        reading = board.read(content)
        report = board.report(board.score(reading), reading)
        self._uploads.put(sha256, content)
        row = Submission(
            id=secrets.token_hex(8),
            split=split,
            team_id=person.team_id,
            person_id=person.id,
            sha256=sha256,
            size=len(content),
            idempotency_key=key,
            method=method.model_dump(mode="json"),
            report=report.model_dump(mode="json"),
        )
        with self._database.writing() as session:
            known = self._known(session, person, split, sha256, key)
            if known is not None:
                return self._repeated(session, known, board, person)
            row.received_at = self._clock()
            usage = self._demand_quota(session, person, board, row.received_at)
            left = usage.with_one_more(row.received_at).state(row.received_at)
            quota = quota_report(left, row.received_at)
            self._keep(session, row, person, quota)
            return Accepted(submission=submission_report(row), quota=quota, is_repeat=False)

    def _keep(self, session: Session, row: Submission, person: Person, quota: QuotaReport) -> None:
        """Sign and insert a submission."""
        receipt = self._signer.sign(
            submission_id=row.id,
            team=person.team.name,
            sha256=row.sha256,
            received_at=row.received_at,
            split=row.split,
            signature=row.report["signature"],
            scores=row.report["scores"],
            quota=quota,
        )
        row.receipt = receipt.model_dump(mode="json")
        session.add(row)
        session.flush()
        record(
            session,
            row.received_at,
            person.name,
            "submitted",
            row.id,
            split=row.split,
            sha256=row.sha256,
        )

    def _known(
        self, session: Session, person: Person, split: str, sha256: str, key: str | None
    ) -> Submission | None:
        """Return the submission that this one repeats, if it does."""
        if key is not None:
            same_key = select(Submission).where(
                Submission.person_id == person.id, Submission.idempotency_key == key
            )
            found = session.scalars(same_key).first()
            if found is not None and (found.sha256, found.split) != (sha256, split):
                raise ConflictError(
                    f"the Idempotency-Key {key!r} was used for another file or split; take a new "
                    "one for each submission"
                )
            if found is not None:
                return found
        same_file = select(Submission).where(
            Submission.team_id == person.team_id,
            Submission.split == split,
            Submission.sha256 == sha256,
        )
        return session.scalars(same_file).first()

    def _repeated(
        self, session: Session, row: Submission, board: Board, person: Person
    ) -> Accepted:
        now = self._clock()
        quota = quota_report(self._usage(session, person, board, now).state(now), now)
        return Accepted(submission=submission_report(row), quota=quota, is_repeat=True)

    def _demand_metadata(self, method: Method) -> None:
        said = {name for name in method.model_fields_set if getattr(method, name) not in {"", None}}
        missing = [name for name in self._required_metadata if name not in said]
        if missing:
            raise MalformedError(f"the organiser asks for more on the method: {', '.join(missing)}")

    def _demand_open(self, session: Session, board: Board) -> None:
        standing = self._notices.standing(session)
        if standing.paused:
            why = f": {standing.banner}" if standing.banner else ""
            raise NotOpenError(f"the organiser has paused submissions{why}")
        now = self._clock()
        if not board.is_open(now):
            opening = [p.opens for p in board.split.phases if p.opens and p.opens > now]
            after = f"; the next phase opens {min(opening).isoformat()}" if opening else ""
            raise NotOpenError(f"{board.name} takes no submissions now{after}")

    def _demand_quota(
        self, session: Session, person: Person, board: Board, now: datetime
    ) -> QuotaUsage:
        usage = self._usage(session, person, board, now)
        state = usage.state(now)
        if not state.remaining:
            raise QuotaSpentError(state)
        return usage

    def _usage(self, session: Session, person: Person, board: Board, now: datetime) -> QuotaUsage:
        return quota_usage(session, board.split.effective_quota, board.name, person, now)

    def mine(
        self, person: Person, split: str | None = None, most: int | None = None
    ) -> Sequence[SubmissionReport]:
        """Return what somebody's team has submitted, the newest first; the organiser sees all.

        Of all splits or of one, and all of it or no more than so many.
        """
        chosen = select(Submission).order_by(Submission.received_at.desc()).limit(most)
        if split is not None:
            chosen = chosen.where(Submission.split == split)
        if person.role != "organiser":
            chosen = chosen.where(Submission.team_id == person.team_id)
        with self._database.reading() as session:
            return [submission_report(row) for row in session.scalars(chosen)]

    def one(self, person: Person, submission_id: str) -> SubmissionReport:
        """Return a submission of somebody's team.

        Raises
        ------
        NotFoundError
            If there is none, or it is another team's: nobody learns which.
        """
        with self._database.reading() as session:
            return submission_report(_of_team(session, person, submission_id))

    def file(self, person: Person, submission_id: str) -> bytes:
        """Return what was uploaded, byte for byte; errors are those of :meth:`one`."""
        return self._uploads.get(self.one(person, submission_id).sha256)

    def episodes(self, person: Person, submission_id: str) -> Scores:
        """Return the scores of every episode, computed again from the upload.

        Raises
        ------
        NotFoundError
            As for :meth:`one`, and for every submission to a private split, whoever asks; also
            where the ground truth or the protocol is not what the submission was scored by.
        """
        known = self.one(person, submission_id)
        board = self.board(known.split)
        if board.is_private:
            raise NotFoundError(f"values per episode of {board.name} leave the server never")
        if not board.measures_as(known.report):
            raise NotFoundError(
                f"{board.name} is scored by other data or another protocol now than this "
                "submission was; see its signature"
            )
        return self._scored(known.split, known.sha256)

    def _score_again(self, split: str, sha256: str) -> Scores:
        """Score what was uploaded; the ground truth is the same for as long as the server runs.

        What the values were computed from is let go: it may be a hundred times as large.
        """
        board = self.board(split)
        scores = board.score(board.read(self._uploads.get(sha256)))
        return replace(scores, episodes=MappingProxyType(dict(scores.episodes)))

    def change(
        self, person: Person, submission_id: str, change: SubmissionChange
    ) -> SubmissionReport:
        """Publish, withdraw, rename a submission, or hide its team for a while.

        Raises
        ------
        NotFoundError
            As for :meth:`one`.
        ConflictError
            If a withdrawn submission is to be published.
        MalformedError
            If something is not said of the method any more that the organiser asks for.
        """
        now = self._clock()
        intervals = self._intervals(person, submission_id) if change.published else None
        with self._database.writing() as session:
            row = _of_team(session, person, submission_id)
            if intervals is not None:
                row.report = {**row.report, "intervals": intervals}
            if change.method is not None:
                said = change.method.model_dump(mode="json", exclude_unset=True)
                method = Method.model_validate({**row.method, **said})
                self._demand_metadata(method)
                row.method = method.model_dump(mode="json")
            if change.withdrawn is not None:
                row.withdrawn_at = (row.withdrawn_at or now) if change.withdrawn else None
            if change.published is not None:
                row.published_at = (row.published_at or now) if change.published else None
            if "anonymous_until" in change.model_fields_set:
                row.anonymous_until = change.anonymous_until
            if change.published and row.withdrawn_at is not None:
                raise ConflictError("a withdrawn submission is not published; restore it first")
            changed = change.model_dump(mode="json", exclude_unset=True)
            record(session, now, person.name, "changed", row.id, **changed)
            return submission_report(row)

    def _intervals(self, person: Person, submission_id: str) -> Mapping[str, Any] | None:
        """Draw confidence intervals, of open splits alone.

        They take longer than scoring does, so they wait until there are readers.
        """
        known = self.one(person, submission_id)
        board = self.board(known.split)
        is_drawn = known.report.intervals is not None
        if board.is_private or is_drawn or not board.measures_as(known.report):
            return None
        scores = board.score(board.read(self._uploads.get(known.sha256)))
        try:
            drawn = scores.with_intervals().to_report().intervals
        except ProtocolError:  # all episodes are of one target, which tells nothing of others
            return None
        return None if drawn is None else drawn.model_dump(mode="json")


def _of_team(session: Session, person: Person, submission_id: str) -> Submission:
    # A database may not be able to look for every text: PostgreSQL has none with a zero byte.
    row = session.get(Submission, submission_id) if submission_id.isalnum() else None
    if row is None or (person.role != "organiser" and row.team_id != person.team_id):
        raise NotFoundError(f"there is no submission {submission_id!r} of your team")
    return row
