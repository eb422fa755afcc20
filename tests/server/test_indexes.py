"""No request looks through all submissions: each finds what it needs by an index.

A server with thousands of submissions is asked for everything that it shows, and the database for
its plan of every statement. ``docs/explanation/evidence.md`` lists the indexes that are used.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from sqlalchemy import Connection, event

from fixtures.many_submissions import SPLIT, fill
from reverie_eval.server.store.tables import Submission
from tests.conftest import REPOSITORY
from tests.server.test_statements import PAGES, READS, visitors_of
from tests.support.demo_site import BOLD, ENDLESS, Site
from tests.support.serving import GROUNDING, MATE, ORGANISER, OTHER, OWNER, Serving
from tests.support.visiting import Visitor, signed_in

EVIDENCE = (REPOSITORY / "docs" / "explanation" / "evidence.md").read_text()
SUBMISSIONS, PUBLISHED, TEAMS = 4_000, 40, 40
INDEXES = {str(index.name) for index in Submission.__table__.indexes}  # type: ignore[attr-defined]
PRIMARY_KEY = {"sqlite_autoindex_submission_1", "submission_pkey"}
FEW = re.compile(r"\b(id|team_id|person_id|sha256)\b")
"""Columns of which a value has few submissions; a split has very many."""
SHORT = {"shown"}
"""Indexes that have few submissions."""
READ_ALL = {
    "/organiser/splits/{split}/submissions.tar",
    "/desk/corrections",
}
"""What is about all submissions to a split: their files, or what each was scored by."""
COUNTS = re.compile(r"count\(|sum\(")


class Access(NamedTuple):
    """How a statement reads the table of submissions."""

    statement: str
    name: str
    """The index that it uses; empty if it reads the table from one end to the other."""
    is_search: bool
    """Whether it looks up few submissions in the index; else it reads much of the index."""
    is_index_only: bool

    @property
    def is_bounded(self) -> bool:
        """Whether it reads no more than it needs, or counts rows in an index."""
        is_count = self.is_index_only and COUNTS.search(self.statement) is not None
        is_beginning = self.name != "" and "LIMIT" in self.statement
        return self.is_search or is_beginning or is_count or self.name in SHORT


@pytest.fixture
def full(server_on: Serving) -> Serving:
    """Return a server on each kind of database, with thousands of submissions."""
    fill(server_on.state, SUBMISSIONS, PUBLISHED, TEAMS)
    if not server_on.state.database.is_sqlite:  # PostgreSQL does so by itself, before long
        engine = server_on.state.database.engine.execution_options(isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            connection.exec_driver_sql("VACUUM ANALYZE")
    return server_on


@contextmanager
def explaining(server: Serving) -> Iterator[list[Access]]:
    """Give how the statements that are made inside read the table of submissions."""
    made: list[tuple[str, Any]] = []
    accesses: list[Access] = []

    def note(_: Any, __: Any, statement: str, parameters: Any, *___: Any) -> None:
        if re.search(r"(FROM|JOIN) submission\b", statement):
            made.append((statement, parameters))

    engine = server.state.database.engine
    event.listen(engine, "before_cursor_execute", note)
    try:
        yield accesses
    finally:
        event.remove(engine, "before_cursor_execute", note)
    explain = _explain_sqlite if server.state.database.is_sqlite else _explain_postgresql
    with engine.connect() as connection:
        for statement, parameters in made:
            accesses += explain(connection, statement, parameters)


def _explain_sqlite(connection: Connection, statement: str, parameters: Any) -> Iterator[Access]:
    """Read the plan: https://www.sqlite.org/eqp.html ."""
    plan = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", parameters)
    pattern = re.compile(r"(?:SCAN|SEARCH) submission\b(?: USING (COVERING )?INDEX (\w+)(.*))?")
    for found in filter(None, (pattern.match(row.detail) for row in plan)):
        is_search = FEW.search(found[3] or "") is not None
        yield Access(statement, found[2] or "", is_search, found[1] is not None)


