"""What participants type: login, submit, leaderboard and verify, against a real server."""

import csv
import io
import json
import shutil
import stat
import sys
from pathlib import Path
from typing import Any

import pytest

from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle
from reverie_eval.receipts import payload_of
from reverie_eval.schemas.service import Envelope
from tests.conftest import SAMPLES
from tests.support.acting import NOON
from tests.support.flat_world import Outcome, Run
from tests.support.participants import RealServer
from tests.support.serving import NO_TLS, PRIVATE, submission_for
from tests.support.signing import receipt_in, with_payload
from tests.support.waiting import PATIENCE

BROKEN = str(SAMPLES / "broken.json")
pytestmark = pytest.mark.usefixtures("at_home")


@pytest.fixture
def token(at_home: Path, real_server: RealServer, monkeypatch: pytest.MonkeyPatch) -> str:
    """Name the server and somebody new's token in the environment."""
    token = real_server.mint(real_server.newcomer())
    monkeypatch.setenv("REVERIE_EVAL_SERVER", real_server.url)
    monkeypatch.setenv("REVERIE_EVAL_TOKEN", token)
    Path("submit.json").write_bytes(submission_for(PRIVATE))
    return token


def typed(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a text on standard input."""
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))


def accepted(outcome: Outcome) -> dict[str, dict[str, object]]:
    """Return the reply to an upload."""
    assert outcome.status == 0, outcome.err
    reply: dict[str, dict[str, object]] = json.loads(outcome.out)
    return reply


SUBMIT = ["submit", "submit.json", "--split", "test"]
JSON = ["--format", "json"]

# Login.


@pytest.mark.parametrize("kind", ["access", "invite"])
def test_login_keeps_a_token_for_oneself_alone(
    kind: str, real_server: RealServer, at_home: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = real_server.newcomer()
    secret = real_server.mint(name, "access" if kind == "access" else "invite")
    typed(f" {secret}\n", monkeypatch)
    outcome = run("login", "--server", real_server.url + "/")
    assert outcome.status == 0
    who = f"{name} of Team of {name} (participant)"
    assert outcome.out == f"signed in to {real_server.url} as {who}; token kept in {at_home}\n"
    assert stat.S_IMODE(at_home.stat().st_mode) == 0o600
    kept = json.loads(at_home.read_text())["tokens"][real_server.url]
    assert (kept == secret) == (kind == "access")
    assert secret not in outcome.out + outcome.err
    Path("submit.json").write_bytes(submission_for(PRIVATE))
    assert accepted(run(*SUBMIT, *JSON))["submission"]["person"] == name


def test_an_invitation_works_once(
    real_server: RealServer, at_home: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    invitation = real_server.mint(real_server.newcomer(), "invite")
    typed(invitation, monkeypatch)
    assert run("login", "--server", real_server.url).status == 0
    before = at_home.read_text()
    typed(invitation, monkeypatch)
    outcome = run("login", "--server", real_server.url)
    assert (outcome.status, outcome.out, at_home.read_text()) == (2, "", before)
    assert outcome.err.startswith(f"reverie-eval: {real_server.url} refuses this, as a token (")
    assert invitation not in outcome.err


@pytest.mark.parametrize("text", ["", "\n"])
def test_login_with_nothing(
    text: str, real_server: RealServer, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed(text, monkeypatch)
    outcome = run("login", "--server", real_server.url)
    assert outcome == (
        2,
        "",
        "reverie-eval: no token given; enter the one that you were sent, or the invitation\n",
    )


@pytest.mark.parametrize(
    ("content", "mode", "said"),
    [
        pytest.param("{}", 0o640, "other users can read your tokens; run `chmod 600 ", id="open"),
        pytest.param("{", 0o600, "is damaged; remove it and run `reverie-eval login`", id="cut"),
        pytest.param('{"tokens": 7}', 0o600, "is damaged; remove it", id="another"),
    ],
)
def test_a_login_file_that_is_not_used(
    content: str, mode: int, said: str, at_home: Path, run: Run
) -> None:
    at_home.parent.mkdir(parents=True)
    at_home.write_text(content)
    at_home.chmod(mode)
    outcome = run(*SUBMIT, "--server", "http://localhost:9")
    assert (outcome.status, said in outcome.err) == (2, True)
    assert at_home.read_text() == content


def test_the_environment_goes_before_the_login(
    token: str, real_server: RealServer, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed(real_server.mint(real_server.newcomer()), monkeypatch)
    outcome = run("login")
    assert outcome.status == 0
    assert "note: REVERIE_EVAL_TOKEN is set, and takes precedence over the login" in outcome.err
    monkeypatch.setenv("REVERIE_EVAL_TOKEN", "rv_none")
    assert run(*SUBMIT).err == (
        "reverie-eval: REVERIE_EVAL_TOKEN is not a valid token (unknown token); correct it, or "
        "unset it to use your login\n"
    )
    monkeypatch.delenv("REVERIE_EVAL_TOKEN")
    assert run(*SUBMIT).status == 0


def test_a_login_that_is_refused_says_how_to_get_another(
    real_server: RealServer, at_home: Path, run: Run
) -> None:
    at_home.parent.mkdir(parents=True)
    at_home.touch(0o600)
    at_home.write_text(json.dumps({"tokens": {real_server.url: "rv_old"}}))
    Path("submit.json").write_bytes(submission_for(PRIVATE))
    remedy = f"; run `reverie-eval login --server {real_server.url}` to enter another\n"
    outcome = run(*SUBMIT, "--server", real_server.url)
    assert (outcome.status, outcome.err.endswith(remedy)) == (2, True)


# Submit.


@pytest.mark.usefixtures("token")
@pytest.mark.parametrize("name", [None, "empty"], ids=["bundle here", "bundle there"])
def test_problems_are_shown_alike_wherever_they_are_found(
    name: str | None, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    locally = run("validate", BROKEN, "--split", "val_unseen")
    if name:
        Path(name).mkdir()
        monkeypatch.setenv("REVERIE_EVAL_GROUND_TRUTH", name)
    outcome = run("submit", BROKEN, "--split", "val_unseen")
    remote = "no bundle here matches the server's val_unseen; the server checks the file\n"
    assert (outcome.status, outcome.out) == (1, "")
    assert (
        outcome.err
        == f"{remote * bool(name)}{locally.err}nothing was scored, and no submission used\n"
    )


@pytest.mark.usefixtures("token")
def test_problems_as_json(run: Run) -> None:
    expected = run("validate", BROKEN, "--split", "val_unseen", *JSON)
    assert run("submit", BROKEN, "--split", "val_unseen", *JSON) == expected


@pytest.mark.usefixtures("token")
def test_another_release_s_bundle_judges_nothing(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bundle of the same split with other data would find problems that are none."""
    Path("bundles").mkdir()
    other = Bundle.load(DEMO_BUNDLES / "train.npz")
    bundle = Bundle.build(
        "test", "custom", other.header.sources, other.arrays, {}, texts=other.texts
    )
    bundle.public().save(Path("bundles/test.public.npz"))
    monkeypatch.setenv("REVERIE_EVAL_GROUND_TRUTH", "bundles")
    outcome = run(*SUBMIT)
    assert outcome.status == 0
    assert "the server checks the file" in outcome.err


@pytest.mark.usefixtures("token")
@pytest.mark.parametrize("file", ["submit.json.gz", "ours.v2.json", "-", ".json"])
def test_a_method_without_a_name_has_the_file_s(
    file: str, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = submission_for(PRIVATE)
    if file == "-":
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))
    else:
        Path(file).write_bytes(content)
    method = accepted(run("submit", file, "--split", "test", *JSON))["submission"]["method"]
    expected = {"submit.json.gz": "submit", "ours.v2.json": "ours"}.get(file, "unnamed")
    assert isinstance(method, dict)
    assert method["name"] == expected


