"""Scoring again after a correction: results, ranks, receipts, what stays, and what is told."""

import base64
import json
import os
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path
from signal import SIGKILL
from typing import Any, Literal

import pytest
from sqlalchemy import select
from sqlalchemy.engine.default import DefaultDialect

from reverie_eval.errors import ReverieEvalError, SubmissionError
from reverie_eval.ground_truth import Bundle
from reverie_eval.receipts import verify
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import EarlierResult, Envelope, Phase
from reverie_eval.server.audit.log import audit_reports, entries
from reverie_eval.server.audit.rows import mismatches
from reverie_eval.server.boards.leaderboard import cluster_sums
from reverie_eval.server.corrections.corrections import (
    Outcome,
    Outdated,
    Rescored,
    changes,
    count_outdated,
    list_corrections,
    outdated,
    replace_results,
    rescore_one,
)
from reverie_eval.server.corrections.snapshots import Closing, Snapshots
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.intake.submissions import SubmissionService
from reverie_eval.server.operations import backup, scoring_again
from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.operations.checks import check_folder
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.operations.restore import restore_backup, verify_backup
from reverie_eval.server.platforms.export import export
from reverie_eval.server.platforms.site import export_site
from reverie_eval.server.scoring.boards import rules_of
from reverie_eval.server.scoring.rules import append_rules, record_rules
from reverie_eval.server.settings import SettingsError
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.dump import Row, dump
from reverie_eval.server.store.paging import Page
from reverie_eval.server.store.tables import ClusterSums, Correction, Submission
from tests.support.acting import NOON, review
from tests.support.correcting import WHY, rescored
from tests.support.flat_world import Run
from tests.support.forking import Forked, Surroundings, run_command
from tests.support.killing import Step, run_until
from tests.support.server_data import rows_of
from tests.support.serving import (
    BROKEN,
    GOOD,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    STRICT,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
    submission_for,
)
from tests.support.signing import receipt_in
from tests.support.waiting import PATIENCE
from tests.support.worlds import with_arrays

CORRECTED = "bundles/corrected.npz"


