"""Persons: their e-mail addresses, names that several teams share, new names, moves."""

from typing import Any

import pytest
from pydantic import ValidationError

from reverie_eval.schemas.organising import NewPerson, PersonChange
from reverie_eval.server.errors import ConflictError, NotFoundError
from reverie_eval.server.service.people import change_person, person_named
from tests.support.acting import add_person, create_token
from tests.support.flat import Run
from tests.support.serving import MATE, OPEN, ORGANISER, OTHER, OWNER, Serving

ADDRESS = "ada@example.org"


def change(server: Serving, who: str, **fields: Any) -> Any:
    """Let the organiser change a person; return the reply."""
    path = f"/organiser/people/{server.person(who).id}"
    return server.ask(ORGANISER, "PATCH", path, json=fields)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        pytest.param(" ada@example.org ", ADDRESS, id="spaces around it"),
        pytest.param("ada@EXAMPLE.org", ADDRESS, id="a domain in capitals"),
        pytest.param("ada", None, id="no @"),
        pytest.param("Ada <ada@example.org>", None, id="with a name"),
        pytest.param("ada@example.org, ben@example.org", None, id="two"),
        pytest.param("ada@example.org\nBcc: all@example.org", None, id="a header of mail"),
        pytest.param(f"{'a' * 250}@example.org", None, id="too long"),
    ],
)
def test_what_is_an_address(text: str, expected: str | None) -> None:
    if expected is None:
        with pytest.raises(ValidationError):
            NewPerson(team="Blue", name="Ada", email=text)
    else:
        assert NewPerson(team="Blue", name="Ada", email=text).email == expected


def test_only_organisers_and_the_person_see_an_address(server: Serving) -> None:
    assert change(server, OWNER, email=ADDRESS).json()["email"] == ADDRESS
    submission = server.upload(OWNER).json()["submission"]["id"]
    server.ask(OWNER, "PATCH", f"/submissions/{submission}", json={"published": True})
    assert server.ask(OWNER, "GET", "/me").json()["email"] == ADDRESS
    assert ADDRESS in server.ask(ORGANISER, "GET", "/organiser/people").text
    for path in (f"/submissions/{submission}", f"/submissions/{submission}/receipt"):
        assert ADDRESS not in server.ask(OWNER, "GET", path).text
    for who in (None, MATE, OTHER):
        assert ADDRESS not in server.ask(who, "GET", f"/splits/{OPEN}/leaderboard").text
        assert ADDRESS not in server.ask(who, "GET", "/me").text
    assert ADDRESS not in server.ask(ORGANISER, "GET", "/organiser/audit").text
    assert change(server, OWNER, email=None).json()["email"] is None


def test_two_teams_may_have_a_person_of_the_same_name(server: Serving) -> None:
    with server.acting() as transaction:
        add_person(transaction, "Red", OWNER)
        with pytest.raises(ConflictError, match="the team 'Red' already has a person 'Ada'"):
            add_person(transaction, "Red", OWNER)
    with server.acting() as transaction:
        message = "several teams have a person 'Ada': 'Blue', 'Red'; name the team"
        with pytest.raises(ConflictError, match=message):
            create_token(transaction, OWNER)
        assert person_named(transaction.session, OWNER, "Red").team.name == "Red"
        with pytest.raises(NotFoundError, match="the team 'Organisers' has no person 'Ada'"):
            person_named(transaction.session, OWNER, "Organisers")
    asked = {"person": OWNER, "team": "Red"}
    made = server.ask(ORGANISER, "POST", "/organiser/tokens", json=asked).json()
    assert (made["person"], made["team"]) == (OWNER, "Red")


def test_a_name_that_several_teams_have_needs_its_team_on_the_command_line(
    server: Serving, run: Run
) -> None:
    folder = str(server.state.settings.folder)
    assert run("server", "person", "add", folder, OWNER, "--team", "Red").status == 0
    refused = run("server", "invite", folder, OWNER)
    assert (refused.status, "'Blue', 'Red'; name the team: --team" in refused.err) == (2, True)
    assert run("server", "invite", folder, OWNER, "--team", "Red").status == 0
    assert (
        "1 token revoked" in run("server", "person", "revoke", folder, OWNER, "--team", "Red").out
    )


def test_a_person_is_edited_on_the_command_line(server: Serving, run: Run) -> None:
    folder = str(server.state.settings.folder)
    edit = ("server", "person", "edit", folder)
    changed = run(*edit, OWNER, "--name", "Adele", "--email", ADDRESS, "--move-to", "Red")
    assert (changed.status, changed.out) == (0, f"Adele, Red, {ADDRESS}\n")
    assert (
        f"Adele   Red         participant  {ADDRESS}" in run("server", "person", "list", folder).out
    )
    assert run(*edit, "Adele", "--email", "").out == "Adele, Red, no e-mail address\n"
    assert run(*edit, "Adele").status == 2
    assert run(*edit, "Adele", "--email", "adele").err.endswith(
        "email: must be an e-mail address: ada@example.org\n"
    )


def test_a_person_is_renamed_and_the_log_does_not_keep_the_name(server: Serving) -> None:
    assert change(server, OWNER, name="Adele").json()["name"] == "Adele"
    log = server.ask(ORGANISER, "GET", "/organiser/audit")
    last = log.json()[-1]
    assert (last["action"], last["subject"], last["details"]["changed"]) == (
        "person changed",
        "Adele",
        ["name"],
    )
    assert OWNER not in log.text
    assert change(server, MATE, name="Adele").status_code == 409  # in the same team
    assert change(server, OTHER, name=OTHER).status_code == 200  # as before
    assert len(server.ask(ORGANISER, "GET", "/organiser/audit").json()) == len(log.json())
    assert change(server, OTHER, name="Adele").status_code == 200


def test_a_person_moves_and_their_submissions_stay(server: Serving) -> None:
    submission = server.upload(OWNER).json()["submission"]["id"]
    assert change(server, OWNER, team="Red").json()["team"] == "Red"
    assert server.ask(OWNER, "GET", f"/submissions/{submission}").status_code == 404
    assert server.ask(MATE, "GET", f"/submissions/{submission}").json()["team"] == "Blue"
    assert change(server, OWNER, team="Nobody's").status_code == 404
    last = server.ask(ORGANISER, "GET", "/organiser/audit").json()[-1]
    assert (last["details"]["moved_from"], last["details"]["moved_to"]) == ("Blue", "Red")


@pytest.mark.parametrize("number", [99, 2**31])
def test_a_person_who_does_not_exist_is_not_changed(server: Serving, number: int) -> None:
    path = f"/organiser/people/{number}"
    assert server.ask(ORGANISER, "PATCH", path, json={"name": "x"}).status_code in (400, 404)
    with server.acting() as transaction, pytest.raises(NotFoundError, match="no person number 99"):
        change_person(transaction, 99, PersonChange(name="x"))