@pytest.mark.usefixtures("token")
def test_what_no_option_names_is_not_declared_and_can_be_later(run: Run) -> None:
    flags = ("extra_data", "pre_exploration", "ground_truth_objects", "ensemble", "human")
    first, second = (
        accepted(run(*SUBMIT, *JSON, *options))["submission"]["method"]
        for options in ((), ("--no-extra-data", "--human"))
    )
    assert isinstance(first, dict)
    assert isinstance(second, dict)
    assert [first[flag] for flag in flags] == [None] * 5
    assert [second[flag] for flag in flags] == [False, None, None, None, True]


@pytest.mark.usefixtures("token")
def test_a_folder_of_a_run_declares_what_the_agent_was_shown_and_used(run: Run) -> None:
    assert run("run", "nearest-first", "--split", "test", "-o", "mine").status == 0
    words = ("submit", "mine", "--split", "test", *JSON, "--money-per-episode", "0.5", "--human")
    method = accepted(run(*words))["submission"]["method"]
    assert isinstance(method, dict)
    totals = json.loads(Path("mine/run.json").read_text())["totals"]
    assert (method["name"], method["input_class"], method["sample_size"], method["human"]) == (
        *("nearest-first", "geometry", None, True),
    )
    assert method["actions_per_episode"] == totals["steps"] / totals["ended"]
    assert method["seconds_per_episode"] == totals["seconds"] / totals["ended"]
    assert (method["input_tokens_per_episode"], method["money_per_episode"]) == (None, 0.5)


