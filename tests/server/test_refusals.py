"""What keeps an organiser's commands from what they are to do, each named with its remedy."""

import shutil
import socket
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import click
import pytest

from reverie_eval.ground_truth import Bundle
from reverie_eval_cli.main import program
from tests.conftest import SAMPLES
from tests.support.flat_world import Run
from tests.support.processes import Laptop

SETTINGS = "reverie-eval.toml"


def no_bundle(folder: Path) -> None:
    (folder / "bundles" / "test.npz").unlink()


def readable_solution(folder: Path) -> None:
    (folder / "bundles" / "test.npz").chmod(0o640)


def public_solution(folder: Path) -> None:
    """Compile the open split's solution under the private split's name."""
    bundles = folder / "bundles"
    bundle = Bundle.load(bundles / "val_unseen.npz")
    (bundles / "test.npz").unlink()
    replace(bundle, header=replace(bundle.header, split="test")).save(bundles / "test.npz")


def open_key(folder: Path) -> None:
    (folder / "signing-key.pem").chmod(0o644)


def no_key(folder: Path) -> None:
    (folder / "signing-key.pem").unlink()


def no_database(folder: Path) -> None:
    (folder / "server.db").unlink()


def damaged_database(folder: Path) -> None:
    (folder / "server.db").write_bytes(b"x" * 8192)


def later_database(folder: Path) -> None:
    with closing(sqlite3.connect(folder / "server.db")) as database, database:
        database.execute("UPDATE alembic_version SET version_num = '9999'")


def unknown_keys(folder: Path) -> None:
    with (folder / SETTINGS).open("a") as settings:
        settings.write("spead = 9\n[splits.train]\nvisability = 'open'\n")


def default_secret(folder: Path) -> None:
    settings = folder / SETTINGS
    password = '"postgresql+psycopg://someone:postgres@localhost:1/none"'
    settings.write_text(settings.read_text().replace('"sqlite:///server.db"', password))


TROUBLES = [
    pytest.param([no_bundle], ["reverie-eval compile"], id="no bundle"),
    pytest.param([readable_solution], ["chmod 600"], id="solution others can read"),
    pytest.param(
        [public_solution],
        ["splits.test.bundle", "has the solution of the open split val_unseen"],
        id="solution of an open split",
    ),
    pytest.param([open_key], ["chmod 600"], id="key others can read"),
    pytest.param([no_key], ["restore it from the backup"], id="no key"),
    pytest.param([no_database], ["reverie-eval server upgrade"], id="no database"),
    pytest.param([damaged_database], ["file is not a database"], id="damaged database"),
    pytest.param([later_database], ["install the latest"], id="later version"),
    pytest.param([default_secret], ["easy to guess", "connection"], id="default secret"),
    pytest.param(
        [unknown_keys],
        ["spead: is not a setting", "visability: is not a setting"],
        id="unknown keys",
    ),
    pytest.param(
        [no_bundle, open_key, later_database],
        ["reverie-eval compile", "chmod 600", "install the latest"],
        id="all at once",
    ),
]


@pytest.mark.parametrize(("troubles", "told"), TROUBLES)
def test_a_server_refuses_to_start_and_says_why(
    troubles: list[Callable[[Path], object]], told: list[str], folder: Path, run: Run
) -> None:
    for trouble in troubles:
        trouble(folder)
    for options in ([], ["--quick"]):
        checked = run("server", "doctor", str(folder), *options)
        assert checked.status == 1
        assert [remedy for remedy in told if remedy not in checked.out] == []
    served = run("serve", str(folder), "--port", "0")
    assert (served.status, served.out) == (1, "")
    assert [remedy for remedy in told if remedy not in served.err] == []


