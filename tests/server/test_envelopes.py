"""What a server signs, judged by the libraries of others: DSSE envelopes, in-toto statements."""

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.serialization import load_pem_public_key
from google.protobuf.json_format import Parse
from in_toto_attestation.v1 import statement_pb2
from in_toto_attestation.v1.statement import Statement
from securesystemslib.dsse import Envelope
from securesystemslib.exceptions import VerificationError
from securesystemslib.signer import SSlibKey  # type: ignore[attr-defined]

from reverie_eval.server.audit.signing import public_pem_of
from tests.server.test_receipts import ENVELOPE, OTHER_KEY, RECEIPT, SIGNER, SNAPSHOT
from tests.support.serving import OWNER, PRIVATE, Serving, submission_for
from tests.support.signing import receipt_in

DOCS = Path(__file__).parents[2] / "docs"
FILE = ENVELOPE.model_dump_json().encode()


def key_of(public_pem: str, key_id: str) -> SSlibKey:
    return SSlibKey.from_crypto(load_pem_public_key(public_pem.encode()), key_id)


KEY = key_of(SIGNER.public_pem, SIGNER.key_id)


def verified(content: bytes, key: SSlibKey = KEY) -> bytes:
    """Return the payload of a genuine envelope."""
    envelope = Envelope.from_dict(json.loads(content))
    envelope.verify([key], threshold=1)
    return bytes(envelope.payload)


def test_a_statement_says_what_the_receipt_says_about_the_submitted_file() -> None:
    statement: dict[str, Any] = json.loads(verified(FILE))
    Statement.copy_from_pb(Parse(json.dumps(statement), statement_pb2.Statement())).validate()
    receipt = RECEIPT.model_dump(mode="json")
    assert statement["_type"] == "https://in-toto.io/Statement/v1"
    assert statement["subject"] == [
        {"name": receipt["submission_id"], "digest": {"sha256": receipt["sha256"]}}
    ]
    said = ("server", "submission_id", "team", "received_at", "split", "signature", "quota")
    assert statement["predicate"] == {name: receipt[name] for name in said} | {
        "schema_version": 1,
        "scores": {"path_length": "9.47", "rgspl": "0.1", "success": "1.0"},
    }


@pytest.mark.parametrize(
    ("score", "expected"),
    [
        pytest.param(1e-7, "0.0000001", id="no exponent"),
        pytest.param(1 / 3, "0.3333333333333333", id="all digits"),
        pytest.param(0.0, "0.0", id="zero"),
    ],
)
def test_a_score_is_a_decimal_string(score: float, expected: str) -> None:
    envelope = SIGNER.sign(RECEIPT.model_copy(update={"scores": {"rgspl": score}}))
    statement = json.loads(base64.b64decode(envelope.payload))
    assert statement["predicate"]["scores"] == {"rgspl": expected}


def flipped(content: bytes) -> Iterator[bytes]:
    """Yield the content with each of its bytes changed in turn."""
    for place, byte in enumerate(content):
        yield content[:place] + bytes([byte ^ 1]) + content[place + 1 :]


def test_no_byte_of_an_envelope_can_be_changed_unnoticed() -> None:
    """A few can change in base64 without a change of what it says; the payload stays the same."""
    payload = verified(FILE)
    for changed in flipped(FILE):
        try:
            found = verified(changed)
        except (VerificationError, ValueError, KeyError, TypeError):
            continue
        assert found == payload


@pytest.mark.parametrize("part", ["payload", "sig"])
def test_every_flipped_byte_of_what_is_signed_is_rejected(part: str) -> None:
    def with_part(content: bytes) -> bytes:
        envelope = json.loads(FILE)
        place = envelope if part == "payload" else envelope["signatures"][0]
        place[part] = base64.b64encode(content).decode()
        return json.dumps(envelope).encode()

    envelope = json.loads(FILE)
    content = base64.b64decode((envelope | envelope["signatures"][0])[part])
    assert verified(with_part(content)) == base64.b64decode(envelope["payload"])
    for changed in flipped(content):
        with pytest.raises(VerificationError):
            verified(with_part(changed))


def test_another_key_does_not_fit() -> None:
    other = key_of(public_pem_of(OTHER_KEY), SIGNER.key_id)
    with pytest.raises(VerificationError):
        verified(FILE, other)


def test_a_snapshot_is_an_envelope_too() -> None:
    payload = verified(SIGNER.sign(SNAPSHOT).model_dump_json().encode())
    assert json.loads(payload) == SNAPSHOT.model_dump(mode="json")


def test_the_code_in_the_documentation_verifies_what_a_server_issued(
    server: Serving, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    submission = server.upload(OWNER, submission_for(PRIVATE), PRIVATE).json()["submission"]
    place = f"/submissions/{submission['id']}/receipt"
    (tmp_path / "submit.json.receipt.json").write_bytes(server.ask(OWNER, "GET", place).content)
    (tmp_path / "keys.json").write_bytes(server.ask(None, "GET", "/keys").content)
    monkeypatch.chdir(tmp_path)
    blocks = (DOCS / "how-to" / "submit.md").read_text(encoding="utf-8").split("```python\n")[1:]
    (code,) = (block.partition("```")[0] for block in blocks if "securesystemslib" in block)
    names: dict[str, Any] = {}
    exec(code, names)
    receipt = receipt_in(submission["receipt"])
    assert names["statement"]["subject"][0]["digest"] == {"sha256": receipt.sha256}
    said = {key: float(text) for key, text in names["statement"]["predicate"]["scores"].items()}
    assert said == receipt.scores
