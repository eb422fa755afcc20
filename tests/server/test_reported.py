"""Reported results by the file and one by one: what is the same, what changes, what is refused."""

import json
import re
from collections.abc import Mapping
from math import inf
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy.orm import Session

from fixtures.published import published_folder
from reverie_eval.schemas.organising import ImportReport, NewImport, NewReported, ReportedChange
from reverie_eval.server.audit.log import entries
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.boards.reported import (
    add_reported,
    change_reported,
    find_reported,
    import_reported,
    list_reported,
    remove_reported,
    reported_of,
)
from reverie_eval.server.errors import ConflictError, MalformedError, NotFoundError, TableError
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.paging import Page
from reverie_eval.tasks import find_task
from tests.conftest import REPOSITORY, unavailable
from tests.server.test_reported_files import LEGACY
from tests.support.acting import NOON, acting
from tests.support.entries import entered, named
from tests.support.processes import Laptop
from tests.support.serving import OPEN, ORGANISER, PRIVATE, Serving

SOURCE = "An old leaderboard"
PAGE = "/organiser/reported"


def send(server: Serving, text: str, **more: object) -> httpx.Response:
    """Import a file."""
    new = {"split": OPEN, "source": SOURCE, "text": text, **more}
    return server.ask(ORGANISER, "POST", f"{PAGE}/import", json=new)


def counts(reply: httpx.Response) -> tuple[int, int, int]:
    """Return the number of rows in the file, and of those that were added or known."""
    assert reply.status_code == 200, reply.text
    report = reply.json()
    return report["rows"], len(report["added"]), report["known"]


def problems(reply: httpx.Response) -> list[str]:
    """Return what is wrong with a file, each with its place."""
    assert (reply.status_code, reply.json()["code"]) == (400, "malformed-request")
    return [f"{each['where']}: {each['message']}" for each in reply.json()["problems"]]


def listed(server: Serving) -> list[dict[str, Any]]:
    """Return all reported results, the earliest first."""
    found: list[dict[str, Any]] = server.ask(ORGANISER, "GET", PAGE).json()
    return found[::-1]


def test_a_file_goes_in_once(server_on: Serving) -> None:
    assert counts(send(server_on, LEGACY, dry_run=True)) == (2, 2, 0)
    assert listed(server_on) == []
    assert counts(send(server_on, LEGACY)) == (2, 2, 0)
    before = listed(server_on)
    assert [(each["team"], each["date"]) for each in before] == [
        ("Blue (Walker)", "2026-01"),
        ("Red", "2022-11"),
    ]
    assert before[0]["method"]["name"] == "Blue (Walker)"
    with server_on.state.database.reading() as session:
        logged = len(entries(session))
    assert counts(send(server_on, LEGACY)) == (2, 0, 2)
    assert listed(server_on) == before
    with server_on.state.database.reading() as session:
        assert len(entries(session)) == logged


def test_the_board_of_a_file_is_sorted_like_any_other(server: Serving) -> None:
    entered(server, {"rgspl": 0.1, "spl": 0.5}, **named("Ours"))
    send(server, LEGACY, dataset="v1")
    send(server, LEGACY.replace("Red", "Green"))
    board = server.ask(None, "GET", f"/splits/{OPEN}/leaderboard", params={"metric": "spl"}).json()
    assert [(row["rank"], row["method"]["name"], row["standing"]) for row in board["rows"]] == [
        (1, "Ours", "ranked"),
        (None, "Green", "reported"),
    ]
    assert [(row["team"], row["standing"], row["dataset"]) for row in board["apart"]] == [
        ("Blue (Walker)", "other-dataset", "v1"),
        ("Red", "other-dataset", "v1"),
    ]
    green = board["rows"][1]
    assert (green["source"], green["reported_date"]) == (SOURCE, "2022-11")
    assert {green["method"][flag] for flag in ("extra_data", "ensemble", "navigation_only")} == {
        None
    }
    lines = server.ask(None, "GET", f"/splits/{OPEN}/leaderboard.csv").text.splitlines()
    assert [line.split(",")[5] for line in lines[1:]] == ["Ours", "Green", "Blue (Walker)", "Red"]
    nothing = "," * 17
    assert f"Green{nothing}reported,,{SOURCE},2022-11,,," in lines[2]


