"""The database is durable and strict, writers take turns, and migrations keep every row."""

import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import URL, event, inspect, make_url, select, text
from sqlalchemy.exc import IntegrityError, StatementError

from reverie_eval import ReverieEvalError
from reverie_eval.server.accounts.people import person_named
from reverie_eval.server.errors import ConflictError
from reverie_eval.server.opening import database_errors
from reverie_eval.server.store import database as database_module
from reverie_eval.server.store.database import MIGRATIONS, Database, known_revisions
from reverie_eval.server.store.tables import Base, Person, Team
from tests.support.acting import NOON, acting, add_person, add_team, create_token
from tests.support.waiting import PATIENCE, WatchedLock


def test_every_connection_to_sqlite_is_durable_and_strict(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path}/server.db")
    connections = [database.engine.connect() for _ in range(3)]
    try:
        for connection in connections:
            found = {
                name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
                for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
            }
            assert found == {
                "journal_mode": "wal",
                "synchronous": 2,  # FULL
                "foreign_keys": 1,
                "busy_timeout": 30_000,
            }
    finally:
        for connection in connections:
            connection.close()
        database.close()


@pytest.fixture
def opened(database: str) -> Iterator[Database]:
    """Open a database of each kind, with a team and a person in it."""
    opened = Database(database)
    with acting(opened) as transaction:
        add_team(transaction, "Blue")
        add_person(transaction, "Blue", "Ada")
        create_token(transaction, "Ada")
    yield opened
    opened.close()


RUNNING = "check that it is running, and `database` in the settings"


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        pytest.param(
            "INSERT INTO person (team_id, name, name_salt, role, created_at) "
            "VALUES (999, 'Eve', '', 'participant', '2026-03-02')",
            "(?i)foreign key constraint",
            id="refers to nothing",
        ),
        pytest.param("SELECT * FROM lost", "no such table|does not exist", id="no table"),
    ],
)
def test_only_a_database_that_does_not_answer_has_to_be_started(
    statement: str, said: str, opened: Database
) -> None:
    with pytest.raises(ReverieEvalError, match=said) as caught:
        run_statement(opened.engine.url, statement)
    assert RUNNING not in str(caught.value)
    assert "`reverie-eval server doctor` checks all stored data" in str(caught.value)


def test_a_database_that_does_not_answer_has_to_be_started(tmp_path: Path) -> None:
    with pytest.raises(ReverieEvalError, match=RUNNING):
        run_statement(make_url(f"postgresql+psycopg://nobody@/none?host={tmp_path}"), "SELECT 1")


def run_statement(url: URL, statement: str) -> None:
    """Run a statement as commands do."""
    with database_errors(), closing(Database(url)) as database, database.writing() as session:
        session.execute(text(statement))


def test_a_row_that_refers_to_nothing_is_refused(opened: Database) -> None:
    with pytest.raises(IntegrityError), opened.writing() as session:
        session.add(Person(team_id=999, name="Ben", role="participant", created_at=NOON))
    with opened.reading() as session:
        assert [person.name for person in session.scalars(select(Person))] == ["Ada"]


def test_a_failed_statement_does_not_quote_its_values(opened: Database) -> None:
    with pytest.raises(IntegrityError) as refused, opened.writing() as session:
        session.add(Person(team_id=999, name="1999999937", role="participant", created_at=NOON))
    assert "1999999937" not in str(refused.value)


def test_a_connection_that_broke_is_replaced(postgresql: Callable[[], str]) -> None:
    database, other = (Database(url) for url in [postgresql()] * 2)
    with closing(database), closing(other):
        with database.reading() as session:
            number = session.scalar(text("SELECT pg_backend_pid()"))
        with other.reading() as session:
            session.execute(text(f"SELECT pg_terminate_backend({number}, 10000)"))
        with database.reading() as session:
            assert session.scalar(text("SELECT 1")) == 1


def test_what_others_refer_to_stays(opened: Database) -> None:
    with pytest.raises(IntegrityError), opened.writing() as session:
        session.execute(text("DELETE FROM team"))


def test_writing_leaves_all_or_nothing(opened: Database) -> None:
    twice = "belongs to another team"
    with pytest.raises(ConflictError, match=twice), acting(opened) as transaction:
        _ = [add_team(transaction, name) for name in ("Red", "Blue")]  # type: ignore[func-returns-value]
    with opened.reading() as session:
        assert [team.name for team in session.scalars(select(Team))] == ["Blue"]


def test_writers_of_two_processes_take_turns(opened: Database) -> None:
    """The second sees what the first has left, however long that takes."""
    other = Database(opened.engine.url.render_as_string(hide_password=False))
    asked, inside = threading.Event(), threading.Event()
    seen: list[str] = []

    @event.listens_for(other.engine, "before_cursor_execute")
    def note(_: object, __: object, statement: str, *___: object) -> None:
        if "BEGIN IMMEDIATE" in statement or "pg_advisory_xact_lock" in statement:
            asked.set()

    def second() -> None:
        with other.writing() as session:
            inside.set()
            seen.extend(team.name for team in session.scalars(select(Team).order_by(Team.name)))

    thread = threading.Thread(target=second)
    with acting(opened) as transaction:
        thread.start()
        assert asked.wait(PATIENCE)
        assert not inside.wait(0.3)
        add_team(transaction, "Red")
    thread.join()
    other.close()
    assert seen == ["Blue", "Red"]


