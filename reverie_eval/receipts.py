"""Verifying receipts: anyone with a server's public key can check what the server signed.

The proof is an Ed25519 signature [1]_ of the canonical JSON of all other fields:
keys sorted, no spaces, UTF-8.

For other programs, the same receipt is also available as an in-toto statement [2]_ about the
submitted file, signed with the same key in a DSSE envelope [3]_.

References
----------
.. [1] Josefsson and Liusvaara, "Edwards-Curve Digital Signature Algorithm", RFC 8032, 2017.
.. [2] in-toto Attestation Framework, Statement v1,
   https://github.com/in-toto/attestation/blob/main/spec/v1/statement.md.
.. [3] Dead Simple Signing Envelope 1.0.2, https://github.com/secure-systems-lab/dsse.
"""

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from decimal import Decimal
from typing import Any, TypeAlias

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_public_key

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.service import Envelope, KeyReport, Receipt, Snapshot
from reverie_eval.text import printable

PAYLOAD_TYPE = "application/vnd.in-toto+json"
"""What an envelope contains: an in-toto statement."""
PREDICATE_TYPE = "urn:reverie-eval:receipt:v1"
"""What such a statement says about its subject: the fields of a receipt."""
_STATEMENT_TYPE = "https://in-toto.io/Statement/v1"
_KEY_ID_LENGTH = 16


class ReceiptError(ReverieEvalError):
    """A receipt is not genuine, or the key is invalid."""


class NotGenuineError(ReceiptError):
    """A receipt was not signed with this key while it was valid, or was changed afterwards."""


Signed: TypeAlias = Receipt | Snapshot | Envelope
"""What a server signs."""


def verify(signed: Signed, public_pem: str) -> None:
    """Check that a receipt, or a snapshot, was signed with a key and has not been changed.

    Parameters
    ----------
    signed : Receipt, Snapshot or Envelope
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
    key_id, named = key_id_of(public_pem_of(key)), key_named_by(signed)
    if named != key_id:
        raise NotGenuineError(
            f"it names key {printable(named)}, but this is key {key_id}: the receipt is "
            "from another server, or was changed"
        )
    try:
        if isinstance(signed, Envelope):
            proof = signed.signatures[0].sig
            content = pre_authentication(base64.b64decode(signed.payload, validate=True))
        else:
            proof, content = signed.proof, canonical(signed)
        key.verify(base64.b64decode(proof, validate=True), content)
    except (InvalidSignature, ValueError):
        raise NotGenuineError("the signature does not match: the receipt was changed") from None


def verify_by_history(signed: Signed, keys: Sequence[KeyReport]) -> KeyReport:
    """Check a receipt with all keys that a server has had, and return the one that signed it.

    Parameters
    ----------
    signed : Receipt, Snapshot or Envelope
        As issued by the server.
    keys : sequence of KeyReport
        As :meth:`reverie_eval.client.Client.keys` returns them.

    Raises
    ------
    NotGenuineError
        If it was changed, signed with an unknown key, or signed with a key that was no longer
        valid.
    ReceiptError
        If the key is invalid.
    """
    named = key_named_by(signed)
    key = next((each for each in keys if each.key_id == named), None)
    if key is None:
        raise NotGenuineError(
            f"it names key {printable(named)}, which is not in the list of keys: the "
            "receipt is from another server, was changed, or is newer than the list"
        )
    verify(signed, key.public_key)
    at, claim, remedy = _claim(signed)
    if key.valid_until is not None and at > key.valid_until:
        raise NotGenuineError(
            f"key {key.key_id} was valid until {key.valid_until.isoformat()} "
            f"({printable(key.reason)}), but {claim} {at.isoformat()}; {remedy}"
        )
    return key


def key_named_by(signed: Signed) -> str:
    """Return the id of the key that something says it was signed with."""
    return signed.signatures[0].keyid if isinstance(signed, Envelope) else signed.key_id


def receipt_in(envelope: Envelope) -> Receipt:
    """Return the receipt in an envelope, with the envelope's signature.

    It is not verified.

    Raises
    ------
    NotGenuineError
        If it is not a receipt in an envelope.
    """
    (signature,) = envelope.signatures
    try:
        worded = json.loads(base64.b64decode(envelope.payload, validate=True))
        (subject,) = worded["subject"]
        return Receipt.model_validate_json(
            json.dumps(
                {
                    **worded["predicate"],
                    "sha256": subject["digest"]["sha256"],
                    "key_id": signature.keyid,
                    "proof": signature.sig,
                }
            )
        )
    except (ValueError, KeyError, TypeError):
        raise NotGenuineError("it has no receipt that this version can read") from None


def _claim(signed: Signed) -> tuple[datetime, str, str]:
    """Return the time by which a key must have counted, what says so, and what to do if not."""
    if isinstance(signed, Snapshot):
        return signed.as_of, "the snapshot is as of", "download it again"
    if isinstance(signed, Envelope):
        signed = receipt_in(signed)
    remedy = "if it is yours, download its receipt again"
    return signed.received_at, "the receipt says that the submission came at", remedy


def canonical(receipt: Receipt | Snapshot) -> bytes:
    """Return the bytes that are signed: the receipt without its proof, in canonical JSON."""
    return _compact(receipt.model_dump(mode="json", exclude={"proof"}))


def statement(receipt: Receipt) -> bytes:
    """Return a receipt as an in-toto statement: the file is its subject, the rest its predicate.

    Scores are decimal strings with all digits, because programs write floating-point numbers
    differently. The envelope holds the signature.
    """
    predicate = receipt.model_dump(
        mode="json", exclude={"schema_version", "sha256", "key_id", "proof"}
    )
    scores = {key: f"{Decimal(repr(value)):f}" for key, value in receipt.scores.items()}
    return _compact(
        {
            "_type": _STATEMENT_TYPE,
            "subject": [{"name": receipt.submission_id, "digest": {"sha256": receipt.sha256}}],
            "predicateType": PREDICATE_TYPE,
            "predicate": {**predicate, "scores": scores},
        }
    )


def pre_authentication(payload: bytes) -> bytes:
    """Return the bytes that an envelope signs: the payload's type, its length and the payload.

    It begins with ``DSSEv1``, so it cannot be taken for the canonical JSON of a receipt.
    """
    return b"DSSEv1 %d %s %d %s" % (
        len(PAYLOAD_TYPE),
        PAYLOAD_TYPE.encode(),
        len(payload),
        payload,
    )


def _compact(fields: Mapping[str, Any]) -> bytes:
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