ROWS = [
    pytest.param("team,method,SR\nBlue,Walker,5", {"team": "Blue"}, id="a team and a method"),
    pytest.param("method,SR\nWalker,5", {"team": "Walker"}, id="a method only"),
    pytest.param("team,SR,source\nWalker,5,Them", {"source": "Them"}, id="a source"),
    pytest.param("team,SR,dataset\nWalker,5,v2", {"dataset": "v2"}, id="a dataset"),
    pytest.param("team,SR,source\nWalker,5,", {"source": SOURCE}, id="no source of its own"),
    pytest.param("team,SR,date\nWalker,5,2026-01-31", {"date": "2026-01-31"}, id="a day"),
    pytest.param("team,SR,date\nWalker,5,1/2026", {"date": "2026-01"}, id="a month"),
    pytest.param("team,SR,date\nWalker,5,2026", {"date": "2026"}, id="a year"),
    pytest.param("team,SR,date\nWalker,5,", {"date": None}, id="no date"),
]


@pytest.mark.parametrize(("text", "expected"), ROWS)
def test_what_a_row_says(text: str, expected: Mapping[str, object], server: Serving) -> None:
    assert counts(send(server, text)) == (1, 1, 0)
    (result,) = listed(server)
    assert {name: result[name] for name in expected} == expected
    assert result["method"]["name"] == "Walker"


def test_flags_are_declared_or_not(server: Serving) -> None:
    send(server, "team,SR,extra_data,ensemble,pre_exploration\nWalker,5,yes,no,\n")
    (result,) = listed(server)
    flags = {"extra_data": True, "ensemble": False, "pre_exploration": None}
    assert {name: result["method"][name] for name in flags} == flags


PAPER = """{"columns": ["RGS"], "methods": {
    "Shortest": {"val_unseen": [60]}, "Walker": {"val_unseen": [35]}, "Human": {"val_unseen": [78]}
}}"""


def test_people_and_references_are_marked_and_not_charted_as_methods(server: Serving) -> None:
    """The shape of the paper's file has no column to say so."""
    reply = send(server, PAPER, human=["People"], reference=["Walker", "Short"])
    methods = "Shortest, Walker, Human"  # in the order of the file
    assert [(each["where"], each["message"]) for each in reply.json()["problems"]] == [
        ("human", f"no row is of the method 'People'; choose one of: {methods}"),
        (
            "reference",
            f"no row is of the method 'Short'; did you mean Shortest? Choose one of: {methods}",
        ),
    ]
    assert listed(server) == []
    assert counts(send(server, PAPER, human=["Human"], reference=["Shortest"])) == (3, 3, 0)
    marks = [(each["method"]["human"], each["method"]["reference"]) for each in listed(server)]
    assert marks == [(None, True), (None, None), (True, None)]
    chart = server.client.get(f"/splits/{OPEN}/chart").json()
    assert chart["lines"] == [{"name": "Human", "y": 78.0}, {"name": "Best reported", "y": 35.0}]


def test_everything_that_is_wrong_is_told_at_once_and_nothing_is_added(server: Serving) -> None:
    send(server, "team,SR,date\nKnown,5,2026\n")
    text = (
        "team,SR,date,extra_data,link\n"
        "Good,5,2026,,\n"
        "Bad,500,13/2026,perhaps,http://example.org\n"
        f"{'x' * 101},5,,,\n"
        ",5,,,\n"
        "Good,5,2026,,\n"
        "Good,6,2026,,\n"
        "Known,6,2026,,\n"
    )
    told = problems(send(server, text))
    assert [problem.split(":")[0] for problem in told] == [
        *(4 * ["line 3"]),
        *("line 4", "line 4", "line 5", "line 7", "line 8"),
    ]
    assert told[0] == "line 3: SR %: 500 is not from 0 to 100"
    assert {"found '13/2026'", "found 'perhaps'", "found 'http://example.org'"} == {
        problem.partition("; ")[2] for problem in told[1:4]
    }
    assert "neither a team nor a method" in told[6]
    assert "has other scores in line 2" in told[7]
    assert "is on the leaderboard with other scores" in told[8]
    assert [each["team"] for each in listed(server)] == ["Known"]


