"""A person's data: what an export has, what a deletion removes and what it leaves."""

import hashlib
import json
import re
import shlex
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from datetime import timedelta
from threading import Barrier

import pytest
from sqlalchemy import delete, select

from reverie_eval.schemas.organising import NewMerge
from reverie_eval.schemas.people import Rejection
from reverie_eval.server.accounts.joining import accept_request, reject_request
from reverie_eval.server.accounts.people import merge_teams
from reverie_eval.server.accounts.personal_data import delete_person
from reverie_eval.server.audit.log import entries
from reverie_eval.server.audit.rows import mismatches
from reverie_eval.server.errors import ConflictError
from reverie_eval.server.intake.retention import tidy
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.store.tables import AuditEntry, BrowserSession, Message, Person, Token
from tests.support.acting import NOON, add_person, ask_to_join, create_token
from tests.support.flat_world import Run
from tests.support.serving import GOOD, MATE, OPEN, ORGANISER, OTHER, OWNER, Serving
from tests.support.visiting import said, signed_in
from tests.support.waiting import PATIENCE

ADDRESS = "ada.lovelace@example.org"
SECOND = "Zoraida"
"""An organiser whose name is nowhere else."""


def faults(server: Serving) -> list[str]:
    found = examine(server.state.settings.folder)
    return [finding.what for finding in found if finding.kind == "fault"]


def second_organiser(server: Serving) -> tuple[int, dict[str, str]]:
    """Add another organiser, and return their number and the headers that they send."""
    with server.acting() as transaction:
        add_person(transaction, "Organisers", SECOND, "organiser")
        token = create_token(transaction, SECOND)
    return server.person(SECOND).id, {"Authorization": f"Bearer {token.token}"}


def test_an_export_has_all_of_a_person_and_nothing_of_others(server: Serving) -> None:
    path = f"/organiser/people/{server.person(OWNER).id}"
    server.ask(ORGANISER, "PATCH", path, json={"email": ADDRESS})
    submission = server.upload(OWNER).json()["submission"]
    server.upload(MATE, server.distinct())
    server.upload(OWNER, b"[]")
    signed_in(server, OWNER)
    for change in ({"published": True}, {"withdrawn": True}):
        server.clock.turn(hours=1)
        server.ask(OWNER, "PATCH", f"/submissions/{submission['id']}", json=change)
    data = server.ask(ORGANISER, "GET", path).json()
    assert (data["person"]["name"], data["person"]["email"]) == (OWNER, ADDRESS)
    assert data["submissions"] == [
        {
            "id": submission["id"],
            "split": OPEN,
            "team": "Blue",
            "sha256": hashlib.sha256(GOOD).hexdigest(),
            "size": len(GOOD),
            "received_at": "2026-03-02T12:00:00Z",
            "published_at": "2026-03-02T13:00:00Z",
            "withdrawn_at": "2026-03-02T14:00:00Z",
            "method": submission["method"],
        }
    ]
    assert [each["outcome"] for each in data["attempts"]] == ["scored", "submission-rejected"]
    assert ([each["kind"] for each in data["tokens"]], len(data["sessions"])) == (["access"], 1)
    assert [each["action"] for each in data["audit"]] == [
        "person added",
        "access token created",
        "person changed",
        "submitted",
        "changed",
        "changed",
    ]
    assert server.tokens[OWNER] not in json.dumps(data)
    assert MATE not in json.dumps(data)


def test_a_deleted_person_is_nowhere_and_the_log_is_whole(server: Serving) -> None:
    number, headers = second_organiser(server)
    server.ask(ORGANISER, "PATCH", f"/organiser/people/{number}", json={"email": ADDRESS})
    submission = server.upload(OWNER).json()["submission"]["id"]
    server.ask(OWNER, "PATCH", f"/submissions/{submission}", json={"published": True})
    review = {"submission_id": submission, "verdict": "verified", "reason": "ran it"}
    server.ask(None, "POST", "/organiser/reviews", json=review, headers=headers)
    server.ask(None, "PUT", "/organiser/notice", json={"banner": "Hello"}, headers=headers)
    server.ask(ORGANISER, "POST", "/organiser/news", json={"text": "Hello"})
    digests = [each["digest"] for each in server.ask(ORGANISER, "GET", "/organiser/audit").json()]
    deleted = server.ask(ORGANISER, "DELETE", f"/organiser/people/{number}")
    assert deleted.json()["name"] == f"deleted person {number}"
    assert server.client.get("/api/v1/me", headers=headers).status_code == 401
    log = server.ask(ORGANISER, "GET", "/organiser/audit").json()
    assert [each["digest"] for each in log[: len(digests)]] == digests
    assert faults(server) == []
    stored = database_text(server)
    assert (SECOND in stored, ADDRESS in stored) == (False, False)
    for method in ("GET", "PATCH", "DELETE"):
        path = f"/organiser/people/{number}"
        assert server.ask(ORGANISER, method, path, json={}).status_code == 404


