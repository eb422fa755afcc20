"""Scoring again after a correction: results, ranks, receipts, what stays, and what is told."""

import json
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from reverie_eval.ground_truth import Bundle
from reverie_eval.receipts import verify
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import Phase, Receipt
from reverie_eval.server.operations import rescoring
from reverie_eval.server.operations.checks import check_folder
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.service.audit import audit_reports, entries, mismatches
from reverie_eval.server.service.rescoring import Outcome, Scorer, changes, outdated
from tests.support.acting import review
from tests.support.flat import Run
from tests.support.serving import (
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
    submission_for,
    with_arrays,
)

WHY = "The target of a task was corrected."
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


def rescored(server: Serving, split: str = OPEN, reason: str = WHY) -> dict[str, Any]:
    said = {"split": split, "reason": reason}
    reply = server.ask(ORGANISER, "POST", "/organiser/corrections", json=said)
    assert reply.status_code == 200, reply.text
    report: dict[str, Any] = reply.json()
    return report


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
    report = rescored(corrected)
    assert (report["scored"], report["rejected"], report["left"]) == (2, {}, 0)
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
            receipt = Receipt.model_validate(result["receipt"])
            verify(receipt, key)
            assert receipt.scores == result["report"]["scores"]
            assert receipt.signature == result["report"]["signature"]
        old = submission["earlier"][0]["receipt"]
        same = old.keys() - {"scores", "signature", "proof"}
        assert {name: submission["receipt"][name] for name in same} == {
            name: old[name] for name in same
        }


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
    page = corrected.client.get(f"/boards/{OPEN}").text
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
    said = {"split": OPEN, "reason": WHY}
    reply = corrected.ask(ORGANISER, "POST", "/organiser/corrections", json=said)
    assert (reply.status_code, reply.json()["code"]) == (409, "conflict")
    assert len(board(corrected)["corrections"]) == 1


def test_a_run_goes_on_where_another_was_interrupted(corrected: Serving) -> None:
    state = corrected.state
    place = state.boards[OPEN]
    with state.database.reading() as session:
        jobs = outdated(session, place)
    outcomes = map(Scorer(place, state.uploads), jobs)
    running = state.rescoring.replace_results(ORGANISER, place, WHY, jobs, outcomes)
    assert len(list(islice(running, 1))) == 1
    report = rescored(corrected, reason="another reason")
    assert (report["scored"], report["left"]) == (1, 0)
    assert [each["reason"] for each in board(corrected)["corrections"]] == [WHY]
    submissions = corrected.ask(ORGANISER, "GET", "/submissions").json()
    assert [result["reason"] for each in submissions for result in each["earlier"]] == [WHY] * 2


def test_two_runs_at_once_replace_each_result_once(corrected: Serving) -> None:
    state = corrected.state
    place = state.boards[OPEN]
    with state.database.reading() as session:
        jobs = outdated(session, place)
    outcomes = list(map(Scorer(place, state.uploads), jobs))
    for _ in range(2):
        list(state.rescoring.replace_results(ORGANISER, place, WHY, jobs, outcomes))
    submissions = corrected.ask(ORGANISER, "GET", "/submissions").json()
    assert [len(each["earlier"]) for each in submissions] == [1, 1]


def test_a_few_at_a_time(corrected: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reverie_eval.server.service.rescoring.AT_ONCE", 1)
    reports = [rescored(corrected) for _ in range(2)]
    assert [(report["scored"], report["left"]) for report in reports] == [(1, 1), (1, 0)]


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
    report = rescored(later)
    assert (report["scored"], report["left"]) == (0, 0)
    (why,) = report["rejected"].values()
    assert why.startswith("rejected: ")
    assert shown(later, submission) == submission
    assert [row["standing"] for row in board(later)["apart"]] == ["other-rules"]


def test_a_missing_upload_does_not_stop_the_others(corrected: Serving) -> None:
    first, _ = corrected.ask(ORGANISER, "GET", "/submissions").json()
    uploads = corrected.state.settings.folder / "uploads"
    (lost,) = uploads.rglob(f"{first['sha256']}*")
    lost.unlink()
    report = rescored(corrected)
    assert (report["scored"], list(report["rejected"])) == (1, [first["id"]])
    assert "is missing" in report["rejected"][first["id"]]


def test_changes_are_listed_with_ranks_the_largest_first(corrected: Serving) -> None:
    state, place = corrected.state, corrected.state.boards[OPEN]
    with state.database.reading() as session:
        jobs = outdated(session, place)
        outcomes: dict[str, Outcome] = {
            job.submission_id: Scorer(place, state.uploads)(job) for job in jobs
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


# The command.


def test_the_command_previews_and_then_corrects(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rescoring, "FOR_ONE", 1)  # so that two are enough for two processes
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
    done = run("server", "rescore", *options, "--reason", WHY)
    assert (done.status, done.out) == (0, preview.out), done.err
    assert "restart the server" in done.err
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
        pytest.param(["tset", "--reason", WHY], 2, "there is no split 'tset'", id="split"),
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
