"""Verifying receipts: anyone with a server's public key can check what the server signed.

The proof is an Ed25519 signature [1]_ of the canonical JSON of all other fields:
keys sorted, no spaces, UTF-8.

References
----------
.. [1] Josefsson and Liusvaara, "Edwards-Curve Digital Signature Algorithm", RFC 8032, 2017.
"""

import base64
import hashlib
import json
from collections.abc import Sequence
from datetime import datetime
from typing import Any

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_public_key

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.service import KeyReport, Receipt, Snapshot
from reverie_eval.text import printable

_KEY_ID_LENGTH = 16


class ReceiptError(ReverieEvalError):
    """A receipt is not genuine, or the key is invalid."""


class NotGenuineError(ReceiptError):
    """A receipt was not signed with this key while it counted, or was changed afterwards."""


def verify(receipt: Receipt | Snapshot, public_pem: str) -> None:
    """Check that a receipt, or a snapshot, was signed with a key and has not been changed.

    Parameters
    ----------
    receipt : Receipt or Snapshot
        As issued by the server; the layout of its JSON file does not matter.
    public_pem : str
        The server's public key in PEM form, as :meth:`reverie_eval.client.Client.key` returns it.

    Raises
    ------
    NotGenuineError
        If it was changed, or signed with another key.
    ReceiptError
        If the key is invalid.
    """
    key = _load_key(public_pem)
    key_id = key_id_of(public_pem_of(key))
    if receipt.key_id != key_id:
        raise NotGenuineError(
            f"it names key {printable(receipt.key_id)}, but this is key {key_id}: the receipt is "
            "from another server, or was changed"
        )
    try:
        key.verify(base64.b64decode(receipt.proof, validate=True), canonical(receipt))
    except (InvalidSignature, ValueError):
        raise NotGenuineError("the signature does not match: the receipt was changed") from None


def verify_by_history(receipt: Receipt | Snapshot, keys: Sequence[KeyReport]) -> KeyReport:
    """Check a receipt with all keys that a server has had, and return the one that signed it.

    Parameters
    ----------
    receipt : Receipt or Snapshot
        As issued by the server.
    keys : sequence of KeyReport
        As :meth:`reverie_eval.client.Client.keys` returns them.

    Raises
    ------
    NotGenuineError
        If it was changed, signed with another key, or signed with one that had ended.
    ReceiptError
        If the key is invalid.
    """
    key = next((each for each in keys if each.key_id == receipt.key_id), None)
    if key is None:
        raise NotGenuineError(
            f"it names key {printable(receipt.key_id)}, which is not in the list of keys: the "
            "receipt is from another server, was changed, or is newer than the list"
        )
    verify(receipt, key.public_key)
    at, claim, remedy = _claim(receipt)
    if key.valid_until is not None and at > key.valid_until:
        raise NotGenuineError(
            f"key {key.key_id} counts until {key.valid_until.isoformat()} "
            f"({printable(key.reason)}), but {claim} {at.isoformat()}; {remedy}"
        )
    return key


def _claim(signed: Receipt | Snapshot) -> tuple[datetime, str, str]:
    """Return the time by which a key must have counted, what says so, and what to do if not."""
    if isinstance(signed, Snapshot):
        return signed.as_of, "the snapshot is as of", "download it again"
    remedy = "if it is yours, download its receipt again"
    return signed.received_at, "the receipt says that the submission came at", remedy


def canonical(receipt: Receipt | Snapshot) -> bytes:
    """Return the bytes that are signed: the receipt without its proof, in canonical JSON."""
    fields: dict[str, Any] = receipt.model_dump(mode="json", exclude={"proof"})
    text = json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return text.encode()


def public_pem_of(key: Ed25519PublicKey) -> str:
    """Return a public key in PEM form, as servers publish it."""
    return key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()


def key_id_of(public_pem: str) -> str:
    """Return the first hexadecimal digits of the key's SHA-256."""
    return hashlib.sha256(public_pem.strip().encode()).hexdigest()[:_KEY_ID_LENGTH]


def _load_key(public_pem: str) -> Ed25519PublicKey:
    try:
        key = load_pem_public_key(public_pem.encode())
    except (ValueError, UnsupportedAlgorithm):
        raise ReceiptError("this is not a public key in PEM form") from None
    if not isinstance(key, Ed25519PublicKey):
        raise ReceiptError("this is not an Ed25519 key")
    return key
