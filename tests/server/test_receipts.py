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

from reverie_eval.receipts import NotGenuineError, ReceiptError, canonical, key_id_of, verify
from reverie_eval.schemas.service import Leaderboard, QuotaReport, QuotaWindow, Receipt
from reverie_eval.server.service.receipts import (
    KeyMissingError,
    Signer,
    load_key,
    make_key,
    public_pem_of,
)
from tests.support.acting import NOON
from tests.support.serving import (
    GOOD,
    OWNER,
    PRIVATE,
    Serving,
    submission_for,
)

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
RECEIPT = SIGNER.sign(**SAID)


def test_a_receipt_says_everything_that_was_given_and_is_genuine() -> None:
    assert {name: getattr(RECEIPT, name) for name in SAID} == SAID
    assert RECEIPT.key_id == key_id_of(SIGNER.public_pem)
    verify(RECEIPT, SIGNER.public_pem)


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


def test_a_snapshot_says_everything_that_was_given_and_is_genuine() -> None:
    leaderboard = Leaderboard(
        split="test", protocol="official-v1", metric="rgspl", fingerprint="0123456789ab", rows=[]
    )
    about: dict[str, Any] = {"split": "test", "number": 3, "title": "2026", "as_of": NOON}
    snapshot = SIGNER.sign_snapshot(**about, leaderboard=leaderboard)
    assert {name: getattr(snapshot, name) for name in about} == about
    assert (snapshot.server, snapshot.leaderboard) == (SIGNER.server, leaderboard)
    verify(snapshot, SIGNER.public_pem)


def test_a_receipt_is_changed_and_signed_again_with_another_key() -> None:
    other = Signer(OTHER_KEY, "another name")
    again = other.sign_again(RECEIPT, team="Red")
    expected = RECEIPT.model_copy(
        update={"team": "Red", "key_id": other.key_id, "proof": again.proof}
    )
    assert again == expected
    verify(again, other.public_pem)


def test_what_is_signed_is_canonical_json() -> None:
    """Pinned: another program must come to the same bytes."""
    assert canonical(RECEIPT).decode() == (
        f'{{"key_id":"{RECEIPT.key_id}","quota":{{"next_at":null,"remaining":1,'
        '"seconds_to_next":0,"windows":[{"limit":2,"name":"day","remaining":1,'
        '"resets_at":"2026-03-03T12:00:00Z"}]},"received_at":"2026-03-02T12:00:00.000007Z",'
        '"schema_version":1,"scores":{"path_length":9.47,"rgspl":0.1,"success":1.0},'
        '"server":"REVERIE évaluation","sha256":"' + "ab" * 32 + '","signature":'
        '"split:test|protocol:official-v1|data:0123456789ab|n:91|version:0.1.0","split":"test",'
        '"submission_id":"0123456789abcdef","team":"蓝 team"}'
    )


def rewritten(**layout: Any) -> Receipt:
    """Return the receipt from a file that another program has written."""
    return Receipt.model_validate_json(json.dumps(RECEIPT.model_dump(mode="json"), **layout))


@pytest.mark.parametrize(
    "receipt",
    [
        pytest.param(rewritten(indent=4, sort_keys=True), id="indented and sorted"),
        pytest.param(rewritten(ensure_ascii=False), id="without escapes"),
        pytest.param(
            Receipt.model_validate_json(RECEIPT.model_dump_json().replace("1.0}", "1}")),
            id="a whole number for a float",
        ),
        pytest.param(
            Receipt.model_validate_json(RECEIPT.model_dump_json().replace("07Z", "07+00:00")),
            id="UTC written otherwise",
        ),
    ],
)
def test_the_layout_of_the_file_does_not_matter(receipt: Receipt) -> None:
    verify(receipt, SIGNER.public_pem)


