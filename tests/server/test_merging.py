"""Two teams that become one: what they share from then on, and what stays as it was."""

from collections.abc import Mapping
from typing import Any

import pytest
from sqlalchemy import select

from reverie_eval.schemas.organising import NewMerge, NewTeam
from reverie_eval.server.accounts import people
from reverie_eval.server.accounts.people import merge_teams, person_named, rename_team, team_named
from reverie_eval.server.audit.rows import all_names_of_teams
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.store.tables import Submission, Team
from tests.support.acting import add_person, add_team
from tests.support.flat_world import Run
from tests.support.serving import MATE, OPEN, ORGANISER, OTHER, OWNER, PRIVATE, Serving
from tests.support.signing import receipt_in

MERGE = {"team": "Red", "into": "Blue"}


def merge(server: Serving, **changes: str) -> Any:
    return server.ask(ORGANISER, "POST", "/organiser/teams/merge", json=MERGE | changes)


def used(server: Serving, who: str, split: str = PRIVATE) -> Mapping[str, int]:
    """Count what was used of each window."""
    quota = server.ask(who, "GET", f"/splits/{split}").json()["quota"]
    return {each["name"]: each["limit"] - each["remaining"] for each in quota["windows"]}


def test_quotas_are_those_of_one_team(server_on: Serving) -> None:
    server = server_on
    shared = server.distinct(PRIVATE)
    server.upload(OTHER, shared, PRIVATE)
    server.clock.turn(hours=23)
    server.upload(OWNER, shared, PRIVATE)
    server.upload(MATE, server.distinct(PRIVATE), PRIVATE)
    assert (used(server, OWNER)["month"], used(server, OTHER)["month"]) == (2, 1)
    report = merge(server).json()
    assert report == {**MERGE, "people": 1, "submissions": 1, "repeats": 1}
    assert used(server, OWNER) == used(server, OTHER) == {"day": 2, "month": 2, "year": 2}
    server.clock.turn(hours=2)  # the earlier of the same file leaves the window
    assert used(server, OWNER) == {"day": 1, "month": 2, "year": 2}
    again = server.upload(OTHER, shared, PRIVATE)
    assert (again.status_code, used(server, OTHER)["month"]) == (200, 2)


def test_everything_of_the_team_goes_over_and_nothing_is_amiss(server: Serving) -> None:
    mine, theirs = (server.upload(who).json()["submission"] for who in (OWNER, OTHER))
    for who, each in ((OWNER, mine), (OTHER, theirs)):
        path = f"/submissions/{each['id']}"
        assert server.ask(who, "PATCH", path, json={"published": True}).status_code == 200
    board = f"/splits/{OPEN}/leaderboard"
    assert {row["submissions"] for row in server.ask(None, "GET", board).json()["rows"]} == {1}
    server.upload(OTHER, server.distinct())
    assert merge(server).status_code == 200
    rows = server.ask(None, "GET", board).json()["rows"]
    assert [(row["team"], row["submissions"]) for row in rows] == 2 * [("Blue", 2)]
    seen = server.ask(MATE, "GET", f"/submissions/{theirs['id']}").json()
    assert (seen["team"], seen["receipt"]) == ("Blue", theirs["receipt"])
    assert receipt_in(seen["receipt"]).team == "Red"
    assert server.ask(OTHER, "GET", "/me").json()["team"] == "Blue"
    teams = server.ask(ORGANISER, "GET", "/organiser/teams").json()
    assert [(team["name"], team["people"]) for team in teams] == [
        ("Blue", ["Ada", "Ben", "Carl"]),
        ("Organisers", ["Olga"]),
    ]
    assert [each for each in examine(server.state.settings.folder) if each.kind == "fault"] == []
    last = server.ask(ORGANISER, "GET", "/organiser/audit").json()[-1]
    assert (last["action"], last["subject"], last["details"]["into"]) == (
        "team merged",
        "Red",
        "Blue",
    )


def test_of_files_that_arrived_at_once_that_of_the_team_that_stays_counts(server: Serving) -> None:
    content, people = server.distinct(), (OWNER, OTHER, ORGANISER)
    first, second, third = (
        server.upload(who, content).json()["submission"]["id"] for who in people
    )
    assert merge(server).json()["repeats"] == 1
    assert merge(server, team="Organisers").json()["repeats"] == 1
    with server.state.database.reading() as session:
        repeats = {row.id: row.repeat for row in session.scalars(select(Submission))}
    assert repeats == {first: "", second: second, third: third}


def test_a_file_that_counted_as_a_repeat_before_is_not_counted_again(server: Serving) -> None:
    content = server.distinct()
    for who in (OWNER, OTHER, ORGANISER):
        server.upload(who, content)
    assert merge(server).json()["repeats"] == 1  # Blue now has the file twice
    assert merge(server, team="Blue", into="Organisers").json()["repeats"] == 1