EVERY_COMMAND = """
upgrade {}
team add {} Blue
team list {}
team merge {} Blue Red --yes
team rename {} Blue Red
team revoke {} Blue
person add {} Ada --team Blue
person delete {} Ada --yes
person edit {} Ada --name Bea
person export {} Ada
person import {} {file}
person list {}
person revoke {} Ada
request accept {} 1
request list {}
request reject {} 1
token add {} Ada
token invite {} Ada
token list {}
token revoke {} rv_12345
grant {} Blue test 1 --reason why
submit {} {file} --split test --team Blue --person Ada --received 2026-01-01T00:00:00Z
submissions {}
inspect {} 0123456789abcdef
evidence {} test
review add {} 0123456789abcdef verified --reason why
review lift {} 1
review list {}
rescore {} test --reason why
phase close {} test
phase pause {} test
phase reset {} test
phase resume {} test
phase set {} test always
phase show {}
news add {} Welcome
news banner {} Welcome
news list {}
news remove {} 1
snapshot {} test --title First
import {} {file} --split test --source paper
reported edit {} 1 team=Blue
reported list {}
reported remove {} 1
export codabench {} --split test --image image -o {}.out
export evalai {} -o {}.out
export site {} -o {}.out
export submissions {} test -o {}.out
export tables {} -o {}.out
doctor {}
doctor --quick {}
audit {}
key list {}
key revoke {} 0123456789abcdef --since 2026-01-01T00:00:00Z --reason why
key rotate {}
backup {} -o {}.out
""".strip().splitlines()
WITHOUT_A_DATABASE = {"init", "restore", "notify"}
"""The first two make one, and the last sends a message as the settings say."""


def words_of(row: str, folder: Path) -> Sequence[str]:
    file = str(SAMPLES / "good.json")
    return [word.replace("{}", str(folder)).replace("{file}", file) for word in row.split()]


def commands_below(command: click.Command, *words: str) -> Iterator[str]:
    """Yield the words of each command, as one text."""
    if not isinstance(command, click.Group):
        yield " ".join(words)
        return
    context = click.Context(command)
    for name in command.list_commands(context):
        below = command.get_command(context, name)
        assert below is not None
        yield from commands_below(below, *words, name)


def test_every_command_is_tried() -> None:
    """A new one has no door to its action before it has a row here."""
    context = click.Context(program)
    server = program.get_command(context, "server")
    assert server is not None
    tried = {row.partition(" {")[0].removesuffix(" --quick") for row in EVERY_COMMAND}
    assert tried | WITHOUT_A_DATABASE == set(commands_below(server))


LATER, REMOVED, DAMAGED = (
    (later_database, "install the latest reverie-eval"),
    (shutil.rmtree, "reverie-eval server init"),
    (damaged_database, "file is not a database"),
)


@pytest.mark.parametrize(
    ("command", "trouble", "told"),
    [
        *((command, *LATER) for command in EVERY_COMMAND),
        *((command, *trouble) for command in EVERY_COMMAND[::9] for trouble in (REMOVED, DAMAGED)),
    ],
)
def test_every_command_says_what_keeps_it(
    command: str, trouble: Callable[[Path], object], told: str, folder: Path, run: Run
) -> None:
    trouble(folder)
    outcome = run("server", *words_of(command, folder))
    assert outcome.status in (1, 2)
    assert told in outcome.out + outcome.err
    assert not folder.with_name(f"{folder.name}.out").exists()


