"""The server's signing keys: the one in use, and those before it.

A private key is a file. The database has what everyone may know about it: the public key, from when
until when its signatures count, and why it was replaced. So receipts can be verified for ever, and
a server whose file is not the key in the database is noticed.
"""

from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.receipts import ReceiptError, key_id_of
from reverie_eval.schemas.service import KeyReport
from reverie_eval.server.audit.receipts import KeyMissingError, Signer, load_key, public_pem_of
from reverie_eval.server.errors import KeyReplacedError
from reverie_eval.server.store.tables import SigningKey, read_stored

# Built here, because each change runs it, and building it takes as long as running it.
_IN_USE = select(SigningKey).where(SigningKey.replaced_at.is_(None))


def current_key(session: Session) -> SigningKey | None:
    """Return the key in use; None if the database has not been used yet."""
    return session.scalars(_IN_USE).first()


def all_keys(session: Session) -> Sequence[SigningKey]:
    """Return all keys, the earliest first."""
    return session.scalars(select(SigningKey).order_by(SigningKey.id)).all()


def list_keys(session: Session) -> list[KeyReport]:
    """List all keys, the earliest first."""
    return [read_stored(KeyReport, row) for row in all_keys(session)]


def admit(session: Session, signer: Signer, now: datetime) -> None:
    """Make sure that a change is made with the key in use; the first change admits the first key.

    Raises KeyReplacedError if another key is in use.
    """
    current = current_key(session)
    if current is None:
        session.add(new_row(signer, now))
    elif current.key_id != signer.key_id:
        raise KeyReplacedError(signer.key_id, current.key_id)


def new_row(signer: Signer, now: datetime) -> SigningKey:
    """Return the row of a key that is in use from now on."""
    return SigningKey(key_id=signer.key_id, public_key=signer.public_pem, valid_from=now, reason="")


def open_key(path: Path, key_id: str | None) -> Ed25519PrivateKey:
    """Read the private key with an id, or the first one, and finish a rotation to it.

    Raises
    ------
    ReceiptError
        If there is no usable key, other users can read it, or another key is in use.
    """
    file = file_of_key(path, key_id)
    key = load_key(file)
    if file != path:
        with suppress(FileNotFoundError):  # another process has done it meanwhile
            file.replace(path)
    return key


def file_of_key(path: Path, key_id: str | None) -> Path:
    """Return the file of a key: the one that the settings name, or the new key beside it.

    Raises
    ------
    ReceiptError
        If neither file has that key.
    """
    if key_id is None:
        return path
    pending = pending_path(path)
    if pending.exists() and _id_in(pending) == key_id:
        return pending
    found = key_id_of(public_pem_of(load_key(path)))
    if found != key_id:
        raise KeyMissingError(
            f"{path} is key {found}, but the database says that {key_id} is in use: copy its file "
            "here, from the machine on which the key was rotated or from a backup; or, if it was "
            "rotated a moment ago, try again"
        )
    return path


def pending_path(path: Path) -> Path:
    """Return where a new key is kept until the database knows it."""
    return path.with_name(f"{path.name}.new")


def _id_in(path: Path) -> str | None:
    try:
        return key_id_of(public_pem_of(load_key(path)))
    except ReceiptError:
        return None
