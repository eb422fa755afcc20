"""Receipts and snapshots as tests read them, and as servers of other versions would sign them."""

import base64
import json
import re
from collections.abc import Mapping
from typing import Any

from reverie_eval.receipts import read
from reverie_eval.schemas.service import Envelope, Receipt, Snapshot
from reverie_eval.server.audit.signing import Signer


def receipt_in(told: Envelope | Mapping[str, Any]) -> Receipt:
    """Return the receipt in an envelope, also in one as a reply has it."""
    content = read(Envelope.model_validate(told)).content
    assert isinstance(content, Receipt)
    return content


def snapshot_in(told: Envelope | Mapping[str, Any]) -> Snapshot:
    """Return the snapshot in an envelope, also in one as a reply has it."""
    content = read(Envelope.model_validate(told)).content
    assert isinstance(content, Snapshot)
    return content


def payload_in(told: Mapping[str, Any]) -> dict[str, Any]:
    """Return what was signed, read without the code of the server."""
    payload: dict[str, Any] = json.loads(base64.b64decode(told["payload"]))
    return payload


def payloads_in(text: str) -> list[str]:
    """Return what is signed in all envelopes in a text: a reply, a page, a dump of a database."""
    found = re.findall(r"\bpayload\W{1,5}([A-Za-z0-9+/]{8,})", text)
    # The file of a database may have a part of one; the padding is optional.
    whole = (each[: len(each) - (len(each) % 4 == 1)] for each in found)
    padded = (each + "=" * (-len(each) % 4) for each in whole)
    return [base64.b64decode(each).decode(errors="replace") for each in padded]


def with_payload(envelope: Envelope, payload: bytes) -> Envelope:
    """Return an envelope with other bytes and the old signature."""
    return envelope.model_copy(update={"payload": base64.b64encode(payload).decode()})


def signed_as(signer: Signer, envelope: Envelope, payload: Any) -> Envelope:
    """Return an envelope with another JSON document in it, signed, as another version would."""
    content = json.dumps(payload, separators=(",", ":"), ensure_ascii=False).encode()
    return signer.sign_again(with_payload(envelope, content))


def altered(envelope: Envelope) -> Envelope:
    """Return an envelope in which a bit of what was signed is another one."""
    content = bytearray(base64.b64decode(envelope.payload))
    content[len(content) // 2] ^= 1
    return with_payload(envelope, bytes(content))
