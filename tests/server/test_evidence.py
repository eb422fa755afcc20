"""Evidence about how submissions came about: for the organiser alone, and as it is."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.answer_histories import random_halves
from reverie_eval import GroundTruth, evaluate
from reverie_eval.ground_truth import Bundle
from reverie_eval.schemas.organising import WalkReport
from reverie_eval.server.audit.log import entries
from reverie_eval.server.operations.evidence import Trace, gather_evidence
from reverie_eval.server.scoring.boards import Board, load_board
from reverie_eval.server.settings import Split
from reverie_eval.server.store.tables import Submission
from tests.conftest import SAMPLES
from tests.support.acting import NOON
from tests.support.flat_world import TUB, WALKS, Run, write_submission
from tests.support.serving import (
    GOOD,
    OPEN,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    settings_of,
    submission_for,
)
from tests.support.worlds import SPLIT, with_arrays

MEDIOCRE = (SAMPLES / "mediocre.json").read_bytes()
DRAWN = (SAMPLES / "drawn.json").read_bytes()


MULTIPLIER, MASK = 0x9E3779B97F4A7C15, 2**64 - 1
"""What the numbers of paths, and of answers and stops, are mixed with; they are 64 bits long."""
TWO_JUMPS = (["door", "bath", "door"], TUB)
"""28 m in two jumps, in place of the walk that does not move."""


def sent(server: Serving, who: str, content: bytes = GOOD, split: str = OPEN) -> str:
    server.clock.turn(seconds=1)
    return str(server.upload(who, content, split).json()["submission"]["id"])


def shown(server: Serving, split: str = OPEN, team: str | None = None) -> dict[str, Any]:
    return gather_evidence(server.state, split, team).model_dump(mode="json")


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
    monkeypatch.setattr("reverie_eval.server.operations.evidence.PAIRS", 0)
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
def test_a_trace_has_what_the_scores_say(sample: str, server: Serving, demo: GroundTruth) -> None:
    content = (SAMPLES / f"{sample}.json").read_bytes()
    scores = evaluate(content, split=OPEN, ground_truth=demo)
    trace = Trace.of(server.state.boards[OPEN], content)
    assert trace.is_success.tolist() == (scores.episodes["success"] > 0).tolist()
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
    assert f"{lost} is left out" in run("server", "evidence", str(folder), OPEN).err


def test_uploads_are_read_with_the_bundle_of_today(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    sent(server, OWNER)
    path = folder / "bundles" / f"{OPEN}.npz"
    bundle = Bundle.load(path)
    with_arrays(bundle, task_start=bundle.arrays["task_start"][::-1].copy()).save(path)
    later = open_server(settings_of(folder), server.tokens)
    (reason,) = shown(later)["unreadable"].values()
    assert reason.startswith("rejected: ")


def test_each_format_shows_the_report(server: Serving, folder: Path, run: Run) -> None:
    for who, content in ((OWNER, GOOD), (OWNER, MEDIOCRE), (OTHER, GOOD)):
        sent(server, who, content)
    report = shown(server, team="Blue")
    words = ("server", "evidence", str(folder), OPEN, "--team", "Blue")
    assert json.loads(run(*words, "--format", "json").out) == report
    table = run(*words).out
    rows = run(*words, "--format", "csv").out.splitlines()[1:]
    assert len(rows) == 2
    for row in rows:
        for cell in row.split(","):
            assert cell in table
    for each in report["same_files"][0]["submissions"]:
        assert each["id"] in table


def test_what_there_is_not_is_not_found(server: Serving, folder: Path, run: Run) -> None:
    sent(server, OWNER)
    unknown = run("server", "evidence", str(folder), "none")
    assert (unknown.status, "'none'" in unknown.err) == (2, True)
    missing = run("server", "evidence", str(folder), OPEN, "--team", "Green")
    assert (missing.status, "no team 'Green' with submissions" in missing.err) == (2, True)
    report = shown(server, PRIVATE)
    assert (report["submissions"], report["teams"]) == (0, [])


def test_files_that_were_deleted_are_left_out(server: Serving) -> None:
    deleted = sent(server, OTHER, MEDIOCRE)
    replies = [server.upload(OWNER, server.distinct()).json() for _ in range(4)]
    with server.state.database.writing() as session:
        session.get_one(Submission, deleted).upload_deleted_at = NOON
    report = shown(server, team="Blue")
    assert (report["submissions"], len(report["teams"])) == (4, 1)
    same_moment = sorted(reply["submission"]["id"] for reply in replies)
    assert [each["id"] for each in report["history"]] == same_moment


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
    assert int((one.answer != other.answer).sum()) == 1


@pytest.fixture
def flat_board(here: Path) -> Board:
    """Return an open leaderboard of the flat's split."""
    (here / "full.npz").chmod(0o600)
    split = Split(bundle=Path("full.npz"), visibility="open")
    return load_board(SPLIT, split, here / "full.npz")


def walking(folder: Path, answers: Sequence[object]) -> bytes:
    """Return a submission of the flat's walks with these answers."""
    walks = [*WALKS[:3], TWO_JUMPS, WALKS[4]]
    told = [
        ([[place, 0, 0] for place in walk], answer)
        for (walk, _), answer in zip(walks, answers, strict=True)
    ]
    write_submission(folder / "told.json", told)  # type: ignore[arg-type]  # also texts
    return (folder / "told.json").read_bytes()


def test_what_a_trace_has_of_each_episode(flat_board: Board, here: Path) -> None:
    found = Trace.of(flat_board, walking(here, [TUB, "6", "05", -1, -1]))
    door, hall, bath = map(flat_board.truth.graph.viewpoint_ids.index, _PLACES)
    assert found.answer.tolist() == [5, 6, 5, -1, -1]
    assert found.stop.tolist() == [bath, hall, bath, door, bath]
    by_name = {"door": door, "hall": hall, "bath": bath}
    walks = [*WALKS[:3], TWO_JUMPS, WALKS[4]]
    assert found.path.tolist() == [
        path_code([by_name[place] for place in walk]) for walk, _ in walks
    ]
    assert found.codes.tolist() == [
        answer_code(answer, stop)
        for answer, stop in zip(found.answer.tolist(), found.stop.tolist(), strict=True)
    ]
    assert found.codes.dtype == np.uint32
    assert found.walks == WalkReport(
        jumps=4,
        episodes_with_jumps=3,
        longest_jump=14.0,
        mean_viewpoints=14 / 5,
        most_viewpoints=3,
        longest_walk=46.0,
        exact_stops=None,
        exact_by_chance=None,
    )


_PLACES = ("door", "hall", "bath")


def path_code(viewpoints: list[int]) -> int:
    """Mix a trajectory's viewpoints with their places, in numbers of any length."""
    total = 0
    for step, viewpoint in enumerate(viewpoints):
        mixed = (viewpoint + 1) * MULTIPLIER & MASK
        mixed = (mixed ^ mixed >> 29) * (2 * step + 3) & MASK
        total += mixed * MULTIPLIER
    return (total & MASK) >> 32


def answer_code(answer: int, stop: int) -> int:
    mixed = (answer & MASK) * MULTIPLIER & MASK
    return ((mixed ^ stop) * MULTIPLIER & MASK) >> 32