@pytest.mark.usefixtures("token")
def test_sending_again_publishes_and_renames(run: Run) -> None:
    first = accepted(run(*SUBMIT, *JSON))
    about = ["--paper", "https://x.org/p", "--human", "--publish"]
    second = accepted(run(*SUBMIT, *JSON, *about))
    third = accepted(run(*SUBMIT, *JSON, "--method", "Ours"))
    assert [each["quota"]["remaining"] for each in (first, second, third)] == [1, 1, 1]
    assert [each["submission"]["status"] for each in (first, second, third)] == [
        "unpublished",
        "published",
        "published",
    ]
    before, after = second["submission"]["method"], third["submission"]["method"]
    assert isinstance(before, dict)
    assert isinstance(after, dict)
    assert (before["name"], before["paper"], before["human"]) == (
        "submit",
        "https://x.org/p",
        True,
    )
    assert after == before | {"name": "Ours"}
    assert first["submission"]["receipt"] == third["submission"]["receipt"]
    # The command has made the changes; under another name without an option, nothing is changed.
    assert not any(each["ignored"] for each in (first, second, third))
    shutil.copy("submit.json", "copy.json")
    renamed = run("submit", "copy.json", *SUBMIT[2:])
    told = "ignored, because the first upload said otherwise: name; options such as --method"
    assert told in renamed.out


@pytest.mark.usefixtures("token")
@pytest.mark.parametrize(
    ("options", "said"),
    [
        pytest.param(["--paper", "http://x.org"], "--paper: must be a link that begins", id="http"),
        pytest.param(
            ["--method", "x" * 101, "--code", "no"], "--method: must have at most 100", id="two"
        ),
        pytest.param(["--receipt", "no/receipt.json"], "no is not a folder", id="no folder"),
        pytest.param(["--receipt", "submit.json"], "submit.json already exists", id="taken"),
    ],
)
def test_options_that_are_wrong_cost_nothing(options: list[str], said: str, run: Run) -> None:
    outcome = run(*SUBMIT, *options)
    assert (outcome.status, outcome.out, said in outcome.err) == (2, "", True)
    assert accepted(run(*SUBMIT, *JSON))["quota"]["remaining"] == 1


@pytest.mark.usefixtures("token")
def test_receipts_are_kept_and_never_written_over(run: Run) -> None:
    def kept(*options: str) -> str:
        (line,) = [x for x in run(*SUBMIT, *options).out.splitlines() if x.startswith("receipt")]
        return line.removeprefix("receipt: ")

    assert [kept(), kept()] == ["submit.json.receipt.json"] * 2
    Path("submit.json").write_bytes(submission_for(PRIVATE, seed=1))
    assert [kept(), kept()] == ["submit.json.2.receipt.json"] * 2
    assert kept("--receipt", "mine.json") == "mine.json"
    assert Path("mine.json").read_text() == Path("submit.json.2.receipt.json").read_text()
    Path("submit.json").write_bytes(submission_for(PRIVATE, seed=2))
    outcome = run(*SUBMIT, "--receipt", "mine.json")
    said = "mine.json already exists; choose another file for the receipt"
    assert outcome == (2, "", f"reverie-eval: {said}\n")


@pytest.mark.usefixtures("token")
def test_a_receipt_that_cannot_be_written_hides_no_score(run: Run) -> None:
    longest = Path(f"{'x' * 250}.json")  # with .receipt.json, no file system would take it
    longest.write_bytes(submission_for(PRIVATE))
    outcome = run("submit", str(longest), "--split", "test")
    assert (outcome.status, "submissions left on test: 1" in outcome.out) == (2, True)
    assert outcome.err.startswith("scored, but the receipt could not be written (")
    assert outcome.err.endswith(
        "; send the same file again, which uses no submission, with --receipt\n"
    )
    assert run("submit", str(longest), "--split", "test", "--receipt", "r.json").status == 0


@pytest.mark.usefixtures("token")
def test_a_split_that_is_none(run: Run) -> None:
    outcome = run("submit", "submit.json", "--split", "tset")
    assert outcome.status == 2
    assert outcome.err.endswith(
        "has no split 'tset'; did you mean test? Choose one of: test, val_seen, val_unseen\n"
    )


# Leaderboard.


