"""Receipts: results signed by the server, so that anyone can check them later."""

import base64
import os
from pathlib import Path
from typing import TypeVar

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)

from reverie_eval import receipts
from reverie_eval.files import is_private
from reverie_eval.receipts import (
    Content,
    ReceiptError,
    key_id_of,
    payload_of,
    pre_authentication,
    read,
)
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import Envelope, EnvelopeSignature, QuotaReport, Receipt, Snapshot
from reverie_eval.server.errors import ConflictError
from reverie_eval.server.store.tables import Submission

Kind = TypeVar("Kind", Receipt, Snapshot)


_RESTORE = "restore it from the backup of the server"


class KeyMissingError(ReceiptError):
    """The file of the signing key does not exist, or contains another key."""


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

    def sign(self, content: Content) -> Envelope:
        """Return a signed receipt or snapshot; the same content gives the same envelope."""
        return self._sign(*payload_of(content))

    def sign_result(self, row: Submission, report: ScoreReport, quota: QuotaReport) -> Envelope:
        """Return a signed receipt of a submission's result on a leaderboard of its split."""
        receipt = Receipt(
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

    def sign_again(self, envelope: Envelope) -> Envelope:
        """Return an envelope with the same bytes, signed with this key alone."""
        return self._sign(envelope.payload_type, base64.b64decode(envelope.payload))

    def _sign(self, payload_type: str, content: bytes) -> Envelope:
        signature = self._key.sign(pre_authentication(payload_type, content))
        return Envelope(
            payloadType=payload_type,
            payload=base64.b64encode(content).decode(),
            signatures=[
                EnvelopeSignature(keyid=self.key_id, sig=base64.b64encode(signature).decode())
            ],
        )


def read_as(kind: type[Kind], envelope: Envelope) -> Kind:
    """Return the receipt or the snapshot that the server has stored in an envelope.

    Raises ConflictError if a newer version has made it, and this one cannot read it.
    """
    content = read(envelope).content
    if not isinstance(content, kind):
        raise ConflictError(
            f"this {kind.__name__.lower()} was made by a newer version of reverie-eval; the "
            "server must be updated to read it"
        )
    return content


def make_key(path: Path) -> None:
    """Write a new private key that nobody else can read."""
    key = Ed25519PrivateKey.generate()
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
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
        key = load_pem_private_key(pem, password=None)
    except FileNotFoundError:
        raise KeyMissingError(f"{path} is missing; {_RESTORE}") from None
    except OSError as error:
        raise ReceiptError(f"{path} cannot be read: {error.strerror}; {_RESTORE}") from None
    except (ValueError, UnsupportedAlgorithm):
        raise ReceiptError(f"{path} is not a private key in PEM format; {_RESTORE}") from None
    except TypeError:  # the library wants a password
        raise ReceiptError(f"{path} is locked with a password; store it without one") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise ReceiptError(f"{path} is not an Ed25519 key")
    return key


def public_pem_of(key: Ed25519PrivateKey) -> str:
    """Return the public key in PEM form."""
    return receipts.public_pem_of(key.public_key())