def test_rows_that_repeat_another_are_named(server: Serving) -> None:
    reply = send(server, "team,SR\nWalker,5\nRunner,6\nWalker,5\n")
    assert counts(reply) == (3, 2, 0)
    assert reply.json()["repeated"] == ["line 4 repeats line 2"]


def test_other_files_are_refused(server: Serving) -> None:
    assert send(server, LEGACY, split="train").status_code == 404
    assert send(server, "x" * 100_001).status_code == 400
    assert send(server, LEGACY, source="http://example.org").status_code == 400
    assert problems(send(server, "team,SRR\na,1"))[0].startswith("column 'SRR': unknown; did you")


# One by one.


def add(server: Serving, **changes: object) -> httpx.Response:
    """Add a result."""
    new = {
        "split": OPEN,
        "method": {"name": "Walker"},
        "team": "Blue",
        "scores": {"success": 0.5, "spl": 0.25},
        "source": SOURCE,
        **changes,
    }
    return server.ask(ORGANISER, "POST", PAGE, json=new)


def test_results_are_told_apart_by_split_team_method_and_date(server: Serving) -> None:
    for changes in ({}, {"team": "Red"}, {"date": "2026"}, {"split": PRIVATE}):
        assert add(server, **changes).status_code == 201
        assert add(server, **changes).json()["code"] == "conflict"


CHANGES = [
    pytest.param(
        {"team": "Red", "date": "01/2026"},
        {"team": "Blue", "date": None},
        {"team": "Red", "date": "2026-01"},
        id="team and date",
    ),
    pytest.param(
        {"method": {"ensemble": True}},
        {"method": {"ensemble": None}},
        {"method": {"ensemble": True}},
        id="a flag",
    ),
    pytest.param(
        {"scores": {"spl": None, "rgs": 0.125}},
        {"scores": {"spl": 0.25}},
        {"scores": {"rgs": 0.125}},
        id="scores",
    ),
]


@pytest.mark.parametrize(("change", "before", "after"), CHANGES)
def test_a_change_is_logged_with_what_was_there_before(
    change: Mapping[str, Any],
    before: Mapping[str, object],
    after: Mapping[str, object],
    server_on: Serving,
) -> None:
    added = add(server_on).json()
    changed = server_on.ask(ORGANISER, "PATCH", f"{PAGE}/{added['id']}", json=change)
    assert changed.status_code == 200
    assert listed(server_on) == [changed.json()]
    with server_on.state.database.reading() as session:
        last = entries(session)[-1]
    assert (last.action, last.subject) == ("reported result changed", "Walker")
    assert last.details == {"before": before, "after": after}
    logged = last.id
    server_on.ask(ORGANISER, "PATCH", f"{PAGE}/{added['id']}", json=change)
    with server_on.state.database.reading() as session:
        assert entries(session)[-1].id == logged  # nothing was left to change