def test_a_deletion_ends_sessions_and_reaches_messages_about_submissions(server: Serving) -> None:
    for who in (OWNER, MATE):
        signed_in(server, who)
    about = {"channel": "mail", "event": "submission", "attempts": 0, "error": ""}
    with server.acting() as transaction:
        session = transaction.session
        text = f"Blue ({OWNER}) submitted {OWNER} to test"
        for path in ("/submissions/1", "/desk"):
            session.add(Message(**about, path=path, text=text, created_at=NOON, due_at=NOON))
        delete_person(transaction, server.person(OWNER).id)
        messages = session.scalars(select(Message.text).order_by(Message.id)).all()
        owners = select(Token.person_id).join(BrowserSession, BrowserSession.token_id == Token.id)
        assert session.scalars(owners).all() == [server.person(MATE).id]
    assert messages == ["Blue (deleted person 1) submitted Ada to test", text]


def database_text(server: Serving) -> str:
    """Return all that the rows of the database hold."""
    with closing(sqlite3.connect(server.state.settings.folder / "server.db")) as connection:
        return "\n".join(connection.iterdump())


def test_results_of_a_deleted_person_stay(server: Serving) -> None:
    submission = server.upload(OWNER).json()["submission"]
    server.ask(ORGANISER, "DELETE", f"/organiser/people/{server.person(OWNER).id}")
    seen = server.ask(MATE, "GET", f"/submissions/{submission['id']}").json()
    assert (seen["person"], seen["receipt"]) == ("deleted person 1", submission["receipt"])
    teams = server.ask(ORGANISER, "GET", "/organiser/teams").json()
    assert next(team for team in teams if team["name"] == "Blue")["people"] == [MATE]
    with server.acting() as transaction:
        add_person(transaction, "Blue", OWNER)  # the name is free


def test_actions_on_people_that_are_cut_off_the_log_are_seen(server: Serving) -> None:
    """By the rows that they left."""
    server.upload(OWNER)
    for team in ("Green", "Spam"):
        ask_to_join(server.state.transactions, team)
    with server.acting() as transaction:
        first = len(entries(transaction.session))
        accept_request(transaction, 1)
        reject_request(transaction, 2, Rejection())
        merge_teams(transaction, NewMerge(team="Red", into="Green"))
        delete_person(transaction, 1)
    server.clock.turn(days=1)
    tidy(server.state, 1)
    assert faults(server) == []
    with server.state.database.writing() as session:
        cut = AuditEntry.id > first
        rows = {each.row for each in entries(session, cut)}
        session.execute(delete(AuditEntry).where(cut))
        told = " ".join(mismatches(session))
    assert {row.partition(":")[0] for row in rows} >= {
        "join_request",
        "team",
        "person",
        "submission",
    }
    assert {row for row in rows if row not in told} == set()


ONLY = "is the only organiser; first add another, and create a token for them"


def test_the_only_organiser_cannot_be_deleted(server_on: Serving) -> None:
    server = server_on
    number = server.person(ORGANISER).id
    refused = server.ask(ORGANISER, "DELETE", f"/organiser/people/{number}")
    assert (refused.status_code, refused.json()["detail"]) == (409, f"{ORGANISER} {ONLY}")
    desk = signed_in(server, ORGANISER)
    page = desk.send(f"/desk/people/{number}/delete", {"confirmed": "yes"})
    assert (page.status_code, ONLY in said(page)) == (409, True)
    with server.acting() as transaction, pytest.raises(ConflictError, match=ONLY):
        delete_person(transaction, number)
    assert server.person(ORGANISER).deleted_at is None

    second, headers = second_organiser(server)
    deleted = server.ask(None, "DELETE", f"/organiser/people/{number}", headers=headers)
    assert deleted.status_code == 200
    with server.acting() as transaction, pytest.raises(ConflictError, match=f"{SECOND} {ONLY}"):
        delete_person(transaction, second)


def test_one_of_two_organisers_that_are_deleted_at_once_stays(server_on: Serving) -> None:
    number, _ = second_organiser(server_on)
    both = (server_on.person(ORGANISER).id, number)
    ready = Barrier(len(both))

    def delete_one(number: int) -> bool:
        ready.wait(PATIENCE)
        try:
            with server_on.acting() as transaction:
                delete_person(transaction, number)
        except ConflictError:
            return False
        return True

    with ThreadPoolExecutor(len(both)) as pool:
        assert sorted(pool.map(delete_one, both)) == [False, True]


