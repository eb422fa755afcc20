"""Rotating the signing key: the new file and the database change together.

The new key is written beside the old one, then the database names it as the key in use, then the
file takes the old one's place. If the process is killed before the second step, nothing has
changed; if after it, the next process that opens the server takes the third (:func:`open_key`).
"""

from pathlib import Path

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.service import KeyReport
from reverie_eval.server.audit.keys import pending_path
from reverie_eval.server.audit.log import AuditLog
from reverie_eval.server.audit.receipts import KeyMissingError, Signer, load_key, make_key
from reverie_eval.server.audit.rotation import replace_key
from reverie_eval.server.audit.transactions import Transaction, utc_now
from reverie_eval.server.operations.checks import acting, opened
from reverie_eval.server.settings import Settings
from reverie_eval.server.state import signer_of


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
    _put_in_place(settings)
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
    _put_in_place(settings)
    return report


def _make_pending(settings: Settings) -> Signer:
    pending = _pending(settings)
    pending.unlink(missing_ok=True)
    make_key(pending)
    return Signer(load_key(pending), settings.title)


def _put_in_place(settings: Settings) -> None:
    _pending(settings).replace(settings.path(settings.signing_key))


def _pending(settings: Settings) -> Path:
    return pending_path(settings.path(settings.signing_key))