@pytest.mark.parametrize(
    ("change", "status"),
    [
        pytest.param({"team": "Red"}, 409, id="to what another is"),
        pytest.param({"scores": {"success": None, "spl": None}}, 400, id="no score left"),
        pytest.param({"scores": {"success": 50}}, 400, id="out of bounds"),
        pytest.param({"scores": {"srr": 0.5}}, 400, id="no metric"),
        pytest.param({"date": "2026-13"}, 400, id="no month"),
        pytest.param({"date": "2026-02-30"}, 400, id="no day"),
        pytest.param({"team": ""}, 400, id="no team"),
        pytest.param({"split": PRIVATE}, 400, id="another split"),
    ],
)
def test_changes_that_are_refused(
    change: Mapping[str, object], status: int, server: Serving
) -> None:
    add(server, team="Red")
    number = add(server).json()["id"]
    before = listed(server)
    assert server.ask(ORGANISER, "PATCH", f"{PAGE}/{number}", json=change).status_code == status
    assert server.ask(ORGANISER, "PATCH", f"{PAGE}/99", json={}).status_code == 404
    assert listed(server) == before


REVERIE = find_task("reverie")
TASKS = {"r2r-val_unseen": find_task("r2r"), "ndh-test": find_task("ndh"), OPEN: REVERIE}


def entry(**changes: object) -> NewReported:
    """Return a request to add a result, valid but for its scores."""
    about = {"split": OPEN, "method": {"name": "Walker"}, "team": "Blue", "source": SOURCE}
    return NewReported.model_validate({**about, "scores": {"success": 0.5}, **changes})


def last_logged(session: Session) -> tuple[str, str, str, Mapping[str, Any]]:
    last = entries(session)[-1]
    return last.action, last.row, last.subject, last.details


REFUSED = [
    pytest.param({"scores": {"success": 1.5}}, "success is 1.5; expected a fraction from 0 to 1"),
    pytest.param({"scores": {"path_length": -1.0}}, "path_length is -1.0; expected 0 or more"),
    pytest.param({"scores": {"path_length": inf}}, "path_length is inf; expected 0 or more"),
    pytest.param(
        {"split": "ndh-test", "scores": {"goal_progress": -inf}},
        "goal_progress is -inf; expected a number",
    ),
    pytest.param(
        {"scores": {"spl": 1.0, "sucess": 0.5}},
        "there is no metric 'sucess'; did you mean success? Choose one of: "
        + ", ".join(REVERIE.metrics),
    ),
    pytest.param(
        {"scores": {"goal_progress": 0.5}},
        "there is no metric 'goal_progress'; choose one of: " + ", ".join(REVERIE.metrics),
    ),
    pytest.param(
        {"split": "ndh-tset"},
        "there is no split 'ndh-tset' here; did you mean ndh-test? "
        f"Choose one of: r2r-val_unseen, ndh-test, {OPEN}",
    ),
]


@pytest.mark.parametrize(("changes", "told"), REFUSED)
def test_what_is_not_added_says_why(
    changes: Mapping[str, object], told: str, sqlite: Database
) -> None:
    with acting(sqlite) as transaction:
        with pytest.raises((MalformedError, NotFoundError)) as refused:
            add_reported(transaction, entry().model_copy(update=changes), TASKS)
        assert str(refused.value) == told
        assert list_reported(transaction.session, Page()).rows == []


def test_results_are_listed_from_the_latest_and_ranked_from_the_earliest(sqlite: Database) -> None:
    with acting(sqlite, ORGANISER) as transaction:
        session = transaction.session
        first = add_reported(transaction, entry(date="2026"), TASKS)
        shown = first.model_dump(mode="json")
        details = {name: shown[name] for name in NewReported.model_fields}
        row = f"reported_result:{first.id}"
        assert last_logged(session) == ("reported result added", row, "Walker", details)
        second = add_reported(transaction, entry(scores={"success": 1, "path_length": 0}), TASKS)
        other = add_reported(
            transaction, entry(split="ndh-test", scores={"goal_progress": -2.5}), TASKS
        )
        third = add_reported(transaction, entry(team="Red"), TASKS)
        removed = add_reported(transaction, entry(team="Green"), TASKS)
        assert (first.created_at, first.scores) == (NOON, {"success": 0.5})
        assert remove_reported(transaction, removed.id) == removed
        assert last_logged(session) == (
            "reported result removed",
            f"reported_result:{removed.id}",
            "Walker",
            {"split": OPEN},
        )
        assert list_reported(session, Page()).rows == [third, other, second, first]
        assert list_reported(session, Page(limit=1)).rows == [third]
        assert [each.id for each in reported_of(session, OPEN)] == [first.id, second.id, third.id]
        assert find_reported(session, other.id) == other
        for missing in (removed.id, removed.id + 1):
            with pytest.raises(NotFoundError) as unknown:
                find_reported(session, missing)
            assert str(unknown.value) == f"there is no reported result {missing} on any leaderboard"
        for result, name in ((first, "'Walker', by 'Blue', 2026"), (second, "'Walker', by 'Blue'")):
            with pytest.raises(ConflictError) as taken:
                add_reported(transaction, NewReported.model_validate(result), TASKS)
            assert str(taken.value) == (
                f"{name} is already on the leaderboard of {OPEN}; change that result, or give this "
                "one another date or name"
            )


