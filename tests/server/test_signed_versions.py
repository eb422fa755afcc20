"""What another version has signed: genuine, read as far as possible, and never in the way."""

import json
from collections.abc import Callable, Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from _pytest.mark import ParameterSet
from pydantic import BaseModel

from reverie_eval import receipts
from reverie_eval.receipts import NewerVersionError, read, verify, verify_by_history
from reverie_eval.schemas.organising import KeyRevocation
from reverie_eval.schemas.service import (
    Envelope,
    KeyReport,
    LeaderboardRow,
    Phase,
    Receipt,
    ScoredSubmission,
    Snapshot,
)
from reverie_eval.server.audit.signing import Signer
from reverie_eval.server.opening import open_server
from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.operations.keys import revoke_key, rotate_key
from reverie_eval.server.operations.restore import restore_backup
from reverie_eval.server.settings import load_settings
from reverie_eval.server.store.tables import StoredSnapshot, Submission
from tests.server.test_receipts import RECEIPT, SIGNER, SNAPSHOT
from tests.support.acting import NOON
from tests.support.correcting import rescored
from tests.support.entries import entered
from tests.support.flat_world import Run
from tests.support.serving import (
    OPEN,
    ORGANISER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    replace_answers,
    settings_of,
)
from tests.support.signing import payload_in, receipt_in, signed_as, snapshot_in

Change = Callable[[Any], object]
PHASES = (Phase(name="first", closes=NOON + timedelta(days=1)),)
UPDATE = "made by a newer version of reverie-eval; update to read all of it"
ROW: Mapping[str, Any] = {
    "rank": 1,
    "submission_id": "0123456789abcdef",
    "team": "Blue",
    "method": {"name": "Walker"},
    "published_at": "2026-03-02T12:00:00Z",
    "submissions": 1,
    "scores": {"rgspl": 0.5},
}
"""A row of a leaderboard without anything that can be left out."""
BOARD = SNAPSHOT.leaderboard.model_copy(update={"rows": [LeaderboardRow.model_validate(ROW)]})
FULL = SNAPSHOT.model_copy(update={"leaderboard": BOARD})


def signed(signer: Signer, envelope: Envelope, change: Change) -> Envelope:
    """Return an envelope as a version would have signed it that has something else in it."""
    payload = payload_in(envelope.model_dump(mode="json"))
    change(payload)
    return signed_as(signer, envelope, payload)


def newer_receipt(**fields: Any) -> Change:
    """Return a change of a receipt's fields."""
    return lambda payload: payload["predicate"].update(fields)


# Every one of them is signed by a newer version. Of these, this one can read the fields ...
READABLE_RECEIPTS = [
    pytest.param(newer_receipt(hardware="a laptop"), id="a field"),
    pytest.param(
        lambda payload: payload["predicate"]["quota"].update(per_person=1), id="a field within"
    ),
    pytest.param(newer_receipt(schema_version=2), id="a version"),
]
# ... and of these not.
UNREADABLE_RECEIPTS = [
    pytest.param(newer_receipt(schema_version=2, scores=[["rgspl", "0.1"]]), id="another type"),
    pytest.param(newer_receipt(quota=None), id="nothing where something was"),
    pytest.param(
        lambda payload: payload.update(predicateType="urn:reverie-eval:receipt:v2"),
        id="another statement",
    ),
    pytest.param(lambda payload: payload["predicate"].pop("team"), id="a field left out"),
]
READABLE_SNAPSHOTS = [
    pytest.param(lambda payload: payload.update(medal="gold"), id="a field"),
    pytest.param(
        lambda payload: payload["leaderboard"]["rows"][0].update(energy=3.5), id="a field of a row"
    ),
    pytest.param(lambda payload: payload.update(schema_version=2), id="a version"),
]
UNREADABLE_SNAPSHOTS = [
    pytest.param(
        lambda payload: payload["leaderboard"]["rows"][0].update(standing="withdrawn"),
        id="an unknown word",
    ),
    pytest.param(lambda payload: payload.update(leaderboard=[]), id="another type"),
]


