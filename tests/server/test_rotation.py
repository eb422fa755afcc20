"""Signing keys in the database and as files: which is in use, and what another one replaces."""

from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from sqlalchemy import select

from reverie_eval.receipts import ReceiptError, public_key_of, verify
from reverie_eval.schemas.organising import KeyRevocation, NewSnapshot
from reverie_eval.schemas.service import EarlierResult, Envelope
from reverie_eval.server.audit.log import AuditLog, entries
from reverie_eval.server.audit.signing import (
    Signer,
    all_keys,
    current_key,
    file_of_key,
    list_keys,
    load_key,
    make_key,
    open_key,
)
from reverie_eval.server.audit.transactions import Transaction, Transactions
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.errors import ConflictError, KeyReplacedError, NotFoundError
from reverie_eval.server.operations.keys import replace_key, revoke_key
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import SigningKey, StoredSnapshot, Submission
from tests.support.acting import AUDIT_LOG, NOON
from tests.support.serving import OPEN, OWNER, Serving

FIRST, SECOND, THIRD = (
    AUDIT_LOG.signer,
    *(Signer(Ed25519PrivateKey.from_private_bytes(bytes([seed]) * 32), "tests") for seed in (1, 2)),
)
HOUR = timedelta(hours=1)


def transactions(database: Database, signer: Signer, hours: int = 0) -> Transactions:
    """Return the transactions of a server with a key, some time after noon."""
    return Transactions(database, AuditLog(signer), lambda: NOON + hours * HOUR)


def test_the_first_server_s_key_is_in_use_until_it_is_replaced(sqlite: Database) -> None:
    with sqlite.writing() as session:
        assert current_key(session) is None
        unused = Transaction(session, "test", NOON, AUDIT_LOG)
        with pytest.raises(ConflictError) as refused:
            replace_key(unused, SECOND, "x")
    told = "the database has no signing key to replace; start the server first"
    assert str(refused.value) == told
    for _ in range(2):
        with transactions(sqlite, FIRST).begin("test"):
            pass
    with transactions(sqlite, FIRST, 1).begin("Olga") as transaction:
        begun = replace_key(transaction, SECOND, "the yearly change")
        first, second = list_keys(transaction.session)
        assert current_key(transaction.session) is all_keys(transaction.session)[1]
        (logged,) = entries(transaction.session)
    assert second == begun
    assert first.model_dump() == {
        "key_id": FIRST.key_id,
        "public_key": FIRST.public_pem,
        "valid_from": NOON,
        "valid_until": NOON + HOUR,
        "reason": "the yearly change",
    }
    assert begun.model_dump() == {
        "key_id": SECOND.key_id,
        "public_key": SECOND.public_pem,
        "valid_from": NOON + HOUR,
        "valid_until": None,
        "reason": "",
    }
    assert (logged.action, logged.row, logged.subject, logged.actor) == (
        "signing key replaced",
        "signing_key:1",
        FIRST.key_id,
        "Olga",
    )
    public_key_of(SECOND.public_pem).verify(bytes.fromhex(logged.seal), logged.digest.encode())
    assert logged.details == {
        "public_key": FIRST.public_pem,
        "by": SECOND.key_id,
        "until": "2026-03-02T13:00:00+00:00",
        "lost": False,
        "reason": "the yearly change",
    }
    with (
        pytest.raises(KeyReplacedError, match=f"{FIRST.key_id} was replaced by {SECOND.key_id} "),
        transactions(sqlite, FIRST).begin("test"),
    ):
        pass


def new_key(path: Path) -> str:
    """Write a key, and return its id."""
    make_key(path)
    return Signer(load_key(path), "").key_id


def garbage(path: Path) -> str:
    path.write_text("no key")
    return ""


@pytest.mark.parametrize("other", [new_key, garbage])
def test_a_new_key_that_is_not_in_use_stays_beside_it(
    other: Callable[[Path], str], tmp_path: Path
) -> None:
    path, pending = tmp_path / "key.pem", tmp_path / "key.pem.new"
    row = SigningKey(key_id=new_key(path))
    other(pending)
    assert file_of_key(path, row.key_id) == path
    assert Signer(open_key(path, row.key_id), "").key_id == row.key_id
    assert pending.exists()
    assert Signer(open_key(path, None), "").key_id == row.key_id


def test_a_rotation_that_was_interrupted_is_finished(tmp_path: Path) -> None:
    path, pending = tmp_path / "key.pem", tmp_path / "key.pem.new"
    old, row = new_key(path), SigningKey(key_id=new_key(pending))
    assert file_of_key(path, None) == path
    assert file_of_key(path, row.key_id) == pending
    assert Signer(open_key(path, row.key_id), "").key_id == row.key_id
    assert not pending.exists()
    with pytest.raises(ReceiptError) as refused:
        open_key(path, old)
    assert str(refused.value) == (
        f"{path} is key {row.key_id}, but the database says that {old} is in use: copy its file "
        "here, from the machine on which the key was rotated or from a backup; or, if it was "
        "rotated a moment ago, try again; if it is lost for good, run "
        "`reverie-eval server key rotate FOLDER --lost`"
    )