def test_a_result_of_a_split_that_is_gone_can_be_changed(sqlite: Database) -> None:
    with acting(sqlite) as transaction:
        paper, code = "https://example.org/paper", "https://example.org/code"
        method = {"name": "Walker", "paper": paper}
        known = add_reported(transaction, entry(date="2026", method=method), TASKS)
        change = ReportedChange.model_validate(
            {
                "method": {"name": "Runner", "code": code},
                "date": None,
                "scores": {"goal_progress": 1.5},
            }
        )
        changed = change_reported(transaction, known.id, change, {})
        assert changed == find_reported(transaction.session, known.id)
        assert changed.scores == {"success": 0.5, "goal_progress": 1.5}
        assert (changed.method.name, changed.date, changed.team) == ("Runner", None, "Blue")
        assert (str(changed.method.paper), str(changed.method.code)) == (paper, code)
        assert last_logged(transaction.session) == (
            "reported result changed",
            f"reported_result:{known.id}",
            "Walker",
            {
                "before": {
                    "method": {"name": "Walker", "code": None},
                    "scores": {},
                    "date": "2026",
                },
                "after": {
                    "method": {"name": "Runner", "code": code},
                    "scores": {"goal_progress": 1.5},
                    "date": None,
                },
            },
        )
        same = ReportedChange.model_validate({"method": None})
        assert change_reported(transaction, known.id, same, {}) == changed
        gone = ReportedChange(scores={"success": None, "goal_progress": None})
        with pytest.raises(MalformedError) as refused:
            change_reported(transaction, known.id, gone, {})
        assert str(refused.value) == "no score would be left; remove the result instead"
        for tasks, told in ((TASKS, "'goal_progress'"), ({}, "'joy'")):
            change = ReportedChange(scores={} if tasks else {"joy": 1.0})
            with pytest.raises(MalformedError, match=f"^there is no metric {told}"):
                change_reported(transaction, known.id, change, tasks)


# What a file says, as an error and as a report.


def imported(transaction: Transaction, text: str, **more: Any) -> ImportReport:
    new = NewImport.model_validate({"split": OPEN, "source": SOURCE, "text": text, **more})
    return import_reported(transaction, new, TASKS)


def test_rows_without_a_date_have_that_of_the_import(sqlite: Database) -> None:
    text = json.dumps({"columns": ["SR"], "methods": {"Walker": {OPEN: [5.0]}}})
    with acting(sqlite) as transaction:
        table = imported(transaction, "team,SR,date\nA,5,2021\nB,6,\n", date="06/2020").added
        paper = imported(transaction, text, date="2020-06-14").added
    assert [each.date for each in (*table, *paper)] == ["2021", "2020-06", "2020-06-14"]


