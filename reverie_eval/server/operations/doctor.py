"""Checks of all data that a server has stored."""

import hashlib
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path

from pydantic import ValidationError
from sqlalchemy import func, select, text
from sqlalchemy.orm import Session

from reverie_eval.errors import ReverieEvalError
from reverie_eval.processes import Progress, no_progress
from reverie_eval.receipts import Content, NewerVersionError, ReceiptError, read, verify_by_history
from reverie_eval.schemas.service import (
    BoardResult,
    EarlierResult,
    Envelope,
    KeyReport,
    Receipt,
    ScoredSubmission,
    Snapshot,
    SnapshotEntry,
)
from reverie_eval.server.audit.log import AuditLog
from reverie_eval.server.audit.rows import all_names_of_teams, mismatches
from reverie_eval.server.audit.signing import list_keys
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.messages.queue import given_up, notify_of_fault
from reverie_eval.server.opening import REFUSALS, acting, open_server
from reverie_eval.server.operations.checks import NEWEST_UPLOAD, Finding, check_folder, guarded
from reverie_eval.server.settings import load_settings
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.database import AT_ONCE, Database, count_rows
from reverie_eval.server.store.tables import AuditEntry, StoredSnapshot, Submission
from reverie_eval.server.store.uploads import ENDING, Uploads, UploadsError, name_of
from reverie_eval.text import count_text, first_few, short_digest

_RESTORE = "restore the key or the database from the last backup"
_KEPT = select(Submission.sha256).where(Submission.upload_deleted_at.is_(None)).distinct()
_SKEW = timedelta(minutes=1)
"""By how much the clocks of a server's machines may differ."""
LITTLE_SPACE = 1 << 30
"""Bytes of a disk that are too few: a thousand typical uploads to the largest split, unpacked, take
a few times as much."""


def examine(folder: Path, progress: Progress = no_progress) -> Iterator[Finding]:
    """Check what a server needs to start, then all stored data, if it can be read at all."""
    yield from (each for each in check_folder(folder) if each.check != NEWEST_UPLOAD)
    try:
        state = open_server(load_settings(folder))
    except (ReverieEvalError, *REFUSALS):
        message = "not checked; fix the faults above first"
        yield Finding("stored data", "note", message)
        return
    with closing(state.database), state.database.reading() as session:
        yield from guarded("database", _at_references(state.database, session))
        yield from guarded("submissions", _at_submissions(session, state, progress))
        yield from guarded("uploads", _at_lost(state))
        yield from guarded("snapshots", _at_snapshots(session, state))
        yield from guarded("audit log", _at_audit_log(session, state.audit_log))
        yield from guarded("clock", _at_clock(session, state.clock()))
        yield from guarded("messages", _at_messages(session))
    yield from _at_disk(state.settings.folder)


def tell_of_faults(folder: Path, findings: Iterable[Finding], actor: str) -> None:
    """Notify the organiser of faults by mail and webhook, if these are set up.

    Does nothing if the fault is in the server's own files or its database.
    """
    faults = [finding for finding in findings if finding.kind == "fault"]
    with suppress(ReverieEvalError):
        settings = load_settings(folder)
        if faults and settings.channels:
            with acting(settings, actor) as transaction:
                found = count_text(len(faults), "fault")
                text = f"server doctor found {found}: {faults[0].check}: {faults[0].what}"
                notify_of_fault(transaction, text)


def _at_references(database: Database, session: Session) -> Iterator[Finding]:
    if not database.is_sqlite:
        return
    for table, row, parent, _ in session.execute(text("PRAGMA foreign_key_check")):
        message = f"row {row} of {table} refers to a missing {parent}; restore the last backup"
        yield Finding("database", "fault", message)


def _at_submissions(session: Session, state: ServerState, progress: Progress) -> Iterator[Finding]:
    yield from _at_uploads(session, state.uploads, progress)
    counted = select(Submission.split, func.count()).group_by(Submission.split)
    for split, number in session.execute(counted.order_by(Submission.split)):
        if split not in state.boards:
            sent = count_text(number, "submission")
            message = f"{sent} to {split}, which is not a split in the settings"
            yield Finding("submissions", "note", message)
    receipts, teams = _Envelopes("receipt", list_keys(session)), all_names_of_teams(session)
    chosen = select(Submission.id).order_by(Submission.received_at)
    for names in session.scalars(chosen.execution_options(yield_per=AT_ONCE)).partitions():
        for name, submission in _read(session, names):
            if submission is None:
                message = f"the row of submission {name} cannot be read; restore the last backup"
                yield Finding("submissions", "fault", message)
            else:
                yield from _at_receipts(receipts, submission, teams[submission.team])
    yield from receipts.sum_up()