def of_both(receipts: Sequence[ParameterSet], snapshots: Sequence[ParameterSet]) -> list[Any]:
    """Return the changes with what they change, for a table."""
    kinds: Sequence[tuple[str, Receipt | Snapshot, Sequence[ParameterSet]]] = [
        ("receipt", RECEIPT, receipts),
        ("snapshot", FULL, snapshots),
    ]
    return [
        pytest.param(content, *each.values, id=f"{kind}: {each.id}")
        for kind, content, changes in kinds
        for each in changes
    ]


READABLE = of_both(READABLE_RECEIPTS, READABLE_SNAPSHOTS)
UNREADABLE = of_both(UNREADABLE_RECEIPTS, UNREADABLE_SNAPSHOTS)
KEYS = [
    KeyReport(
        key_id=SIGNER.key_id,
        public_key=SIGNER.public_pem,
        valid_from=NOON,
        valid_until=NOON + timedelta(days=1),
        reason="the yearly change",
    )
]


@pytest.mark.parametrize(("content", "change"), READABLE)
def test_a_newer_one_is_genuine_and_read_but_for_what_is_new(
    content: Receipt | Snapshot, change: Change
) -> None:
    newer = signed(SIGNER, SIGNER.sign(content), change)
    verify(newer, SIGNER.public_pem)
    verify_by_history(newer, KEYS)
    reading = read(newer)
    assert reading.content is not None
    version = {"schema_version": reading.content.schema_version}
    assert reading.content == content.model_copy(update=version)


@pytest.mark.parametrize(("content", "change"), [*READABLE, *UNREADABLE])
def test_verify_says_that_a_newer_one_is_genuine_and_to_update(
    content: Receipt | Snapshot, change: Change, tmp_path: Path, run: Run
) -> None:
    newer = signed(SIGNER, SIGNER.sign(content), change)
    file, key = tmp_path / "signed.json", tmp_path / "key.pem"
    file.write_text(newer.model_dump_json())
    key.write_text(SIGNER.public_pem)
    outcome = run("verify", str(file), "--key", str(key))
    assert (outcome.status, outcome.err) == (0, "")
    first, second, *more = outcome.out.splitlines()
    assert first == f"{file}: genuine, signed with the key of {key} ({SIGNER.key_id})"
    assert second == UPDATE
    assert any(SIGNER.server in line or "proven: the server" in line for line in [second, *more])


def test_more_beside_what_is_signed_is_ignored(tmp_path: Path, run: Run) -> None:
    told = SIGNER.sign(RECEIPT).model_dump(mode="json")
    told["signatures"][0]["cert"] = told["log"] = "new"
    file, key = tmp_path / "signed.json", tmp_path / "key.pem"
    file.write_text(json.dumps(told))
    key.write_text(SIGNER.public_pem)
    outcome = run("verify", str(file), "--key", str(key))
    assert (outcome.status, UPDATE in outcome.out) == (0, False)


@pytest.mark.parametrize(("content", "change"), UNREADABLE)
def test_one_that_cannot_be_read_still_proves_its_time_and_its_file(
    content: Receipt | Snapshot, change: Change
) -> None:
    newer = signed(SIGNER, SIGNER.sign(content), change)
    reading = read(newer)
    assert (reading.content, reading.is_complete) == (None, False)
    verify_by_history(newer, KEYS)
    if isinstance(content, Receipt):
        assert reading.fields["sha256"] == content.sha256