def test_the_problems_of_a_file_have_their_kind_and_their_row(sqlite: Database) -> None:
    text = (
        "team,SR,date,code\n"
        "Bad,500,13/2026,http://example.org\n"
        ",5,,\n"
        "Known,6,2026,\n"
        "Good,5,,\n"
        "Good,6,,\n"
        f"Long,5,,http://example.org/{60 * 'x'}\n"
    )
    date = "must be a day, a month or a year: 2026-01-15, 2026-01, 01/2026 or 2026"
    link = "must be a link that begins with https://"
    with acting(sqlite) as transaction:
        imported(transaction, "team,SR,date\nKnown,5,2026\n")
        with pytest.raises(TableError) as refused:
            imported(transaction, text)
        assert len(list_reported(transaction.session, Page()).rows) == 1
    found = [(each.code, str(each), each.position) for each in refused.value.problems]
    assert sorted(found, key=lambda each: each[2]) == [
        ("wrong-value", "line 2: SR %: 500 is not from 0 to 100", (0,)),
        ("wrong-value", f"line 2: code: {link}; found 'http://example.org'", (0,)),
        ("wrong-value", f"line 2: date: {date}; found '13/2026'", (0,)),
        ("wrong-value", "line 3: has neither a team nor a method", (1,)),
        (
            "other-scores",
            (
                "line 4: 'Known', by 'Known', 2026 is on the leaderboard with other scores; change "
                "it there"
            ),
            (2,),
        ),
        (
            "other-scores",
            "line 6: 'Good', by 'Good' has other scores in line 5; rename one or remove it",
            (4,),
        ),
        ("wrong-value", f"line 7: code: {link}; found 'http://example.org/{40 * 'x'}", (5,)),
    ]


def test_the_report_of_an_import_says_what_became_of_each_row(sqlite: Database) -> None:
    text = (
        "team,method,SR,source,dataset,description\n"
        "Blue,Walker,5,,,walks\n"
        "Red,,10,Them,v1,\n"
        "Blue,Walker,5,,,\n"
        ",Runner,20,,,\n"
    )
    with acting(sqlite) as transaction:
        imported(transaction, "team,SR\nRed,10\n")
        report = imported(transaction, text, dataset="v2")
        again = imported(transaction, text)
        listed = list_reported(transaction.session, Page()).rows
    assert (report.rows, report.known, report.unread) == (4, 1, [])
    assert report.repeated == ["line 4 repeats line 2"]
    assert report.added == [
        entry(
            method={"name": "Walker", "description": "walks"},
            scores={"success": 0.05},
            dataset="v2",
        ),
        entry(method={"name": "Runner"}, team="Runner", scores={"success": 0.2}, dataset="v2"),
    ]
    stored = [each.model_dump(exclude={"id", "created_at"}) for each in listed[:2]]
    assert stored == [each.model_dump() for each in report.added[::-1]]
    assert (again.rows, again.added, again.known) == (4, [], 4)


def test_a_file_of_another_task_names_the_split_without_it(sqlite: Database) -> None:
    text = json.dumps(
        {"columns": ["SR"], "methods": {"Walker": {"val_unseen": [50]}}, "source": "a table"}
    )
    with acting(sqlite) as transaction:
        report = imported(transaction, text, split="r2r-val_unseen", rates="percent")
        with pytest.raises(TableError, match="not a metric of this split"):
            imported(transaction, "team,RGS\nBlue,5\n", split="r2r-val_unseen")
        with pytest.raises(
            NotFoundError, match=r"^there is no split 'train' here; choose one of: r2r-"
        ):
            imported(transaction, text, split="train")
        fractions = imported(transaction, "team,SR\nRed,0.5\n", rates="fraction")
    assert [each.scores for each in report.added] == [{"success": 0.5}]
    assert (report.added[0].split, report.unread) == ("r2r-val_unseen", ["source"])
    assert [each.scores for each in fractions.added] == [{"success": 0.5}]


# The command line.


