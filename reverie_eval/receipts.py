"""Checking receipts: whether a result is what a server signed, for anybody with its public key.

Ed25519 [1]_ over the canonical JSON of every field but the proof: keys sorted, no spaces, UTF-8.

References
----------
.. [1] Josefsson and Liusvaara, "Edwards-Curve Digital Signature Algorithm", RFC 8032, 2017.
"""

import base64
import hashlib
import json
from typing import Any

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_public_key,
)

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.service import Receipt
from reverie_eval.text import printable

_KEY_ID_LENGTH = 16


class ReceiptError(ReverieEvalError):
    """A receipt is not what the server signed, or the key is none."""


class NotGenuineError(ReceiptError):
    """A receipt is not what the holder of the key has signed."""


def verify(receipt: Receipt, public_pem: str) -> None:
    """Check that a receipt is what the holder of a key has signed.

    Parameters
    ----------
    receipt : Receipt
        As the server gave it; the layout of its JSON file does not matter.
    public_pem : str
        The server's public key in PEM form, as :meth:`reverie_eval.client.Client.key` gets it.

    Raises
    ------
    NotGenuineError
        If it is not, or the key is another.
    ReceiptError
        If the key is none.
    """
    key = _key(public_pem)
    key_id = key_id_of(public_pem_of(key))
    if receipt.key_id != key_id:
        named = printable(receipt.key_id)
        raise NotGenuineError(
            f"it names key {named}, this is key {key_id}: it is another server's, or was changed"
        )
    try:
        key.verify(base64.b64decode(receipt.proof, validate=True), canonical(receipt))
    except (InvalidSignature, ValueError):
        raise NotGenuineError("it is not what the server signed: it was changed") from None


def canonical(receipt: Receipt) -> bytes:
    """Return what is signed: the receipt without its proof, always in the same bytes."""
    fields: dict[str, Any] = receipt.model_dump(mode="json", exclude={"proof"})
    text = json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return text.encode()


def public_pem_of(key: Ed25519PublicKey) -> str:
    """Return a public key in the PEM form that servers publish."""
    return key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()


def key_id_of(public_pem: str) -> str:
    """Return the first letters of the key's SHA-256."""
    return hashlib.sha256(public_pem.strip().encode()).hexdigest()[:_KEY_ID_LENGTH]


def _key(public_pem: str) -> Ed25519PublicKey:
    try:
        key = load_pem_public_key(public_pem.encode())
    except (ValueError, UnsupportedAlgorithm):
        raise ReceiptError("this is no public key in PEM form") from None
    if not isinstance(key, Ed25519PublicKey):
        raise ReceiptError("this is no Ed25519 key")
    return key
