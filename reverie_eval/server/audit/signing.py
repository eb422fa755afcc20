"""The server's signing keys, and what they sign: receipts, snapshots and the audit log.

A private key is a file. The database has what everyone may know about it: the public key, from when
until when its signatures count, and why it was replaced. So receipts can be verified for ever, and
a server whose file is not the key in the database is noticed.
"""

import base64
import os
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import TypeVar

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval import receipts
from reverie_eval.files import is_private, naming
from reverie_eval.receipts import Content, ReceiptError, key_id_of
from reverie_eval.schemas import service as schemas
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.server.errors import ConflictError, KeyReplacedError
from reverie_eval.server.store.tables import SigningKey, Submission, read_stored

Kind = TypeVar("Kind", schemas.Receipt, schemas.Snapshot)

_RESTORE = "restore it from the backup of the server"
# Built here, because each change runs it, and building it takes as long as running it.
_IN_USE = select(SigningKey).where(SigningKey.replaced_at.is_(None))


class KeyMissingError(ReceiptError):
    """The file of the signing key does not exist, or does not contain the key."""

    def __init__(self, message: str) -> None:
        super().__init__(
            f"{message}; if it is lost for good, run `reverie-eval server key rotate FOLDER --lost`"
        )


class Signer:
    """Signs receipts and snapshots with a server's key."""

    def __init__(self, key: Ed25519PrivateKey, server: str) -> None:
        self._key = key
        self.server = server
        self.public_pem = public_pem_of(key)
        self.key_id = key_id_of(self.public_pem)

    def secret_for(self, purpose: str) -> bytes:
        """Derive 32 secret bytes from the private key, independent of those for other purposes.

        References
        ----------
        RFC 5869, HKDF with SHA-256; the purpose is its ``info``.
        """
        derivation = HKDF(hashes.SHA256(), length=32, salt=None, info=purpose.encode())
        return derivation.derive(self._key.private_bytes_raw())

    def sign(self, content: Content) -> schemas.Envelope:
        """Return a signed receipt or snapshot; the same content gives the same envelope."""
        return self._sign(*receipts.payload_of(content))

    def sign_result(
        self, row: Submission, report: ScoreReport, quota: schemas.QuotaReport
    ) -> schemas.Envelope:
        """Return a signed receipt of a submission's result on a leaderboard of its split."""
        receipt = schemas.Receipt(
            server=self.server,
            submission_id=row.id,
            team=row.team.name,
            sha256=row.sha256,
            received_at=row.received_at,
            split=row.split,
            signature=report.signature,
            scores=report.scores,
            quota=quota,
        )
        return self.sign(receipt)

    def seal(self, digest: str) -> str:
        """Return the signature of an audit entry's digest, in hexadecimal digits."""
        return self._key.sign(digest.encode()).hex()

    def sign_again(self, envelope: schemas.Envelope) -> schemas.Envelope:
        """Return an envelope with the same bytes, signed with this key alone."""
        return self._sign(envelope.payload_type, base64.b64decode(envelope.payload))

    def _sign(self, payload_type: str, content: bytes) -> schemas.Envelope:
        signature = self._key.sign(receipts.pre_authentication(payload_type, content))
        return schemas.Envelope(
            payloadType=payload_type,
            payload=base64.b64encode(content).decode(),
            signatures=[
                schemas.EnvelopeSignature(
                    keyid=self.key_id, sig=base64.b64encode(signature).decode()
                )
            ],
        )


def read_as(kind: type[Kind], envelope: schemas.Envelope) -> Kind:
    """Return the receipt or the snapshot that the server has stored in an envelope.

    Raises ConflictError if a newer version has made it, and this one cannot read it.
    """
    content = receipts.read(envelope).content
    if not isinstance(content, kind):
        raise ConflictError(
            f"this {kind.__name__.lower()} was made by a newer version of reverie-eval; the "
            "server must be updated to read it"
        )
    return content


def current_key(session: Session) -> SigningKey | None:
    """Return the key in use; None if the database has not been used yet."""
    return session.scalars(_IN_USE).first()


def all_keys(session: Session) -> Sequence[SigningKey]:
    """Return all keys, the earliest first."""
    return session.scalars(select(SigningKey).order_by(SigningKey.id)).all()


def list_keys(session: Session) -> list[schemas.KeyReport]:
    """List all keys, the earliest first."""
    return [read_stored(schemas.KeyReport, row) for row in all_keys(session)]


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


def make_key(path: Path) -> None:
    """Write a new private key that nobody else can read."""
    key = Ed25519PrivateKey.generate()
    pem = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with naming(path, path), os.fdopen(descriptor, "wb") as file:
        file.write(pem)
        file.flush()
        os.fsync(file.fileno())


def load_key(path: Path) -> Ed25519PrivateKey:
    """Read a private key.

    Raises ReceiptError if the file is missing or holds no such key, or if other users can read it.
    """
    try:
        pem = path.read_bytes()
        if not is_private(path):
            raise ReceiptError(f"other users can read {path}; run `chmod 600 {path}`")
        key = serialization.load_pem_private_key(pem, password=None)
    except FileNotFoundError:
        raise KeyMissingError(f"{path} is missing; {_RESTORE}") from None
    except OSError as error:
        raise ReceiptError(f"{path} cannot be read: {error.strerror}; {_RESTORE}") from None
    except (ValueError, UnsupportedAlgorithm):
        raise KeyMissingError(f"{path} is not a private key in PEM format; {_RESTORE}") from None
    except TypeError:  # the library wants a password
        raise ReceiptError(f"{path} is locked with a password; store it without one") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise ReceiptError(f"{path} is not an Ed25519 key")
    return key


def public_pem_of(key: Ed25519PrivateKey) -> str:
    """Return the public key in PEM form."""
    return receipts.public_pem_of(key.public_key())