def test_the_commands_of_the_guide_print_what_it_says(laptop: Laptop) -> None:
    guide = (REPOSITORY / "docs" / "how-to" / "organising" / "history.md").read_text()
    commands, printed = re.findall(r"```\w*\n(.*?)```", guide, re.DOTALL)[:2]
    laptop.run("server", "init", "lab")
    write, *lines = commands.splitlines()
    laptop.shell(write)
    outcomes = [laptop.run(*line.split()[1:]) for line in lines]
    told = [outcome.out.splitlines()[-1] for outcome in outcomes[:3]]
    assert told == printed.splitlines()
    assert outcomes[0].out.splitlines()[1].split() == [
        *("Walker", "Walker", "2026-01", "24.66", "59.64", "38.98", "21.48")
    ]
    assert "SR 41.20" in outcomes[3].out
    assert outcomes[4].out == "reported result 1 (Walker) changed\n"
    assert outcomes[5].out == "1 reported result removed\n"
    shown = laptop.run("server", "reported", "list", "lab").out.splitlines()[1]
    assert shown.split()[:6] == ["1", "test", "Walker", "Blue", "2026-01-15", "v2"]
    assert "SR 59.70" in shown


def test_commands_say_what_is_wrong(laptop: Laptop) -> None:
    laptop.run("server", "init", "lab")
    history = laptop.folder / "history.csv"
    words = ("server", "import", "lab", "history.csv", "--split", "test", "--source", SOURCE)
    history.write_text("team,SR,date\na,200,2026\nb,5,soon\n")
    assert laptop.run(*words, status=1).err.splitlines() == [
        "reverie-eval: file rejected, 2 problems",
        "line 2: SR %: 200 is not from 0 to 100",
        (
            "line 3: date: must be a day, a month or a year: 2026-01-15, 2026-01, 01/2026 or 2026; "
            "found 'soon'"
        ),
    ]
    history.write_bytes(b"team,SR\n\xff,5\n")
    assert "invalid UTF-8 from byte 8 on" in laptop.run(*words, status=2).err
    history.write_bytes(b"")
    assert laptop.run(*words, status=2).err == "reverie-eval: history.csv: the file is empty\n"
    history.write_text("team,SR\na,5\n")
    laptop.run(*words)
    edit = ("server", "reported", "edit", "lab", "1")
    assert "did you mean team?" in laptop.run(*edit, "tem=b", status=1).err
    assert "200 is not from 0 to 100" in laptop.run(*edit, "SR=200", status=1).err
    assert "expected FIELD=VALUE, found 'team'" in laptop.run(*edit, "team", status=2).err
    assert "there is no reported result 2" in laptop.run(*edit[:-1], "2", "team=b", status=2).err


# The files that this was made for.


@pytest.fixture
def history() -> Path:
    """Return the folder with the rows of the public leaderboard and the paper's tables."""
    folder = published_folder()
    if folder is None:
        unavailable("the published REVERIE files are not here (REVERIE_DATA names their folder)")
    return folder


@pytest.mark.dataset
def test_the_public_leaderboard_and_the_paper_go_in(history: Path, laptop: Laptop) -> None:
    laptop.run("server", "init", "lab")
    legacy, paper = (
        (
            *("server", "import", "lab", history / name, "--split", "test"),
            *("--source", SOURCE, "--dataset-version", version),
        )
        for name, version in (("legacy_leaderboard.csv", "v2"), ("paper_results.json", "v1"))
    )
    first = laptop.run(*legacy)
    assert first.out == "test: 83 rows: 81 added, 0 already there, 2 repeated\n"
    assert first.err == "note: line 32 repeats line 29\nnote: line 45 repeats line 43\n"
    assert laptop.run(*legacy).out == "test: 83 rows: 0 added, 83 already there\n"
    assert laptop.run(*paper).out == "test: 10 rows: 10 added, 0 already there\n"
    assert laptop.run(*paper).out == "test: 10 rows: 0 added, 10 already there\n"
    rows = laptop.run("server", "reported", "list", "lab").out.splitlines()[1:]
    assert len(rows) == 91
    assert " fault " not in laptop.run("server", "doctor", "lab").out
