"""A server's folder, which contains everything that the server needs.

::

    reverie-eval.toml     the organiser's settings
    signing-key.pem       signs receipts
    bundles/              ground truth, readable only by its owner
    server.db             the SQLite file, unless the database is elsewhere
    uploads/              every accepted file, by its SHA-256
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from datetime import datetime
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment

from reverie_eval.errors import Problem, RejectedError
from reverie_eval.files import staged_folder
from reverie_eval.ground_truth import DEMO_BUNDLES, bundle_folder, bundle_name
from reverie_eval.schemas.organising import NewPerson, NewTeam, NewToken
from reverie_eval.server.accounts.people import add_person, add_team
from reverie_eval.server.accounts.tokens import create_token
from reverie_eval.server.audit.signing import make_key
from reverie_eval.server.opening import acting, check_known
from reverie_eval.server.settings import SETTINGS_FILE, Settings, load_settings
from reverie_eval.server.store.database import Database
from reverie_eval.tasks import DEFAULT_TASK, Task, find_task
from reverie_eval.tasks.reverie import TASK as REVERIE

SIGNING_KEY = "signing-key.pem"
FIRST_TEAM = "Organisers"
FIRST_PERSON = "Organiser"

_OWNER_ONLY = 0o600
_BUNDLES = Path("bundles")


class FolderTakenError(RejectedError):
    """The folder for a new server is not empty."""

    subject = "folder"


class DatabaseTakenError(RejectedError):
    """The database for a new server is not empty."""

    subject = "database"


def make_server(
    folder: Path, *, now: datetime, actor: str, tasks: Sequence[str] = (DEFAULT_TASK,)
) -> str:
    """Make a server's folder with one organiser, and return the organiser's token.

    Raises
    ------
    FolderTakenError, DatabaseTakenError
        If the folder, or the database that an environment variable names, is not empty.
    ProtocolError
        If there is no such task.
    """
    found = [find_task(name) for name in dict.fromkeys(tasks)]
    with building(folder) as aside:
        fill(aside, found)
        return _add_first_organiser(aside, now=now, actor=actor)


def fill(folder: Path, tasks: Sequence[Task] = (REVERIE,)) -> None:
    """Fill a folder with a server on the demo world, without teams or people."""
    for task in tasks:
        bundles = folder / bundle_folder(_BUNDLES, task.name)
        bundles.mkdir(mode=0o700, parents=True, exist_ok=True)
        for split, bundle in _demo_splits(task).items():
            target = bundles / bundle_name(split, public=False)
            shutil.copyfile(bundle, target)
            target.chmod(_OWNER_ONLY)
    make_key(folder / SIGNING_KEY)
    (folder / SETTINGS_FILE).write_text(_settings_for(tasks), encoding="utf-8")
    (folder / SETTINGS_FILE).chmod(_OWNER_ONLY)  # the database's URL may contain a password
    check_empty(load_settings(folder))
    upgrade_folder(folder)


def _demo_splits(task: Task) -> Mapping[str, Path]:
    """Return a task's bundles of the demo world; tasks of other packages have none."""
    demo = bundle_folder(DEMO_BUNDLES, task.name)
    places = {"test": demo / "private", "val_seen": demo, "val_unseen": demo}
    bundles = {split: place / bundle_name(split, public=False) for split, place in places.items()}
    return {split: bundle for split, bundle in bundles.items() if bundle.is_file()}


def _settings_for(tasks: Sequence[Task]) -> str:
    """Return the settings of a server with the splits of some tasks."""
    template = (files("reverie_eval.server") / "template.toml").read_text(encoding="utf-8")
    environment = Environment(trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)  # noqa: S701  # not HTML
    return environment.from_string(template).render(
        tasks=tasks,
        default=DEFAULT_TASK,
        folder_of=lambda task: bundle_folder(_BUNDLES, task.name).as_posix(),
        splits_of=lambda task: list(_demo_splits(task)) or ["test"],
    )


def _add_first_organiser(folder: Path, *, now: datetime, actor: str) -> str:
    with acting(load_settings(folder), actor, lambda: now) as transaction:
        add_team(transaction, NewTeam(name=FIRST_TEAM))
        add_person(transaction, NewPerson(team=FIRST_TEAM, name=FIRST_PERSON, role="organiser"))
        return create_token(transaction, NewToken(person=FIRST_PERSON, kind="access")).token


def check_empty(settings: Settings) -> None:
    """Check that a database is empty. Raises DatabaseTakenError if it is not."""
    with closing(Database(settings.database_url)) as database:
        if database.revision() is not None:
            remedy = "is not empty; create a new one and set REVERIE_EVAL_DATABASE to its URL"
            raise DatabaseTakenError([Problem("database-taken", "database", remedy)])


@contextmanager
def building(folder: Path) -> Iterator[Path]:
    """Build a server's folder in a temporary place; it appears complete, or not at all.

    Raises
    ------
    FolderTakenError
        If the folder is not empty.
    """
    place = folder.absolute()
    if place.exists() and any(place.iterdir()):
        is_server = (place / SETTINGS_FILE).exists()
        kind = "already contains a server" if is_server else "is not empty"
        remedy = f"{kind}; choose a new or an empty folder"
        raise FolderTakenError([Problem("folder-taken", str(folder), remedy)])
    # The settings file is written last: a folder that has it is a server's.
    with staged_folder(folder, mode=0o700, last=SETTINGS_FILE) as aside:
        yield aside
        if place.exists():
            place.chmod(0o700)


def upgrade_folder(folder: Path) -> None:
    """Upgrade a server's database. Raises FolderError if it was made by a later version."""
    with closing(Database(load_settings(folder).database_url)) as database:
        check_known(database)
        make_private(database)
        database.upgrade()


def make_private(database: Database) -> None:
    """Create a missing SQLite file so that other users cannot read it."""
    if database.is_sqlite:
        Path(str(database.engine.url.database)).touch(_OWNER_ONLY)