def correct(folder: Path, split: str = OPEN) -> Path:
    """Write a bundle in which some tasks have another target."""
    bundle = Bundle.load(folder / "bundles" / f"{split}.npz")
    target = bundle.arrays["task_target"].copy()
    target[: len(target) // 2] += 1
    path = folder / CORRECTED
    with_arrays(bundle, task_target=target).save(path)
    path.chmod(0o600)
    return path


def sent(server: Serving, who: str, content: bytes, split: str = OPEN) -> dict[str, Any]:
    """Submit and publish, and return the submission."""
    reply = server.upload(who, content, split)
    assert reply.status_code == 201, reply.text
    path = f"/submissions/{reply.json()['submission']['id']}"
    published: dict[str, Any] = server.ask(who, "PATCH", path, json={"published": True}).json()
    return published


def shown(server: Serving, submission: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = server.ask(ORGANISER, "GET", f"/submissions/{submission['id']}").json()
    return found


def board(server: Serving, split: str = OPEN) -> dict[str, Any]:
    found: dict[str, Any] = server.client.get(f"/api/v1/splits/{split}/leaderboard").json()
    return found


def agents(number: int, split: str = OPEN) -> Iterator[bytes]:
    """Return submissions of agents that differ."""
    for seed in range(number):
        records = json.loads(submission_for(split))
        for record in records[seed::number]:
            record["predObjId"] = -1
        yield json.dumps(records).encode()


@pytest.fixture
def corrected(server: Serving, folder: Path, open_server: OpenServer) -> Serving:
    """Return a server whose open split was corrected after two teams had submitted."""
    first, second = agents(2)
    best = sent(server, OWNER, first)
    sent(server, OTHER, second)
    with server.acting(ORGANISER) as transaction:
        review(transaction, best["id"], "verified")
    correct(folder)
    settings = adjusted(settings_of(folder), OPEN, bundle=CORRECTED)
    later = open_server(settings, server.tokens)
    later.clock.turn(hours=30)
    return later


def test_every_submission_gets_what_its_file_scores_now(corrected: Serving) -> None:
    before = {each["id"]: each for each in corrected.ask(ORGANISER, "GET", "/submissions").json()}
    assert board(corrected)["rows"] == []
    assert rescored(corrected) == (2, {})
    place = corrected.state.boards[OPEN]
    for submission in before.values():
        now, upload = (
            shown(corrected, submission),
            corrected.state.uploads.get(submission["sha256"]),
        )
        reading = place.read(upload)
        fresh = place.report(place.score(reading).with_intervals(), reading)
        assert ScoreReport.model_validate(now["report"]) == fresh
        assert now["report"]["scores"] != submission["report"]["scores"]
        (earlier,) = now["earlier"]
        assert (earlier["report"], earlier["receipt"]) == (
            submission["report"],
            submission["receipt"],
        )
        assert (earlier["reason"], earlier["replaced_at"][:10]) == (WHY, "2026-03-03")
        same = now.keys() - {"report", "receipt", "earlier"}
        assert {name: now[name] for name in same} == {name: submission[name] for name in same}


def test_both_receipts_prove_their_scores(corrected: Serving) -> None:
    rescored(corrected)
    key = corrected.state.signer.public_pem
    for submission in corrected.ask(ORGANISER, "GET", "/submissions").json():
        for result in (submission, *submission["earlier"]):
            verify(Envelope.model_validate(result["receipt"]), key)
            receipt = receipt_in(result["receipt"])
            assert receipt.scores == result["report"]["scores"]
            assert receipt.signature == result["report"]["signature"]
        old, new = (receipt_in(each["receipt"]) for each in (submission["earlier"][0], submission))
        different = {"scores": old.scores, "signature": old.signature}
        assert new.model_copy(update=different) == old


def test_the_leaderboard_ranks_them_again_and_announces_the_correction(corrected: Serving) -> None:
    assert [row["standing"] for row in board(corrected)["apart"]] == ["other-rules"] * 2
    rescored(corrected)
    found = board(corrected)
    assert [row["rank"] for row in found["rows"]] == [1, 2]
    assert found["apart"] == []
    (correction,) = found["corrections"]
    assert (correction["reason"], correction["created_at"][:10]) == (WHY, "2026-03-03")
    assert correction["signature"] == found["signature"]
    reviewed = [row["reviews"] for row in found["rows"] if row["reviews"]]
    assert [review["verdict"] for (review,) in reviewed] == ["verified"]
    page = corrected.client.get(f"/splits/{OPEN}").text
    assert WHY in page


def test_quotas_and_the_audit_log_stay_whole(corrected: Serving, folder: Path) -> None:
    quota = corrected.ask(OWNER, "GET", f"/splits/{OPEN}").json()["quota"]
    rescored(corrected)
    assert corrected.ask(OWNER, "GET", f"/splits/{OPEN}").json()["quota"] == quota
    with corrected.state.database.reading() as session:
        assert list(corrected.state.audit_log.broken_links(session)) == []
        assert list(mismatches(session)) == []
        again = [
            (entry.actor, entry.details) for entry in audit_reports(session, entries(session))
        ][-2:]
    for actor, details in again:
        assert actor == ORGANISER
        assert details["before"] != details["after"]
    settings = folder / "reverie-eval.toml"
    settings.write_text(settings.read_text().replace(f"bundles/{OPEN}.npz", CORRECTED))
    assert [each for each in examine(folder) if each.kind == "fault"] == []


def test_the_same_file_gets_the_current_result_and_the_earlier_one(corrected: Serving) -> None:
    content = next(agents(2))
    rescored(corrected)
    again = corrected.upload(OWNER, content)
    assert (again.status_code, again.json()["is_repeat"]) == (200, True)
    submission = again.json()["submission"]
    assert submission["report"]["fingerprint"] == corrected.state.boards[OPEN].truth.fingerprint
    assert len(submission["earlier"]) == 1


def test_nothing_is_left_to_score_again(corrected: Serving) -> None:
    rescored(corrected)
    assert rescored(corrected) == (0, {})
    assert len(board(corrected)["corrections"]) == 1


def rescorer(server: Serving, split: str) -> Callable[[Outdated], Outcome]:
    """Return what scores a submission to a split again."""
    return lambda old: server.state.scoring.run(rescore_one, split, "", old)


def test_a_correction_that_was_announced_keeps_its_reason(corrected: Serving) -> None:
    state = corrected.state
    place = state.boards[OPEN]
    with state.database.reading() as session:
        first, _ = outdated(session, place)
    outcomes = {first: rescorer(corrected, OPEN)(first)}
    with corrected.acting(ORGANISER) as transaction:
        replace_results(transaction, place, WHY, outcomes)
    assert rescored(corrected, reason="another reason") == (1, {})
    assert [each["reason"] for each in board(corrected)["corrections"]] == [WHY]
    submissions = corrected.ask(ORGANISER, "GET", "/submissions").json()
    assert [result["reason"] for each in submissions for result in each["earlier"]] == [WHY] * 2


def test_two_runs_at_once_replace_each_result_once(corrected: Serving) -> None:
    state = corrected.state
    place = state.boards[OPEN]
    with state.database.reading() as session:
        waiting = outdated(session, place)
    outcomes = {old: rescorer(corrected, OPEN)(old) for old in waiting}
    for _ in range(2):
        with corrected.acting(ORGANISER) as transaction:
            replace_results(transaction, place, WHY, outcomes)
    submissions = corrected.ask(ORGANISER, "GET", "/submissions").json()
    assert [len(each["earlier"]) for each in submissions] == [1, 1]


def test_corrections_that_follow_one_another(
    corrected: Serving, folder: Path, open_server: OpenServer
) -> None:
    rescored(corrected)
    restored = open_server(settings_of(folder), corrected.tokens)
    restored.clock.turn(hours=60)
    rescored(restored, reason="It was right before.")
    for submission in restored.ask(ORGANISER, "GET", "/submissions").json():
        first, second = submission["earlier"]
        assert first["report"]["scores"] == submission["report"]["scores"]
        assert second["report"]["scores"] != submission["report"]["scores"]
    reasons = [each["reason"] for each in board(restored)["corrections"]]
    assert reasons == ["It was right before.", WHY]


def test_a_file_that_does_not_fit_the_correction_keeps_its_result(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    submission = sent(server, OWNER, submission_for(OPEN))
    bundle = Bundle.load(folder / "bundles" / f"{OPEN}.npz")
    names = bundle.arrays["instr_id"].copy()
    names[0] = "1_9_9"
    with_arrays(bundle, instr_id=names).save(folder / CORRECTED)
    later = open_server(adjusted(settings_of(folder), OPEN, bundle=CORRECTED), server.tokens)
    scored, rejected = rescored(later)
    assert scored == 0
    (why,) = rejected.values()
    assert why.startswith("rejected: ")
    assert shown(later, submission) == submission
    assert [row["standing"] for row in board(later)["apart"]] == ["other-rules"]


def test_a_missing_upload_does_not_stop_the_others(corrected: Serving) -> None:
    first, _ = corrected.ask(ORGANISER, "GET", "/submissions").json()
    uploads = corrected.state.settings.folder / "uploads"
    (lost,) = uploads.rglob(f"{first['sha256']}*")
    lost.unlink()
    scored, rejected = rescored(corrected)
    assert (scored, [*rejected]) == (1, [first["id"]])
    assert "is missing" in rejected[first["id"]]


def test_changes_are_listed_with_ranks_the_largest_first(corrected: Serving) -> None:
    state, place = corrected.state, corrected.state.boards[OPEN]
    with state.database.reading() as session:
        waiting = outdated(session, place)
        outcomes: dict[str, Outcome] = {
            old.submission_id: rescorer(corrected, OPEN)(old) for old in waiting
        }
        expected = changes(session, place, outcomes)
    rescored(corrected)
    with state.database.reading() as session:
        found = changes(session, place, {})
    assert found == expected, "what a preview says comes true"
    moved = [abs(change.difference(place.primary.key)) for change in found]
    assert moved == sorted(moved, reverse=True)
    assert {change.rank_before for change in found} == {1, 2}


def test_private_results_stay_rounded(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    submission = sent(server, OWNER, submission_for(PRIVATE), PRIVATE)
    correct(folder, PRIVATE)
    later = open_server(adjusted(settings_of(folder), PRIVATE, bundle=CORRECTED), server.tokens)
    rescored(later, PRIVATE)
    now = shown(later, submission)
    place = later.state.boards[PRIVATE]
    for report in (now["report"], now["earlier"][0]["report"]):
        assert place.may_keep(ScoreReport.model_validate(report))
    assert now["report"]["intervals"] is None


def test_held_scores_hide_earlier_ones(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    submission = sent(server, OWNER, submission_for(PRIVATE), PRIVATE)
    correct(folder, PRIVATE)
    phase = Phase(name="2026", closes=server.clock.now.replace(month=6))
    held = adjusted(
        settings_of(folder),
        PRIVATE,
        bundle=CORRECTED,
        phases=(phase,),
        release_scores="phase-end",
    )
    later = open_server(held, server.tokens)
    rescored(later, PRIVATE)
    now = shown(later, submission)
    assert (now["report"]["scores"], now["earlier"]) == ({}, [])
    page = later.client.get(f"/submissions/{submission['id']}").text
    assert "Earlier results" not in page
    later.clock.turn(days=200)
    assert len(shown(later, submission)["earlier"]) == 1


# What is scored again, in which order, and what became of it.


def store(server: Serving, submission: str, **columns: object) -> None:
    """Write columns of a submission, whatever the service would say."""
    with server.state.database.writing() as session:
        row = session.get_one(Submission, submission)
        for name, value in columns.items():
            setattr(row, name, value)


def report_of(server: Serving, submission: str, **changes: object) -> dict[str, Any]:
    """Return a submission's report with other values, as it is stored."""
    with server.state.database.reading() as session:
        return {**session.get_one(Submission, submission).report, **changes}


def test_a_submission_is_scored_again_or_it_is_said_why_not(server: Serving) -> None:
    place, uploads = server.state.boards[OPEN], server.state.uploads
    score = rescorer(server, OPEN)
    sent(server, OWNER, GOOD)
    old = Outdated(
        submission_id="0" * 16,
        sha256=sha256(GOOD).hexdigest(),
        has_intervals=False,
        upload_deleted_at=None,
        was_scored=True,
    )
    plain, published = place.scored(GOOD), place.scored(GOOD, has_intervals=True)
    assert published.scores is not None
    assert score(old) == Rescored(plain.report, None)
    sums = cluster_sums(published.scores)
    assert score(old._replace(has_intervals=True)) == Rescored(published.report, sums)
    assert score(old._replace(upload_deleted_at=NOON)) == (
        "its upload was deleted on 2026-03-02 (keep_uploads_days)"
    )
    assert score(old._replace(sha256="0" * 64)) == (
        f"the upload {'0' * 64} is missing; run `reverie-eval server doctor`"
    )
    uploads.put("1" * 64, BROKEN)
    with pytest.raises(SubmissionError) as rejected:
        place.read(BROKEN)
    assert score(old._replace(sha256="1" * 64)) == f"rejected: {rejected.value.problems[0]}"


def test_what_is_outdated_is_found_the_oldest_first(several: Serving) -> None:
    server, place = several, several.state.boards[OPEN]
    early = sorted(
        server.upload(OWNER, server.distinct()).json()["submission"]["id"] for _ in "123"
    )
    sent(server, OTHER, submission_for(PRIVATE), PRIVATE)
    server.clock.turn(hours=1)
    current = server.upload(OTHER, server.distinct()).json()["submission"]["id"]
    last = sent(server, OTHER, server.distinct())["id"]
    other_truth, other_rules = {"fingerprint": "0" * 64}, {"signature": "x|version:1"}
    for each, columns in (
        (early[0], {"report": report_of(server, early[0], **other_truth)}),
        (early[1], {"report": report_of(server, early[1], **other_rules)}),
        (last, {"report": report_of(server, last, **other_truth), "upload_deleted_at": NOON}),
    ):
        store(server, each, **columns)
    store(server, current, boards={})
    assert count_outdated_on(server, "") == 3
    assert count_outdated_on(server, STRICT) == 1
    with server.state.database.reading() as session:
        found, strict = outdated(session, place), outdated(session, place.others[STRICT])
    assert [(old.submission_id, *old[2:]) for old in found] == [
        (early[0], False, None, True),
        (early[1], False, None, True),
        (last, True, NOON, True),
    ]
    assert [(old.submission_id, *old[2:]) for old in strict] == [(current, False, None, False)]
    assert [old.sha256 for old in strict] == [shown(server, {"id": current})["sha256"]]
    private = server.state.boards[PRIVATE]
    (secret,) = (row["submission_id"] for row in board(server, PRIVATE)["rows"])
    store(server, secret, report=report_of(server, secret, fingerprint="0" * 64))
    with server.state.database.reading() as session:
        (old,) = outdated(session, private)
    assert (old.submission_id, old.has_intervals) == (secret, False)


def count_outdated_on(server: Serving, name: str) -> int:
    """Count outdated results on a leaderboard of the open split."""
    own = server.state.boards[OPEN]
    with server.state.database.reading() as session:
        return count_outdated(session, own.others[name] if name else own)


def test_a_correction_and_each_new_result_are_logged(corrected: Serving) -> None:
    place = corrected.state.boards[OPEN]
    before = {
        each["id"]: each["report"]["signature"]
        for each in corrected.ask(ORGANISER, "GET", "/submissions").json()
    }
    assert rescored(corrected) == (2, {})
    with corrected.state.database.reading() as session:
        announced, *again = [
            (each.actor, each.action, each.row, each.subject, each.details)
            for each in audit_reports(session, entries(session))
        ][-3:]
        rows = session.scalars(select(Submission)).all()
        assert {row.rescored_at for row in rows} == {corrected.clock()}
        sums = {each.submission_id: each for each in session.scalars(select(ClusterSums))}
        (listed,) = list_corrections(session, Page()).rows
        uploads = {row.id: row.sha256 for row in rows}
    assert announced == (
        ORGANISER,
        "correction announced",
        "correction:1",
        OPEN,
        {"reason": WHY},
    )
    assert sorted(again, key=lambda entry: entry[3]) == [
        (
            ORGANISER,
            "scored again",
            f"submission:{name}",
            name,
            {"board": "", "before": before[name], "after": place.signature},
        )
        for name in sorted(before)
    ]
    assert listed.model_dump() == {
        "split": OPEN,
        "board": "",
        "created_at": corrected.clock(),
        "reason": WHY,
        "signature": place.signature,
    }
    for name, sha in uploads.items():
        scores = place.scored(corrected.state.uploads.get(sha)).scores
        assert scores is not None
        assert (sums[name].board, sums[name].sums) == ("", cluster_sums(scores))


def test_first_results_on_a_leaderboard_correct_nothing(several: Serving) -> None:
    server, strict = several, several.state.boards[OPEN].others[STRICT]
    submission = sent(server, OWNER, GOOD)
    others = {name: each for name, each in submission["boards"].items() if name != STRICT}
    with server.state.database.writing() as session:
        session.delete(session.get_one(ClusterSums, (submission["id"], STRICT)))
    store(server, submission["id"], boards=others)
    server.clock.turn(hours=1)
    assert rescored(server) == (1, {})
    now = shown(server, submission)
    assert now["boards"] == submission["boards"]
    with server.state.database.reading() as session:
        assert list_corrections(session, Page()).rows == []
        last = entries(session)[-1]
        assert session.get(ClusterSums, (submission["id"], STRICT)) is not None
    assert (last.action, last.at) == ("scored again", server.clock())
    assert last.details == {"board": STRICT, "before": "", "after": strict.signature}


def test_corrections_are_listed_the_latest_first(sqlite: Database) -> None:
    with sqlite.writing() as session:
        for reason in ("one", "two"):
            about = {"split": OPEN, "board": "", "signature": "x", "created_at": NOON}
            session.add(Correction(**about, reason=reason))
            session.flush()
    with sqlite.reading() as session:
        assert [each.reason for each in list_corrections(session, Page()).rows] == ["two", "one"]


OTHER_TRUTH = {"fingerprint": "0" * 64}
"""What the reports have of submissions that were not scored again."""
RESULTS: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any]]] = {
    "Ant": ({"rgspl": 0.5}, {}),
    "Bee": ({"rgspl": 0.25}, {}),
    "Cat": ({"rgspl": 0.875}, {}),
    "Dog": ({"rgspl": 1.0}, {}),
    "Elk": ({"rgspl": 1.0}, {"withdrawn_at": NOON}),
    "Fox": ({"rgspl": 1.0}, {"published_at": None}),
    "Gnu": ({"rgspl": 0.0625}, {}),
    "Hen": ({"spl": 0.5}, {}),
}
"""Scores and other columns of submissions; Dog is disqualified."""


def test_what_a_correction_changes_is_told_with_ranks_and_reasons(server: Serving) -> None:
    place, ids = server.state.boards[OPEN], {}
    for name, (scores, columns) in RESULTS.items():
        each = server.upload(OWNER, server.distinct(), name=name).json()["submission"]["id"]
        report = report_of(server, each, scores=scores, **({} if name == "Gnu" else OTHER_TRUTH))
        store(server, each, **{"report": report, "published_at": NOON, **columns})
        server.clock.turn(seconds=1)
        ids[name] = each
    with server.acting() as transaction:
        review(transaction, ids["Dog"], "disqualified")
        review(transaction, ids["Ant"], "verified")
    now = {"Ant": 0.25, "Bee": 0.75, "Dog": 0.9375, "Elk": 0.5, "Fox": 0.96875}
    template = ScoreReport.model_validate(report_of(server, ids["Gnu"]))
    outcomes: dict[str, Outcome] = {
        ids[name]: Rescored(template.model_copy(update={"scores": {"rgspl": value}}), None)
        for name, value in now.items()
    }
    outcomes[ids["Cat"]] = "its upload is missing"

    def told(first: Collection[str] = ()) -> list[tuple[Any, ...]]:
        """Return a row for each change: values and ranks before and after, and the reason."""
        with server.state.database.reading() as session:
            found = changes(session, place, outcomes, first_results=[ids[name] for name in first])
        assert {(each.board, each.team) for each in found} == {("", "Blue")}
        assert {each.method: each.submission_id for each in found} == ids
        return [
            (each.method, each.before, each.after, each.rank_before, each.rank_after, each.problem)
            for each in found
        ]

    def rgspl(value: float) -> Mapping[str, float]:
        return {"rgspl": value}

    bee = ("Bee", rgspl(0.25), rgspl(0.75), 3, 1, "")
    elk = ("Elk", rgspl(1.0), rgspl(0.5), None, None, "")
    ant = ("Ant", rgspl(0.5), rgspl(0.25), 2, 2, "")
    small = [
        ("Dog", rgspl(1.0), rgspl(0.9375), None, None, ""),
        ("Fox", rgspl(1.0), rgspl(0.96875), None, None, ""),
        ("Cat", rgspl(0.875), {}, 1, None, "its upload is missing"),
    ]
    last = [
        ("Gnu", rgspl(0.0625), rgspl(0.0625), 4, 3, ""),
        ("Hen", {"spl": 0.5}, {}, None, None, ""),
    ]
    assert told() == [bee, elk, ant, *small, *last]
    gnu: tuple[Any, ...] = ("Gnu", {}, rgspl(0.0625), None, 3, "")
    assert told(["Gnu"]) == [bee, elk, ant, *small, gnu, last[1]]

    # A result that was replaced by this correction is compared with the one before it.
    noon = NOON.replace(minute=30)
    about = {"split": OPEN, "board": "", "reason": WHY, "created_at": noon}
    old = place.signature.replace("version:", "version:0.")
    for seconds, signature, before in (
        (0, place.signature.replace("data:", "data:0"), (0.0625, 4)),
        (0, old, (0.75, 2)),
        (1, old, (0.75, 2)),
        (-1, old, (0.0625, 4)),
    ):
        replaced = EarlierResult(
            report=template.model_copy(update={"scores": {"rgspl": 0.75}}),
            receipt=shown(server, {"id": ids["Gnu"]})["receipt"],
            replaced_at=noon + timedelta(seconds=seconds),
            reason=WHY,
        )
        oldest = replaced.model_copy(update={"report": template})
        stored = [each.model_dump(mode="json") for each in (oldest, replaced)]
        store(server, ids["Gnu"], earlier=stored)
        with server.state.database.writing() as session:
            session.add(Correction(**about, signature=signature))
        value, rank = before
        (found,) = [each for each in told() if each[0] == "Gnu"]
        assert found == ("Gnu", rgspl(value), rgspl(0.0625), rank, 3, "")


# The command.


def test_the_command_previews_and_then_corrects(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_again, "FOR_ONE", 1)  # so that two are enough for two processes
    first, second = agents(2)
    best = sent(server, OWNER, first)
    sent(server, OTHER, second)
    new = correct(folder)
    options = [str(folder), OPEN, "--bundle", str(new), "--jobs", "2"]
    before = shown(server, best)
    preview = run("server", "rescore", *options, "--dry-run")
    assert preview.status == 0, preview.err
    assert shown(server, best) == before
    assert "1 -> 1" in preview.out
    done = run("server", "rescore", *options, "--jobs", "1", "--reason", WHY)
    assert (done.status, done.out) == (0, preview.out), done.err
    assert "servers that run use the new ground truth" in done.err
    assert shown(server, best)["report"]["scores"] != before["report"]["scores"]
    kept = folder / "bundles" / f"{OPEN}.{before['report']['fingerprint'][:12]}.npz"
    assert Bundle.load(kept).header.fingerprint == before["report"]["fingerprint"]
    assert (folder / "bundles" / f"{OPEN}.npz").read_bytes() == new.read_bytes()
    assert [each for each in check_folder(folder) if each.kind != "ok"] == []


def test_the_check_says_what_a_new_bundle_does(server: Serving, folder: Path) -> None:
    sent(server, OWNER, submission_for(OPEN))
    correct(folder).replace(folder / "bundles" / f"{OPEN}.npz")
    (finding,) = [each for each in check_folder(folder) if each.kind != "ok"]
    assert (finding.check, finding.kind) == ("results", "note")
    assert finding.what.startswith(f"1 submission to {OPEN} not ranked, because the ground truth")
    assert f"server rescore {folder} {OPEN}" in finding.what


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        pytest.param([OPEN], 2, "give a --reason, or --dry-run", id="no reason"),
        pytest.param([OPEN, "--reason", " "], 2, "reason: ", id="an empty reason"),
        pytest.param(
            ["tset", "--reason", WHY], 2, "no split 'tset' here; did you mean test?", id="split"
        ),
        pytest.param(
            ["tset", "--dry-run", "--bundle", "x.npz"], 2, "there is no split", id="and bundle"
        ),
        pytest.param(
            [OPEN, "--dry-run", "--bundle", "x.npz"], 1, "x.npz: No such file", id="no file"
        ),
        pytest.param([OPEN, "--reason", WHY], 0, "there are no submissions", id="nothing to do"),
    ],
)
def test_a_call_that_changes_nothing(
    folder: Path, run: Run, words: list[str], status: int, said: str
) -> None:
    before = (folder / "server.db").read_bytes()
    outcome = run("server", "rescore", str(folder), *words)
    assert (outcome.status, said in outcome.err) == (status, True)
    assert (folder / "server.db").read_bytes() == before


