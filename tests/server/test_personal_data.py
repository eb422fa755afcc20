"""A person's data: what an export has, what a deletion removes and what it leaves."""

import hashlib
import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import timedelta

from sqlalchemy import delete, select

from reverie_eval.schemas.joining import Rejection
from reverie_eval.schemas.organising import NewMerge
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.service.audit import entries
from reverie_eval.server.service.audited_rows import mismatches, swapped_names
from reverie_eval.server.service.joining import accept_request, reject_request
from reverie_eval.server.service.merging import merge_teams
from reverie_eval.server.service.personal_data import delete_person
from reverie_eval.server.store.tables import (
    AuditEntry,
    BrowserSession,
    Message,
    News,
    Person,
    Token,
)
from tests.support.acting import NOON, add_person, ask_to_join, create_token
from tests.support.flat import Run
from tests.support.serving import GOOD, MATE, OPEN, ORGANISER, OTHER, OWNER, Serving
from tests.support.visiting import said, signed_in

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
    assert SECOND in server.client.get(f"/boards/{OPEN}").text

    deleted = server.ask(ORGANISER, "DELETE", f"/organiser/people/{number}")
    assert deleted.json()["name"] == f"deleted person {number}"
    assert server.client.get("/api/v1/me", headers=headers).status_code == 401
    board = server.client.get(f"/boards/{OPEN}").text
    assert (SECOND in board, f"deleted person {number}" in board) == (False, True)
    log = server.ask(ORGANISER, "GET", "/organiser/audit").json()
    assert [each["digest"] for each in log[: len(digests)]] == digests
    assert faults(server) == []
    stored = database_text(server)
    assert (SECOND in stored, ADDRESS in stored) == (False, False)
    with server.state.database.reading() as session:
        assert session.scalars(select(News.posted_by)).all() == [ORGANISER]
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
    """By the rows that they left; the last name of a person is one of them."""
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
    replace(server.state.retention, days=1).tidy("test")
    assert faults(server) == []
    with server.state.database.writing() as session:
        session.execute(delete(AuditEntry).where(AuditEntry.id > first))
        told = " ".join(mismatches(session))
    expected = ("request accepted", "request rejected", "team merged", "person deleted")
    for action in (*expected, "upload deleted"):
        assert f"{action} (" in told


def test_the_last_organiser_keeps_a_token(server: Serving) -> None:
    own = f"/organiser/people/{server.person(ORGANISER).id}"
    token = f"/organiser/tokens/{server.tokens[ORGANISER][:11]}"
    for path in (own, token):
        refused = server.ask(ORGANISER, "DELETE", path)
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
    warning = "no organiser has a valid token now; `server token add` creates one"
    assert warning not in run("server", "person", "revoke", folder, OWNER).err
    assert warning in run("server", "person", "revoke", folder, ORGANISER).err
    assert warning not in run("server", "person", "revoke", folder, OTHER).err


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
    own = server.person(ORGANISER).id
    refused = desk.send(f"/desk/people/{own}/delete", {"confirmed": "yes"})
    assert (refused.status_code, "leave no organiser with" in said(refused)) == (409, True)


def test_a_name_that_was_put_back_is_found(server: Serving) -> None:
    server.ask(ORGANISER, "DELETE", "/organiser/people/1")
    with server.state.database.writing() as session:
        session.get_one(Person, 1).name = OWNER
    assert faults(server) == [
        "person:1 is called 'Ada'; the audit log has another name; compare with a backup"
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
    assert replace(server.state.retention, days=1).tidy("test").files == 1
    with server.state.database.reading() as session:
        assert list(mismatches(session)) == []
        assert list(swapped_names(session, server.state.audit_log)) == []
