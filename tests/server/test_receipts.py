"""Receipts: what a server signs, anybody can check, and nobody can change."""

import base64
import hmac
import json
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)
from hypothesis import given
from hypothesis import strategies as st

from reverie_eval.receipts import (
    SNAPSHOT_TYPE,
    NotGenuineError,
    ReceiptError,
    key_id_of,
    read,
    verify,
)
from reverie_eval.schemas.service import (
    Envelope,
    EnvelopeSignature,
    Leaderboard,
    QuotaReport,
    QuotaWindow,
    Receipt,
    Snapshot,
)
from reverie_eval.server.audit.signing import (
    KeyMissingError,
    Signer,
    load_key,
    make_key,
    public_pem_of,
)
from tests.support.acting import NOON
from tests.support.serving import GOOD, OWNER, PRIVATE, Serving, submission_for
from tests.support.signing import receipt_in, with_payload

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
OTHER_KEY = Ed25519PrivateKey.from_private_bytes(bytes(32))
SIGNER = Signer(KEY, "REVERIE évaluation")
SAID: Mapping[str, Any] = {
    "submission_id": "0123456789abcdef",
    "team": "蓝 team",
    "sha256": "ab" * 32,
    "received_at": NOON + timedelta(microseconds=7),
    "split": "test",
    "signature": "split:test|protocol:official-v1|data:0123456789ab|n:91|version:0.1.0",
    "scores": {"rgspl": 0.1, "path_length": 9.47, "success": 1.0},
    "quota": QuotaReport(
        remaining=1,
        next_at=None,
        seconds_to_next=0,
        windows=[
            QuotaWindow(name="day", limit=2, remaining=1, resets_at=NOON + timedelta(hours=24))
        ],
    ),
}
RECEIPT = Receipt(server=SIGNER.server, **SAID)
SNAPSHOT = Snapshot(
    server=SIGNER.server,
    split="test",
    number=3,
    title="2026",
    as_of=NOON,
    leaderboard=Leaderboard(
        split="test", protocol="official-v1", metric="rgspl", fingerprint="0123456789ab", rows=[]
    ),
)
ENVELOPE = SIGNER.sign(RECEIPT)
ENVELOPES = [
    pytest.param(ENVELOPE, id="receipt"),
    pytest.param(SIGNER.sign(SNAPSHOT), id="snapshot"),
]


@pytest.mark.parametrize("envelope", ENVELOPES)
def test_what_was_signed_is_genuine(envelope: Envelope) -> None:
    assert envelope.key_ids == [key_id_of(SIGNER.public_pem)]
    assert verify(envelope, SIGNER.public_pem) == SIGNER.key_id


@pytest.mark.parametrize("content", [RECEIPT, SNAPSHOT], ids=["receipt", "snapshot"])
def test_what_was_signed_is_read_as_it_was(content: Receipt | Snapshot) -> None:
    reading = read(SIGNER.sign(content))
    assert (reading.content, reading.is_complete) == (content, True)


def test_each_purpose_and_each_key_has_a_secret_of_its_own() -> None:
    secrets = [
        signer.secret_for(purpose)
        for signer in (SIGNER, Signer(OTHER_KEY, "REVERIE"))
        for purpose in ("cookies", "something else")
    ]
    assert len(set(secrets)) == 4
    assert {len(secret) for secret in secrets} == {32}
    assert SIGNER.secret_for("cookies") == secrets[0]


def test_a_secret_is_derived_as_rfc_5869_says() -> None:
    """Pinned: the audit log and cookies of earlier versions depend on it."""
    extracted = hmac.digest(bytes(32), bytes(range(32)), "sha256")
    assert SIGNER.secret_for("cookies") == hmac.digest(extracted, b"cookies\x01", "sha256")


def test_the_same_bytes_are_signed_again_with_another_key() -> None:
    other = Signer(OTHER_KEY, "another name")
    again = other.sign_again(ENVELOPE)
    assert (again.payload_type, again.payload) == (ENVELOPE.payload_type, ENVELOPE.payload)
    assert again.key_ids == [other.key_id]
    verify(again, other.public_pem)


RECEIPT_BYTES = (
    '{"_type":"https://in-toto.io/Statement/v1","predicate":{"quota":{"next_at":null,'
    '"remaining":1,"seconds_to_next":0,"windows":[{"limit":2,"name":"day","remaining":1,'
    '"resets_at":"2026-03-03T12:00:00Z"}]},"received_at":"2026-03-02T12:00:00.000007Z",'
    '"schema_version":1,"scores":{"path_length":"9.47","rgspl":"0.1","success":"1.0"},'
    '"server":"REVERIE évaluation","signature":'
    '"split:test|protocol:official-v1|data:0123456789ab|n:91|version:0.1.0","split":"test",'
    '"submission_id":"0123456789abcdef","team":"蓝 team"},'
    '"predicateType":"urn:reverie-eval:receipt:v1","subject":[{"digest":{"sha256":"'
    + "ab" * 32
    + '"},"name":"0123456789abcdef"}]}'
)
SNAPSHOT_BYTES = (
    '{"as_of":"2026-03-02T12:00:00Z","leaderboard":{"apart":[],"board":"","corrections":[],'
    '"fingerprint":"0123456789ab","metric":"rgspl","protocol":"official-v1","rows":[],'
    '"signature":"","split":"test"},"number":3,"schema_version":1,'
    '"server":"REVERIE évaluation","split":"test","title":"2026"}'
)


