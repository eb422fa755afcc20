"""Files of people: what is read, what is refused, and what a file adds."""

import csv
import io
from pathlib import Path

import pytest

from reverie_eval.schemas.people import NewPeopleImport, PersonInvitation
from reverie_eval.server.accounts.people_files import import_people, invitations_csv
from reverie_eval.server.errors import TableError
from tests.support.acting import NOON
from tests.support.flat_world import Run
from tests.support.serving import ORGANISER, Serving
from tests.support.visiting import said, signed_in

FILE = """\
team,person,email,role
Blue,Ada
Green,Dora,dora@example.org,participant
Green,Emil,,
Blue,Olga 2,olga@example.org,organiser
"""
SOUND = FILE.replace("Blue,Ada\n", "Blue,Ada,,\n")


def imported(server: Serving, text: str, **options: bool) -> list[tuple[str, str, str | None, str]]:
    with server.acting() as transaction:
        report = import_people(transaction, NewPeopleImport(text=text, **options))
    return [(each.team, each.name, each.email, each.role) for each in report.added]


def test_a_file_adds_teams_and_people_once(server: Serving) -> None:
    assert imported(server, SOUND) == [
        ("Green", "Dora", "dora@example.org", "participant"),
        ("Green", "Emil", None, "participant"),
        ("Blue", "Olga 2", "olga@example.org", "organiser"),
    ]
    logged = len(server.ask(ORGANISER, "GET", "/organiser/audit").json())
    assert imported(server, SOUND) == []
    assert imported(server, "\ufeffPerson;Team\r\nDora;Green\r\n") == []
    assert len(server.ask(ORGANISER, "GET", "/organiser/audit").json()) == logged


def test_an_address_is_kept_alone(server: Serving) -> None:
    """Mail programs copy it with a name."""
    (added,) = imported(server, "team,person,email\nBlue,Dora,Dora D. <dora@example.org>")
    assert added[2] == "dora@example.org"
    new = {"team": "Blue", "name": "Emil", "email": '"Emil E." <emil@example.org>'}
    assert server.ask(ORGANISER, "POST", "/organiser/people", json=new).json()["email"] == (
        "emil@example.org"
    )
    form = {"team": "Blue", "name": "Fay", "role": "participant", "email": "F <fay@example.org>"}
    assert signed_in(server, ORGANISER).send("/desk/people", form).status_code == 303
    people = server.ask(ORGANISER, "GET", "/organiser/people").json()
    assert "fay@example.org" in [each["email"] for each in people]


NOBODY = "columns: there is no column 'person'"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        pytest.param(
            "team,person",
            ["the file: has no rows below a line with the names of the columns"],
            id="no rows",
        ),
        pytest.param(
            "team,name\nBlue,Dora",
            ["column 'name': unknown; choose one of: team, person, email, role", NOBODY],
            id="unknown column",
        ),
        pytest.param(
            "team,e-mail\na,b",
            [
                (
                    "column 'e-mail': unknown; did you mean email? Choose one of: team, person, "
                    "email, role"
                ),
                NOBODY,
            ],
            id="misspelt",
        ),
        pytest.param("person\nDora", ["columns: there is no column 'team'"], id="no team"),
        pytest.param(
            "team,team,person\na,b,c",
            ["column 'team': occurs twice; remove one"],
            id="repeated column",
        ),
        pytest.param(FILE, ["line 2: has 2 values for 4 columns"], id="too few values"),
        pytest.param("team,person\nBlue,", ["line 2: person: required but missing"], id="no name"),
        pytest.param(
            "team,person,email\nBlue,Dora,dora",
            ["line 2: email: must be an e-mail address, such as ada@example.org"],
            id="no address",
        ),
        pytest.param(
            "team,person,role\nBlue,Dora,king",
            ["line 2: role: must be 'participant' or 'organiser'"],
            id="role",
        ),
        pytest.param(
            "team,person\nGreen,Dora\nGreen,Dora",
            ["line 3: repeats the person of line 2; remove one"],
            id="twice",
        ),
        pytest.param(
            "team,person,email\nBlue,Ada,ada@example.org",
            [
                (
                    "line 2: this person has another e-mail address; "
                    "change it with `person edit`, or at the desk"
                )
            ],
            id="email",
        ),
        pytest.param(
            "team,person,role\nBlue,Ada,organiser",
            ["line 2: this person is already registered as participant; roles cannot be changed"],
            id="another role",
        ),
    ],
)
def test_what_is_wrong_with_a_file_is_said_and_nothing_is_added(
    text: str, expected: list[str], server: Serving
) -> None:
    with pytest.raises(TableError) as refused:
        imported(server, text)
    assert list(map(str, refused.value.problems)) == expected
    assert "Dora" not in server.ask(ORGANISER, "GET", "/organiser/people").text


