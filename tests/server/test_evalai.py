"""A worker for EvalAI finishes each submission once, with our digits, whatever ends it or fails it.

The other side is a server that does what EvalAI does (``tests/support/evalai.py``).
"""

import gzip
import hashlib
import io
import json
import re
import shutil
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import get_args
from zipfile import ZipFile

import pytest
import yaml
from tenacity import RetryCallState, Retrying

import reverie_eval as rv
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.operations.checks import opened_server
from reverie_eval.server.operations.logs import JsonLines
from reverie_eval.server.platforms import evalai_worker
from reverie_eval.server.platforms.evalai_api import (
    EvalAIClient,
    EvalAIError,
    MismatchError,
    UnavailableError,
)
from reverie_eval.server.platforms.evalai_worker import EvalAIWorker
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import SETTINGS_FILE, SettingsError, load_settings
from reverie_eval.server.state import ServerState
from tests.conftest import REPOSITORY
from tests.support import killing
from tests.support.evalai import (
    CHALLENGE,
    LABELS,
    QUEUE,
    TOKEN,
    EvalAI,
    Fault,
    Message,
    Moment,
    Request,
    Step,
    Submission,
    serving_evalai,
    working,
)
from tests.support.flat_world import Run
from tests.support.serving import (
    GOOD,
    OPEN,
    PRIVATE,
    adjusted,
    broken_private,
    private_truth,
    submission_for,
    submission_without_answers,
)
from tests.support.waiting import PATIENCE

SECTION = """
[evalai]
url = "{url}"
challenge = {challenge}
queue = "{queue}"
token_file = "evalai-token"

[evalai.phases]
{phases}
"""
PHASES = {1213: PRIVATE, 1214: OPEN}
FOR_TEST, FOR_VAL = PHASES
LIMITS = {
    "upload_mebibytes = 32": "upload_mebibytes = 1",
    "unpacked_mebibytes = 64": "unpacked_mebibytes = 2",
}
REQUESTS: Sequence[tuple[Request, int]] = [
    ("receive", 1),
    ("look up", 1),
    ("report running", 1),
    ("download", 1),
    ("look up", 2),
    ("report end", 1),
    ("remove", 1),
]
"""The requests of a submission that is scored, in their order; those of a kind are numbered."""


@pytest.fixture(scope="module")
def running() -> Iterator[EvalAI]:
    with serving_evalai() as running:
        yield running


