"""A competition for Codabench, unpacked and run as its upload and its workers do.

What they do is taken from Codabench c7dbc756: ``competitions/unpackers/v2.py`` and
``compute_worker``.
"""

import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest
import yaml

import reverie_eval as rv
from reverie_eval.server.platforms import codabench_program
from reverie_eval.server.settings import SETTINGS_FILE
from tests.conftest import SAMPLES
from tests.support.codabench import KILLS, Task, compute
from tests.support.flat_world import Run
from tests.support.serving import (
    OPEN,
    OWNER,
    PRIVATE,
    Serving,
    private_truth,
    submission_for,
    submission_without_answers,
)

PHASES = """
phases = [
    { name = "dry run", opens = 2027-01-01, closes = 2027-02-28 },
    { name = "challenge", opens = 2027-03-01 },
]
"""
SHARES = ("success", "oracle_success", "spl", "rgs", "rgspl")
Worker = Callable[[dict[str, bytes]], Path]


@pytest.fixture
def competition(folder: Path, tmp_path: Path, run: Run) -> Path:
    """Write the bundle of the private split, and unpack it."""
    settings = folder / SETTINGS_FILE
    text = settings.read_text()
    assert f"[splits.{PRIVATE}]\n" in text
    settings.write_text(text.replace('phases = [{ name = "always" }]', PHASES))
    # A container's image may have such times, which zip archives cannot.
    os.utime(folder / "bundles" / f"{PRIVATE}.npz", (0, 0))
    archive = tmp_path / "competition.zip"
    words = ["--split", PRIVATE, "--image", "lab/scorer", "-o", str(archive)]
    outcome = run("server", "export", "codabench", str(folder), *words)
    assert outcome.status == 0, outcome.err
    assert "submissions in 30 days" in outcome.err
    assert archive.stat().st_mode & 0o077 == 0
    with ZipFile(archive) as file:
        file.extractall(tmp_path / "unpacked")
    return tmp_path / "unpacked"


@pytest.fixture
def described(competition: Path) -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load((competition / "competition.yaml").read_text())
    return document


@pytest.fixture
def submitted(competition: Path, tmp_path: Path) -> Worker:
    """Return a function that lays out the files of a submission as a worker does."""

    def lay_out(files: dict[str, bytes]) -> Path:
        given = tmp_path / "app" / "input"
        given.mkdir(parents=True)
        (given / "ref").symlink_to(competition / "reference_data")
        for name, content in {"metadata": b"", **files}.items():
            place = given / "res" / name
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(content)
        return given

    return lay_out


def test_the_upload_finds_what_it_needs(competition: Path, described: dict[str, Any]) -> None:
    assert described["version"] == 2
    texts = [described["terms"], *(page["file"] for page in described["pages"])]
    assert all((competition / name).read_text() for name in texts)
    assert (competition / described["image"]).read_bytes().startswith(b"\x89PNG")
    (task,) = described["tasks"]
    assert (competition / task["reference_data"] / "bundle.npz").is_file()
    (board,) = described["leaderboards"]
    assert len(board["key"]) <= 36
    assert board["columns"][board["primary_index"]]["key"] == "rgspl"
    assert {column["key"]: column["sorting"] for column in board["columns"]}["rgs"] == "desc"


def test_phases_and_quotas_are_the_server_s(described: dict[str, Any]) -> None:
    first, second = described["phases"]
    # Texts: Codabench drops the hours of times that YAML has read.
    assert (first["start"], first["end"]) == ("2027-01-01 00:00:00", "2027-02-28 23:59:59")
    assert second["start"] == "2027-03-01 00:00:00"
    assert "end" not in second
    for phase in (first, second):
        assert phase["tasks"] == [0]
        assert phase["hide_prediction_output"] is True


def test_a_worker_comes_to_the_scores_of_the_server(
    server: Serving, competition: Path, submitted: Worker
) -> None:
    content = submission_for(PRIVATE)
    given = submitted({"mine/submit.json": content, "__MACOSX/mine/._submit.json": b"\x00"})
    metadata = yaml.safe_load((competition / "scoring_program" / "metadata.yaml").read_text())
    places = {
        "python3": sys.executable,
        "/app/program/scoring.py": str(competition / "scoring_program" / "scoring.py"),
        "/app/input/": str(given),
        "/app/output/": str(given.parent / "output"),
    }
    command = [places[word] for word in shlex.split(metadata["command"])]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (process.returncode, process.stdout, process.stderr) == (0, "", "")
    (written,) = (given.parent / "output").iterdir()
    scores = json.loads(written.read_bytes())
    report = server.upload(OWNER, content, PRIVATE).json()["submission"]["report"]
    metres = "path_length"
    assert scores == {
        key: value if key == metres else pytest.approx(100 * value, abs=1e-9)
        for key, value in report["scores"].items()
    }


@pytest.mark.parametrize(
    ("files", "message"),
    [
        pytest.param({"broken.json": (SAMPLES / "broken.json").read_bytes()}, "rejected", id="bad"),
        pytest.param({"a.json": b"[]", "b.json": b"[]"}, "found: a.json, b.json", id="two files"),
        pytest.param({"submit.txt": b"[]"}, "found: none", id="no file"),
        pytest.param(
            {"submit.json": submission_without_answers()}, "no RGS and no RGSPL", id="no answers"
        ),
    ],
)
def test_what_cannot_be_scored_fails_with_a_reason(
    files: dict[str, bytes], message: str, submitted: Worker, tmp_path: Path
) -> None:
    with pytest.raises(SystemExit, match=message):
        codabench_program.main(submitted(files), tmp_path / "output")
    assert not (tmp_path / "output").exists()


@pytest.mark.parametrize("kill", KILLS)
def test_a_killed_worker_leaves_nothing_half_done(
    kill: str, competition: Path, tmp_path: Path
) -> None:
    archive = tmp_path / "submission.zip"
    with ZipFile(archive, "w") as file:
        file.writestr("submit.json", submission_for(PRIVATE))
    task = Task(competition, archive, tmp_path / "told.jsonl")
    assert compute(task, kill) == -signal.SIGKILL
    assert not task.is_acknowledged()
    assert compute(task) == 0
    assert task.is_acknowledged()
    scores = rv.evaluate(submission_for(PRIVATE), split=PRIVATE, ground_truth=private_truth())
    expected = {key: round(100 * scores[key], 2) for key in SHARES} | {
        "path_length": round(scores["path_length"], 2)
    }
    # What was sent before a kill is sent again, by Codabench's own worker: the same digits.
    assert task.scores() == [expected] * (2 if kill == "the scores are sent" else 1)
    written = [json.loads(file.read_bytes()) for file in tmp_path.glob("run-*/output/scores.json")]
    assert all(each == expected for each in written)


def test_an_unknown_split_is_named(folder: Path, run: Run, tmp_path: Path) -> None:
    words = ["--split", OPEN + "s", "--image", "lab/scorer", "-o", str(tmp_path / "x.zip")]
    outcome = run("server", "export", "codabench", str(folder), *words)
    assert outcome.status == 2
    assert f"{OPEN}s" in outcome.err
