"""Persons: their e-mail addresses, names that several teams share, new names, moves."""

import re
from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import pytest
from pydantic import ValidationError

from reverie_eval.schemas.organising import NewMerge, NewPerson, NewTeam, PersonChange
from reverie_eval.server.accounts import people
from reverie_eval.server.accounts.people import change_person, merge_teams, person_named
from reverie_eval.server.accounts.personal_data import delete_person
from reverie_eval.server.audit.log import audit_reports, entries
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import ConflictError, NotFoundError
from reverie_eval.server.intake import pages
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.paging import Page
from tests.support.acting import NOON, acting, add_person, add_team, create_token
from tests.support.flat_world import Run
from tests.support.serving import MATE, OPEN, ORGANISER, OTHER, OWNER, Serving
from tests.support.visiting import said, signed_in

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
        pytest.param("Ada L. <ada@example.org>", ADDRESS, id="with a name"),
        pytest.param("Ada <ada>", None, id="with a name alone"),
        pytest.param("Ada <ada@example.org>, Ben <ben@example.org>", None, id="two with names"),
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
    refused = run("server", "token", "invite", folder, OWNER)
    assert (refused.status, "'Blue', 'Red'; name the team: --team" in refused.err) == (2, True)
    assert run("server", "token", "invite", folder, OWNER, "--team", "Red").status == 0
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
        "email: must be an e-mail address, such as ada@example.org\n"
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


# In the database.


@pytest.fixture
def change_of(sqlite: Database) -> Iterator[Transaction]:
    """Change a database with Carl and Ada of Red, Ada and Ben of Blue, and a merged team."""
    with acting(sqlite, "Olga") as transaction:
        for team, name in (("Red", "Carl"), ("Blue", "Ben"), ("Red", "Ada"), ("Blue", "Ada")):
            if name in {"Carl", "Ben"}:
                add_team(transaction, team)
            add_person(transaction, team, name)
        add_team(transaction, "Old")
        merge_teams(transaction, NewMerge(team="Old", into="Blue"))
        yield transaction


def logged(change: Transaction) -> tuple[Any, ...]:
    """Return the last entry of the audit log."""
    *_, last = audit_reports(change.session, entries(change.session))
    return last.actor, last.action, last.subject, last.details


def told(error: type[Exception], action: Any, *given: Any) -> str:
    """Return why an action is refused."""
    with pytest.raises(error) as refused:
        action(*given)
    return str(refused.value)


def test_what_is_added_is_reported_and_logged(change_of: Transaction) -> None:
    team = people.add_team(change_of, NewTeam(name="Green"))
    assert (team.name, team.people, team.created_at) == ("Green", [], NOON)
    assert logged(change_of) == ("Olga", "team added", "Green", {})
    new = NewPerson(team="Green", name="Dora", email=ADDRESS, role="organiser")
    person = people.add_person(change_of, new)
    row = people.find_person(change_of.session, person.id)
    assert person.model_dump() == {
        "id": row.id,
        "name": "Dora",
        "email": ADDRESS,
        "team": "Green",
        "role": "organiser",
        "created_at": NOON,
    }
    details = {"team": "Green", "role": "organiser"}
    assert logged(change_of) == ("Olga", "person added", "Dora", details)
    assert people.rename_team(change_of, "Green", NewTeam(name="Lime")).people == ["Dora"]
    assert logged(change_of) == (
        *("Olga", "team renamed", "Green"),
        {"before": "Green", "after": "Lime"},
    )


def test_a_change_is_logged_with_what_was_changed(change_of: Transaction) -> None:
    carl = person_named(change_of.session, "Carl")
    assert change_person(change_of, carl.id, PersonChange(name="Carl", team="Red")).name == "Carl"
    assert logged(change_of)[1] == "team merged", "nothing was changed"
    moved = change_person(change_of, carl.id, PersonChange(email=ADDRESS, team="Blue"))
    assert (moved.email, moved.team) == (ADDRESS, "Blue")
    assert logged(change_of) == (
        "Olga",
        "person changed",
        "Carl",
        {"changed": ["email", "team"], "moved_from": "Red", "moved_to": "Blue"},
    )
    change_person(change_of, carl.id, PersonChange(name="Karl"))
    assert logged(change_of)[2:] == ("Karl", {"changed": ["name"]})


