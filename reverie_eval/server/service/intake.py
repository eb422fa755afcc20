"""Taking submissions in: each is scored in the request that brings it, and kept or not at all.

Scoring comes before the transaction and needs no lock. What the transaction decides - is this a
repeat, is anything left of the quota - is decided on what is there when it is this one's turn.
Whether submissions are taken, and when one was received, is decided as soon as all of it has
arrived: who is in time need not be fast.
"""

import hashlib
import secrets
from collections.abc import Callable, Collection, Mapping
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.schemas.service import Accepted, Checked, Method, QuotaReport
from reverie_eval.server.errors import ConflictError, NotOpenError, QuotaSpentError
from reverie_eval.server.service.attempts import Attempts
from reverie_eval.server.service.audit import record
from reverie_eval.server.service.boards import Board, board_named
from reverie_eval.server.service.methods import demand_metadata
from reverie_eval.server.service.notices import Notices
from reverie_eval.server.service.quotas import QuotaUsage, quota_usage
from reverie_eval.server.service.receipts import Signer
from reverie_eval.server.service.reports import quota_report, submission_report
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Person, Submission
from reverie_eval.server.store.uploads import Uploads
from reverie_eval.submissions._sources import unpack

Clock = Callable[[], datetime]


class Intake:
    """Where submissions come in."""

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
        self._most_bytes = most_bytes

    def validate(self, person: Person, split: str, content: bytes) -> Checked:
        """Check a submission without looking at answers; nothing is spent or kept.

        Raises
        ------
        SubmissionError
            Listing everything that is wrong.
        """
        notes = board_named(self._boards, split).check(content).validation().notes
        quota = self.quota(person, split)
        return Checked(split=split, valid=True, notes=list(notes), quota=quota)

    def quota(self, person: Person, split: str) -> QuotaReport:
        """Return what somebody has left on a split."""
        board = board_named(self._boards, split)
        with self._database.reading() as session:
            return self._left(session, person, board)

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
        arrived = self._clock()
        board = board_named(self._boards, split)
        with self._attempts.noting(person, split, len(packed)) as noted:
            content = unpack(packed, self._most_bytes)
            noted.size = len(content)
            accepted = self._submit(person, board, content, method, key, arrived=arrived)
            noted.outcome = "repeat" if accepted.is_repeat else "scored"
        return accepted

    def _submit(
        self,
        person: Person,
        board: Board,
        content: bytes,
        method: Method,
        key: str | None,
        *,
        arrived: datetime,
    ) -> Accepted:
        split, sha256 = board.name, hashlib.sha256(content).hexdigest()
        with self._database.reading() as session:
            known = self._known(session, person, split, sha256, key)
            if known is not None:
                return self._repeated(session, known, board, person)
            demand_metadata(method, self._required_metadata)
            self._demand_open(session, board, arrived)
            self._demand_quota(session, person, board, arrived)
        reading = board.read(content)
        report = board.report(board.score(reading), reading)
        self._uploads.put(sha256, content)
        row = Submission(
            id=secrets.token_hex(8),
            split=split,
            team_id=person.team_id,
            person_id=person.id,
            sha256=sha256,
            received_at=arrived,
            size=len(content),
            idempotency_key=key,
            method=method.model_dump(mode="json"),
            report=report.model_dump(mode="json"),
        )
        with self._database.writing() as session:
            known = self._known(session, person, split, sha256, key)
            if known is not None:
                return self._repeated(session, known, board, person)
            usage = self._demand_quota(session, person, board, arrived)
            quota = quota_report(usage.with_one_more(arrived).state(arrived), arrived)
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
            self._clock(),
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
        quota = self._left(session, person, board)
        return Accepted(submission=submission_report(row), quota=quota, is_repeat=True)

    def _demand_open(self, session: Session, board: Board, now: datetime) -> None:
        standing = self._notices.standing(session)
        if standing.paused:
            why = f": {standing.banner}" if standing.banner else ""
            raise NotOpenError(f"the organiser has paused submissions{why}")
        if not board.is_open(now):
            opening = [p.opens for p in board.split.phases if p.opens and p.opens > now]
            after = f"; the next phase opens {min(opening).isoformat()}" if opening else ""
            raise NotOpenError(f"{board.name} takes no submissions now{after}")

    def _demand_quota(
        self, session: Session, person: Person, board: Board, now: datetime
    ) -> QuotaUsage:
        usage = self._usage(session, person, board, now)
        left = quota_report(usage.state(now), now)
        if not left.remaining:
            raise QuotaSpentError(left)
        return usage

    def _left(self, session: Session, person: Person, board: Board) -> QuotaReport:
        now = self._clock()
        return quota_report(self._usage(session, person, board, now).state(now), now)

    def _usage(self, session: Session, person: Person, board: Board, now: datetime) -> QuotaUsage:
        return quota_usage(session, board.split.effective_quota, board.name, person, now)