@pytest.mark.parametrize(
    "changed",
    [
        pytest.param({"server": "REVERIE evaluation"}, id="server"),
        pytest.param({"submission_id": "0123456789abcdee"}, id="submission"),
        pytest.param({"team": "Red"}, id="team"),
        pytest.param({"sha256": "ac" + "ab" * 31}, id="file"),
        pytest.param({"received_at": NOON}, id="time"),
        pytest.param({"split": "val_unseen"}, id="split"),
        pytest.param({"signature": "split:test"}, id="signature"),
        pytest.param({"scores": {**SAID["scores"], "rgspl": 0.1001}}, id="a score"),
        pytest.param({"scores": {"rgspl": 0.1, "path_length": 9.47}}, id="a score left out"),
        pytest.param({"scores": {**SAID["scores"], "rgs": 0.5}}, id="a score added"),
        pytest.param({"quota": SAID["quota"].model_copy(update={"remaining": 2})}, id="quota"),
        pytest.param({"quota": SAID["quota"].model_copy(update={"windows": []})}, id="windows"),
        pytest.param({"schema_version": 2}, id="version"),
        pytest.param({"key_id": "0" * 16}, id="key"),
        pytest.param({"proof": ""}, id="no proof"),
        pytest.param({"proof": RECEIPT.proof[4:]}, id="part of the proof"),
        pytest.param({"proof": f"!{RECEIPT.proof}"}, id="a proof that is no base64"),
        pytest.param(
            {"proof": base64.b64encode(OTHER_KEY.sign(canonical(RECEIPT))).decode()},
            id="somebody else's proof",
        ),
    ],
)
def test_a_change_of_any_field_is_found_out(changed: dict[str, Any]) -> None:
    with pytest.raises(NotGenuineError):
        verify(RECEIPT.model_copy(update=changed), SIGNER.public_pem)


def test_the_table_changes_every_field() -> None:
    (table,) = (mark.args[1] for mark in test_a_change_of_any_field_is_found_out.pytestmark)
    assert {name for row in table for name in row.values[0]} == set(Receipt.model_fields)


@given(st.integers(0, len(base64.b64decode(RECEIPT.proof)) * 8 - 1))
def test_a_bit_of_the_proof_is_enough(bit: int) -> None:
    proof = bytearray(base64.b64decode(RECEIPT.proof))
    proof[bit // 8] ^= 1 << bit % 8
    changed = RECEIPT.model_copy(update={"proof": base64.b64encode(proof).decode()})
    with pytest.raises(NotGenuineError):
        verify(changed, SIGNER.public_pem)


def test_another_servers_key_does_not_fit() -> None:
    with pytest.raises(NotGenuineError, match="names key"):
        verify(RECEIPT, public_pem_of(OTHER_KEY))


def ec_pem() -> str:
    public = generate_private_key(SECP256R1()).public_key()
    return public.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()


@pytest.mark.parametrize("text", ["", "no key", "-----BEGIN PUBLIC KEY-----", "é", ec_pem()])
def test_what_is_no_key_is_said_to_be_none(text: str) -> None:
    with pytest.raises(ReceiptError, match=r"not a public key|not an Ed25519 key"):
        verify(RECEIPT, text)


def test_a_key_with_other_line_ends_is_the_same() -> None:
    verify(RECEIPT, f"\n{SIGNER.public_pem}".replace("\n", "\r\n"))


# The server's own.


def test_the_receipt_of_an_upload_can_be_checked_with_the_published_key(server: Serving) -> None:
    reply = server.upload(OWNER, submission_for(PRIVATE), PRIVATE)
    submission = reply.json()["submission"]
    receipt = Receipt.model_validate(submission["receipt"])
    verify(receipt, server.client.get("/api/v1/key").text)
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
def test_times_are_signed_in_one_form(received_at: datetime) -> None:
    receipt = SIGNER.sign(**{**SAID, "received_at": received_at})
    verify(Receipt.model_validate_json(receipt.model_dump_json()), SIGNER.public_pem)


# The private key.


def test_a_new_key_is_its_owners_alone_and_never_replaces_one(tmp_path: Path) -> None:
    path = tmp_path / "key.pem"
    make_key(path)
    assert path.stat().st_mode & 0o777 == 0o600
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        make_key(path)
    assert path.read_bytes() == before
    receipt = Signer(load_key(path), "here").sign(**SAID)
    verify(receipt, public_pem_of(load_key(path)))


def pem(key: Any, encryption: Any) -> bytes:
    written: bytes = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption)
    return written


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        pytest.param(
            lambda path: path.unlink(),
            "{} is missing; restore it from the backup of the server",
            id="missing",
        ),
        pytest.param(
            lambda path: path.chmod(0o640),
            "other users can read {0}; run `chmod 600 {0}`",
            id="others can read it",
        ),
        pytest.param(
            lambda path: path.write_bytes(b"key"),
            "{} is not a private key in PEM format",
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
            "{} cannot be read: Is a directory",
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
    assert isinstance(refused.value, KeyMissingError) == ("missing" in message)