def test_a_wrong_bundle_is_not_installed(server: Serving, folder: Path, run: Run) -> None:
    sent(server, OWNER, submission_for(OPEN))
    place = folder / "bundles" / f"{OPEN}.npz"
    before = place.read_bytes()
    wrong = folder / "bundles" / "val_seen.npz"
    outcome = run("server", "rescore", str(folder), OPEN, "--bundle", str(wrong), "--reason", WHY)
    assert "this is the ground truth of val_seen, not of val_unseen" in outcome.err
    assert place.read_bytes() == before


def corrects(run: Run, folder: Path) -> Bundle:
    """Correct the open split by the command, as a process beside the server would."""
    done = run(
        *("server", "rescore", str(folder), OPEN, "--bundle", str(correct(folder))),
        *("--reason", WHY, "--jobs", "1"),
    )
    assert done.status == 0, done.err
    return Bundle.load(folder / "bundles" / f"{OPEN}.npz")


def test_a_server_that_runs_uses_the_new_ground_truth_at_once(
    server: Serving, folder: Path, run: Run
) -> None:
    record_rules(server.state.transactions, rules_of(server.state.boards))
    first, second, third = agents(3)
    sent(server, OWNER, first)
    sent(server, OTHER, second)
    before = board(server)
    walks = server.client.get(f"/episodes/{OPEN}?submission=random").text
    new = corrects(run, folder).header.fingerprint
    after = board(server)
    assert [len(found["rows"]) for found in (before, after)] == [2, 2]
    assert after["apart"] == []
    assert [each["reason"] for each in after["corrections"]] == [WHY]
    assert server.upload(OWNER, third).json()["submission"]["report"]["fingerprint"] == new
    assert server.client.get(f"/episodes/{OPEN}?submission=random").text != walks
    assert server.client.get("/healthz").json()["failed"] == []
    with server.state.database.reading() as session:
        assert list(server.state.audit_log.broken_links(session)) == []