def _read(session: Session, names: Sequence[str]) -> Iterator[tuple[str, ScoredSubmission | None]]:
    """Read submissions, in one query if all can be read; None for each that cannot."""
    chosen = select(Submission).where(Submission.id.in_(names))
    try:
        rows = {row.id: row for row in session.scalars(chosen)}
        yield from [(name, rows[name].as_scored()) for name in names]
    except (KeyError, *REFUSALS):  # those without a team or a person are not found
        for name in names:
            try:
                yield name, session.get_one(Submission, name).as_scored()
            except REFUSALS:
                yield name, None


def _at_uploads(session: Session, uploads: Uploads, progress: Progress) -> Iterator[Finding]:
    number = session.scalar(select(func.count()).select_from(_KEPT.subquery())) or 0
    streamed = _KEPT.order_by(Submission.sha256).execution_options(yield_per=AT_ONCE)
    sound = 0
    for sha256 in progress(session.scalars(streamed), "uploads", number):
        try:
            trouble = _trouble(uploads, sha256)
        except UploadsError as error:  # no use in asking for all the others
            message = f"{sound:,} of {count_text(number, 'upload')} intact; then {error}"
            yield Finding("uploads", "fault", message)
            return
        sound += not trouble
        if trouble:
            chosen = select(Submission.id).where(Submission.sha256 == sha256)
            whose = first_few(session.scalars(chosen.order_by(Submission.received_at)).all())
            remedy = f"replace it with uploads/{sha256}.json from a backup, compressed with gzip"
            message = f"{name_of(sha256)} of submission {whose} {trouble}; {remedy}"
            yield Finding("uploads", "fault", message)
    yield Finding("uploads", "ok", f"{sound:,} of {count_text(number, 'upload')} intact")


def _at_lost(state: ServerState) -> Iterator[Finding]:
    """Find uploads without a submission: the database may have lost its last rows.

    SQLite forgets transactions without a word if its write-ahead log is damaged or missing.
    """
    try:
        names = [name for name in state.uploads.names() if name.endswith(ENDING)]
    except (OSError, UploadsError) as error:
        yield Finding("uploads", "fault", f"they cannot be listed: {error}")
        return
    # In a later snapshot than that of other checks: a submission that came meanwhile is not lost.
    with state.database.reading() as session:
        known = set(map(name_of, session.scalars(_KEPT)))
    lost = [name for name in names if name not in known]
    if lost:
        message = (
            f"{count_text(len(lost), 'upload')} without a submission: {first_few(lost)}; after a "
            "crash or a restore, the database may lack submissions that have a receipt: ask teams "
            "to send theirs again. If nobody misses one, delete the file"
        )
        yield Finding("uploads", "fault", message)


def _trouble(uploads: Uploads, sha256: str) -> str:
    """Return what is wrong with an upload; empty if nothing is.

    Raises UploadsError if the store does not answer.
    """
    try:
        found = hashlib.sha256(uploads.get(sha256)).hexdigest()
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        return f"cannot be read ({error})"
    return "" if found == sha256 else "differs from the file that was uploaded"


class _Envelopes:
    """Checks what the server has signed, one envelope after the other."""

    def __init__(self, kind: str, keys: Sequence[KeyReport]) -> None:
        self._kind, self._keys = kind, keys
        self._sound = self._unread = 0

    def check(
        self, name: str, stored: object, is_of_row: Callable[[Content], bool]
    ) -> Iterator[Finding]:
        """Check that an envelope is genuine, and that its row says the same."""
        try:
            said = _verified(Envelope.model_validate(stored), self._keys)
        except NewerVersionError:
            self._unread += 1
            return
        except ValidationError:
            trouble = "it was changed, and has no signature"
        except ReceiptError as error:
            trouble = str(error)
        else:
            trouble = "" if is_of_row(said) else f"the {self._kind} differs from its row"
        self._sound += not trouble
        if trouble:
            yield Finding(f"{self._kind}s", "fault", f"{name}: {trouble}; {_RESTORE}")

    def sum_up(self) -> Iterator[Finding]:
        """Count those that are sound, and those that this version cannot read."""
        if self._unread:
            message = (
                f"{count_text(self._unread, self._kind)} of a newer version of reverie-eval: "
                "signed with the server's key, but not compared with the database; update to "
                "compare"
            )
            yield Finding(f"{self._kind}s", "note", message)
        yield Finding(f"{self._kind}s", "ok", f"{count_text(self._sound, self._kind)} verified")


