"""Verifying receipts and snapshots: anyone with a server's public key can check what it signed.

What is signed is bytes, and they are kept as they are. So a signature stays valid whatever fields
later versions add, and any version can check it. The bytes are in a DSSE envelope [1]_, signed with
Ed25519 [2]_. Those of a receipt are an in-toto statement [3]_ about the submitted file, those of a
snapshot a JSON document of a type of their own.

References
----------
.. [1] Dead Simple Signing Envelope 1.0.2, https://github.com/secure-systems-lab/dsse.
.. [2] Josefsson and Liusvaara, "Edwards-Curve Digital Signature Algorithm", RFC 8032, 2017.
.. [3] in-toto Attestation Framework, Statement v1,
   https://github.com/in-toto/attestation/blob/main/spec/v1/statement.md.
"""

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from decimal import Decimal
from typing import Any, NamedTuple, TypeAlias

from pydantic import AwareDatetime, TypeAdapter, ValidationError

from reverie_eval.errors import ReverieEvalError, naming_missing_parts
from reverie_eval.schemas.service import (
    SIGNED_VERSION,
    Envelope,
    KeyReport,
    Receipt,
    Snapshot,
)
from reverie_eval.text import printable

with naming_missing_parts():
    from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import (
        Encoding,
        PublicFormat,
        load_pem_public_key,
    )

RECEIPT_TYPE = "application/vnd.in-toto+json"
"""The type of a receipt's bytes: an in-toto statement."""
SNAPSHOT_TYPE = "application/vnd.reverie-eval.snapshot+json"
"""The type of a snapshot's bytes: its fields."""
PREDICATE_TYPE = "urn:reverie-eval:receipt:v1"
"""What a receipt's statement says about its subject: the fields of the receipt."""
_STATEMENT_TYPE = "https://in-toto.io/Statement/v1"
_KEY_ID_LENGTH = 16
_FIELDS: TypeAdapter[dict[str, Any]] = TypeAdapter(dict[str, Any])
_MOMENT: TypeAdapter[datetime] = TypeAdapter(AwareDatetime)


class ReceiptError(ReverieEvalError):
    """A receipt is not genuine or cannot be checked, or the key is invalid."""


class NotGenuineError(ReceiptError):
    """A receipt was not signed with this key while it was valid, or was changed afterwards."""


class NewerVersionError(ReceiptError):
    """A newer version has signed it, and this one cannot read what is needed to check it."""


Content: TypeAlias = Receipt | Snapshot
"""What a server signs."""


class Reading(NamedTuple):
    """What this version can read of an envelope."""

    content: Content | None
    """None if a newer version has made it, and this one cannot read it."""
    fields: Mapping[str, Any]
    """All its fields, also those that this version does not know."""
    is_complete: bool
    """Whether this version knows all fields and what they mean."""


def verify(envelope: Envelope, public_pem: str) -> str:
    """Check that a receipt, or a snapshot, was signed with a key, and return the key's id.

    Parameters
    ----------
    envelope : Envelope
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
    key = public_key_of(public_pem)
    key_id = key_id_of(public_pem_of(key))
    signature = next((each for each in envelope.signatures if each.keyid == key_id), None)
    if signature is None:
        raise NotGenuineError(
            f"it names {_keys_named_by(envelope)}, but this is key {key_id}: it is from another "
            "server, or was changed"
        )
    try:
        # The bytes as they came: a new field, or another order, would be another signature.
        signed = pre_authentication(envelope.payload_type, _bytes_in(envelope))
        key.verify(base64.b64decode(signature.sig, validate=True), signed)
    except (InvalidSignature, ValueError):
        raise NotGenuineError(
            "the signature does not match: it was changed after it was signed"
        ) from None
    return key_id


def verify_by_history(envelope: Envelope, keys: Sequence[KeyReport]) -> KeyReport:
    """Check a receipt with all keys that a server has had, and return the one that signed it.

    Parameters
    ----------
    envelope : Envelope
        A receipt or a snapshot, as issued by the server.
    keys : sequence of KeyReport
        As :meth:`reverie_eval.client.Client.keys` returns them.

    Raises
    ------
    NotGenuineError
        If it was changed, signed with an unknown key, or signed with a key that was no longer
        valid.
    ReceiptError
        If the key is invalid.
    NewerVersionError
        If the signature is right, but the key has ended, and this version cannot read whether it
        was used before.
    """
    named = envelope.key_ids
    # The latest first: of two keys that are named, the one in use.
    key = next((each for each in reversed(keys) if each.key_id in named), None)
    if key is None:
        raise NotGenuineError(
            f"it names {_keys_named_by(envelope)}, which is not in the list of keys: it is from "
            "another server, was changed, or is newer than the list"
        )
    verify(envelope, key.public_key)
    if key.valid_until is not None:
        _check_time(envelope, key, key.valid_until)
    return key


def read(envelope: Envelope) -> Reading:
    """Return what this version can read of a receipt or a snapshot, which is not verified.

    Fields that it does not know are left out, as in-toto requires of those who read a statement.

    Parameters
    ----------
    envelope : Envelope
        As issued by a server of any version.
    """
    kind, fields = _open(envelope)
    if kind is None:
        return Reading(None, fields, is_complete=False)
    # Read strictly first: only then is it known that nothing was left out.
    for extra in ("forbid", "ignore"):
        with suppress(ValidationError):
            content = kind.model_validate(fields, extra=extra)
            is_known = extra == "forbid" and content.schema_version <= SIGNED_VERSION
            return Reading(content, fields, is_complete=is_known)
    return Reading(None, fields, is_complete=False)


def payload_of(content: Content) -> tuple[str, bytes]:
    """Return the type and the bytes of what is signed."""
    if isinstance(content, Receipt):
        return RECEIPT_TYPE, _compact(_statement(content))
    return SNAPSHOT_TYPE, _compact(content.model_dump(mode="json"))


def pre_authentication(payload_type: str, payload: bytes) -> bytes:
    """Return the bytes that an envelope signs: the payload's type, the payload, their lengths."""
    kind = payload_type.encode()
    return b"DSSEv1 %d %s %d %s" % (len(kind), kind, len(payload), payload)


