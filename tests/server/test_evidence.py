"""Evidence about how submissions came about: for the organiser alone, and as it is."""

import hashlib
import hmac
import json
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from fixtures.answer_histories import random_halves
from reverie_eval import GroundTruth, evaluate
from reverie_eval.arrays import IntArray
from reverie_eval.ground_truth import Bundle
from reverie_eval.scoring import clusters_of
from reverie_eval.server.audit.log import entries
from reverie_eval.server.audit.receipts import Signer
from reverie_eval.server.integrity.evidence import EvidenceService
from reverie_eval.server.integrity.traces import Trace
from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.operations.restore import restore_backup
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.tables import Trace as Row
from tests.conftest import SAMPLES
from tests.support.acting import NOON
from tests.support.flat_world import Run
from tests.support.serving import (
    GOOD,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    settings_of,
    submission_for,
    with_arrays,
)
from tests.support.visiting import said, signed_in

MEDIOCRE = (SAMPLES / "mediocre.json").read_bytes()
DRAWN = (SAMPLES / "drawn.json").read_bytes()


def sent(server: Serving, who: str, content: bytes = GOOD, split: str = OPEN) -> str:
    server.clock.turn(seconds=1)
    return str(server.upload(who, content, split).json()["submission"]["id"])


def shown(server: Serving, split: str = OPEN, **query: str) -> dict[str, Any]:
    reply = server.ask(ORGANISER, "GET", f"/organiser/splits/{split}/evidence", params=query)
    assert reply.status_code == 200, reply.text
    report: dict[str, Any] = reply.json()
    return report


def answering(answers: dict[int, int]) -> bytes:
    """Return the good sample with other answers in some records."""
    records = json.loads(GOOD)
    for row, answer in answers.items():
        records[row]["predObjId"] = answer
    return json.dumps(records).encode()


def test_the_same_file_of_two_teams_is_listed(server: Serving) -> None:
    first, second = sent(server, OWNER), sent(server, OTHER)
    sent(server, OTHER, MEDIOCRE)
    (found,) = shown(server)["same_files"]
    assert found["sha256"] == hashlib.sha256(GOOD).hexdigest()
    assert [each["id"] for each in found["submissions"]] == [first, second]


