"""The values of a submission's episodes, for the organiser on the server's own machine."""

import csv
import io
import json
import stat
from pathlib import Path

import pytest

from reverie_eval import CATALOGUE
from reverie_eval.server.audit.log import entries
from reverie_eval.server.audit.rows import mismatches
from reverie_eval.server.store.tables import Submission
from tests.support.flat_world import Run
from tests.support.serving import (
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    Serving,
    replace_answers,
    submission_for,
)
from tests.support.visiting import signed_in


def sent(server: Serving, split: str = PRIVATE) -> str:
    reply = server.upload(OWNER, submission_for(split), split)
    return str(reply.json()["submission"]["id"])


def stored_scores(server: Serving, submission_id: str) -> dict[str, float]:
    with server.state.database.reading() as session:
        scores: dict[str, float] = session.get_one(Submission, submission_id).report["scores"]
        return scores


@pytest.mark.parametrize("split", [PRIVATE, OPEN])
def test_the_values_of_all_episodes_have_the_stored_scores_as_means(
    split: str, server: Serving, folder: Path, run: Run
) -> None:
    submission_id = sent(server, split)
    episodes = server.state.boards[split].truth.episodes.instr_ids
    outcome = run("server", "inspect", str(folder), submission_id, "--format", "csv")
    assert outcome.status == 0, outcome.err
    rows = list(csv.DictReader(io.StringIO(outcome.out)))
    assert [row["instr_id"] for row in rows] == list(episodes)
    for key, stored in stored_scores(server, submission_id).items():
        mean = sum(float(row[key]) for row in rows) / len(rows)
        if split == PRIVATE:
            mean = CATALOGUE[key].rounded(mean)
        assert mean == pytest.approx(stored, rel=1e-12)


def test_json_and_table_have_the_same_values(server: Serving, folder: Path, run: Run) -> None:
    words = ("server", "inspect", str(folder), sent(server))
    document = json.loads(run(*words, "--format", "json").out)
    lines = run(*words).out.splitlines()
    assert document["signature"] in lines[-1]
    for episode, line in zip(document["episodes"], lines[1:], strict=False):
        instr_id, length, success, *_ = line.split()
        assert instr_id == episode["instr_id"]
        assert float(length) == pytest.approx(episode["path_length"], abs=0.005)
        assert float(success) == 100 * episode["success"]


def test_the_audit_log_says_so_but_nobody_tells_the_team(
    server: Serving, folder: Path, run: Run
) -> None:
    submission_id = sent(server)
    assert run("server", "inspect", str(folder), submission_id).status == 0
    with server.state.database.reading() as session:
        last = entries(session)[-1]
        assert (last.action, last.subject) == ("inspected", submission_id)
        assert list(mismatches(session)) == []
    for who in (OWNER, ORGANISER):
        assert "inspected" not in signed_in(server, who).get(f"/submissions/{submission_id}").text
    assert "inspected" in signed_in(server, ORGANISER).get("/desk/audit").text


def test_a_file_is_its_owner_s_alone(server: Serving, folder: Path, run: Run) -> None:
    submission_id, file = sent(server), folder / "values.csv"
    words = ("server", "inspect", str(folder), submission_id, "--format", "csv")
    assert run(*words, "-o", str(file)).out == ""
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert file.read_text() == run(*words).out


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        pytest.param("none", "there is no submission 'none'", id="no such submission"),
        pytest.param("upload", "is missing; run", id="missing upload"),
        pytest.param("truth", "server rescore", id="other ground truth"),
        pytest.param("report", "does not give the stored scores", id="other scores"),
    ],
)
def test_what_cannot_be_inspected_is_not(
    damage: str, told: str, server: Serving, folder: Path, run: Run
) -> None:
    submission_id = sent(server)
    match damage:
        case "none":
            submission_id = "none"
        case "upload":
            next((folder / "uploads").rglob("*.gz")).unlink()
        case "truth":
            replace_answers(folder, PRIVATE)
        case _:
            with server.state.database.writing() as session:
                row = session.get_one(Submission, submission_id)
                row.report = {**row.report, "scores": {**row.report["scores"], "success": 0.5}}
    outcome = run("server", "inspect", str(folder), submission_id)
    assert outcome.status in {1, 2}
    assert outcome.out == ""
    assert told in outcome.err
    with server.state.database.reading() as session:
        assert all(entry.action != "inspected" for entry in entries(session))


def test_no_request_returns_them(server: Serving) -> None:
    path = f"/submissions/{sent(server)}/episodes"
    for who in (OWNER, OTHER, ORGANISER):
        assert server.ask(who, "GET", path).status_code == 404