def test_a_rotation_that_another_process_finishes_is_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, pending = tmp_path / "key.pem", tmp_path / "key.pem.new"
    new_key(path)
    row = SigningKey(key_id=new_key(pending))
    rename = Path.rename

    def be_second(file: Path, target: Path) -> None:
        rename(file, target)
        file.unlink()

    monkeypatch.setattr(Path, "replace", be_second)
    assert Signer(open_key(path, row.key_id), "").key_id == row.key_id
    assert file_of_key(path, row.key_id) == path


def refusal(transaction: Transaction, key_id: str, hours: int) -> str:
    """Return why a key is not revoked."""
    revocation = KeyRevocation(since=NOON + hours * HOUR, reason="stolen")
    with pytest.raises((ConflictError, NotFoundError)) as refused:
        revoke_key(transaction, key_id, revocation)
    return str(refused.value)


def test_a_key_is_revoked_since_a_time_before_its_end(sqlite: Database) -> None:
    with transactions(sqlite, FIRST, 2).begin("test") as transaction:
        replace_key(transaction, SECOND, "the yearly change")
    with transactions(sqlite, SECOND, 3).begin("test") as transaction:
        told = "there is no key 'x'; `server key list` shows all"
        assert refusal(transaction, "x", 1) == told
        told = f"{SECOND.key_id} is in use; replace it first with `server key rotate`"
        assert refusal(transaction, SECOND.key_id, 1) == told
        told = "are valid only until 2026-03-02T14:00:00+00:00; give an earlier time"
        assert refusal(transaction, FIRST.key_id, 2) == f"signatures of {FIRST.key_id} {told}"
        revocation = KeyRevocation(since=NOON + HOUR, reason="stolen")
        assert revoke_key(transaction, FIRST.key_id, revocation) == 0
        row = all_keys(transaction.session)[0]
        assert (row.valid_until, row.revoked_at) == (NOON + HOUR, NOON + 3 * HOUR)
        logged = entries(transaction.session)[-1]
    assert (row.reason, row.replaced_at) == ("stolen", NOON + 2 * HOUR)
    assert (logged.action, logged.row, logged.subject) == (
        "signing key revoked",
        "signing_key:1",
        FIRST.key_id,
    )
    until = "2026-03-02T13:00:00+00:00"
    before = {"until": "2026-03-02T14:00:00+00:00", "reason": "the yearly change"}
    after = {"until": until, "signed_again": 0, "reason": "stolen"}
    assert logged.details == {"before": before, **after}


def test_later_receipts_and_snapshots_of_a_revoked_key_are_signed_again(server: Serving) -> None:
    state, signed_by = server.state, server.state.signer.key_id
    for _ in range(2):
        server.upload(OWNER, server.distinct())
        with server.acting() as transaction:
            state.get(Snapshots).take(transaction, NewSnapshot(split=OPEN, title="2026"))
        server.clock.turn(hours=1)
    server.upload(OWNER, server.distinct())
    with server.acting() as transaction:
        state.get(Snapshots).take(transaction, NewSnapshot(split=OPEN, title="another"))
    with state.database.writing() as session:
        _, later, _ = session.scalars(select(Submission).order_by(Submission.received_at)).all()
        known = later.results[""]
        by_another = THIRD.sign_again(known.receipt)
        about = {"report": known.report, "replaced_at": NOON, "reason": "corrected"}
        earlier = [EarlierResult(**about, receipt=each) for each in (known.receipt, by_another)]
        later.store_result("", known.model_copy(update={"earlier": earlier}))
        later.store_result("strict", known)
        third = session.scalars(select(StoredSnapshot).where(StoredSnapshot.number == 3)).one()
        by_third = THIRD.sign_again(Envelope.model_validate(third.envelope))
        third.envelope = by_third.model_dump(mode="json")
    with server.acting() as transaction:
        replace_key(transaction, SECOND, "the yearly change")
    with transactions(state.database, SECOND, 3).begin("test") as transaction:
        revocation = KeyRevocation(since=NOON, reason="stolen")
        assert revoke_key(transaction, signed_by, revocation) == 5
        session = transaction.session
        submissions = session.scalars(select(Submission).order_by(Submission.received_at)).all()
        first, later, last = submissions
        assert [result.receipt.key_ids for result in first.results.values()] == [[signed_by]]
        assert [result.receipt.key_ids for result in last.results.values()] == [[SECOND.key_id]]
        own, strict = later.results[""], later.results["strict"]
        assert [each.receipt.key_ids for each in own.earlier] == [[SECOND.key_id], [THIRD.key_id]]
        assert own.earlier[1].receipt == by_another
        for receipt in (own.receipt, own.earlier[0].receipt, strict.receipt):
            verify(receipt, SECOND.public_pem)
        assert own.receipt.payload == known.receipt.payload
        stored = session.scalars(select(StoredSnapshot).order_by(StoredSnapshot.id)).all()
        kept, again, another = (Envelope.model_validate(each.envelope) for each in stored)
        assert (kept.key_ids, another.key_ids) == ([signed_by], [THIRD.key_id])
        verify(again, SECOND.public_pem)
        assert entries(session)[-1].details["signed_again"] == 5