def test_a_merge_is_logged_with_what_went_over(server: Serving) -> None:
    content, early = server.distinct(), server.distinct()
    server.upload(OWNER, content)
    second = server.upload(OTHER, content).json()["submission"]["id"]
    theirs = server.upload(OTHER, early).json()["submission"]["id"]
    server.clock.turn(hours=1)
    mine = server.upload(OWNER, early).json()["submission"]["id"]
    with server.acting() as transaction:
        add_person(transaction, "Red", "Dora")
        people = [person_named(transaction.session, name) for name in ("Carl", "Dora")]
        people[1].deleted_at = transaction.now
    server.clock.turn(hours=1)
    report = merge(server).json()
    assert report == {**MERGE, "people": 1, "submissions": 2, "repeats": 2}
    *earlier, last = server.ask(ORGANISER, "GET", "/organiser/audit").json()
    assert (last["row"], last["subject"]) == ("team:2", "Red")
    assert last["details"] == {"into": "Blue", "people": 1, "submissions": 2, "repeats": 2}
    changed = {each["row"] for each in earlier if each["action"] == "changed by a merge"}
    rows = {f"submission:{each}" for each in (second, theirs, mine)}
    assert changed == {*rows, *(f"person:{each.id}" for each in people)}
    with server.state.database.reading() as session:
        team, into = session.get_one(Team, 2), team_named(session, "Blue")
        assert (team.merged_into, team.merged_at) == (into, server.clock())
        repeats = {row.id: row.repeat for row in session.scalars(select(Submission))}
    assert (repeats[theirs], repeats[mine]) == ("", mine)
    assert sorted(repeats.values())[:2] == ["", ""]


def test_grants_go_over(server: Serving) -> None:
    grant = {"team": "Red", "split": PRIVATE, "extra": 3, "reason": "x"}
    grant["expires_at"] = "2026-04-01T00:00:00Z"
    assert server.ask(ORGANISER, "POST", "/organiser/grants", json=grant).status_code == 201
    merge(server)
    quota = server.ask(OWNER, "GET", f"/splits/{PRIVATE}").json()["quota"]
    assert quota["remaining"] == 5


@pytest.mark.parametrize("hours", [1, 0, -1], ids=["later", "at once", "clock set back"])
def test_names_pass_through_teams_that_were_merged_in_turn(hours: int, server: Serving) -> None:
    with server.acting() as transaction:
        add_team(transaction, "Green")
        rename_team(transaction, "Red", NewTeam(name="Crimson"))
        merge_teams(transaction, NewMerge(team="Crimson", into="Green"))
    server.clock.turn(hours=hours)
    with server.acting() as transaction:
        merge_teams(transaction, NewMerge(team="Green", into="Blue"))
        names = all_names_of_teams(transaction.session)
    assert names["Blue"] == {"Blue", "Green", "Crimson", "Red"}
    assert names["Green"] == {"Green", "Crimson", "Red"}


@pytest.mark.parametrize(
    ("changes", "status", "told"),
    [
        pytest.param(
            {"team": "Lime"},
            404,
            "there is no team 'Lime'; see the list of teams",
            id="no team",
        ),
        pytest.param(
            {"team": "Blue"},
            409,
            "a team cannot be merged into itself; name two teams",
            id="itself",
        ),
        pytest.param(
            {},
            409,
            "both teams have a person called 'Ada', 'Ben'; rename one of them first",
            id="the same names",
        ),
    ],
)
def test_what_is_not_merged(
    changes: Mapping[str, str], status: int, told: str, server: Serving
) -> None:
    with server.acting() as transaction:
        for name in (MATE, OWNER):
            add_person(transaction, "Red", name)
    reply = merge(server, **changes)
    assert (reply.status_code, reply.json()["detail"]) == (status, told)


def test_a_script_has_to_confirm_what_cannot_be_undone(server: Serving, run: Run) -> None:
    refused = run("server", "team", "merge", str(server.state.settings.folder), "Red", "Blue")
    told = "Merge Red into Blue? This cannot be undone; confirm it with --yes"
    assert (refused.status, told in refused.err) == (2, True)
    with server.state.database.reading() as session:
        assert "Red" in people.names_of_teams(session)


def test_the_name_of_a_merged_team_is_not_given_again(server: Serving, run: Run) -> None:
    folder = str(server.state.settings.folder)
    done = run("server", "team", "merge", folder, "Red", "Blue", "--yes")
    assert done.out == "1 person and 0 submissions of Red moved to Blue\n"
    again = run("server", "team", "add", folder, "Red")
    assert (again.status, "or to one that was merged" in again.err) == (2, True)
    person = run("server", "person", "add", folder, "Dora", "--team", "Red")
    assert "the team 'Red' was merged into 'Blue'" in person.err
