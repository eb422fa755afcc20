"""The organiser's commands: what they say, what they refuse, and how they end."""

import json
import re
import shlex
import signal
import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from reverie_eval.ground_truth import DEMO_BUNDLES
from tests.support.flat_world import Run
from tests.support.processes import TOKEN, Laptop
from tests.support.serving import PRIVATE, submission_for
from tests.support.waiting import PATIENCE

SETTINGS = "reverie-eval.toml"


# Trying it.


def test_one_command_serves_the_demo_world(laptop: Laptop) -> None:
    with laptop.serving() as server:
        (token,) = {*TOKEN.findall(server.said)}
        assert f"data in {laptop.folder / 'reverie-eval-server'}" in server.said
        assert f"listening at {server.url}" in server.said
        assert server.url.startswith("http://127.0.0.1:")
        assert {split["name"] for split in server.get("/splits").json()} == {
            "test",
            "val_seen",
            "val_unseen",
        }
        assert server.get("/me", token).json()["role"] == "organiser"
        submit, leaderboard = map(shlex.split, server.said.splitlines()[-2:])
        variable, _, value = submit.pop(0).partition("=")
        assert {submit.pop(0), leaderboard.pop(0)} == {"reverie-eval"}
        assert "100.00" in laptop.run(*submit, variables={variable: value}).out
        assert "Shortest" in laptop.run(*leaderboard).out


def test_people_sign_in_at_the_public_address(laptop: Laptop) -> None:
    laptop.run("server", "init", "lab")
    file = laptop.folder / "lab" / SETTINGS
    public = 'public_address = "https://eval.example.org/reverie"\ntrusted_proxies = ["127.0.0.1"]'
    file.write_text(f"{public}\n{file.read_text()}")
    with laptop.serving("lab") as server:
        assert "reverie-eval login --server https://eval.example.org/reverie\n" in server.said


def test_its_test_split_is_the_demo_world_s_own_and_private(laptop: Laptop) -> None:
    laptop.run("server", "init", "lab")
    served = (laptop.folder / "lab" / "bundles" / "test.npz").read_bytes()
    assert served == (DEMO_BUNDLES / "private" / "test.npz").read_bytes()
    with laptop.serving("lab") as server:
        seen = {split["name"]: split["visibility"] for split in server.get("/splits").json()}
    assert seen == {"test": "private", "val_seen": "open", "val_unseen": "open"}


def test_a_token_is_shown_once_and_a_lost_one_is_replaced(laptop: Laptop) -> None:
    with laptop.serving() as server:
        first = TOKEN.findall(server.said)[0]
    with laptop.serving() as server:
        assert TOKEN.findall(server.said) == []
        *words, person = server.said.splitlines()[-1].partition("reverie-eval ")[2].split()
        assert person == "PERSON"
        added = laptop.run(*words, "Organiser")
        assert "not shown again" in added.err
        assert server.get("/me", added.out.strip()).json()["person"] == "Organiser"
        assert server.get("/me", first).status_code == 200
    made = laptop.folder / "reverie-eval-server"
    kept = b"".join(path.read_bytes() for path in made.rglob("*") if path.is_file())
    logged = b"".join(path.read_bytes() for path in laptop.folder.glob("*.log"))
    for token in (first, added.out.strip()):
        assert token.encode() not in kept + logged


def test_nobody_else_can_read_a_server_s_files(laptop: Laptop) -> None:
    with laptop.serving() as server:
        assert server.upload(
            TOKEN.findall(server.said)[0], "test", submission_for(PRIVATE)
        ).is_success
        made = laptop.folder / "reverie-eval-server"
        open_to_others = [
            path.name
            for path in made.rglob("*")
            if path.is_file() and path.name != "sample.json" and path.stat().st_mode & 0o077
        ]
    assert open_to_others == []
    assert stat.S_IMODE(made.stat().st_mode) == 0o700


@pytest.mark.parametrize("asked", [signal.SIGINT, signal.SIGTERM])
def test_it_stops_when_it_is_asked_to(asked: signal.Signals, laptop: Laptop) -> None:
    laptop.run("server", "init", "lab")
    with laptop.serving("lab") as server:
        server.process.send_signal(asked)
        assert server.process.wait(PATIENCE) == 0
        assert "Traceback" not in server.log.read_text()


