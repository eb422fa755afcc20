"""Names of teams that look alike: only one team has them, whichever way it comes."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy import select

from reverie_eval.schemas.organising import NewMerge, NewTeam
from reverie_eval.server.accounts.people import merge_teams, rename_team
from reverie_eval.server.errors import ConflictError
from reverie_eval.server.store.tables import Team, name_key
from tests.support.acting import add_team
from tests.support.flat_world import Run
from tests.support.serving import ORGANISER, OWNER, Serving
from tests.support.visiting import Visitor, said, signed_in

NAME = "Team 01-A"
ALIKE = {
    "case": "team 01-a",
    "spaces between": "Team   01-A",
    "width": "\uff34eam \uff10\uff11-A",
    "an en dash": "Team 01\u2013A",
    "a minus sign": "Team 01\u2212A",
    "a hyphen that does not break": "Team 01\u2011A",
}
TOLD = "names of teams must differ in more than case, spaces and dashes"


@pytest.fixture
def taken(server: Serving) -> Serving:
    """Return a server with a team."""
    with server.acting() as transaction:
        add_team(transaction, NAME)
    return server


@pytest.mark.parametrize("name", ALIKE.values(), ids=ALIKE)
def test_a_name_that_looks_the_same_is_taken(name: str, taken: Serving) -> None:
    refused = taken.ask(ORGANISER, "POST", "/organiser/teams", json={"name": name})
    assert refused.status_code == 409
    assert TOLD in refused.json()["detail"]
    assert repr(NAME) in refused.json()["detail"]


@pytest.mark.parametrize("name", ["Team 02-A", "Team 01A", "Team 01-\u00c4", "\u0422eam 1"])
def test_another_name_is_not(name: str, taken: Serving) -> None:
    added = taken.ask(ORGANISER, "POST", "/organiser/teams", json={"name": name})
    assert added.status_code == 201


def test_it_is_taken_at_every_door(taken: Serving, run: Run) -> None:
    alike = ALIKE["case"]
    desk = signed_in(taken, ORGANISER)
    assert TOLD in said(desk.send("/desk/people/teams", {"name": alike}))
    renamed = desk.send("/desk/people/teams/rename", {"team": "Blue", "name": alike})
    assert TOLD in said(renamed)
    text = f"team,person\n{alike},Dora"
    shown = desk.send("/desk/people/import", {"text": text})
    assert f"line 2: team: the name {alike!r} looks like {NAME!r}" in said(shown)
    both = desk.send("/desk/people/import", {"text": "team,person\nNew,Dora\nnew,Emil"})
    assert "line 3: team: the name 'new' looks like 'New'" in said(both)
    command = run("server", "team", "add", str(taken.state.settings.folder), alike)
    assert (command.status, TOLD in command.err) == (2, True)


def test_who_asks_to_join_a_team_may_write_it_otherwise(taken: Serving) -> None:
    """A stranger cannot know how it is written, and the organiser sees which team is meant."""
    form = {"team": ALIKE["case"], "people": "Dora, dora@example.org", "institution": "Here"}
    assert Visitor(taken).send("/join", form).status_code == 200
    (asked,) = taken.ask(ORGANISER, "GET", "/organiser/requests").json()
    assert (asked["team"], asked["team_exists"]) == (NAME, True)
    accepted = taken.ask(ORGANISER, "POST", f"/organiser/requests/{asked['id']}/accept")
    assert accepted.json()["team"] == NAME


def test_a_team_may_change_how_its_own_name_is_written(taken: Serving) -> None:
    path = f"/organiser/teams/{NAME}"
    for name in ("TEAM 01-A", "Team 01-B", NAME):
        path = f"/organiser/teams/{path.rpartition('/')[2]}"
        renamed = taken.ask(ORGANISER, "PATCH", path, json={"name": name})
        assert (renamed.status_code, renamed.json().get("name")) == (200, name)
        path = f"/{name}"
    with taken.acting() as transaction:
        merge_teams(transaction, NewMerge(team=NAME, into="Blue"))
    again = taken.ask(ORGANISER, "POST", "/organiser/teams", json={"name": ALIKE["case"]})
    assert again.status_code == 409  # the name of a merged team is not given again


def test_a_former_name_with_results_stays_with_its_team(server: Serving, run: Run) -> None:
    """Receipts and snapshots have it."""
    assert server.upload(OWNER).status_code == 201
    with server.acting() as transaction:
        rename_team(transaction, "Blue", NewTeam(name="Azure"))
        add_team(transaction, "Sky")
    told = "'Blue' was the name of 'Azure' until 2026-03-02, and there are results under it"
    for name in ("Blue", "blue"):
        refused = server.ask(ORGANISER, "POST", "/organiser/teams", json={"name": name})
        assert (refused.status_code, told in refused.json()["detail"]) == (409, True)
    desk = signed_in(server, ORGANISER)
    assert told in said(desk.send("/desk/people/teams/rename", {"team": "Sky", "name": "Blue"}))
    command = run("server", "team", "add", str(server.state.settings.folder), "Blue")
    assert (command.status, told in command.err) == (2, True)
    with server.acting() as transaction:
        merge_teams(transaction, NewMerge(team="Azure", into="Sky"))
    told = "'Blue' was the name of 'Sky' until"
    with server.acting() as transaction, pytest.raises(ConflictError, match=told):
        rename_team(transaction, "Red", NewTeam(name="Blue"))
    with server.acting() as transaction:
        rename_team(transaction, "Sky", NewTeam(name="Blue"))


def test_a_former_name_without_results_is_free(server: Serving) -> None:
    with server.acting() as transaction:
        rename_team(transaction, "Blue", NewTeam(name="Azure"))
    server.clock.turn(seconds=1)
    assert server.upload(OWNER).status_code == 201
    with server.acting() as transaction:
        add_team(transaction, "Blue")


def test_of_two_at_once_one_is_refused(server_on: Serving) -> None:
    names = [NAME, *ALIKE.values()]
    with ThreadPoolExecutor(len(names)) as pool:
        replies = pool.map(
            lambda name: server_on.ask(ORGANISER, "POST", "/organiser/teams", json={"name": name}),
            names,
        )
    assert sorted(reply.status_code for reply in replies) == [201, *(409 for _ in ALIKE)]
    with server_on.state.database.reading() as session:
        kept = session.scalars(select(Team).where(Team.name_key == name_key(NAME))).one()
    assert kept.name in names
