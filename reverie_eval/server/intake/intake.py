"""Accepting submissions: each is scored in the request that uploads it.

Scoring comes before the transaction and needs no lock. Whether a submission is a repeat, and
whether the quota allows it, is checked again inside the transaction, when no other can interfere.
A submission is received when the last byte of its upload has arrived, and the split must be open
at that time: scoring may end later.

People may send files to the organiser instead, by e-mail for example, who submits them for their
senders. For each such file there is a reply to its sender, as text, even if it is refused.
"""

import logging
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Self

from sqlalchemy import and_, bindparam, or_, select
from sqlalchemy.orm import Session

from reverie_eval.errors import ReverieEvalError, SubmissionError
from reverie_eval.reporting.service import quota_lines, result_tables, submission_lines
from reverie_eval.schemas.organising import EmailedFile, EmailedFileReport, NoticeReport
from reverie_eval.schemas.service import (
    Accepted,
    BoardResult,
    Checked,
    Method,
    QuotaReport,
    Schedule,
    ScoredSubmission,
    SubmissionChange,
)
from reverie_eval.server.accounts.people import person_named
from reverie_eval.server.audit.log import SERVER, row_name
from reverie_eval.server.audit.transactions import Actor, Transaction
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.errors import ConflictError, MalformedError, NotOpenError, request_error
from reverie_eval.server.intake.attempts import FAILURES, recording
from reverie_eval.server.intake.quotas import check_quota, usage_of
from reverie_eval.server.intake.submissions import SubmissionService, check_metadata
from reverie_eval.server.messages.notices import current_notice
from reverie_eval.server.messages.queue import notify
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.scoring.contexts import Read, check_file, open_file, score_file
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import (
    IS_SHOWN,
    SAME_FILE,
    SUBMITTED,
    Person,
    Submission,
    Team,
)
from reverie_eval.text import printable, time_text

MOST_NAMED = 5
"""Teams that the notice of a file from several teams names, at most."""
_LOGGER = logging.getLogger("reverie_eval.server")

# Built here, because building them takes longer than running them, which each upload does.
_IS_SAME_FILE = and_(
    Submission.team_id == bindparam("team"),
    Submission.repeat == "",
    Submission.split == bindparam("split"),
    Submission.sha256 == bindparam("sha256"),
)
_IS_SAME_KEY = and_(
    Submission.person_id == bindparam("person"), Submission.idempotency_key == bindparam("key")
)
_SAME_FILE = select(Submission).where(_IS_SAME_FILE)
_SAME_FILE_OR_KEY = select(Submission).where(or_(_IS_SAME_FILE, _IS_SAME_KEY))
_SAME_FROM_OTHERS = (
    select(Submission.id, Team.name, IS_SHOWN.label("is_shown"))
    .join(Team, Submission.team_id == Team.id)
    .where(
        Submission.split == bindparam("split"),
        Submission.sha256 == bindparam("sha256"),
        Submission.team_id != bindparam("team"),
    )
    .order_by(IS_SHOWN.desc(), Submission.received_at, Submission.id)
    .limit(MOST_NAMED)
)