def test_two_servers_in_one_folder_keep_one_quota(laptop: Laptop) -> None:
    with laptop.serving() as first:
        (token,) = {*TOKEN.findall(first.said)}
        with laptop.serving() as second, ThreadPoolExecutor(8) as pool:
            servers = (first, second) * 4
            replies = pool.map(
                lambda numbered: numbered[1].upload(
                    token, "test", submission_for(PRIVATE) + b" " * numbered[0]
                ),
                enumerate(servers),
            )
            assert sorted(reply.status_code for reply in replies) == [201] * 2 + [429] * 6
    assert "fault" not in laptop.run("server", "doctor", "reverie-eval-server").out


# Making a server.


def test_a_folder_with_something_in_it_is_left_alone(tmp_path: Path, run: Run) -> None:
    (tmp_path / "thesis.tex").touch()
    outcome = run("server", "init", str(tmp_path))
    assert (outcome.status, outcome.out) == (1, "")
    assert "is not empty" in outcome.err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_server_is_not_made_twice(lab: str, run: Run) -> None:
    before = (Path(lab) / "signing-key.pem").read_bytes()
    assert run("server", "init", lab).err == (
        "reverie-eval: folder rejected, 1 problem\n"
        f"{lab}: already contains a server; choose a new or an empty folder\n"
    )
    assert (Path(lab) / "signing-key.pem").read_bytes() == before


@pytest.mark.parametrize("name", ["a?b", "a#b%20c", "sqlite:", "?mode=memory", "50%"])
def test_a_folder_may_have_any_name(
    name: str, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    made = run("server", "init", name)
    assert made.status == 0
    assert TOKEN.search(made.out)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name / "server.db").stat().st_size
    assert run("server", "doctor", "--quick", name).status == 0


def test_an_empty_folder_is_filled_in_its_place(laptop: Laptop) -> None:
    """It may be a disk of its own, or all that one may write to."""
    place = laptop.folder / "disk"
    place.mkdir()
    laptop.folder.chmod(0o500)
    made = laptop.like_anybody("server", "init", "disk")
    laptop.folder.chmod(0o700)
    assert made.status == 0, made.err
    assert [path.name for path in place.iterdir() if path.name.startswith(".")] == []
    assert [*laptop.folder.iterdir()] == [place]