@pytest.mark.parametrize("moment", ["find_earlier", "store"])
def test_an_upload_during_a_correction_is_scored_by_the_new_ground_truth(
    moment: str, server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The correction comes when the upload was read, or when it was scored."""
    first, second = agents(2)
    earlier = sent(server, OWNER, first)["id"]
    found: list[str] = []
    real = getattr(Intake, moment)

    def interrupted(*given: Any) -> Any:
        if not found:
            found.append(corrects(run, folder).header.fingerprint)
        return real(*given)

    monkeypatch.setattr(Intake, moment, interrupted)
    reply = server.upload(OTHER, second).json()
    assert reply["submission"]["report"]["fingerprint"] == found[0]
    assert reply["submission"]["earlier"] == []
    assert [row["rank"] for row in board(server)["rows"]] == [1]
    assert shown(server, {"id": earlier})["report"]["fingerprint"] == found[0]
    with server.state.database.reading() as session:
        assert outdated(session, server.state.boards[OPEN]) == []


def test_an_upload_that_comes_while_others_are_scored_again_is_not_forgotten(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second, third = agents(3)
    sent(server, OWNER, first)
    late = iter([second, third])
    real = scoring_again._score  # noqa: SLF001

    def interrupted(*given: Any) -> Any:
        found = real(*given)
        for content in late:
            assert server.upload(OTHER, content).status_code == 201
            break
        return found

    monkeypatch.setattr(scoring_again, "_score", interrupted)
    new = corrects(run, folder).header.fingerprint
    submissions = server.ask(ORGANISER, "GET", "/submissions").json()
    assert [each["report"]["fingerprint"] for each in submissions] == [new] * 3


def test_corrections_of_two_splits_at_once_are_both_in_force(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One begins and ends while submissions are scored again for the other."""
    record_rules(server.state.transactions, rules_of(server.state.boards))
    sent(server, OWNER, submission_for(OPEN))
    other = correct(folder, PRIVATE).rename(folder / "other.npz")
    words = ("server", "rescore", str(folder), PRIVATE, "--bundle", str(other), "--reason", WHY)
    real, begun = scoring_again._score, iter([words])  # noqa: SLF001

    def interrupted(*given: Any) -> Any:
        for other_words in begun:
            assert run(*other_words).status == 0
        return real(*given)

    monkeypatch.setattr(scoring_again, "_score", interrupted)
    new = {OPEN: corrects(run, folder), PRIVATE: Bundle.load(other)}
    for split, bundle in new.items():
        reply = server.upload(OTHER, submission_for(split), split)
        assert reply.status_code == 201, reply.text
        fingerprint = reply.json()["submission"]["report"]["fingerprint"]
        assert fingerprint == bundle.header.fingerprint
    assert server.client.get("/healthz").json()["failed"] == []


def test_of_two_corrections_of_a_split_at_once_the_first_to_end_counts(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    record_rules(server.state.transactions, rules_of(server.state.boards))
    submission = sent(server, OWNER, submission_for(OPEN))
    place = folder / "bundles" / f"{OPEN}.npz"
    original, first = place.read_bytes(), correct(folder).rename(folder / "first.npz")
    second = with_arrays(
        Bundle.load(first), task_target=Bundle.load(place).arrays["task_target"] + 1
    )
    second.save(folder / CORRECTED)
    words = ["server", "rescore", str(folder), OPEN, "--reason", WHY, "--bundle"]
    real, begun = scoring_again._score, iter([first])  # noqa: SLF001

    def interrupted(*given: Any) -> Any:
        for bundle in begun:
            assert run(*words, str(bundle)).status == 0
        return real(*given)

    monkeypatch.setattr(scoring_again, "_score", interrupted)
    refused = run(*words, str(folder / CORRECTED))
    assert (refused.status, "was made meanwhile; run the command again" in refused.err) == (2, True)
    assert place.read_bytes() == first.read_bytes()
    (aside,) = place.parent.glob(f"{OPEN}.*.npz")
    assert aside.read_bytes() == original
    assert len(shown(server, submission)["earlier"]) == 1
    assert run(*words, str(folder / CORRECTED)).status == 0
    assert len(shown(server, submission)["earlier"]) == 2


def test_a_correction_that_fails_changes_nothing(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent(server, OWNER, submission_for(OPEN))
    place = folder / "bundles" / f"{OPEN}.npz"
    before, kept = board(server), place.read_bytes()

    def fail(*_: object) -> None:
        raise ReverieEvalError("there is no power")

    monkeypatch.setattr(scoring_again, "append_rules", fail)
    words = ["server", "rescore", str(folder), OPEN, "--bundle", str(correct(folder))]
    done = run(*words, "--reason", WHY)
    assert (done.status, "there is no power" in done.err) == (2, True)
    assert place.read_bytes() == kept
    assert board(server) == before
    assert server.upload(OTHER).status_code == 201


def starts(server: Serving, folder: Path, open_server: OpenServer) -> None:
    later = open_server(settings_of(folder), server.tokens)
    record_rules(later.state.transactions, rules_of(later.state.boards))


def is_checked(_server: Serving, folder: Path, _open: OpenServer) -> None:
    assert [each for each in check_folder(folder) if each.kind != "ok"] == []


def is_asked(server: Serving, _folder: Path, _open: OpenServer) -> None:
    assert len(board(server)["rows"]) == 1


def killed_at_its_commit(
    folder: Path, new: Path, when: Literal["before", "after"]
) -> Sequence[str | Path]:
    """Return the words of a command that corrects, and that was killed."""
    words = ("server", "rescore", folder, OPEN, "--bundle", new, "--reason", WHY, "--jobs", "1")
    here = Surroundings(folder.parent, dict(os.environ), folder / "output", folder / "errors")
    commit = Step(DefaultDialect, "do_commit", when)
    assert Forked(run_until, here, commit, *words).wait(PATIENCE) == -SIGKILL
    return words


@pytest.mark.parametrize("next_one", [starts, is_checked, is_asked])
@pytest.mark.parametrize("when", ["before", "after"])
def test_a_correction_that_is_killed_at_its_commit_has_changed_nothing_or_all(
    when: Literal["before", "after"],
    next_one: Callable[[Serving, Path, OpenServer], None],
    server: Serving,
    folder: Path,
    open_server: OpenServer,
) -> None:
    record_rules(server.state.transactions, rules_of(server.state.boards))
    submission = sent(server, OWNER, submission_for(OPEN))
    place, new = folder / "bundles" / f"{OPEN}.npz", correct(folder)
    place.chmod(0o640)
    expected = (new if when == "after" else place).read_bytes()
    words = killed_at_its_commit(folder, new, when)
    next_one(server, folder, open_server)
    assert place.read_bytes() == expected
    assert place.stat().st_mode & 0o777 == 0o640
    report = shown(server, submission)["report"]
    assert report["fingerprint"] == Bundle.load(place).header.fingerprint
    is_asked(server, folder, open_server)
    is_checked(server, folder, open_server)
    corrects_again = run_command(*words, folder=folder.parent, environment=dict(os.environ))
    assert corrects_again.status == 0, corrects_again.err
    assert place.read_bytes() == new.read_bytes()
    assert len(shown(server, submission)["earlier"]) == 1
    assert list(folder.glob("bundles/*.next.npz")) == []


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_backup_has_all_of_a_correction_that_was_killed_at_its_commit_or_nothing(
    when: Literal["before", "after"], server: Serving, folder: Path, tmp_path: Path
) -> None:
    record_rules(server.state.transactions, rules_of(server.state.boards))
    sent(server, OWNER, submission_for(OPEN))
    place, new = folder / "bundles" / f"{OPEN}.npz", correct(folder)
    expected = (new if when == "after" else place).read_bytes()
    killed_at_its_commit(folder, new, when)
    write_backup(folder, tmp_path / "b.tar.gz", verify_backup)
    restore_backup(tmp_path / "b.tar.gz", tmp_path / "there")
    assert [each for each in check_folder(tmp_path / "there") if each.kind != "ok"] == []
    assert (tmp_path / "there" / "bundles" / f"{OPEN}.npz").read_bytes() == expected


@pytest.fixture
def correct_while_reading(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Correct the ground truth when the rows are read next, after the first row."""
    record_rules(server.state.transactions, rules_of(server.state.boards))
    sent(server, OWNER, submission_for(OPEN))
    new = [correct(folder)]

    def correcting(database: Database) -> Iterator[Row]:
        rows = dump(database)
        yield next(rows)
        if new:
            words = ("server", "rescore", folder, OPEN, "--bundle", new.pop(), "--reason", WHY)
            assert run(*map(str, words)).status == 0
        yield from rows

    monkeypatch.setattr(backup, "dump", correcting)


@pytest.mark.usefixtures("correct_while_reading")
def test_a_backup_has_the_ground_truth_of_its_rows_if_a_correction_is_made_meanwhile(
    folder: Path, tmp_path: Path
) -> None:
    write_backup(folder, tmp_path / "b.tar.gz")
    restore_backup(tmp_path / "b.tar.gz", tmp_path / "there")
    assert [each for each in check_folder(tmp_path / "there") if each.kind != "ok"] == []
    assert rows_of(tmp_path / "there") == rows_of(folder)


@pytest.mark.usefixtures("correct_while_reading")
def test_a_copy_of_the_pages_has_the_ground_truth_of_its_rows_if_a_correction_is_made_meanwhile(
    server: Serving, folder: Path, tmp_path: Path
) -> None:
    export_site(folder, tmp_path / "site")
    copied = json.loads((tmp_path / f"site/api/v1/splits/{OPEN}/leaderboard.json").read_bytes())
    assert len(copied["rows"]) == 1
    assert (copied["fingerprint"], copied["rows"]) == (
        board(server)["fingerprint"],
        board(server)["rows"],
    )


@pytest.mark.usefixtures("correct_while_reading")
def test_tables_have_the_ground_truth_of_their_rows_if_a_correction_is_made_meanwhile(
    server: Serving, folder: Path, tmp_path: Path
) -> None:
    before = board(server)["fingerprint"]
    leaderboards, *_ = export(folder, tmp_path / "tables")
    (written,) = (row for row in leaderboards.rows if (row["split"], row["board"]) == (OPEN, ""))
    assert written["fingerprint"] == board(server)["fingerprint"] != before
    assert written["rows"] == board(server)["rows"]


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_copy_of_the_pages_changes_nothing_after_a_correction_was_killed(
    when: Literal["before", "after"], server: Serving, folder: Path, tmp_path: Path
) -> None:
    record_rules(server.state.transactions, rules_of(server.state.boards))
    sent(server, OWNER, submission_for(OPEN))
    killed_at_its_commit(folder, correct(folder), when)
    bundles = {path: path.read_bytes() for path in folder.glob("bundles/*")}
    export_site(folder, tmp_path / "site")
    assert {path: path.read_bytes() for path in folder.glob("bundles/*")} == bundles
    copied = json.loads((tmp_path / f"site/api/v1/splits/{OPEN}/leaderboard.json").read_bytes())
    assert copied["rows"] == board(server)["rows"] != []


def test_a_server_without_the_new_ground_truth_asks_to_wait(server: Serving) -> None:
    """It is on another machine, whose files nobody has replaced yet."""
    rules = {**rules_of(server.state.boards), OPEN: "split:val_unseen|of another bundle"}
    with server.acting() as transaction:
        append_rules(transaction, rules)
    reply = server.upload(OWNER)
    assert (reply.status_code, reply.json()["code"]) == (503, "busy")
    assert reply.json()["detail"].startswith(f"the ground truth of {OPEN} was just corrected;")
    assert server.upload(OWNER, submission_for(PRIVATE), PRIVATE).status_code == 201
    assert server.client.get("/healthz").json()["failed"] == ["same rules as other servers"]


def test_a_submission_that_is_scored_again_while_it_is_published_gets_no_older_intervals(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    submission = server.upload(OWNER).json()["submission"]["id"]
    real = SubmissionService._intervals  # noqa: SLF001

    def interrupted(*given: Any) -> Any:
        found = real(*given)
        corrects(run, folder)
        return found

    monkeypatch.setattr(SubmissionService, "_intervals", interrupted)
    reply = server.ask(OWNER, "PATCH", f"/submissions/{submission}", json={"published": True})
    assert (reply.status_code, reply.json()["code"]) == (409, "conflict")
    monkeypatch.setattr(SubmissionService, "_intervals", real)
    reply = server.ask(OWNER, "PATCH", f"/submissions/{submission}", json={"published": True})
    assert reply.json()["report"]["intervals"]


def test_a_submission_that_is_published_while_others_are_scored_again_gets_intervals(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = f"/submissions/{server.upload(OWNER).json()['submission']['id']}"
    real = scoring_again._score  # noqa: SLF001

    def interrupted(*given: Any) -> Any:
        found = real(*given)
        assert server.ask(OWNER, "PATCH", path, json={"published": True}).status_code == 200
        return found

    monkeypatch.setattr(scoring_again, "_score", interrupted)
    new = corrects(run, folder).header.fingerprint
    report = server.ask(OWNER, "GET", path).json()["report"]
    assert (report["fingerprint"], bool(report["intervals"])) == (new, True)


def test_the_new_ground_truth_comes_last_and_the_earlier_one_stays_private(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server that starts, or a correction that is killed, meanwhile finds the earlier one."""
    sent(server, OWNER, submission_for(OPEN))
    place = folder / "bundles" / f"{OPEN}.npz"
    before = place.read_bytes()
    place.chmod(0o600)
    found: list[bytes] = []
    copied: list[int] = []
    real_replace, real_copy = replace_results, shutil.copyfileobj

    def watched(*given: Any) -> None:
        real_replace(*given)
        found.append(place.read_bytes())

    def watch_copy(source: Any, target: Any) -> None:
        real_copy(source, target)
        copied.append(os.fstat(target.fileno()).st_mode & 0o077)

    monkeypatch.setattr(scoring_again, "replace_results", watched)
    monkeypatch.setattr(shutil, "copyfileobj", watch_copy)
    corrects(run, folder)
    assert found == [before]
    assert copied == [0, 0]
    (kept,) = folder.glob(f"bundles/{OPEN}.*.npz")
    assert (kept.read_bytes(), kept.stat().st_mode & 0o077) == (before, 0)


def test_a_phase_that_ends_during_a_correction_has_a_snapshot_of_the_earlier_results(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent(server, OWNER, submission_for(OPEN))
    earlier = server.state.boards[OPEN].signature
    end = datetime.now(UTC).replace(microsecond=0)
    ended: list[Closing] = []
    real_score, real_due = scoring_again._score, Snapshots.due  # noqa: SLF001

    def score(*given: Any) -> Any:
        found = real_score(*given)
        ended.append(Closing(OPEN, "spring", end))
        return found

    monkeypatch.setattr(scoring_again, "_score", score)
    monkeypatch.setattr(Snapshots, "due", lambda *given: ended or real_due(*given))
    corrects(run, folder)
    snapshot = server.client.get(f"/api/v1/splits/{OPEN}/snapshots/1").json()
    shown = json.loads(base64.b64decode(snapshot["payload"]))["leaderboard"]
    assert (shown["signature"], len(shown["rows"])) == (earlier, 1)


def test_a_server_with_ground_truth_that_was_corrected_does_not_start(
    server: Serving, folder: Path, run: Run
) -> None:
    """It is on another machine, and would score uploads by the earlier answers."""
    transactions, earlier = server.state.transactions, rules_of(server.state.boards)
    record_rules(transactions, earlier)
    sent(server, OWNER, submission_for(OPEN))
    before = folder / "before.npz"
    shutil.copy2(folder / "bundles" / f"{OPEN}.npz", before)
    corrects(run, folder)
    with pytest.raises(SettingsError, match=r"splits\.val_unseen\.bundle: a correction has"):
        record_rules(transactions, earlier)
    back = ("server", "rescore", str(folder), OPEN, "--bundle", str(before), "--reason", WHY)
    assert run(*back).status == 0
    record_rules(transactions, earlier)
    assert server.upload(OTHER).status_code == 201


def test_episodes_that_are_scored_during_a_correction_are_not_kept_under_the_earlier_one(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    submission = sent(server, OWNER, submission_for(OPEN))
    path, real = f"/submissions/{submission['id']}/episodes", type(server.state.scoring).run

    def interrupted(*given: Any) -> Any:
        monkeypatch.setattr(type(server.state.scoring), "run", real)
        corrects(run, folder)
        with server.state.database.reading() as session:
            server.state.rules.follow(session)
        return real(*given)

    monkeypatch.setattr(type(server.state.scoring), "run", interrupted)
    reply = server.ask(OWNER, "GET", path)
    assert (reply.status_code, reply.json()["code"]) == (503, "busy")
    assert server.ask(OWNER, "GET", path).status_code == 200