def test_another_kind_is_genuine_but_of_no_file(tmp_path: Path, run: Run) -> None:
    file, key = tmp_path / "signed.json", tmp_path / "key.pem"
    of_tomorrow = SIGNER.sign(RECEIPT).model_copy(update={"payload_type": "application/cbor"})
    file.write_text(signed_as(SIGNER, of_tomorrow, 1).model_dump_json())
    key.write_text(SIGNER.public_pem)
    outcome = run("verify", str(file), "--key", str(key))
    assert (outcome.status, outcome.out.splitlines()[1:]) == (0, [UPDATE])
    compared = run("verify", str(file), "--key", str(key), "--submission", str(file))
    assert (compared.status, "cannot read which file it is for" in compared.err) == (2, True)


@pytest.mark.parametrize("content", [RECEIPT, SNAPSHOT], ids=["receipt", "snapshot"])
def test_one_without_a_time_is_not_proven_by_a_key_that_ended(
    content: Receipt | Snapshot, tmp_path: Path, run: Run
) -> None:
    """Else anybody with a stolen key could sign as a newer version, without a time."""

    def without_time(payload: dict[str, Any]) -> None:
        fields = payload.get("predicate", payload)
        fields.pop("received_at", None)
        fields.pop("as_of", None)

    timeless = signed(SIGNER, SIGNER.sign(content), without_time)
    with pytest.raises(NewerVersionError, match="update reverie-eval to check it"):
        verify_by_history(timeless, KEYS)
    verify_by_history(timeless, [KEYS[0].model_copy(update={"valid_until": None})])
    file, keys = tmp_path / "signed.json", tmp_path / "keys.json"
    file.write_text(timeless.model_dump_json())
    keys.write_text(f"[{KEYS[0].model_dump_json()}]")
    outcome = run("verify", str(file), "--key", str(keys))
    assert (outcome.status, outcome.out) == (2, "")