def _check_time(envelope: Envelope, key: KeyReport, until: datetime) -> None:
    """Raise the errors of :func:`verify_by_history` if a key had ended when it signed something."""
    _, fields = _open(envelope)
    is_snapshot = envelope.payload_type == SNAPSHOT_TYPE
    try:
        at = _MOMENT.validate_python(fields.get("as_of" if is_snapshot else "received_at"))
    except ValidationError:
        raise NewerVersionError(
            f"key {key.key_id} was valid until {until.isoformat()}, and this version cannot read "
            "whether it was signed before; update reverie-eval to check it"
        ) from None
    if at > until:
        claim, remedy = (
            ("the snapshot is as of", "download it again")
            if is_snapshot
            else (
                "the receipt says that the submission came at",
                "if it is yours, download its receipt again",
            )
        )
        raise NotGenuineError(
            f"key {key.key_id} was valid until {until.isoformat()} "
            f"({printable(key.reason)}), but {claim} {at.isoformat()}; {remedy}"
        )


def _open(envelope: Envelope) -> tuple[type[Content] | None, Mapping[str, Any]]:
    """Return the class of what is in an envelope, None if it is unknown, and its fields."""
    try:
        told = _FIELDS.validate_json(_bytes_in(envelope))
        if envelope.payload_type == SNAPSHOT_TYPE:
            return Snapshot, told
        (subject,) = told["subject"]
        fields = {**told["predicate"], "sha256": subject["digest"]["sha256"]}
    except (ValueError, KeyError, TypeError):
        return None, {}
    is_known = (envelope.payload_type, told.get("predicateType")) == (RECEIPT_TYPE, PREDICATE_TYPE)
    return Receipt if is_known else None, fields


def _statement(receipt: Receipt) -> Mapping[str, Any]:
    """Return a receipt as an in-toto statement: the file is its subject, the rest its predicate.

    Scores are decimal strings with all digits, because programs write floating-point numbers
    differently.
    """
    predicate = receipt.model_dump(mode="json", exclude={"sha256"})
    # repr has the fewest digits that give the same float again; Decimal writes them without an
    # exponent.
    scores = {key: f"{Decimal(repr(value)):f}" for key, value in receipt.scores.items()}
    return {
        "_type": _STATEMENT_TYPE,
        "subject": [{"name": receipt.submission_id, "digest": {"sha256": receipt.sha256}}],
        "predicateType": PREDICATE_TYPE,
        "predicate": {**predicate, "scores": scores},
    }


def _bytes_in(envelope: Envelope) -> bytes:
    return base64.b64decode(envelope.payload, validate=True)


def _keys_named_by(envelope: Envelope) -> str:
    return f"key {printable(', '.join(envelope.key_ids))}"


def _compact(fields: Mapping[str, Any]) -> bytes:
    text = json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return text.encode()


def public_pem_of(key: Ed25519PublicKey) -> str:
    """Return a public key in PEM form, as servers publish it."""
    return key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()


def key_id_of(public_pem: str) -> str:
    """Return the first hexadecimal digits of the key's SHA-256."""
    # Stripped, because editors and shells add or drop the last line break.
    return hashlib.sha256(public_pem.strip().encode()).hexdigest()[:_KEY_ID_LENGTH]


def public_key_of(public_pem: str) -> Ed25519PublicKey:
    """Read a public key in PEM form. Raises ReceiptError if it is not an Ed25519 key."""
    try:
        key = load_pem_public_key(public_pem.encode())
    except (ValueError, UnsupportedAlgorithm):
        raise ReceiptError("this is not a public key in PEM form") from None
    if not isinstance(key, Ed25519PublicKey):
        raise ReceiptError("this is not an Ed25519 key")
    return key