@pytest.mark.usefixtures("token")
def test_the_leaderboard_in_every_format(run: Run) -> None:
    reply = accepted(run(*SUBMIT, *JSON, "--publish", "--method", "Ours, <b>"))["submission"]
    rows = json.loads(run("leaderboard", *JSON).out)["rows"]
    (mine,) = [row for row in rows if row["submission_id"] == reply["id"]]
    assert mine["team"] == reply["team"]
    table = run("leaderboard").out.splitlines()
    (line,) = [line for line in table if f"{reply['team']} " in line]
    assert "Ours, <b>" in line
    assert table[-1].startswith("split:test|protocol:official-v1|data:")
    assert table[-1].endswith(", sorted by RGSPL")
    by_length = csv.DictReader(
        io.StringIO(run("leaderboard", "--format", "csv", "--metric", "spl").out)
    )
    assert "Ours, <b>" in {row["method"] for row in by_length}


@pytest.mark.usefixtures("token")
def test_an_empty_board_and_one_that_is_none(run: Run) -> None:
    assert run("leaderboard", "--split", "val_seen").out.endswith(
        "\nno results are published yet\n"
    )
    outcome = run("leaderboard", "--split", "tset")
    assert (outcome.status, outcome.out) == (2, "")
    assert "there is no split 'tset' here; did you mean test? Choose one of: test, " in outcome.err


# Verify.


@pytest.fixture
def receipt(token: str, run: Run) -> Path:
    """Submit, and return the receipt."""
    assert run(*SUBMIT).status == 0
    return Path("submit.json.receipt.json")


def test_a_genuine_receipt_says_what_it_proves(
    receipt: Path, real_server: RealServer, run: Run
) -> None:
    outcome = run("verify", str(receipt), "--submission", "submit.json")
    first, second, *_, signature, file, last = outcome.out.splitlines()
    assert outcome.status == 0
    assert first.startswith(f"{receipt}: genuine, signed with the key of {real_server.url} (")
    assert second.startswith("proven: the server received a file from Team of Person ")
    assert signature.startswith("split:test|protocol:official-v1|data:")
    assert " file sha256 " in file
    assert last == "submit.json: the file that was scored"


def test_a_key_in_a_file_does_without_the_server(
    receipt: Path, real_server: RealServer, run: Run
) -> None:
    import httpx

    key = httpx.get(f"{real_server.url}/api/v1/key", timeout=PATIENCE, verify=NO_TLS)
    Path("key.pem").write_text(key.text)
    assert run("verify", str(receipt), "--key", "key.pem").status == 0
    Path("key.pem").write_text("no key")
    outcome = run("verify", str(receipt), "--key", "key.pem")
    assert outcome == (2, "", "reverie-eval: this is not a public key in PEM form\n")


CHANGES: dict[str, Any] = {
    "server": "Another server",
    "submission_id": "0123456789abcdef",
    "team": "Another team",
    "sha256": "0" * 64,
    "received_at": NOON,
    "split": "val_unseen",
    "signature": "split:test",
    "scores": {"spl": 1.0},
}


@pytest.mark.parametrize("field", CHANGES)
def test_a_changed_field_is_not_genuine(field: str, receipt: Path, run: Run) -> None:
    envelope = Envelope.model_validate_json(receipt.read_text())
    change = {field: CHANGES[field]}
    _, other = payload_of(receipt_in(envelope).model_copy(update=change))
    receipt.write_text(with_payload(envelope, other).model_dump_json())
    outcome = run("verify", str(receipt))
    assert (outcome.status, outcome.out) == (1, "")
    said = ": the signature does not match: it was changed after it was signed\n"
    assert outcome.err.endswith(said)


def test_the_layout_of_a_receipt_does_not_matter(receipt: Path, run: Run) -> None:
    content = json.loads(receipt.read_text())
    receipt.write_text(json.dumps(dict(reversed(content.items()))))
    assert run("verify", str(receipt)).status == 0


def test_another_file_or_another_key(receipt: Path, run: Run) -> None:
    Path("other.json").write_bytes(submission_for(PRIVATE, seed=1))
    outcome = run("verify", str(receipt), "--submission", "other.json")
    assert outcome == (1, "", "other.json: not the file that the receipt is for\n")
    told = json.loads(receipt.read_text())
    told["signatures"][0]["keyid"] = "0" * 16
    receipt.write_text(json.dumps(told))
    outcome = run("verify", str(receipt))
    assert outcome.status == 1
    assert ": it names key 0000000000000000, which is not in the list of keys" in outcome.err


def test_what_is_no_receipt(receipt: Path, run: Run) -> None:
    outcome = run("verify", "submit.json")
    said = "submit.json is not a receipt or a snapshot of a server"
    assert outcome == (2, "", f"reverie-eval: {said}\n")
    assert run("verify", "missing.json").status == 2