def test_a_database_of_another_server_is_not_joined(
    database: str, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", database)
    outcome = run("server", "init", str(tmp_path / "second"))
    assert outcome.status == 1
    assert "database: is not empty" in outcome.err
    assert not (tmp_path / "second").exists()


def test_settings_by_variables_are_used(
    empty_database: str, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", empty_database)
    assert run("server", "init", str(tmp_path / "lab")).status == 0
    assert not (tmp_path / "lab" / "server.db").exists()
    assert "Organiser" in run("server", "person", "list", str(tmp_path / "lab")).out


# People and tokens.


def test_a_submission_is_reviewed(lab: str, run: Run, tmp_path: Path) -> None:
    (tmp_path / "walk.json").write_bytes(submission_for(PRIVATE))
    run("server", "team", "add", lab, "Blue")
    run("server", "person", "add", lab, "Ada", "--team", "Blue")
    sent = ["--split", "test", "--team", "Blue", "--person", "Ada", "--publish"]
    run(
        "server",
        "submit",
        lab,
        str(tmp_path / "walk.json"),
        *sent,
        "--received",
        "2026-06-01T00:00:00Z",
    )
    _, row = run("server", "submissions", lab, "--team", "Blue", "--split", "test").out.splitlines()
    submission, *others = row.split()
    assert others == ["2026-06-01", "00:00", "test", "Blue", "Ada", "walk", "published"]
    assert len(run("server", "submissions", lab, "--split", "val_seen").out.splitlines()) == 1

    words = [submission, "disqualified", "--reason", "It read the answers."]
    assert run("server", "review", "add", lab, *words).out == (
        f"review 1: {submission} is disqualified\n"
    )
    assert run("server", "review", "lift", lab, "1").out == "review 1 lifted\n"
    _, listed = run("server", "review", "list", lab).out.splitlines()
    assert listed.split()[3:8] == [submission, "disqualified", "It", "read", "the"]
    assert len(listed.split()) == 11  # the last two: when it was lifted
    for wrong, said in (
        (["add", lab, "none", "flagged", "--reason", "x"], "no submission 'none'"),
        (["add", lab, submission, "bad", "--reason", "x"], "unknown value 'bad'"),
        (["lift", lab, "1"], "review 1 was already lifted"),
    ):
        outcome = run("server", "review", *wrong)
        assert (outcome.status, said in outcome.err) == (2, True)


def test_people_tokens_and_grants_are_listed(lab: str, run: Run) -> None:
    run("server", "team", "add", lab, "Blue")
    run("server", "person", "add", lab, "Ada", "--team", "Blue")
    token = run("server", "token", "add", lab, "Ada", "--expires-days", "30")
    invitation = run("server", "token", "invite", lab, "Ada")
    for shown in (token, invitation):
        assert TOKEN.fullmatch(shown.out.strip())
        assert "of Ada, until 20" in shown.err
    teams = run("server", "team", "list", lab).out.splitlines()
    assert re.fullmatch(r"Blue +\d+ +\d{4}-\d\d-\d\d \d\d:\d\d +Ada", teams[1])
    assert re.search(
        r"^Ada +Blue +participant ", run("server", "person", "list", lab).out, re.MULTILINE
    )
    tokens = run("server", "token", "list", lab).out
    (hint,) = (line.split()[0] for line in tokens.splitlines() if token.out.startswith(line[:6]))
    assert token.out.startswith(hint)
    assert re.search(rf"^{hint} +access +Ada .* valid$", tokens, re.MULTILINE)
    assert token.out.strip() not in tokens
    assert f"{hint} of Ada revoked" in run("server", "token", "revoke", lab, hint).out
    assert re.search(rf"^{hint} .* revoked$", run("server", "token", "list", lab).out, re.MULTILINE)


def test_a_team_is_renamed(lab: str, run: Run) -> None:
    run("server", "team", "add", lab, "Blue")
    outcome = run("server", "team", "rename", lab, "Blue", "Azure")
    assert outcome.out == "team Blue renamed to Azure\n"
    assert "\nAzure " in run("server", "team", "list", lab).out
    assert "there is no team 'Blue'" in run("server", "team", "rename", lab, "Blue", "Azure").err


@pytest.mark.parametrize(
    ("kind", "name", "revoked"),
    [
        pytest.param("person", "Ada", ["Ada", "Ada"], id="of a person"),
        pytest.param("team", "Blue", ["Ada", "Ada", "Ben"], id="of a team"),
    ],
)
def test_all_tokens_are_revoked_at_once(
    kind: str, name: str, revoked: list[str], lab: str, run: Run
) -> None:
    for team, person in (("Blue", "Ada"), ("Blue", "Ben"), ("Red", "Carl")):
        run("server", "team", "add", lab, team)
        run("server", "person", "add", lab, person, "--team", team)
        run("server", "token", "add", lab, person)
    run("server", "token", "invite", lab, "Ada")
    outcome = run("server", kind, "revoke", lab, name)
    assert outcome.out == f"{name}: {len(revoked)} tokens revoked\n"
    rows = [row.split() for row in run("server", "token", "list", lab).out.splitlines()[1:]]
    assert sorted(row[2] for row in rows if row[-1] != "valid") == revoked
    assert run("server", "audit", lab).out.count("token revoked") == len(revoked)
    assert run("server", kind, "revoke", lab, name).out == f"{name}: 0 tokens revoked\n"


@pytest.mark.parametrize(
    ("command", "told"),
    [
        pytest.param("team add {} Blue", "'Blue' belongs to another team", id="team twice"),
        pytest.param(
            "person add {} Ada --team Blue", "already has a person 'Ada'", id="person twice"
        ),
        pytest.param("person add {} Eve --team Green", "there is no team 'Green'", id="no team"),
        pytest.param("token add {} Eve", "there is no person 'Eve'", id="no person"),
        pytest.param("token invite {} Eve", "there is no person 'Eve'", id="nobody to invite"),
        pytest.param("token revoke {} rv_00000", "`server token list` lists all", id="no token"),
        pytest.param("team revoke {} Green", "there is no team 'Green'", id="nobody's tokens"),
        pytest.param("person revoke {} Eve", "there is no person 'Eve'", id="nobody's token"),
        pytest.param("grant {} Green test 1 --reason x", "no team 'Green'", id="grant to nobody"),
        pytest.param("grant {} Blue train 1 --reason x", "no split 'train'", id="grant of nothing"),
        pytest.param("news remove {} x", "'x' is not a valid whole number", id="no number"),
        pytest.param(
            "phase set {} test a --closes soon", "'soon' is not a day or a time", id="no time"
        ),
        pytest.param("submissions {} --team Green", "no team 'Green'", id="nobody's submissions"),
        pytest.param("submissions {} --split tset", "no split 'tset'", id="submissions to nothing"),
        pytest.param("notify {}", "add one to ", id="no way to notify"),
    ],
)
def test_what_is_not_there_is_named(command: str, told: str, lab: str, run: Run) -> None:
    run("server", "team", "add", lab, "Blue")
    run("server", "person", "add", lab, "Ada", "--team", "Blue")
    outcome = run("server", *command.format(lab).split())
    assert (outcome.status, outcome.out) == (2, "")
    assert told in outcome.err


@pytest.mark.parametrize("number", ["10001", "9" * 23])
def test_nobody_is_given_more_than_can_be_counted(number: str, lab: str, run: Run) -> None:
    run("server", "team", "add", lab, "Blue")
    outcome = run("server", "grant", lab, "Blue", "test", number, "--reason", "x")
    assert (outcome.status, outcome.out) == (2, "")
    assert "is not in the range 1<=x<=10000" in outcome.err
    assert run("server", "grant", lab, "Blue", "test", "10000", "--reason", "x").status == 0


@pytest.mark.parametrize(
    "command",
    [
        pytest.param("token add {} Ada --expires-days", id="token"),
        pytest.param("token invite {} Ada --expires-days", id="invitation"),
        pytest.param("grant {} Blue test 1 --reason x --days", id="grant"),
    ],
)
def test_an_end_is_no_more_than_a_hundred_years_away(command: str, lab: str, run: Run) -> None:
    run("server", "team", "add", lab, "Blue")
    run("server", "person", "add", lab, "Ada", "--team", "Blue")
    words = command.format(lab).split()
    for days in ("36501", "3600000", "9" * 23):
        status, _, err = run("server", *words, days)
        assert status == 2
        assert f"{days} is not in the range 1<=x<=36500" in err
    assert run("server", *words, "36500").status == 0


def test_the_audit_log_says_who_did_what(lab: str, run: Run) -> None:
    run("server", "team", "add", lab, "Blue")
    run("server", "grant", lab, "Blue", "test", "3", "--reason", "the power failed", "--days", "2")
    (added, granted) = run("server", "audit", lab).out.splitlines()[1:]
    assert "(command line)" in added
    assert "team added" in added
    assert "reason: the power failed" in granted
    entries = json.loads(run("server", "audit", lab, "--format", "json").out)
    assert [entry["action"] for entry in entries] == ["team added", "granted"]
    assert entries[1]["previous"] == entries[0]["digest"]


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (["team", "add", "LAB", ""], "name: must have 1 or more characters"),
        (["team", "rename", "LAB", "Blue", "a\nb"], "name: must be one line without invisible"),
        (["person", "add", "LAB", "x" * 101, "--team", "Blue"], "name: must have at most 100"),
        (["grant", "LAB", "Blue", "test", "1", "--reason", " "], "reason: must have 1 or more"),
    ],
)
def test_a_wrong_value_is_named_with_its_field(
    command: list[str], told: str, lab: str, run: Run
) -> None:
    run("server", "team", "add", lab, "Blue")
    before = run("server", "audit", lab).out
    outcome = run("server", *(lab if word == "LAB" else word for word in command))
    assert (outcome.status, outcome.out) == (2, "")
    assert outcome.err.startswith(f"reverie-eval: {told}")
    assert "pydantic" not in outcome.err
    assert run("server", "audit", lab).out == before