@pytest.mark.parametrize(
    ("content", "payload_type", "payload"),
    [
        pytest.param(RECEIPT, "application/vnd.in-toto+json", RECEIPT_BYTES, id="receipt"),
        pytest.param(
            SNAPSHOT,
            "application/vnd.reverie-eval.snapshot+json",
            SNAPSHOT_BYTES,
            id="snapshot",
        ),
    ],
)
def test_what_the_first_version_signed_is_genuine_and_read_in_full(
    content: Receipt | Snapshot, payload_type: str, payload: str
) -> None:
    """Pinned, as files that people have: change them only to add those of a later version."""
    signed = f"DSSEv1 {len(payload_type)} {payload_type} {len(payload.encode())} {payload}"
    signature = EnvelopeSignature(
        keyid=SIGNER.key_id, sig=base64.b64encode(KEY.sign(signed.encode())).decode()
    )
    kept = Envelope(
        payloadType=payload_type,
        payload=base64.b64encode(payload.encode()).decode(),
        signatures=[signature],
    )
    verify(kept, SIGNER.public_pem)
    reading = read(kept)
    assert (reading.content, reading.is_complete) == (content, True)


def test_a_file_has_the_names_that_dsse_gives_its_parts() -> None:
    told = json.loads(ENVELOPE.model_dump_json())
    assert list(told) == ["payloadType", "payload", "signatures"]
    assert list(told["signatures"][0]) == ["keyid", "sig"]


@pytest.mark.parametrize(
    "layout",
    [
        pytest.param({"indent": 4, "sort_keys": True}, id="indented and sorted"),
        pytest.param({"separators": (",", ":")}, id="compact"),
    ],
)
def test_the_layout_of_the_file_does_not_matter(layout: Mapping[str, Any]) -> None:
    written = json.dumps(ENVELOPE.model_dump(mode="json"), **layout)
    verify(Envelope.model_validate_json(written), SIGNER.public_pem)


@pytest.mark.parametrize("envelope", ENVELOPES)
def test_a_change_of_any_byte_is_found_out(envelope: Envelope) -> None:
    content = base64.b64decode(envelope.payload)
    for place, byte in enumerate(content):
        changed = content[:place] + bytes([byte ^ 1]) + content[place + 1 :]
        with pytest.raises(NotGenuineError, match="the signature does not match"):
            verify(with_payload(envelope, changed), SIGNER.public_pem)


SIG = ENVELOPE.signatures[0].sig


@pytest.mark.parametrize(
    "changed",
    [
        pytest.param({"keyid": "0" * 16}, id="key"),
        pytest.param({"sig": ""}, id="no signature"),
        pytest.param({"sig": SIG[4:]}, id="part of the signature"),
        pytest.param({"sig": f"!{SIG}"}, id="a signature that is not base64"),
        pytest.param(
            {"sig": Signer(OTHER_KEY, "").sign(RECEIPT).signatures[0].sig}, id="another's"
        ),
        pytest.param({"sig": SIGNER.sign(SNAPSHOT).signatures[0].sig}, id="of something else"),
    ],
)
def test_a_changed_signature_is_not_genuine(changed: dict[str, str]) -> None:
    signature = ENVELOPE.signatures[0].model_copy(update=changed)
    with pytest.raises(NotGenuineError):
        verify(ENVELOPE.model_copy(update={"signatures": [signature]}), SIGNER.public_pem)


@pytest.mark.parametrize(
    "changed",
    [
        pytest.param({"payload": "!"}, id="bytes that are not base64"),
        pytest.param({"payload": ""}, id="no bytes"),
        pytest.param({"payload_type": SNAPSHOT_TYPE}, id="a receipt as a snapshot"),
    ],
)
def test_a_changed_envelope_is_not_genuine(changed: dict[str, str]) -> None:
    with pytest.raises(NotGenuineError):
        verify(ENVELOPE.model_copy(update=changed), SIGNER.public_pem)