def test_a_command_does_not_delete_the_only_organiser(server: Serving, run: Run) -> None:
    folder = str(server.state.settings.folder)
    words = ("server", "person", "delete", folder, ORGANISER, "--yes")
    refused = run(*words)
    assert (refused.status, refused.out) == (2, "")
    assert f"{ORGANISER} {ONLY}" in refused.err
    with server.acting() as transaction:
        add_person(transaction, "Red", SECOND, "organiser")
    assert run(*words).status == 0


def test_the_last_organiser_keeps_a_token(server: Serving) -> None:
    token = f"/organiser/tokens/{server.tokens[ORGANISER][:11]}"
    refused = server.ask(ORGANISER, "DELETE", token)
    assert (refused.status_code, "leave no organiser with" in refused.text) == (409, True)
    with server.acting() as transaction:
        add_person(transaction, "Organisers", SECOND, "organiser")
        create_token(transaction, SECOND, "invite")
    assert server.ask(ORGANISER, "DELETE", token).status_code == 409  # an invitation is no token
    with server.acting() as transaction:
        ends = server.clock() + timedelta(hours=1)
        create_token(transaction, SECOND, expires_at=ends)
    server.clock.turn(hours=1)
    assert server.ask(ORGANISER, "DELETE", token).status_code == 409  # it has expired
    with server.acting() as transaction:
        create_token(transaction, SECOND)
    assert server.ask(ORGANISER, "DELETE", token).status_code == 200


def test_the_command_line_warns_of_the_last_organiser(server: Serving, run: Run) -> None:
    folder = str(server.state.settings.folder)
    warning = re.compile("no organiser has a valid token now; `reverie-eval (.+)` creates one")
    with server.acting() as transaction:
        add_person(transaction, "Red", ORGANISER)  # another Olga
    words = ("server", "person", "revoke", folder)
    assert not warning.search(run(*words, OWNER).err)
    told = warning.search(run(*words, ORGANISER, "--team", "Organisers").err)
    assert told
    assert not warning.search(run(*words, OTHER).err)
    created = run(*shlex.split(told[1]))
    token = {"Authorization": f"Bearer {created.out.strip()}"}
    assert server.ask(None, "GET", "/organiser/teams", headers=token).status_code == 200


def test_a_person_is_exported_and_deleted_on_the_command_line(server: Serving, run: Run) -> None:
    folder = str(server.state.settings.folder)
    exported = json.loads(run("server", "person", "export", folder, OWNER).out)
    assert exported["person"]["name"] == OWNER
    refused = run("server", "person", "delete", folder, OWNER)
    assert (refused.status, "confirm it with --yes" in refused.err) == (2, True)
    deleted = run("server", "person", "delete", folder, OWNER, "--yes")
    assert (deleted.status, deleted.out) == (0, "Ada is now deleted person 1\n")
    assert run("server", "person", "delete", folder, OWNER, "--yes").status == 2


def test_a_person_is_exported_and_deleted_at_the_desk(server: Serving) -> None:
    desk = signed_in(server, ORGANISER)
    data = desk.get("/desk/people/1/data")
    assert data.headers["content-disposition"] == 'attachment; filename="person-1.json"'
    assert data.json()["person"]["name"] == OWNER
    assert "Delete Ada?" in said(desk.send("/desk/people/1/delete", {}))
    done = desk.send("/desk/people/1/delete", {"confirmed": "yes"})
    assert done.headers["location"] == "/desk/people?done=deleted"


def test_a_name_that_was_put_back_is_found(server: Serving) -> None:
    server.ask(ORGANISER, "DELETE", "/organiser/people/1")
    with server.state.database.writing() as session:
        session.get_one(Person, 1).name = OWNER
    assert faults(server) == [
        "person:1 was changed after its last entry in the audit log; compare with a backup"
    ]


def test_people_are_looked_after_on_both_databases(server_on: Serving) -> None:
    server = server_on
    for who in (OWNER, OTHER):
        server.upload(who)

    def do(method: str, path: str, **fields: object) -> int:
        return server.ask(ORGANISER, method, f"/organiser/{path}", json=fields).status_code

    ask_to_join(server.state.transactions)
    statuses = [
        do("POST", "requests/1/accept"),
        do("POST", "people/import", text="team,person\nLime,Zoe", invite=True),
        do("GET", "people/1"),
        do("DELETE", "people/1"),
        do("POST", "teams/merge", team="Red", into="Blue"),
        do("PATCH", "people/2", name="Bert", team="Lime"),
    ]
    assert statuses == 6 * [200]
    server.clock.turn(days=1)
    assert len(tidy(server.state, 1)) == 2
    with server.state.database.reading() as session:
        assert list(mismatches(session)) == []