def test_what_is_refused_says_why(change_of: Transaction) -> None:
    taken = "the name 'Blue' belongs to another team, or to one that was merged"
    assert told(ConflictError, people.add_team, change_of, NewTeam(name="Blue")) == taken
    red = NewTeam(name="Red")
    assert told(NotFoundError, people.rename_team, change_of, "None", red) == (
        "there is no team 'None'; see the list of teams"
    )
    assert told(NotFoundError, people.team_named, change_of.session, "Old") == (
        "the team 'Old' was merged into 'Blue'"
    )
    new = NewPerson(team="Blue", name="Ada")
    assert told(ConflictError, people.add_person, change_of, new) == (
        "the team 'Blue' already has a person 'Ada'"
    )
    # This ends the transaction.
    assert told(ConflictError, people.rename_team, change_of, "Red", NewTeam(name="Blue")) == taken


def test_who_moves_to_a_team_that_has_the_name_is_refused(change_of: Transaction) -> None:
    ada = person_named(change_of.session, "Ada", "Red")
    assert told(ConflictError, change_person, change_of, ada.id, PersonChange(team="Blue")) == (
        "the team 'Blue' already has a person 'Ada'"
    )


def test_a_person_is_found_by_name_unless_several_have_it(change_of: Transaction) -> None:
    session = change_of.session
    assert person_named(session, "Ada", "Blue").team.name == "Blue"
    assert told(ConflictError, person_named, session, "Ada") == (
        "several teams have a person 'Ada': 'Red', 'Blue'; name the team: --team on the command "
        "line, `team` in a request"
    )
    assert told(NotFoundError, person_named, session, "Ben", "Red") == (
        "the team 'Red' has no person 'Ben'; see the list of people"
    )
    delete_person(change_of, person_named(session, "Ada", "Red").id)
    assert person_named(session, "Ada").team.name == "Blue"
    delete_person(change_of, person_named(session, "Ben").id)
    missing = "there is no person 'Ben'; see the list of people"
    assert told(NotFoundError, person_named, session, "Ben") == missing
    assert told(NotFoundError, people.find_person, session, 2) == (
        "there is no person number 2; see the list of people"
    )


def test_lists_have_neither_merged_teams_nor_deleted_people(change_of: Transaction) -> None:
    session = change_of.session

    def names() -> list[tuple[str, str]]:
        return [(each.name, each.team) for each in people.everybody(session)]

    assert names() == [("Ada", "Blue"), ("Ada", "Red"), ("Ben", "Blue"), ("Carl", "Red")]
    found = people.everybody(session)[0]
    assert found == people.person_report(person_named(session, "Ada", "Blue"))
    ben = person_named(session, "Ben")
    delete_person(change_of, ben.id)
    assert names() == [("Ada", "Blue"), ("Ada", "Red"), ("Carl", "Red")]
    assert people.names_of_teams(session) == ["Blue", "Red"]
    teams = people.list_teams(session, Page())
    assert [(team.name, team.people) for team in teams.rows] == [
        ("Blue", ["Ada"]),
        ("Red", ["Ada", "Carl"]),
    ]
    assert [team.name for team in people.list_teams(session, Page(limit=1)).rows] == ["Blue"]
    listed = people.list_people(session, Page()).rows
    assert [(each.id, each.name) for each in listed] == [(1, "Carl"), (3, "Ada"), (4, "Ada")]
    assert len(people.list_people(session, Page(limit=2)).rows) == 2


def test_a_team_s_page_has_its_latest_submissions_and_one_s_own_tokens(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = []
    for who, hours in ((OWNER, 0), (MATE, 1), (OTHER, 2)):
        server.clock.now = NOON + timedelta(hours=hours)
        sent.append(server.upload(who, server.distinct()).json()["submission"]["id"])
    with server.acting() as transaction:
        add_person(transaction, "Blue", "Aaron")
        hint = create_token(transaction, OWNER).hint
        add_person(transaction, "Blue", "Gone")
        delete_person(transaction, person_named(transaction.session, "Gone").id)
    visitor = signed_in(server, OWNER)
    team = visitor.get("/team").text
    line = re.search(r"<h1.*?</h1>\s*<p class=\"quiet\">(.*?)</p>", team, re.DOTALL)
    assert line
    assert line[1] == f"Aaron, {OWNER} (you), {MATE}"
    own = [hint, server.tokens[OWNER][:11]]
    assert re.findall(r"<code>(rv_[\w-]{8})", team) == own
    assert re.findall(r'href="/submissions/(\w+)"', team) == [sent[1], sent[0]]
    monkeypatch.setattr(pages, "MOST_SUBMISSIONS", 1)
    latest = visitor.get("/team")
    assert re.findall(r'href="/submissions/(\w+)"', latest.text) == [sent[1]]
    assert "The latest 1 of 2 are shown" in said(latest)