def test_the_most_similar_files_are_compared_in_full(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent(server, OWNER, MEDIOCRE)
    first = sent(server, OWNER)
    second = sent(server, OTHER, answering(dict.fromkeys(range(21), 9999)))
    report = shown(server)
    (pair,) = report["similar"]
    assert (pair["first"]["id"], pair["second"]["id"]) == (first, second)
    assert (pair["equal_stops"], pair["equal_paths"]) == (1, 1)
    assert pair["equal"] == pair["equal_answers"] == pytest.approx(1 - 21 / 84)
    assert report["usual_similarity"] == 0.75
    assert report["same_files"] == []
    monkeypatch.setattr("reverie_eval.server.integrity.evidence.PAIRS", 0)
    assert shown(server)["similar"] == []


def test_a_team_s_files_are_compared_with_its_earlier_ones(server: Serving) -> None:
    first = sent(server, OWNER)
    sent(server, OWNER, MEDIOCRE)
    sent(server, OTHER, GOOD + b" ")
    third = sent(server, OWNER, answering({3: 9_999, 5: 9_999}))
    *_, last = history = shown(server, team="Blue")["history"]
    assert [each["id"] for each in (history[0], last)] == [first, third]
    assert (history[0]["nearest"], history[0]["changed"]) == (None, None)
    assert (last["nearest"], last["changed"]) == (first, 2)
    assert [each["received_at"] for each in history] == [
        f"2026-03-02T12:00:0{second}Z" for second in (1, 2, 4)
    ]
    blue, red = shown(server)["teams"]
    assert blue["median_changed"] == (history[1]["changed"] + 2) / 2
    assert red["median_changed"] is None


def test_probing_shows_in_the_files_of_a_team(server: Serving) -> None:
    records, truth = json.loads(GOOD), server.state.boards[OPEN].truth
    answers = random_halves(truth.episodes.item, 24, np.random.default_rng(0))
    sent(server, OWNER)
    for file in answers.tolist():
        for record, answer in zip(records, file, strict=True):
            record["predObjId"] = answer
        sent(server, OTHER, json.dumps(records).encode())
    team, other = shown(server)["teams"]  # the least probable first
    assert (other["team"], other["spread"]) == ("Blue", None)
    assert (team["team"], team["submissions"]) == ("Red", 24)
    assert team["spread"]["files"] > 15
    assert team["spread"]["value"] < 1
    assert team["spread"]["p_value"] < 0.01


@pytest.mark.parametrize("sample", ["good", "mediocre", "drawn"])
def test_a_fingerprint_scores_as_its_file(sample: str, server: Serving, demo: GroundTruth) -> None:
    content = (SAMPLES / f"{sample}.json").read_bytes()
    scores = evaluate(content, split=OPEN, ground_truth=demo)
    board = server.state.boards[OPEN]
    trace = Trace.from_bytes(Trace.of(board, content).to_bytes())
    for metric in ("success", "rgs"):
        values = trace.values(board, metric)
        if sample == "drawn" and metric == "rgs":
            assert values is None
        else:
            assert values is not None
            assert values.tolist() == scores.episodes[metric].tolist()
    walks = trace.walks
    assert walks.jumps == scores.episodes["jumps"].sum()
    assert walks.episodes_with_jumps == (scores.episodes["jumps"] > 0).sum()
    assert walks.longest_walk == scores.episodes["path_length"].max()


def test_jumps_are_measured(server: Serving) -> None:
    truth = server.state.boards[OPEN].truth
    records = json.loads(GOOD)
    start = int(truth.episodes.start[0])
    own = np.flatnonzero(truth.graph.viewpoint_scan == truth.graph.viewpoint_scan[start])
    distances = truth.graph.distance_between(np.full(len(own), start), own)
    far = int(own[np.argmax(np.where(np.isfinite(distances), distances, 0))])
    by_id = {record["instr_id"]: record for record in records}
    begin = truth.graph.viewpoint_ids[start]
    by_id[truth.episodes.instr_ids[0]]["trajectory"] = [
        [begin, 0, 0],
        [truth.graph.viewpoint_ids[far], 0, 0],
        [begin, 0, 0],
    ]
    sent(server, OWNER, json.dumps(records).encode())
    ((each,),) = [shown(server, team="Blue")["history"]]
    distance = float(truth.graph.distance_between(np.array([start]), np.array([far]))[0])
    assert (each["walks"]["jumps"], each["walks"]["episodes_with_jumps"]) == (2, 1)
    assert each["walks"]["longest_jump"] == pytest.approx(distance)
    assert shown(server)["teams"][0]["jumps"] == 2


def test_stops_at_the_path_s_end_are_compared_with_chance(server: Serving) -> None:
    sent(server, OWNER, submission_for(PRIVATE, "shortest"), PRIVATE)
    walks = shown(server, PRIVATE, team="Blue")["history"][0]["walks"]
    truth = server.state.boards[PRIVATE].truth
    solution, scan = truth.require_solution(), truth.graph.viewpoint_scan
    chances = []
    for episode, start in enumerate(truth.episodes.start):
        own = np.flatnonzero(scan == scan[start])
        target = np.full(len(own), solution.target_object[episode])
        chances.append(1 / solution.is_visible(target, own).sum())
    assert walks["exact_stops"] == 1
    assert walks["exact_by_chance"] == pytest.approx(np.mean(chances), abs=5e-5)


def test_only_successful_episodes_say_how_exact_stops_are(server: Serving) -> None:
    """Five of the random agent's episodes are, and none of an agent's that stays.

    Three of the five stop at the path's end; for a success there are 2, 6, 2, 3 and 1 viewpoints.
    """
    for agent in ("random", "stop"):
        sent(server, OWNER, submission_for(PRIVATE, agent), PRIVATE)
    random, stop = (each["walks"] for each in shown(server, PRIVATE, team="Blue")["history"])
    assert (stop["exact_stops"], stop["exact_by_chance"]) == (None, None)
    by_chance = (1 / 2 + 1 / 6 + 1 / 2 + 1 / 3 + 1) / 5
    assert random["exact_stops"] == pytest.approx(3 / 5, abs=5e-5)
    assert random["exact_by_chance"] == pytest.approx(by_chance, abs=5e-5)


def first_bytes(signer: Signer, truth: GroundTruth) -> IntArray:
    """Return the byte of each episode that says in which half its target is."""
    key, names = signer.secret_for("secret half"), truth.episodes.instr_ids
    first: dict[int, str] = {}
    targets = [
        first.setdefault(cluster, name)
        for cluster, name in zip(clusters_of(truth, "target").tolist(), names, strict=True)
    ]
    return np.array([hmac.digest(key, name.encode(), "sha256")[0] for name in targets])


def signer_of(seed: int) -> Signer:
    return Signer(Ed25519PrivateKey.from_private_bytes(seed.to_bytes(32, "big")), "tests")


def test_the_secret_half_follows_from_the_server_s_key(server: Serving) -> None:
    sent(server, OWNER)
    state, truth = server.state, server.state.boards[OPEN].truth
    at_the_border = next(
        signer
        for signer in map(signer_of, count())
        if {127, 128} <= set(first_bytes(signer, truth).tolist())
    )
    rgs = evaluate(GOOD, split=OPEN, ground_truth=truth).episodes["rgs"]
    for signer in (state.signer, at_the_border):
        service = EvidenceService(state.boards, state.database, state.scoring, signer)
        (team,) = service.report_on_all(OPEN).teams
        is_open = first_bytes(signer, truth) < 128
        expected = rgs[is_open].mean() - rgs[~is_open].mean()
        assert team.gap is not None
        assert team.gap.metric == "rgs"
        assert team.gap.value == pytest.approx(expected, abs=5e-5)
        assert team.gap_growth is None


def test_there_is_no_gap_if_all_targets_are_in_the_same_half(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    path = folder / "bundles" / f"{OPEN}.npz"
    bundle = Bundle.load(path)
    task_target = np.full_like(bundle.arrays["task_target"], bundle.arrays["task_target"][0])
    with_arrays(bundle, task_target=task_target).save(path)
    later = open_server(settings_of(folder), server.tokens)
    sent(later, OWNER)
    state, truth = later.state, later.state.boards[OPEN].truth
    for is_open in (True, False):
        signer = next(
            signer
            for signer in map(signer_of, count())
            if set((first_bytes(signer, truth) < 128).tolist()) == {is_open}
        )
        service = EvidenceService(state.boards, state.database, state.scoring, signer)
        assert service.report_on_all(OPEN).teams[0].gap is None


def test_the_gap_of_boxes_is_in_success(server: Serving) -> None:
    sent(server, OWNER, DRAWN)
    (team,) = shown(server)["teams"]
    assert team["gap"]["metric"] == "success"


def test_the_growth_of_the_gap_is_that_of_the_latest_file(server: Serving) -> None:
    sent(server, OWNER, MEDIOCRE)
    sent(server, OWNER)
    report = shown(server, team="Blue")
    (team,), (before, after) = report["teams"], report["history"]
    growth = after["gap"]["value"] - before["gap"]["value"]
    assert team["median_changed"] == after["changed"]
    assert team["gap"] == after["gap"]
    assert team["gap_growth"]["value"] == pytest.approx(growth, abs=2e-4)


def test_uploads_are_read_some_at_a_time_and_only_once(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(3):
        sent(server, OWNER, server.distinct())
    monkeypatch.setattr("reverie_eval.server.integrity.evidence.AT_ONCE", 2)
    first, second = shown(server), shown(server)
    assert (first["left"], first["teams"][0]["submissions"]) == (1, 2)
    assert (second["left"], second["teams"][0]["submissions"]) == (0, 3)
    monkeypatch.setattr(Trace, "of", lambda *_: pytest.fail("read again"))
    assert shown(server) == second


def test_the_command_reads_all_uploads_some_at_a_time(
    server: Serving, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(5):
        sent(server, OWNER, server.distinct())
    monkeypatch.setattr("reverie_eval.server.integrity.evidence.AT_ONCE", 2)
    report = json.loads(run("server", "evidence", str(folder), OPEN, "--format", "json").out)
    assert (report["left"], report["teams"][0]["submissions"]) == (0, 5)


def test_an_upload_that_cannot_be_read_is_left_out_with_the_reason(
    server: Serving, folder: Path, run: Run
) -> None:
    lost, sound = sent(server, OWNER), sent(server, OWNER, MEDIOCRE)
    sha256 = hashlib.sha256(GOOD).hexdigest()
    (folder / "uploads" / sha256[:2] / f"{sha256}.json.gz").unlink()
    report = shown(server, team="Blue")
    assert list(report["unreadable"]) == [lost]
    assert "server doctor" in report["unreadable"][lost]
    assert [each["id"] for each in report["history"]] == [sound]
    assert report["left"] == 0
    assert f"{lost} is left out" in run("server", "evidence", str(folder), OPEN).err


def test_fingerprints_of_another_bundle_are_made_again(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    sent(server, OWNER)
    shown(server)
    path = folder / "bundles" / f"{OPEN}.npz"
    bundle = Bundle.load(path)
    with_arrays(bundle, task_start=bundle.arrays["task_start"][::-1].copy()).save(path)
    later = open_server(settings_of(folder), server.tokens)
    (reason,) = shown(later)["unreadable"].values()
    assert reason.startswith("rejected: ")


def test_a_backup_has_no_fingerprints_and_needs_none(
    server: Serving, folder: Path, tmp_path: Path
) -> None:
    sent(server, OWNER)
    before = shown(server)
    write_backup(folder, tmp_path / "backup.tar.gz")
    restore_backup(tmp_path / "backup.tar.gz", tmp_path / "restored")
    database = Database(f"sqlite:///{tmp_path / 'restored' / 'server.db'}")
    with database.reading() as session:
        assert session.query(Row).count() == 0
    state = server.state
    again = EvidenceService(state.boards, database, state.scoring, state.signer).report_on_all(OPEN)
    assert again.model_dump(mode="json") == before
    database.close()


def test_all_doors_show_the_same(server: Serving, folder: Path, run: Run) -> None:
    for who, content in ((OWNER, GOOD), (OWNER, MEDIOCRE), (OTHER, GOOD)):
        sent(server, who, content)
    report = shown(server, team="Blue")
    words = ("server", "evidence", str(folder), OPEN, "--team", "Blue")
    assert json.loads(run(*words, "--format", "json").out) == report
    page = said(signed_in(server, ORGANISER).get(f"/desk/evidence?split={OPEN}&team=Blue"))
    table = run(*words).out
    rows = run(*words, "--format", "csv").out.splitlines()[1:]
    assert len(rows) == 2
    for row in rows:
        for cell in row.split(","):
            assert cell in page
            assert cell in table
    for each in report["same_files"][0]["submissions"]:
        assert each["id"] in page
        assert each["id"] in table


def test_what_there_is_not_is_not_found(server: Serving, folder: Path, run: Run) -> None:
    sent(server, OWNER)
    path = "/organiser/splits/{}/evidence"
    assert server.ask(ORGANISER, "GET", path.format("none")).status_code == 404
    reply = server.ask(ORGANISER, "GET", path.format(OPEN), params={"team": "Green"})
    assert reply.status_code == 404
    assert "no team 'Green' with submissions" in reply.json()["detail"]
    assert run("server", "evidence", str(folder), OPEN, "--team", "Green").status == 2
    report = shown(server, PRIVATE)
    assert (report["submissions"], report["teams"]) == (0, [])


def test_files_that_were_deleted_are_left_out(server: Serving) -> None:
    deleted = sent(server, OTHER, MEDIOCRE)
    replies = [server.upload(OWNER, server.distinct()).json() for _ in range(4)]
    with server.state.database.writing() as session:
        session.get_one(Submission, deleted).upload_deleted_at = NOON
    report = shown(server, team="Blue")
    assert (report["submissions"], report["left"], len(report["teams"])) == (4, 0, 1)
    same_moment = sorted(reply["submission"]["id"] for reply in replies)
    assert [each["id"] for each in report["history"]] == same_moment


def test_nobody_else_makes_the_server_read_uploads(server: Serving) -> None:
    sent(server, OWNER)
    for who in (None, OWNER):
        server.ask(who, "GET", f"/organiser/splits/{OPEN}/evidence")
    signed_in(server, OWNER).get(f"/desk/evidence?split={OPEN}")
    with server.state.database.reading() as session:
        assert session.query(Row).count() == 0


def test_looking_leaves_no_trace_in_the_audit_log(server: Serving) -> None:
    sent(server, OWNER)
    with server.state.database.reading() as session:
        before = len(entries(session))
    shown(server)
    with server.state.database.reading() as session:
        assert len(entries(session)) == before


def test_it_works_on_each_database(server_on: Serving) -> None:
    sent(server_on, OWNER)
    sent(server_on, OTHER, MEDIOCRE)
    report = shown(server_on, team="Blue")
    assert (len(report["teams"]), len(report["history"]), len(report["similar"])) == (2, 1, 1)
    # Of 84 episodes, 24 have the same answer, 30 the same stop, 14 both, and 16 the same path.
    assert report["usual_similarity"] == 0.1667
    (pair,) = report["similar"]
    shares = [pair[name] for name in ("equal", "equal_answers", "equal_stops", "equal_paths")]
    assert shares == pytest.approx([14 / 84, 24 / 84, 30 / 84, 16 / 84])


def test_boxes_are_compared_by_where_they_are(server: Serving) -> None:
    board = server.state.boards[OPEN]
    records = json.loads(DRAWN)
    moved = next(record for record in records if "predBox" in record)
    moved["predBox"][0] += 1
    one, other = (Trace.of(board, content) for content in (DRAWN, json.dumps(records).encode()))
    assert int((one.codes != other.codes).sum()) == 1
    assert one.equal(other, "answer") == pytest.approx(1 - 1 / len(records))