@pytest.fixture(scope="module")
def lab(running: EvalAI, made_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a server's folder that names the challenge."""
    folder = Path(shutil.copytree(made_folder, tmp_path_factory.mktemp("evalai") / "lab"))
    phases = "\n".join(f'{number} = "{split}"' for number, split in PHASES.items())
    section = SECTION.format(url=running.url, challenge=CHALLENGE, queue=QUEUE, phases=phases)
    settings = folder / SETTINGS_FILE
    text = settings.read_text()
    for found, instead in LIMITS.items():
        assert found in text
        text = text.replace(found, instead)
    settings.write_text(text + section)
    token = folder / "evalai-token"
    token.write_text(f"{TOKEN}\n")
    token.chmod(0o600)
    return folder


@pytest.fixture(scope="module")
def opened(lab: Path) -> Iterator[ServerState]:
    with opened_server(load_settings(lab)) as state:
        yield state


@pytest.fixture
def evalai(running: EvalAI) -> EvalAI:
    """Return EvalAI with a challenge in which nothing was submitted."""
    running.reset()
    running.phases = {number: (split, LABELS) for number, split in PHASES.items()}
    return running


@pytest.fixture(scope="module")
def client(opened: ServerState) -> Iterator[EvalAIClient]:
    with client_of(opened) as client:
        yield client


def client_of(state: ServerState, token: str = TOKEN) -> EvalAIClient:
    assert state.settings.evalai is not None
    return EvalAIClient(state.settings.evalai, token)


@pytest.fixture
def worker(evalai: EvalAI, client: EvalAIClient, opened: ServerState) -> EvalAIWorker:
    return EvalAIWorker(client, opened)


def drain(worker: EvalAIWorker, evalai: EvalAI) -> None:
    """Let a worker go on until the queue is empty, whatever fails."""
    for _ in range(3):
        with suppress(UnavailableError):
            while worker.take_one():
                pass
        evalai.let_messages_return()
    assert evalai.messages == []


@cache
def expected(split: str) -> Mapping[str, float]:
    """Return what the leaderboard has to show: the package's scores to two decimals."""
    truth = private_truth() if split == PRIVATE else None
    scores = rv.evaluate(submission_for(split), split=split, ground_truth=truth)
    keys = ("path_length", "success", "oracle_success", "spl", "rgs", "rgspl")
    percent = [100 * scores[key] for key in keys[1:]]
    values = [scores[keys[0]], *percent]
    return {label: round(value, 2) for label, value in zip(LABELS, values, strict=True)}


def check_finished_once(evalai: EvalAI, *submissions: Submission) -> None:
    for submission in submissions:
        assert (submission.status, submission.ends) == ("finished", ["finished"])
    assert evalai.rows == [
        (each.number, PHASES[each.phase], expected(PHASES[each.phase])) for each in submissions
    ]
    assert not evalai.token_seen_by_store


@pytest.mark.parametrize(
    "step",
    [
        pytest.param(Step(request, number, when), id=f"{request} {number} {when}")
        for request, number in REQUESTS
        for when in get_args(Moment)
    ],
)
def test_a_worker_killed_at_a_request_leaves_nothing_undone(
    step: Step, lab: Path, evalai: EvalAI, worker: EvalAIWorker, tmp_path: Path
) -> None:
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    evalai.hold = step
    with working(lab, tmp_path / "log") as process:
        assert evalai.held.wait(PATIENCE), (tmp_path / "log").read_text()
        process.kill()
        assert process.wait(PATIENCE) == -signal.SIGKILL
    evalai.hold = None
    evalai.let_go.set()
    evalai.let_messages_return()
    drain(worker, evalai)
    check_finished_once(evalai, submission)


def test_a_worker_killed_while_it_scores_leaves_nothing_undone(
    lab: Path, evalai: EvalAI, worker: EvalAIWorker, tmp_path: Path
) -> None:
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    with working(lab, tmp_path / "log", killing.Step(Board, "scored", "after")) as process:
        assert process.wait(PATIENCE) == -signal.SIGKILL
    assert submission.status == "running"
    drain(worker, evalai)
    check_finished_once(evalai, submission)


@pytest.mark.parametrize(
    ("request_", "fault"),
    [
        pytest.param(request, fault, id=f"{request}, {fault}")
        for request in get_args(Request)
        for fault in get_args(Fault)
        # An HTML page instead of the file looks like a page that was submitted.
        if request != "download" or fault not in {"hidden", "nonsense"}
        # That the queue is not there ends the worker.
        if (request, fault) != ("receive", "hidden")
        and (request == "report end" or fault != "half")
    ],
)
def test_a_request_that_fails_costs_nothing(
    request_: Request, fault: Fault, evalai: EvalAI, worker: EvalAIWorker
) -> None:
    first = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    second = evalai.submit(FOR_VAL, GOOD)
    evalai.faults = {request_: [fault]}
    drain(worker, evalai)
    assert evalai.faults == {request_: []}
    evalai.rows.sort()
    check_finished_once(evalai, first, second)


def test_another_worker_may_be_faster(evalai: EvalAI, worker: EvalAIWorker) -> None:
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))

    def meanwhile() -> None:
        evalai.while_downloaded = lambda: None
        evalai.let_messages_return()
        assert worker.take_one()

    evalai.while_downloaded = meanwhile
    drain(worker, evalai)
    check_finished_once(evalai, submission)


def test_what_was_cancelled_meanwhile_stays_cancelled(evalai: EvalAI, worker: EvalAIWorker) -> None:
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    evalai.while_downloaded = lambda: setattr(submission, "status", "cancelled")
    drain(worker, evalai)
    assert (submission.status, submission.ends, evalai.rows) == ("cancelled", [], [])


