"""Replacing the signing key, and revoking one that others may have.

When it is rotated, the new file and the database change together. The new key is written beside
the old one, then the database names it as the key in use, then the file takes the old one's place.
If the process is killed before the second step, nothing has changed; if after it, the next process
that opens the server takes the third (:func:`open_key`).
"""

from dataclasses import replace

from sqlalchemy import select

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.organising import KeyRevocation
from reverie_eval.schemas.service import Envelope, KeyReport
from reverie_eval.server.audit.log import AuditLog
from reverie_eval.server.audit.signing import (
    KeyMissingError,
    Signer,
    current_key,
    load_key,
    make_key,
    new_row,
    open_key,
    pending_path,
)
from reverie_eval.server.audit.transactions import Transaction, utc_now
from reverie_eval.server.errors import ConflictError, NotFoundError
from reverie_eval.server.opening import acting, opened
from reverie_eval.server.settings import Settings
from reverie_eval.server.state import signer_of
from reverie_eval.server.store.database import AT_ONCE
from reverie_eval.server.store.tables import SigningKey, StoredSnapshot, Submission, read_stored


def rotate_key(settings: Settings, actor: str, reason: str) -> KeyReport:
    """Replace the signing key with a new one, and return the new one.

    Raises
    ------
    ReceiptError
        If the key in use cannot be read.
    OSError
        If the new key cannot be written beside it.
    """
    with acting(settings, actor) as transaction:
        new = _make_pending(settings)
        report = replace_key(transaction, new, reason)
    _put_in_place(settings, report)
    return report


def replace_lost_key(settings: Settings, actor: str, reason: str) -> KeyReport:
    """Replace a signing key whose file is lost, and return the new one.

    Raises
    ------
    ReceiptError
        If its file exists, but cannot be used as it is.
    ReverieEvalError
        If the key is not lost, or another key is in its place.
    """
    path = settings.path(settings.signing_key)
    with opened(settings) as database:
        try:
            signer_of(settings, database)
        except KeyMissingError:
            pass
        else:
            raise ReverieEvalError(f"{path} is the key in use, so it is not lost; omit --lost")
        if path.exists():
            raise ReverieEvalError(f"{path} is not the key in use; move it to another place first")
        # `Transactions.begin` would refuse both keys: the lost one cannot sign the entry, and the
        # new one is not in use before this transaction has ended.
        with database.writing() as session:
            new = _make_pending(settings)
            transaction = Transaction(session, actor, utc_now(), AuditLog(new))
            report = replace_key(transaction, new, reason, is_lost=True)
    _put_in_place(settings, report)
    return report


def _make_pending(settings: Settings) -> Signer:
    pending = pending_path(settings.path(settings.signing_key))
    pending.unlink(missing_ok=True)
    make_key(pending)
    return Signer(load_key(pending), settings.title)


def _put_in_place(settings: Settings, new: KeyReport) -> None:
    open_key(settings.path(settings.signing_key), new.key_id)  # unless another process has done it


def replace_key(
    transaction: Transaction, new: Signer, reason: str, *, is_lost: bool = False
) -> KeyReport:
    """Make a new key the one in use, and return it; its first audit entry records this.

    Raises
    ------
    ConflictError
        If no key is in use.
    """
    session, now = transaction.session, transaction.now
    ended = current_key(session)
    if ended is None:
        raise ConflictError("the database has no signing key to replace; start the server first")
    ended.valid_until = ended.replaced_at = now
    ended.reason = reason
    session.flush()
    begun = new_row(new, now)
    transaction.add(begun)
    replace(transaction, audit_log=AuditLog(new)).record(
        "signing key replaced",
        ended,
        ended.key_id,
        public_key=ended.public_key,
        by=new.key_id,
        until=now.isoformat(),
        lost=is_lost,
        reason=reason,
    )
    return KeyReport.model_validate(begun)


def revoke_key(transaction: Transaction, key_id: str, revocation: KeyRevocation) -> int:
    """Stop counting a replaced key's signatures of submissions received after a given time.

    The stored receipts of these submissions, and later snapshots, are signed again with the key in
    use. The number of new signatures is returned.

    Raises
    ------
    NotFoundError
        If there is no such key.
    ConflictError
        If it is in use, or its signatures stopped counting before that time.
    """
    session, since = transaction.session, revocation.since
    key = session.scalars(select(SigningKey).where(SigningKey.key_id == key_id)).first()
    if key is None:
        raise NotFoundError(f"there is no key {key_id!r}; `server key list` shows all")
    if key.valid_until is None:
        raise ConflictError(f"{key_id} is in use; replace it first with `server key rotate`")
    if since >= key.valid_until:
        raise ConflictError(
            f"signatures of {key_id} are valid only until {key.valid_until.isoformat()}; give an "
            "earlier time"
        )
    before = {"until": key.valid_until.isoformat(), "reason": key.reason}
    key.valid_until, key.revoked_at, key.reason = since, transaction.now, revocation.reason
    signed = 0
    chosen = select(Submission).where(Submission.received_at > since)
    for row in session.scalars(chosen.execution_options(yield_per=AT_ONCE)):
        signed += _sign_again(row, key_id, transaction.audit_log.signer)
    snapshots = select(StoredSnapshot).where(StoredSnapshot.as_of > since)
    for stored in session.scalars(snapshots):
        envelope = read_stored(Envelope, stored.envelope)
        if key_id in envelope.key_ids:
            again = transaction.audit_log.signer.sign_again(envelope)
            stored.envelope = again.model_dump(mode="json")
            signed += 1
    transaction.record(
        "signing key revoked",
        key,
        key_id,
        before=before,
        until=since.isoformat(),
        signed_again=signed,
        reason=revocation.reason,
    )
    return signed


def _sign_again(row: Submission, key_id: str, signer: Signer) -> int:
    """Replace the receipts of a submission that a key signed, and return their number."""
    number = 0

    def signed(receipt: Envelope) -> Envelope:
        nonlocal number
        if key_id not in receipt.key_ids:
            return receipt
        number += 1
        return signer.sign_again(receipt)

    for name, known in row.results.items():
        earlier = [
            each.model_copy(update={"receipt": signed(each.receipt)}) for each in known.earlier
        ]
        changed = {"receipt": signed(known.receipt), "earlier": earlier}
        row.store_result(name, known.model_copy(update=changed))
    return number