def test_all_problems_of_the_columns_are_listed(server: Serving) -> None:
    with pytest.raises(TableError) as refused:
        imported(server, "role,Role,nam\nx,x,Dora")
    assert [(each.code, each.where) for each in refused.value.problems] == [
        ("unknown-column", "column 'nam'"),
        ("repeated-column", "column 'role'"),
        ("no-column", "columns"),
        ("no-column", "columns"),
    ]


def test_all_problems_are_listed(server: Serving) -> None:
    with pytest.raises(TableError, match="3 problems") as refused:
        imported(server, "team,person,email\n,Dora,x\nBlue,Emil,y")
    assert [(each.code, each.position) for each in refused.value.problems] == [
        ("wrong-value", (0,)),
        ("wrong-value", (0,)),
        ("wrong-value", (1,)),
    ]


def test_invitations_as_a_file() -> None:
    first = PersonInvitation(
        hint="rvi_abcdefg",
        kind="invite",
        person="Dora",
        team="Blue",
        created_at=NOON,
        expires_at=NOON,
        revoked_at=None,
        token="rvi_abcdefgh",
        email="d@example.org",
    )
    changed = {"person": "Emil", "team": "=Red", "expires_at": None, "email": None}
    assert invitations_csv([first, first.model_copy(update=changed)]) == (
        "team,person,email,invitation,expires\n"
        "Blue,Dora,d@example.org,rvi_abcdefgh,2026-03-02T12:00:00+00:00\n"
        "'=Red,Emil,,rvi_abcdefgh,\n"
    )


def test_a_file_over_http(server: Serving) -> None:
    asked = {"text": SOUND, "invite": True, "dry_run": True}
    path = "/organiser/people/import"
    tried = server.ask(ORGANISER, "POST", path, json=asked).json()
    assert (len(tried["added"]), tried["teams"], tried["invitations"]) == (3, ["Green"], [])
    done = server.ask(ORGANISER, "POST", path, json={**asked, "dry_run": False}).json()
    assert [each["person"] for each in done["invitations"]] == ["Dora", "Emil", "Olga 2"]
    wrong = server.ask(ORGANISER, "POST", path, json={"text": "team,person\nBlue,"})
    assert (wrong.status_code, wrong.json()["problems"][0]["where"]) == (400, "line 2")


def test_a_file_on_the_command_line(server: Serving, run: Run, tmp_path: Path) -> None:
    folder, file = str(server.state.settings.folder), tmp_path / "people.csv"
    file.write_text(SOUND)
    tried = run("server", "person", "import", folder, str(file), "--dry-run")
    assert (tried.status, "3 would be added, 1 already there; 1 new team" in tried.err) == (0, True)
    done = run("server", "person", "import", folder, str(file), "--invite")
    rows = list(csv.DictReader(io.StringIO(done.out)))
    assert [(row["person"], row["email"]) for row in rows] == [
        ("Dora", "dora@example.org"),
        ("Emil", ""),
        ("Olga 2", "olga@example.org"),
    ]
    assert run("server", "person", "import", folder, str(file), "--invite").out == ""
    file.write_text(FILE)
    assert run("server", "person", "import", folder, str(file)).status == 1


def test_the_desk_says_how_many_people_a_file_has_added(server: Serving) -> None:
    desk = signed_in(server, ORGANISER)
    for count in (3, 0):
        sent = desk.send("/desk/people/import", {"text": SOUND, "confirmed": "yes"})
        assert f"Imported: {count} people added." in said(desk.get(sent.headers["location"]))


def test_a_file_at_the_desk(server: Serving) -> None:
    desk = signed_in(server, ORGANISER)
    path, form = "/desk/people/import", {"text": SOUND, "invite": "true"}
    asked = desk.send(path, form)
    assert "Add 3 people? The file has 4 rows; 1 is already on this server." in said(asked)
    shown = desk.send(path, {**form, "confirmed": "yes"})
    assert (shown.status_code, "3 invitations" in said(shown)) == (200, True)
    assert "Line 2" not in said(shown)
    refused = desk.send(path, {"text": FILE})
    assert refused.status_code == 400
    assert "has 2 values for 4 columns" in said(refused)