@given(st.integers(0, len(base64.b64decode(SIG)) * 8 - 1))
def test_a_bit_of_the_signature_is_enough(bit: int) -> None:
    content = bytearray(base64.b64decode(SIG))
    content[bit // 8] ^= 1 << bit % 8
    signature = EnvelopeSignature(keyid=SIGNER.key_id, sig=base64.b64encode(content).decode())
    with pytest.raises(NotGenuineError):
        verify(ENVELOPE.model_copy(update={"signatures": [signature]}), SIGNER.public_pem)


def test_one_of_several_signatures_is_enough() -> None:
    """A later version may let others sign as well."""
    both = [
        *SIGNER.sign_again(ENVELOPE).signatures,
        *Signer(OTHER_KEY, "").sign(RECEIPT).signatures,
    ]
    envelope = ENVELOPE.model_copy(update={"signatures": both})
    for pem in (SIGNER.public_pem, public_pem_of(OTHER_KEY)):
        assert verify(envelope, pem) == key_id_of(pem)


def test_another_servers_key_does_not_fit() -> None:
    with pytest.raises(NotGenuineError, match="names key"):
        verify(ENVELOPE, public_pem_of(OTHER_KEY))


def ec_pem() -> str:
    public = generate_private_key(SECP256R1()).public_key()
    return public.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()


@pytest.mark.parametrize("text", ["", "no key", "-----BEGIN PUBLIC KEY-----", "é", ec_pem()])
def test_what_is_no_key_is_said_to_be_none(text: str) -> None:
    with pytest.raises(ReceiptError, match=r"not a public key|not an Ed25519 key"):
        verify(ENVELOPE, text)


def test_a_key_with_other_line_ends_is_the_same() -> None:
    verify(ENVELOPE, f"\n{SIGNER.public_pem}".replace("\n", "\r\n"))


# The server's own.


def test_the_receipt_of_an_upload_can_be_checked_with_the_published_key(server: Serving) -> None:
    reply = server.upload(OWNER, submission_for(PRIVATE), PRIVATE)
    submission = reply.json()["submission"]
    envelope = Envelope.model_validate(submission["receipt"])
    verify(envelope, server.client.get("/api/v1/key").text)
    receipt = receipt_in(envelope)
    assert receipt.submission_id == submission["id"]
    assert receipt.sha256 == submission["sha256"]
    assert receipt.scores == submission["report"]["scores"]
    assert receipt.signature == submission["report"]["signature"]
    assert receipt.received_at == NOON
    assert receipt.quota.model_dump(mode="json") == reply.json()["quota"]
    alone = server.ask(OWNER, "GET", f"/submissions/{receipt.submission_id}/receipt")
    assert alone.json() == submission["receipt"]


def test_a_receipt_stays_what_it_was(server: Serving) -> None:
    """Whatever the team says of the submission later."""
    submission = server.upload(OWNER, GOOD).json()["submission"]
    server.clock.turn(days=40)
    for change in ({"published": True}, {"method": {"name": "Runner"}}, {"withdrawn": True}):
        server.ask(OWNER, "PATCH", f"/submissions/{submission['id']}", json=change)
    again = server.ask(OWNER, "GET", f"/submissions/{submission['id']}")
    assert again.json()["receipt"] == submission["receipt"]


@given(st.datetimes(timezones=st.sampled_from([UTC, timezone(timedelta(hours=-9))])))
def test_times_are_read_as_they_were_signed(received_at: datetime) -> None:
    receipt = RECEIPT.model_copy(update={"received_at": received_at})
    assert receipt_in(SIGNER.sign(receipt)) == receipt


# The private key.


def test_a_new_key_is_its_owners_alone_and_never_replaces_one(tmp_path: Path) -> None:
    path = tmp_path / "key.pem"
    make_key(path)
    assert path.stat().st_mode & 0o777 == 0o600
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        make_key(path)
    assert path.read_bytes() == before
    envelope = Signer(load_key(path), "here").sign(RECEIPT)
    verify(envelope, public_pem_of(load_key(path)))


IF_LOST = "if it is lost for good, run `reverie-eval server key rotate FOLDER --lost`"


def pem(key: Any, encryption: Any) -> bytes:
    written: bytes = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption)
    return written


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        pytest.param(
            lambda path: path.unlink(),
            f"{{}} is missing; restore it from the backup of the server; {IF_LOST}",
            id="missing",
        ),
        pytest.param(
            lambda path: path.chmod(0o640),
            "other users can read {0}; run `chmod 600 {0}`",
            id="others can read it",
        ),
        pytest.param(
            lambda path: path.write_bytes(b"key"),
            "{} is not a private key in PEM format; restore it from the backup of the server; "
            + IF_LOST,
            id="no key",
        ),
        pytest.param(
            lambda path: path.write_bytes(pem(KEY, BestAvailableEncryption(b"secret"))),
            "{} is locked with a password; store it without one",
            id="locked",
        ),
        pytest.param(
            lambda path: path.write_bytes(pem(generate_private_key(SECP256R1()), NoEncryption())),
            "{} is not an Ed25519 key",
            id="another kind",
        ),
        pytest.param(
            lambda path: (path.unlink(), path.mkdir(mode=0o700)),
            "{} cannot be read: Is a directory; restore it from the backup of the server",
            id="a folder",
        ),
    ],
)
def test_a_key_that_cannot_be_used_is_refused(
    spoil: Callable[[Path], object], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "key.pem"
    make_key(path)
    spoil(path)
    with pytest.raises(ReceiptError) as refused:
        load_key(path)
    assert str(refused.value) == message.format(path)
    assert isinstance(refused.value, KeyMissingError) == (IF_LOST in message)