def required_alone(model: type[BaseModel], fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that a model has no default for: what its oldest version had."""
    return {name: fields[name] for name, each in model.model_fields.items() if each.is_required()}


def test_an_older_one_is_read_in_full() -> None:
    def of_receipt(payload: dict[str, Any]) -> None:
        del payload["predicate"]["schema_version"]  # everything else has been there from the start

    def of_snapshot(payload: dict[str, Any]) -> None:
        board = payload["leaderboard"]
        board["rows"] = [required_alone(LeaderboardRow, row) for row in board["rows"]]
        for fields, model in ((board, type(BOARD)), (payload, Snapshot)):
            for name in fields.keys() - required_alone(model, fields).keys():
                del fields[name]

    contents: Sequence[tuple[Receipt | Snapshot, Change]] = [
        (RECEIPT, of_receipt),
        (FULL, of_snapshot),
    ]
    for content, change in contents:
        older = signed(SIGNER, SIGNER.sign(content), change)
        assert len(older.payload) < len(SIGNER.sign(content).payload)
        verify_by_history(older, KEYS)
        reading = read(older)
        assert (reading.content, reading.is_complete) == (content, True)


class NextRow(LeaderboardRow):
    """A row of the next version, which has a field more."""

    energy: float | None = None


class NextLeaderboard(type(BOARD)):  # type: ignore[misc]
    """A leaderboard of the next version."""

    rows: list[NextRow]


class NextSnapshot(Snapshot):
    """A snapshot of the next version."""

    leaderboard: NextLeaderboard


def test_a_field_that_is_added_makes_no_signature_false(monkeypatch: pytest.MonkeyPatch) -> None:
    of_today = SIGNER.sign(FULL)
    board = NextLeaderboard.model_validate(BOARD.model_dump())
    of_tomorrow = SIGNER.sign(
        NextSnapshot.model_validate({**FULL.model_dump(), "leaderboard": board.model_dump()})
    )
    for each in (of_today, of_tomorrow):
        verify(each, SIGNER.public_pem)
    assert read(of_tomorrow).content == FULL
    monkeypatch.setattr(receipts, "Snapshot", NextSnapshot)  # after an update
    for each in (of_today, of_tomorrow):
        verify(each, SIGNER.public_pem)
        reading = read(each)
        assert isinstance(reading.content, NextSnapshot)
        assert reading.is_complete


# On a server. Its database has what a newer version of it has signed.


def plant_receipt(server: Serving, submission: str, change: Change) -> Envelope:
    """Let a newer version have signed the receipt of a submission."""
    with server.state.database.writing() as session:
        row = session.get_one(Submission, submission)
        newer = signed(server.state.signer, Envelope.model_validate(row.receipt), change)
        row.receipt = newer.model_dump(mode="json")
    return newer


def plant_snapshot(server: Serving, change: Change) -> Envelope:
    """Let a newer version have taken the snapshot."""
    with server.state.database.writing() as session:
        row = session.query(StoredSnapshot).one()
        newer = signed(server.state.signer, Envelope.model_validate(row.envelope), change)
        row.envelope = newer.model_dump(mode="json")
    return newer


def take(server: Serving) -> None:
    body = {"split": OPEN, "title": "2026"}
    assert server.ask(ORGANISER, "POST", "/organiser/snapshots", json=body).status_code == 201


def findings(folder: Path, check: str) -> list[tuple[str, str]]:
    return [(each.kind, each.what) for each in examine(folder) if each.check == check]


def shown(server: Serving, submission: str) -> ScoredSubmission:
    reply = server.ask(OWNER, "GET", f"/submissions/{submission}")
    return ScoredSubmission.model_validate(reply.json())


@pytest.mark.parametrize("change", READABLE_RECEIPTS)
def test_the_doctor_compares_what_it_can_read_of_a_newer_receipt(
    change: Change, server: Serving, folder: Path
) -> None:
    submission = entered(server)
    plant_receipt(server, submission, change)
    assert findings(folder, "receipts") == [("ok", "1 receipt verified")]
    plant_receipt(server, submission, newer_receipt(team="Another"))
    (fault, _) = findings(folder, "receipts")
    assert (fault[0], "the receipt differs from its row" in fault[1]) == (
        "fault",
        True,
    )


@pytest.mark.parametrize("change", UNREADABLE_RECEIPTS)
def test_the_doctor_does_not_call_a_receipt_forged_that_it_cannot_read(
    change: Change, server: Serving, folder: Path
) -> None:
    plant_receipt(server, entered(server), change)
    (note, verified) = findings(folder, "receipts")
    assert (note[0], verified) == ("note", ("ok", "0 receipts verified"))
    assert note[1].startswith("1 receipt of a newer version of reverie-eval: ")


@pytest.mark.parametrize("change", READABLE_SNAPSHOTS)
def test_the_doctor_and_everybody_read_a_newer_snapshot(
    change: Change, server: Serving, folder: Path
) -> None:
    entered(server)
    take(server)
    path = f"/splits/{OPEN}/snapshots/1"
    text = server.ask(None, "GET", f"{path}.csv").text
    before = snapshot_in(server.ask(None, "GET", path).json())
    newer = plant_snapshot(server, change)
    assert findings(folder, "snapshots") == [("ok", "1 snapshot verified")]
    told = Envelope.model_validate(server.ask(None, "GET", path).json())
    assert told == newer
    assert snapshot_in(told).leaderboard == before.leaderboard
    assert server.ask(None, "GET", f"{path}.csv").text == text
    assert "Walker" in server.client.get(f"/splits/{OPEN}/snapshots/1").text


@pytest.mark.parametrize("change", UNREADABLE_SNAPSHOTS)
def test_a_snapshot_that_cannot_be_read_is_genuine_and_the_page_says_why(
    change: Change, server: Serving, folder: Path
) -> None:
    entered(server)
    take(server)
    newer = plant_snapshot(server, change)
    assert [kind for kind, _ in findings(folder, "snapshots")] == ["note", "ok"]
    path = f"/splits/{OPEN}/snapshots/1"
    assert server.ask(None, "GET", path).json() == newer.model_dump(mode="json")
    for reply in (
        server.ask(None, "GET", f"{path}.csv"),
        server.client.get(f"/splits/{OPEN}/snapshots/1"),
    ):
        assert reply.status_code == 409
        assert "snapshot was made by a newer version of reverie-eval" in reply.text


@pytest.mark.parametrize("change", [*READABLE_RECEIPTS, *UNREADABLE_RECEIPTS])
def test_a_newer_receipt_is_handed_out_as_it_was_signed(change: Change, server: Serving) -> None:
    submission = entered(server)
    newer = plant_receipt(server, submission, change)
    assert shown(server, submission).receipt == newer
    assert server.ask(OWNER, "GET", f"/submissions/{submission}/receipt").json() == (
        newer.model_dump(mode="json")
    )
    verify(newer, server.state.signer.public_pem)


def test_what_is_new_in_a_receipt_is_not_in_one_without_scores(
    folder: Path, open_server: OpenServer
) -> None:
    held = open_server(adjusted(settings_of(folder), release_scores="phase-end", phases=PHASES))
    submission = entered(held, split=PRIVATE)
    plant_receipt(held, submission, newer_receipt(medians={"spl": "0.4321"}))
    receipt = shown(held, submission).receipt
    assert "medians" not in payload_in(receipt.model_dump(mode="json"))["predicate"]
    assert receipt_in(receipt).scores == {}
    verify(receipt, held.state.signer.public_pem)


def test_scoring_again_keeps_the_bytes_of_a_newer_receipt_and_its_quota(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    submission = entered(server)
    newer = plant_receipt(server, submission, newer_receipt(hardware="a laptop"))
    replace_answers(folder, OPEN)
    later = open_server(settings_of(folder), server.tokens)
    assert rescored(later) == (1, {})
    now = shown(later, submission)
    assert [each.receipt for each in now.earlier] == [newer]
    assert receipt_in(now.receipt).quota == receipt_in(newer).quota
    assert findings(folder, "receipts") == [("ok", "2 receipts verified")]


def test_a_revoked_key_s_newer_documents_are_signed_again_as_they_are(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    submission = entered(server)
    take(server)
    receipt = plant_receipt(server, submission, newer_receipt(hardware="a laptop"))
    snapshot = plant_snapshot(server, lambda payload: payload.update(medal="gold"))
    rotate_key(settings_of(folder), "test", "the yearly change")
    after = open_server(settings_of(folder), server.tokens)
    revocation = KeyRevocation(since=NOON - timedelta(days=1), reason="stolen")
    with after.acting() as transaction:
        assert revoke_key(transaction, server.state.signer.key_id, revocation) == 2
    again = shown(after, submission).receipt
    taken = Envelope.model_validate(after.ask(None, "GET", f"/splits/{OPEN}/snapshots/1").json())
    for old, new in ((receipt, again), (snapshot, taken)):
        assert (old.payload, old.payload_type) == (new.payload, new.payload_type)
        verify(new, after.state.signer.public_pem)
    assert not [each for each in examine(folder) if each.kind == "fault"]


def test_a_backup_keeps_the_bytes(server: Serving, folder: Path, tmp_path: Path) -> None:
    submission = entered(server)
    take(server)
    receipt = plant_receipt(server, submission, newer_receipt(hardware="a laptop", n=1.0))
    snapshot = plant_snapshot(server, lambda payload: payload.update(medal="gold"))
    write_backup(folder, tmp_path / "backup.tar.gz")
    restored = tmp_path / "restored"
    restore_backup(tmp_path / "backup.tar.gz", restored)
    state = open_server(load_settings(restored))
    with state.database.reading() as session:
        row = session.get_one(Submission, submission)
        assert Envelope.model_validate(row.receipt) == receipt
        taken = session.query(StoredSnapshot).one()
        assert Envelope.model_validate(taken.envelope) == snapshot
    state.database.close()
    assert not [each for each in examine(restored) if each.kind == "fault"]