def test_a_locked_database_is_named(lab: str, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from reverie_eval.server.store import database

    impatient = [p.replace("30000", "10") for p in database._SQLITE_PRAGMAS]  # noqa: SLF001
    monkeypatch.setattr(database, "_SQLITE_PRAGMAS", impatient)
    with closing(sqlite3.connect(Path(lab) / "server.db")) as other:
        other.execute("BEGIN IMMEDIATE")
        outcome = run("server", "team", "add", lab, "Blue")
        assert (outcome.status, outcome.out) == (2, "")
        assert "database is locked" in outcome.err
        assert run("server", "team", "list", lab).status == 0
    assert run("server", "team", "add", lab, "Blue").status == 0


def test_a_full_disk_is_named_and_leaves_nothing(laptop: Laptop) -> None:
    """A limit on the size of files stands for the disk."""
    limited = (
        "import resource, sys\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))\n"
        "from reverie_eval_cli.main import main\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    made = subprocess.run(
        [sys.executable, "-c", limited, "server", "init", "lab"],
        cwd=laptop.folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (made.returncode, made.stdout) == (2, "")
    assert "Traceback" not in made.stderr
    assert made.stderr.startswith("reverie-eval: ")
    assert list(laptop.folder.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "told"),
    [
        pytest.param(("server", "init", "closed/lab"), "closed", id="init"),
        pytest.param(("server", "backup", "lab", "-o", "closed/b"), "closed", id="backup"),
        pytest.param(("server", "team", "add", "lab", "Blue"), "readonly", id="team add"),
        pytest.param(("server", "upgrade", "lab"), "readonly", id="upgrade"),
    ],
)
def test_a_read_only_folder_is_named(words: tuple[str, ...], told: str, laptop: Laptop) -> None:
    laptop.run("server", "init", "lab")
    (laptop.folder / "closed").mkdir(mode=0o500)
    (laptop.folder / "lab" / "server.db").chmod(0o400)
    (laptop.folder / "lab").chmod(0o500)
    tried = laptop.like_anybody(*words)
    (laptop.folder / "lab").chmod(0o700)
    assert tried.status in (1, 2)
    assert told in tried.err
    assert "Traceback" not in tried.err


def test_a_port_that_is_taken_is_named(lab: str, run: Run) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        served = run("serve", lab, "--port", str(port))
    assert served.status == 2
    assert f"cannot listen at 127.0.0.1, port {port}: address already in use" in served.err


@pytest.mark.parametrize("port", ["65536", "-1", "http"])
def test_what_is_no_port_is_refused(port: str, lab: str, run: Run) -> None:
    assert run("serve", lab, "--port", port).status == 2


def test_a_database_s_password_is_never_shown(
    folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret = "correct-horse"
    address = f"postgresql+psycopg://someone:{secret}@127.0.0.1:1/none"
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", address)
    for command in EVERY_COMMAND[::9]:
        outcome = run("server", *words_of(command, folder))
        assert outcome.status in (1, 2)
        assert secret not in outcome.out + outcome.err


def test_nor_the_password_of_its_key(
    folder: Path,
    postgresql: Callable[[], str],
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", f"{postgresql()}&sslpassword=correct-horse")
    assert run("server", "upgrade", str(folder)).status == 0
    checked = run("server", "doctor", "--quick", str(folder))
    assert checked.status == 0
    assert "postgresql+psycopg://" in checked.out
    assert "correct-horse" not in checked.out


def test_uploads_that_are_no_folder_are_named(folder: Path, run: Run) -> None:
    (folder / "uploads").touch()
    checked = run("server", "doctor", "--quick", str(folder))
    assert checked.status == 1
    assert "uploads: Not a directory; choose a folder that the server can write to" in checked.out


def test_uploads_that_cannot_be_written_are_named(laptop: Laptop) -> None:
    laptop.run("server", "init", "lab")
    (laptop.folder / "lab" / "uploads").mkdir()
    assert laptop.run("server", "doctor", "--quick", "lab").status == 0
    (laptop.folder / "lab" / "uploads").chmod(0o500)
    checked = laptop.like_anybody("server", "doctor", "--quick", "lab")
    assert checked.status == 1
    assert "uploads: Permission denied; choose a folder that the server" in checked.out


NO_STORE = "s3://kept: Could not connect to the endpoint URL"
NO_BOTO3 = "pip install 'reverie-eval[s3]'"


@pytest.fixture(params=[NO_STORE, NO_BOTO3], ids=["store is down", "boto3 is not there"])
def no_store(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Set the uploads to a store that cannot be used, and return what is said of it."""
    monkeypatch.setenv("REVERIE_EVAL_UPLOADS", "s3://kept")
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", "http://127.0.0.1:1")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "test")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "test")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    if request.param == NO_BOTO3:
        monkeypatch.setitem(sys.modules, "boto3", None)
    told: str = request.param
    return told


def test_a_store_that_cannot_be_used_is_named(
    used: Path, archive: Path, no_store: str, tmp_path: Path, run: Run
) -> None:
    checked = run("server", "doctor", "--quick", str(used))
    assert (checked.status, no_store in checked.out) == (1, True)
    there = tmp_path / "there"
    for words in (["backup", str(used), "-o", str(there)], ["restore", str(archive), str(there)]):
        outcome = run("server", *words)
        assert (outcome.status, outcome.out) == (2, "")
        assert no_store in outcome.err
        assert outcome.err.startswith("reverie-eval: ")
        assert outcome.err.count("\n") == 1
        assert "database" not in outcome.err
        assert not there.exists()