def _explain_postgresql(
    connection: Connection, statement: str, parameters: Any
) -> Iterator[Access]:
    """Read the plan: https://www.postgresql.org/docs/current/using-explain.html ."""
    explained = connection.exec_driver_sql(f"EXPLAIN (FORMAT JSON) {statement}", parameters)
    nodes: list[Any] = [explained.scalar_one()[0]["Plan"]]
    while nodes:
        node = nodes.pop()
        nodes += node.get("Plans", ())
        index, kind = node.get("Index Name", ""), node["Node Type"]
        is_ours = node.get("Relation Name") == "submission" or index in INDEXES | PRIMARY_KEY
        if is_ours and kind != "Bitmap Heap Scan":  # its indexes are nodes below it
            is_search = FEW.search(node.get("Index Cond", "")) is not None
            yield Access(statement, index, is_search, kind == "Index Only Scan")


@pytest.mark.slow
def test_no_request_reads_all_submissions(full: Serving) -> None:
    own, other = (
        full.upload(who, full.distinct()).json()["submission"]["id"] for who in (OWNER, OTHER)
    )
    parts = {"split": SPLIT, "submission_id": own, "board": GROUNDING, "number": 1}
    parts["person_id"] = full.person(OWNER).id
    names = {(SPLIT, "Walker"): own, (SPLIT, BOLD): other, (SPLIT, ENDLESS): other}
    site = Site("", Path(), full.tokens, names)
    visitors: dict[str | None, Visitor] = {None: Visitor(full)}
    visitors |= {who: signed_in(full, who) for who in (OWNER, OTHER, ORGANISER)}
    with explaining(full) as accesses:
        full.ask(OWNER, "GET", f"/splits/{SPLIT}/leaderboard")
        assert full.upload(OWNER, full.distinct(), key="mine").status_code == 201
        for who in (OWNER, ORGANISER):
            for path in set(READS) - READ_ALL:
                full.ask(who, "GET", path.format(**parts))
            (first, *_) = full.ask(who, "GET", "/submissions").json()
            full.ask(who, "GET", f"/submissions?cursor={first['id']}")
        for example in PAGES:
            if example.route + example.query not in READ_ALL:
                for visitor in visitors_of(example):
                    visitors[visitor].get(example.path(site))
    assert {each.name for each in accesses} & INDEXES
    assert [each for each in accesses if not each.is_bounded] == []


@pytest.mark.parametrize("kind_of_database", ["sqlite"], indirect=True)
def test_the_documented_indexes_are_used_and_there_are_no_others(full: Serving) -> None:
    reply = full.upload(MATE, full.distinct()).json()
    paths = {
        "A team's submissions": (OWNER, "/submissions"),
        "A submission": (OWNER, f"/submissions/{reply['submission']['id']}"),
        "All submissions": (ORGANISER, "/submissions"),
        "A leaderboard": (None, f"/splits/{SPLIT}/leaderboard"),
    }
    used = set()
    with explaining(full) as accesses:
        full.upload(OWNER, full.distinct(), key="mine")
    used |= documented("An upload", accesses)
    for name, (who, path) in paths.items():
        with explaining(full) as accesses:
            assert full.ask(who, "GET", path).status_code == 200
        used |= documented(name, accesses)
    full.upload(OWNER, full.distinct())
    with explaining(full) as accesses:
        full.ask(None, "GET", f"/splits/{SPLIT}/leaderboard")
    used |= documented("A leaderboard after an upload", accesses)
    organiser = signed_in(full, ORGANISER)
    with explaining(full) as accesses:
        assert organiser.get("/desk").status_code == 200
    used |= documented("The organiser's overview", accesses)
    assert used >= INDEXES


def documented(name: str, accesses: list[Access]) -> set[str]:
    """Check what the documentation says of a request, and return the indexes that it uses."""
    indexes = {"primary key" if each.name in PRIMARY_KEY else each.name for each in accesses}
    row = f"| {name} | {', '.join(f'`{index}`' for index in sorted(indexes))} |"
    assert row in EVIDENCE
    return indexes