@pytest.mark.parametrize("status", ["finished", "failed", "cancelled", "archived", "deleted"])
def test_what_is_over_is_left_alone(status: str, evalai: EvalAI, worker: EvalAIWorker) -> None:
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    submission.deleted = status == "deleted"
    submission.status = "submitted" if submission.deleted else status
    drain(worker, evalai)
    assert submission.ends == []
    assert evalai.requests.keys() == {"receive", "look up", "remove"}


@pytest.mark.parametrize("status", ["submitted", "queued", "resuming", "running"])
def test_what_is_not_over_is_finished(status: str, evalai: EvalAI, worker: EvalAIWorker) -> None:
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    submission.status = status
    drain(worker, evalai)
    check_finished_once(evalai, submission)
    assert evalai.requests["report running"] == (status != "running")


def test_hosts_and_participants_are_told_what_they_may_know(
    evalai: EvalAI, worker: EvalAIWorker, opened: ServerState
) -> None:
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    drain(worker, evalai)
    board = opened.board(PRIVATE)
    assert submission.shown == [expected(PRIVATE)]
    assert submission.stdout.splitlines()[0] == board.signature
    asked = dict(evalai.requests) | {"receive": 1}  # and again, until the queue is empty
    assert asked == dict.fromkeys(get_args(Request), 1) | {"look up": 2}
    about = json.loads(submission.metadata)
    assert about["fingerprint"] == board.truth.fingerprint
    assert about["sha256"] == hashlib.sha256(submission_for(PRIVATE)).hexdigest()


def test_scores_that_are_held_back_are_not_shown(
    evalai: EvalAI, worker: EvalAIWorker, opened: ServerState
) -> None:
    splits = adjusted(opened.settings, release_scores="phase-end").splits
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    state = copy(opened)
    state.services = {**opened.services, Schedules: Schedules(splits)}
    drain(replace(worker, state=state), evalai)
    check_finished_once(evalai, submission)
    assert submission.shown == []
    signature, *notes = submission.stdout.splitlines()
    assert signature == opened.board(PRIVATE).signature
    assert notes == ["3 of 91 answers predict no object"]


def packed(name: str = "submit.json", *others: str) -> bytes:
    """Return a submission in a zip archive."""
    archive = io.BytesIO()
    with ZipFile(archive, "w") as file:
        for each in (name, *others):
            file.writestr(each, submission_for(PRIVATE))
    return archive.getvalue()


def test_a_file_may_be_packed(evalai: EvalAI, worker: EvalAIWorker) -> None:
    submissions = [
        evalai.submit(FOR_TEST, content)
        for content in (gzip.compress(submission_for(PRIVATE)), packed())
    ]
    drain(worker, evalai)
    check_finished_once(evalai, *submissions)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        pytest.param(broken_private(), "episode 240_0 has no prediction", id="problems"),
        pytest.param(submission_without_answers(), "no record has an answer", id="navigation only"),
        pytest.param(b"<html>Log in</html>", "JSON", id="not JSON"),
        pytest.param(b"", "empty", id="empty"),
        pytest.param(
            packed("a.json", "b.json"), "with 2 files: 'a.json', 'b.json'", id="two files"
        ),
        pytest.param(b" " * (2 << 20), "larger than 1 MiB; send it gzipped", id="too large"),
        pytest.param(gzip.compress(b" " * (3 << 20)), "larger than 2 MiB unpacked", id="bomb"),
        pytest.param(GOOD, "val_unseen", id="another split's"),
        pytest.param(None, "EvalAI does not have it", id="lost by the store"),
    ],
)
def test_what_cannot_be_scored_fails_with_a_reason(
    content: bytes | None, reason: str, evalai: EvalAI, worker: EvalAIWorker, lab: Path
) -> None:
    submission = evalai.submit(FOR_TEST, content)
    drain(worker, evalai)
    assert (submission.ends, evalai.rows) == (["failed"], [])
    assert reason in submission.stderr
    assert submission.stderr.startswith("submission rejected, ")
    assert "Traceback" not in submission.stderr
    assert str(lab) not in submission.stderr