def _verified(envelope: Envelope, keys: Sequence[KeyReport]) -> Content:
    """Return what was signed, as far as this version can read it.

    Raises ReceiptError if it is not genuine, NewerVersionError if this version cannot read it.
    """
    verify_by_history(envelope, keys)
    content = read(envelope).content
    if content is None:
        raise NewerVersionError
    return content


def _at_receipts(
    receipts: _Envelopes, kept: ScoredSubmission, names: Collection[str]
) -> Iterator[Finding]:
    """Check the receipts of all results that a submission has had, given its team's names."""
    for current in kept.results.values():
        results: Sequence[BoardResult | EarlierResult] = (current, *current.earlier)
        for result in results:
            is_of_row = partial(_matches_row, kept, result, names)
            yield from receipts.check(kept.id, result.receipt, is_of_row)


def _matches_row(
    kept: ScoredSubmission,
    result: BoardResult | EarlierResult,
    names: Collection[str],
    said: Content,
) -> bool:
    return (
        isinstance(said, Receipt)
        and (said.submission_id, said.split) == (kept.id, kept.split)
        and said.team in names
        and (said.sha256, said.received_at) == (kept.sha256, kept.received_at)
        and (said.signature, said.scores) == (result.report.signature, result.report.scores)
        and f"|data:{short_digest(result.report.fingerprint)}|" in said.signature
    )


def _at_snapshots(session: Session, state: ServerState) -> Iterator[Finding]:
    snapshots = _Envelopes("snapshot", list_keys(session))
    for row in session.scalars(select(StoredSnapshot).order_by(StoredSnapshot.id)):
        name = f"snapshot {row.number} of {row.split}"
        yield from snapshots.check(name, row.envelope, partial(_is_of_row, row))
    for missed in state.get(Snapshots).missed(session, state.clock()):
        message = (
            f"none of {missed.split} was taken at the end of {missed.phase}, and the "
            "leaderboard may have changed since; take one as it is now with `reverie-eval server "
            "snapshot`"
        )
        yield Finding("snapshots", "note", message)
    yield from snapshots.sum_up()


def _is_of_row(row: StoredSnapshot, said: Content) -> bool:
    columns = SnapshotEntry.model_fields
    return isinstance(said, Snapshot) and all(
        getattr(said, name) == getattr(row, name) for name in columns
    )


def _at_audit_log(session: Session, audit_log: AuditLog) -> Iterator[Finding]:
    broken, count = list(audit_log.broken_links(session)), count_rows(session, AuditEntry)
    if broken:
        message = (
            f"{count_text(len(broken), 'entry', 'entries')} cannot be verified "
            f"({first_few(broken)}): changed, not signed with the key that was in use, "
            "or after an entry that was removed"
        )
        yield Finding("audit log", "fault", f"{message}; compare with a backup")
    for message in mismatches(session):
        yield Finding("audit log", "fault", f"{message}; compare with a backup")
    if not broken:
        verified = count_text(count, "entry", "entries")
        yield Finding("audit log", "ok", f"{verified} verified, none missing between them")


def _at_clock(session: Session, now: datetime) -> Iterator[Finding]:
    latest = session.scalar(select(func.max(AuditEntry.at)))
    if latest is not None and latest - now > _SKEW:
        message = (
            f"it is {now:%Y-%m-%d %H:%M} UTC by this machine's clock, but the audit log has an "
            f"entry of {latest:%Y-%m-%d %H:%M} UTC: the clock is wrong now, or was wrong then"
        )
        yield Finding("clock", "note", f"{message}; phases and quotas depend on it")


def _at_messages(session: Session) -> Iterator[Finding]:
    for channel, number, error in given_up(session):
        message = (
            f"{count_text(number, 'message')} to the organiser could not be sent by {channel} "
            f"({error}); test the settings with `reverie-eval server notify`"
        )
        yield Finding("messages", "note", message)


def _at_disk(folder: Path) -> Iterator[Finding]:
    free = shutil.disk_usage(folder).free
    message = f"{free / (1 << 30):,.1f} GiB free"
    if free < LITTLE_SPACE:
        yield Finding("disk", "fault", f"{message}; free some space before uploads fail")
    else:
        yield Finding("disk", "ok", message)