@dataclass
class Intake:
    """Accepts submissions.

    Scoring takes too long for a transaction, so this class reads the database before scoring and
    writes to it after.
    """

    server: ServerState

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return the intake of a server."""
        return cls(server)

    def validate(self, person: Person, split: str, packed: bytes) -> Checked:
        """Unpack and check a submission without the solution; it is not stored or counted.

        Raises
        ------
        SubmissionError
            If it is rejected; lists all problems.
        """
        self.server.board(split)  # or there is no such split
        with self.server.scoring.hold() as runner:
            runner.run(open_file, packed, self._most_unpacked)
            notes = runner.run(check_file, split)
        with self.server.database.reading() as session:
            quota = self.quotas(session, person, split)[split]
        return Checked(split=split, valid=True, notes=notes, quota=quota)

    def quotas(self, session: Session, person: Person, *splits: str) -> Mapping[str, QuotaReport]:
        """Return the submissions left to a person on these splits, or on all splits."""
        now = self.server.clock()
        usage = usage_of(session, person, now)
        boards = [self.server.board(split) for split in splits or self.server.boards]
        return {
            board.split: usage.of_split(board.split, board.settings.effective_quota).state(now)
            for board in boards
        }

    def submit(
        self,
        person: Person,
        split: str,
        packed: bytes,
        method: Method,
        key: str | None,
        *,
        arrived: datetime,
        organiser: Actor | None = None,
    ) -> Accepted:
        """Unpack a submission, score and store it, and record the attempt.

        An ``organiser`` may do this for a person, also while submissions are paused. The phase and
        the quota are those of the time at which it arrived, which may be long ago.

        If the team has submitted the same file to the split before, or the person has used the same
        key, the earlier result is returned. This holds even if the quota is spent, the split is
        closed, or its ground truth or protocol has changed since; the signature shows the latter.

        Raises
        ------
        SubmissionError
            If it is rejected; lists all problems. No submission is used.
        QuotaSpentError
            If no submissions are left.
        BytesSpentError
            If the team has sent too many bytes in the last 24 hours.
        NotOpenError
            If the split did not accept submissions when the upload had arrived.
        ConflictError
            If the key was used for another file.
        MalformedError
            If required information about the method is missing.
        """
        self.server.board(split)  # or there is no such split
        with recording(self.server, person, split, len(packed)) as attempt:
            accepted = None
            while accepted is None:  # again if the ground truth was corrected meanwhile
                with self.server.scoring.hold() as runner:
                    file = runner.run(open_file, packed, self._most_unpacked)
                    attempt.size = file.size
                    row = Submission(
                        split=split,
                        sha256=file.sha256,
                        received_at=arrived,
                        size=file.size,
                        idempotency_key=key,
                        method=method.model_dump(mode="json"),
                        boards={},
                    )
                    found = self.find_earlier(row, person, method, organiser) or runner.run(
                        score_file, split, navigation_only=method.navigation_only
                    )
                accepted = (
                    self.store(row, found, person, method, organiser)
                    if isinstance(found, Read)
                    else found
                )
            if accepted.is_repeat:
                attempt.outcome = "repeat"
        return accepted

    @property
    def _most_unpacked(self) -> int:
        return self.server.settings.limits.unpacked_mebibytes << 20

    def find_earlier(
        self, row: Submission, person: Person, method: Method, organiser: Actor | None
    ) -> Accepted | None:
        """Return the result of the submission that a new one repeats, if any.

        Otherwise the new one may be scored; raises the errors of :meth:`submit` if not.
        """
        board, limits = self.server.boards[row.split], self.server.settings.limits
        with self.server.database.reading() as session:
            earlier = self._earlier(session, row, person)
            if earlier is not None:
                return self._repeated(session, earlier, board, person, method)
            check_metadata(method, self.server.settings.required_metadata)
            schedule = self.server.get(Schedules).of_split(session, row.split).at(row.received_at)
            if not organiser:
                notice = current_notice(session, row.received_at)
                self._check_paused(notice, board, schedule)
            self._check_open(board, schedule, row.received_at)
            check_quota(session, row, person, board, limits, in_the_past=bool(organiser))
        return None

    def store(
        self,
        row: Submission,
        read: Read,
        person: Person,
        method: Method,
        organiser: Actor | None,
    ) -> Accepted | None:
        """Complete and store the row of a submission, unless it repeats an earlier one.

        Returns None if other rules than those that it was scored by are now in force.
        """
        row.id = secrets.token_hex(8)
        with (
            self.server.uploads.staged(row.sha256, read.packed) as keep,
            self.server.transactions.begin(organiser or person) as transaction,
        ):
            session = transaction.session
            self.server.rules.check(session, row.split)
            board = self.server.boards[row.split]
            earlier = self._earlier(session, row, person)
            if earlier is not None:
                return self._repeated(session, earlier, board, person, method)
            if not all(each.measures_as(read.reports[each.name]) for each in board.all):
                return None
            limits = self.server.settings.limits
            usage = check_quota(session, row, person, board, limits, in_the_past=bool(organiser))
            usage = usage.with_one_more(row.received_at)
            quota = usage.state(row.received_at)
            row.person = session.merge(person, load=False)
            row.team = row.person.team
            row.scored_at = transaction.now
            for name, report in read.reports.items():
                receipt = self.server.signer.sign_result(row, report, quota)
                row.store_result(name, BoardResult(report=report, receipt=receipt))
            notify_of_same_file(transaction, row)  # so the log's last entry has the row's digest
            described = method.model_dump(mode="json", exclude_defaults=True)
            transaction.record(
                SUBMITTED, row, row.id, split=row.split, sha256=row.sha256, method=described
            )
            said = f"{row.team.name} ({person.name}) submitted {method.name} to {row.split}"
            notify(transaction, "submission", said, f"/submissions/{row.id}")
            keep()
            # The receipt has the quota of the time at which a file was received, also long ago.
            left = usage.state(transaction.now) if organiser else quota
            return Accepted(submission=self._worded(session, row), quota=left, is_repeat=False)

    def _earlier(self, session: Session, new: Submission, person: Person) -> Submission | None:
        """Return the earlier submission that a new one repeats, or None."""
        key = new.idempotency_key
        given = {"team": person.team_id, "split": new.split, "sha256": new.sha256}
        if key is None:
            return session.scalars(_SAME_FILE, given).first()
        given |= {"person": person.id, "key": key}
        repeated = session.scalars(_SAME_FILE_OR_KEY, given).all()
        by_key = [
            row for row in repeated if (row.person_id, row.idempotency_key) == (person.id, key)
        ]
        if by_key and (by_key[0].sha256, by_key[0].split) != (new.sha256, new.split):
            raise ConflictError(
                f"the Idempotency-Key {key!r} was used for another file or split; use a new one "
                "for each submission"
            )
        return next(iter([*by_key, *repeated]), None)

    def _repeated(
        self, session: Session, row: Submission, board: Board, person: Person, method: Method
    ) -> Accepted:
        """Return the earlier result, and what a new description of the method says otherwise."""
        quota = self.quotas(session, person, board.split)[board.split]
        given = method.model_dump(mode="json", include=method.model_fields_set)
        ignored = [name for name, value in given.items() if row.method.get(name) != value]
        submission = self._worded(session, row)
        return Accepted(submission=submission, quota=quota, is_repeat=True, ignored=ignored)

    def _worded(self, session: Session, row: Submission) -> ScoredSubmission:
        now = self.server.clock()
        return self.server.get(SubmissionService).view(session, now).report(row)

    def _check_paused(self, notice: NoticeReport, board: Board, schedule: Schedule) -> None:
        why = f": {notice.banner}" if notice.banner else ""
        if notice.paused:
            raise NotOpenError(f"the organiser has paused submissions{why}")
        if schedule.paused:
            raise NotOpenError(f"the organiser has paused submissions to {board.split}{why}")

    def _check_open(self, board: Board, schedule: Schedule, now: datetime) -> None:
        if not schedule.is_open(now):
            closed, opens = schedule.closed_at(now), schedule.opens_at(now)
            arrived = now.isoformat(timespec="microseconds")
            before = (
                f"; the last phase closed {closed.isoformat()}, and this file arrived {arrived}"
                if closed
                else ""
            )
            after = f"; the next phase opens {opens.isoformat()}" if opens else ""
            raise NotOpenError(f"{board.split} accepts no submissions now{before}{after}")


def notify_of_same_file(transaction: Transaction, new: Submission) -> None:
    """Notify the organiser if another team has submitted the same file to the split.

    The same file has the same bytes after unpacking. The same predictions in another file are left
    to `server evidence`: an upload does not wait until they are compared with all others.
    """
    given = {"split": new.split, "sha256": new.sha256, "team": new.team.id}
    others = transaction.session.execute(_SAME_FROM_OTHERS, given).all()
    if not others:
        return
    same_as = [each.id for each in others]
    # About the split, not the submission, whose history its team sees.
    transaction.audit_log.append(
        transaction.session,
        transaction.now,
        SERVER,
        SAME_FILE,
        row=row_name(new),
        row_digest="",
        subject=new.split,
        same_as=same_as,
    )
    names = ", ".join(f"{each.name}{' (published)' * each.is_shown}" for each in others)
    whose = "other teams" if len(others) > 1 else "another team"
    text = f"{new.team.name} submitted to {new.split} the file that {whose} had submitted: {names}"
    notify(transaction, "same-file", text, "/desk")
    about = {"split": new.split, "team": new.team.id, "submission": new.id, "same_as": same_as}
    _LOGGER.warning("same file from two teams", extra={"fields": about})


def submit_for_sender(
    server: ServerState,
    organiser: Actor,
    file: EmailedFile,
    packed: bytes,
    method: Method,
    *,
    filename: str,
) -> EmailedFileReport:
    """Score a file as if its sender had uploaded it when it was received.

    This is possible during a pause. A file that was submitted before gets its earlier result.
    The reply names the file, if it has a name, and says how many submissions are left today.

    Raises
    ------
    NotFoundError
        If the team has no such person, or the server no such split.
    MalformedError
        If the time is in the future.
    RequestError
        If the file is refused, as an upload would be; the error has the reply to the sender.
    """
    server.board(file.split)  # or there is no such split
    with server.database.reading() as session:
        sender = person_named(session, file.person, file.team)
    if file.received_at > server.clock():
        raise MalformedError(
            f"the file was received at {time_text(file.received_at)}, which is in the future; "
            "give the time at which the e-mail arrived"
        )
    named = f"file {printable(filename)}" if filename else "file"
    about = f"Your {named}, received {time_text(file.received_at)}, was"
    try:
        accepted = server.get(Intake).submit(
            sender,
            file.split,
            packed,
            method,
            key=None,
            arrived=file.received_at,
            organiser=organiser,
        )
    except ReverieEvalError as error:
        refusal = request_error(error)
        if not isinstance(refusal, FAILURES):
            raise
        opening = f"{about} not scored, and no submission was used."
        refusal.reply = _letter(file, opening, _why_refused(error))
        raise refusal from error
    if accepted.is_repeat and accepted.submission.received_at != file.received_at:
        ignored = [*accepted.ignored, "received_at"]
        accepted = accepted.model_copy(update={"ignored": ignored})
    # A withdrawn submission stays withdrawn until its team restores it.
    if file.publish and accepted.submission.status == "unpublished":
        change = SubmissionChange(published=True)
        published = server.get(SubmissionService).change(
            sender, accepted.submission.id, change, organiser
        )
        accepted = accepted.model_copy(update={"submission": published})
    reply = _letter(
        file, f"{about} scored on {file.split}.", *_result_lines(accepted, server.settings.title)
    )
    return EmailedFileReport(**dict(accepted), reply=reply)


def _letter(file: EmailedFile, opening: str, *lines: str) -> str:
    return "\n".join([f"Dear {file.team},", "", opening, "", *lines])


def _why_refused(error: ReverieEvalError) -> str:
    if isinstance(error, SubmissionError):
        return f"{error}\n\n`reverie-eval validate` finds the same problems before you send a file."
    return str(error)


def _result_lines(accepted: Accepted, server: str) -> Iterator[str]:
    submission = accepted.submission
    for name, table in result_tables(submission, server).items():
        yield from [f"On the leaderboard {name}:"] if name else []
        yield table.to_text()
        yield ""
    to_publish = "answer this message if you want it on the leaderboard"
    to_change = "answer this message if it should be changed"
    yield from submission_lines(accepted, to_publish=to_publish, to_change=to_change)
    yield from quota_lines(accepted.quota, submission.split)
    yield ""
    yield f"The signed {'receipts are' if submission.boards else 'receipt is'} attached."