def test_writers_of_a_process_queue_before_they_come_to_the_database(
    sqlite: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite would let the one that waited longest come last."""
    came = threading.Event()
    monkeypatch.setattr(sqlite, "_write_lock", WatchedLock(came))
    begun: list[str] = []

    @event.listens_for(sqlite.engine, "before_cursor_execute")
    def note(_: object, __: object, statement: str, *___: object) -> None:
        if statement == "BEGIN IMMEDIATE":
            begun.append(threading.current_thread().name)
            came.set()

    def second() -> None:
        with sqlite.writing():
            pass

    thread = threading.Thread(target=second, name="second")
    with sqlite.writing():
        came.clear()
        thread.start()
        assert came.wait(PATIENCE)
        assert begun == [threading.current_thread().name]
    thread.join()
    assert begun == [threading.current_thread().name, "second"]


def test_readers_do_not_wait_for_a_writer(opened: Database) -> None:
    with acting(opened) as transaction:
        add_team(transaction, "Red")
        with opened.reading() as reading:
            assert [team.name for team in reading.scalars(select(Team))] == ["Blue"]


@pytest.mark.parametrize(
    "instant",
    [
        pytest.param(NOON, id="UTC"),
        pytest.param(NOON.astimezone(timezone(timedelta(hours=9, minutes=30))), id="elsewhere"),
        pytest.param(datetime(2028, 2, 29, 23, 59, 59, 999_999, UTC), id="leap day"),
    ],
)
def test_an_instant_comes_back_as_it_was_and_in_utc(opened: Database, instant: datetime) -> None:
    with opened.writing() as session:
        session.add(Team(name="Red", created_at=instant))
    with opened.reading() as session:
        found = session.scalars(select(Team.created_at).where(Team.name == "Red")).one()
    assert (found, found.tzinfo) == (instant, UTC)


def test_a_time_without_a_zone_is_refused(opened: Database) -> None:
    with pytest.raises(StatementError, match="has no time zone"), opened.writing() as session:
        session.add(Team(name="Red", created_at=datetime(2026, 1, 1)))  # noqa: DTZ001


def test_migrations_make_the_tables_of_the_models(database: str) -> None:
    fresh = Database(database)
    with fresh.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
    assert fresh.is_current()
    fresh.close()


def test_migrations_are_known_by_the_names_of_their_files() -> None:
    walked = ScriptDirectory(str(MIGRATIONS)).walk_revisions()
    assert known_revisions() == [script.revision for script in walked][::-1]


def test_to_upgrade_twice_changes_nothing(opened: Database) -> None:
    opened.upgrade()
    with opened.reading() as session:
        assert person_named(session, "Ada").team.name == "Blue"


LATER = """
import sqlalchemy as sa
from alembic import op

revision = "9999"
down_revision = {last!r}


def upgrade() -> None:
    with op.batch_alter_table("team", recreate="auto") as team:
        team.add_column(sa.Column("country", sa.String(2), nullable=False, server_default="??"))
        team.alter_column("name", type_=sa.String(200))
    {further}
"""
"""A step that makes SQLite write the table anew, to which persons refer."""


def with_a_later_step(tmp_path: Path, last: str | None, further: str = "") -> Path:
    """Return the migrations with one more behind them."""
    copy = Path(shutil.copytree(MIGRATIONS, tmp_path / "migrations"))
    (copy / "versions" / "9999_later.py").write_text(LATER.format(last=last, further=further))
    return copy


def test_a_later_step_keeps_every_row(
    opened: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = with_a_later_step(tmp_path, opened.revision())
    monkeypatch.setattr(database_module, "MIGRATIONS", copy)
    assert not opened.is_current()
    opened.upgrade()
    assert opened.is_current()
    with opened.reading() as session:
        assert person_named(session, "Ada").team.name == "Blue"
        assert session.scalar(text("SELECT country FROM team")) == "??"
    test_a_row_that_refers_to_nothing_is_refused(opened)
    if opened.is_sqlite:
        with opened.engine.connect() as connection:
            assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar() == 1


@pytest.mark.parametrize("kind_of_database", ["sqlite"], indirect=True)
@pytest.mark.parametrize(
    ("further", "error"),
    [
        pytest.param("raise RuntimeError", RuntimeError, id="fails"),
        pytest.param('op.execute("DELETE FROM team")', ReverieEvalError, id="loses rows"),
    ],
)
def test_a_step_that_goes_wrong_changes_nothing(
    opened: Database,
    further: str,
    error: type[Exception],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    revision = opened.revision()
    monkeypatch.setattr(
        database_module, "MIGRATIONS", with_a_later_step(tmp_path, revision, further)
    )
    with pytest.raises(error):
        opened.upgrade()
    assert opened.revision() == revision
    assert "country" not in {each["name"] for each in inspect(opened.engine).get_columns("team")}
    with opened.reading() as session:
        assert person_named(session, "Ada").team.name == "Blue"


def test_looking_for_a_database_does_not_make_one(tmp_path: Path) -> None:
    absent = Database(f"sqlite:///{tmp_path}/absent.db")
    assert absent.revision() is None
    assert not absent.is_current()
    assert list(tmp_path.iterdir()) == []