def test_a_fault_of_ours_fails_without_telling_secrets(
    evalai: EvalAI,
    worker: EvalAIWorker,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("the target is 1999999937")

    monkeypatch.setattr(Board, "scored", fail)
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    drain(worker, evalai)
    assert submission.ends == ["failed"]
    assert submission.stderr.startswith("the evaluation failed, but not because of the file")
    logged = [JsonLines().format(record) for record in caplog.records]
    assert any("submission could not be scored" in line for line in logged)
    assert "1999999937" not in submission.stderr + "".join(logged)


@pytest.mark.parametrize(
    "text",
    ["null", '"text"', "[1]", "{}", '{"submission_pk": null}', '{"submission_pk": "x"}', "{"],
)
def test_a_message_that_makes_no_sense_stops_nothing(
    text: str, evalai: EvalAI, worker: EvalAIWorker
) -> None:
    evalai.messages.append(Message(text))
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    for _ in range(3):
        with suppress(UnavailableError):  # EvalAI itself fails if it cannot read one
            worker.take_one()
    check_finished_once(evalai, submission)
    assert [each.text for each in evalai.messages] == (["{"] if text == "{" else [])


def test_a_message_without_its_submission_is_removed(evalai: EvalAI, worker: EvalAIWorker) -> None:
    evalai.submissions.pop(evalai.submit(FOR_TEST, GOOD).number)
    drain(worker, evalai)


@pytest.mark.parametrize(
    ("phase", "reason"),
    [
        pytest.param(1299, "phase 1299, which the settings do not name", id="phase"),
        pytest.param(FOR_TEST, "missing in theleaderboard data: ['RGS'", id="label"),
    ],
)
def test_what_does_not_fit_the_challenge_waits_until_it_does(
    phase: int,
    reason: str,
    evalai: EvalAI,
    worker: EvalAIWorker,
    caplog: pytest.LogCaptureFixture,
) -> None:
    evalai.phases[FOR_TEST] = (PRIVATE, LABELS[:4])
    first = evalai.submit(phase, submission_for(PRIVATE))
    second = evalai.submit(FOR_VAL, GOOD)
    while worker.take_one():
        pass
    check_finished_once(evalai, second)
    assert (first.ends, len(evalai.messages)) == ([], 1)
    (record,) = [each for each in caplog.records if each.levelname == "WARNING"]
    assert reason in JsonLines().format(record)
    first.phase = FOR_TEST
    evalai.phases[FOR_TEST] = (PRIVATE, LABELS)
    evalai.let_messages_return()
    drain(worker, evalai)
    check_finished_once(evalai, second, first)


def test_a_refused_token_is_not_shown(evalai: EvalAI, opened: ServerState) -> None:
    evalai.submit(FOR_TEST, submission_for(PRIVATE))
    with (
        client_of(opened, "another-token") as client,
        pytest.raises(EvalAIError, match="Invalid token; check that the token is") as caught,
    ):
        client.receive()
    assert "another-token" not in str(caught.value)


@pytest.mark.parametrize("token", ["", " ", "a\nb", "tökn"])
def test_a_token_that_no_header_can_carry_is_refused(token: str, opened: ServerState) -> None:
    with pytest.raises(EvalAIError, match="REVERIE_EVAL_EVALAI__TOKEN"):
        client_of(opened, token)


def test_an_unknown_queue_ends_the_worker(evalai: EvalAI, worker: EvalAIWorker) -> None:
    assert worker.client.settings.queue == QUEUE
    settings = worker.client.settings.model_copy(update={"queue": "other"})
    with (
        EvalAIClient(settings, TOKEN) as client,
        pytest.raises(MismatchError, match="queue name other does not exist"),
    ):
        replace(worker, client=client).run()


def test_an_evalai_that_fails_is_tried_until_it_answers(
    evalai: EvalAI, worker: EvalAIWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evalai_worker, "LONGEST_PAUSE", 0)
    submission = evalai.submit(FOR_TEST, submission_for(PRIVATE))
    evalai.faults = {"receive": ["refused", "busy", "nonsense", "lost"]}
    evalai.while_downloaded = worker.stopping.set
    message = evalai.messages[0]
    monkeypatch.setattr(evalai, "now", float("inf"))  # a lost reply hides the message
    message.hidden_until = 0.0
    worker.run()
    check_finished_once(evalai, submission)


@pytest.mark.parametrize(
    ("asked", "attempt", "seconds"),
    [
        pytest.param(None, 1, 1, id="the first time"),
        pytest.param(None, 3, 4, id="twice as long each time"),
        pytest.param(None, 5000, 60, id="a minute at most"),
        pytest.param(7.0, 1, 7, id="as EvalAI asks"),
        pytest.param(86400.0, 1, 600, id="ten minutes at most"),
    ],
)
def test_pauses(asked: float | None, attempt: int, seconds: float) -> None:
    state = RetryCallState(Retrying(), None, (), {})
    state.attempt_number = attempt
    state.set_exception((UnavailableError, UnavailableError("", asked), None))
    assert evalai_worker.pause_after(state) == seconds


def test_sigterm_lets_a_submission_end(lab: Path, evalai: EvalAI, tmp_path: Path) -> None:
    first, second = (evalai.submit(FOR_TEST, submission_for(PRIVATE)) for _ in range(2))
    evalai.hold, evalai.is_killed = Step("download"), False
    log = tmp_path / "log"
    with working(lab, log) as process:
        assert evalai.held.wait(PATIENCE), log.read_text()
        process.send_signal(signal.SIGTERM)
        evalai.let_go.set()
        assert process.wait(PATIENCE) == 0, log.read_text()
    check_finished_once(evalai, first)
    assert (second.status, len(evalai.messages)) == ("submitted", 1)
    announced, *lines = log.read_text().splitlines()
    assert announced.startswith(f"scoring submissions to challenge {CHALLENGE} at http://127.0")
    (line,) = map(json.loads, lines)
    assert (line["event"], line["submission"]) == ("submission finished", first.number)
    assert TOKEN not in log.read_text()


@pytest.mark.parametrize(
    ("found", "instead", "problem"),
    [
        pytest.param(
            f'"{PRIVATE}"',
            '"tset"',
            "evalai.phases.1213: got 'tset'; must be one of the splits: test, val_seen, val_unseen",
            id="unknown split",
        ),
        pytest.param(
            "http://127.0.0.1", "http://eval.ai", "must begin with https://", id="not encrypted"
        ),
        pytest.param("token_file", "token = 7 #", "evalai.token: must be text", id="token"),
    ],
)
def test_settings_that_cannot_be_right(
    found: str, instead: str, problem: str, lab: Path, tmp_path: Path
) -> None:
    text = (lab / SETTINGS_FILE).read_text()
    before, section = text.rsplit("[evalai]", 1)
    (tmp_path / SETTINGS_FILE).write_text(f"{before}[evalai]{section.replace(found, instead, 1)}")
    with pytest.raises(SettingsError) as caught:
        load_settings(tmp_path)
    assert problem in str(caught.value)


def test_the_section_in_the_guide_can_be_added(made_folder: Path, tmp_path: Path) -> None:
    guide = (REPOSITORY / "docs" / "how-to" / "organising" / "platforms.md").read_text()
    (section,) = re.findall(r"```toml\n(.*?)```", guide, re.DOTALL)
    settings = (made_folder / SETTINGS_FILE).read_text()
    (tmp_path / SETTINGS_FILE).write_text(settings + section)
    challenge = load_settings(tmp_path).evalai
    assert challenge is not None
    assert challenge.phases == PHASES
    assert str(challenge.url) == "https://eval.ai/"


def test_the_token_may_be_a_variable(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert load_settings(lab).evalai_token == TOKEN
    monkeypatch.setenv("REVERIE_EVAL_EVALAI__TOKEN", "from a variable")
    settings = load_settings(lab)
    assert settings.evalai is not None
    assert "from a variable" not in repr(settings)
    without = settings.evalai.model_copy(update={"token_file": None})
    assert settings.model_copy(update={"evalai": without}).evalai_token == "from a variable"


def test_a_token_that_others_can_read_stops_the_worker(lab: Path, tmp_path: Path, run: Run) -> None:
    folder = Path(shutil.copytree(lab, tmp_path / "lab"))
    (folder / "evalai-token").chmod(0o644)
    outcome = run("server", "evalai-worker", str(folder))
    assert outcome.status == 1
    assert f"other users can read {folder / 'evalai-token'}" in outcome.err


def test_a_server_without_a_challenge_has_no_worker(made_folder: Path, run: Run) -> None:
    outcome = run("server", "evalai-worker", str(made_folder))
    assert outcome.status == 2
    assert "the settings have no section [evalai]" in outcome.err


def test_the_challenge_has_a_place_for_every_result(lab: Path, run: Run) -> None:
    outcome = run("server", "export", "evalai", str(lab))
    assert outcome.status == 0
    assert f"{PRIVATE}: quotas for any 24 hours, 30 and 365 days" in outcome.err
    config = yaml.safe_load(outcome.out)
    assert config["remote_evaluation"] is True
    boards = {board["id"]: board["schema"] for board in config["leaderboard"]}
    splits = {split["id"]: split["codename"] for split in config["dataset_splits"]}
    phases = {phase["id"]: phase for phase in config["challenge_phases"]}
    assert len({phase["codename"] for phase in phases.values()}) == len(phases)
    for place in config["challenge_phase_splits"]:
        schema, split = boards[place["leaderboard_id"]], splits[place["dataset_split_id"]]
        assert (schema["labels"], schema["default_order_by"]) == (list(LABELS), "RGSPL")
        assert schema["metadata"]["TL"]["sort_ascending"] is True
        assert schema["metadata"]["RGSPL"]["sort_ascending"] is False
        assert phases[place["challenge_phase_id"]]["name"] == f"{split}: always"
        assert (place["visibility"], place["leaderboard_decimal_precision"]) == (3, 2)
        assert place["is_leaderboard_order_descending"] is True
    assert sorted(splits.values()) == ["test", "val_seen", "val_unseen"]
    test = next(phase for phase in phases.values() if phase["name"] == "test: always")
    quota = [test[f"max_submissions{per}"] for per in ("_per_day", "_per_month", "")]
    assert quota == [2, 10, 40]
    assert test["end_date"] == datetime(2099, 12, 31, 23, 59, 59)  # noqa: DTZ001  # as in YAML


def test_a_challenge_hides_scores_that_are_held_back(lab: Path, tmp_path: Path, run: Run) -> None:
    folder = Path(shutil.copytree(lab, tmp_path / "lab"))
    settings = folder / SETTINGS_FILE
    phases = """
phases = [{ name = "challenge", opens = 2027-01-01T12:00:00+01:00, closes = 2027-06-01 },
          { name = "earlier", closes = 2020-01-31 }]
release_scores = "phase-end"
"""
    text = settings.read_text()
    settings.write_text(text.replace('\nphases = [{ name = "always" }]\n', phases))
    outcome = run("server", "export", "evalai", str(folder))
    assert outcome.status == 0, outcome.err
    assert f"{PRIVATE}: the date from which scores are shown" in outcome.err
    config = yaml.safe_load(outcome.out)
    (phase, earlier), place = config["challenge_phases"][:2], config["challenge_phase_splits"][0]
    assert earlier["start_date"] == earlier["end_date"]
    assert phase["start_date"] == datetime(2027, 1, 1, 11)  # noqa: DTZ001  # in UTC
    assert phase["end_date"] == datetime(2027, 6, 1, 23, 59, 59)  # noqa: DTZ001
    assert (phase["leaderboard_public"], place["visibility"]) == (False, 1)
    assert place["show_scores_on_leaderboard"] is False
