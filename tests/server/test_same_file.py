"""If two teams upload one file, the organiser hears of it at once, and nobody else ever."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select

from reverie_eval.server.audit.log import entries
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.settings import Settings, Webhook
from reverie_eval.server.store.tables import Message, Team
from tests.support.flat_world import Run
from tests.support.serving import (
    GOOD,
    MATE,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    settings_of,
    submission_for,
)
from tests.support.visiting import said, signed_in

SECRET = submission_for(PRIVATE)
TOLD = f"Red submitted to {PRIVATE} the file that another team had submitted: Blue"
ON_DESK = "The same file from two teams"


def telling(settings: Settings) -> Settings:
    """Return the settings of a server that tells the organiser everything."""
    hook = Webhook.model_validate({"url": "https://hooks.example.org"})
    return settings.model_copy(update={"webhook": hook})


@pytest.fixture
def told(folder: Path, open_server: OpenServer) -> Serving:
    """Return a server that tells the organiser everything."""
    return open_server(telling(settings_of(folder)))


def sent(server: Serving, who: str, content: bytes = SECRET, split: str = PRIVATE) -> str:
    """Send a file that is scored, and return the id of the submission."""
    reply = server.upload(who, content, split)
    assert reply.status_code == 201, reply.text
    server.clock.turn(seconds=1)
    submission: str = reply.json()["submission"]["id"]
    return submission


def messages(server: Serving) -> Sequence[tuple[str, str]]:
    """Return what the organiser is told of files that several teams sent, and where to look."""
    rows = select(Message.text, Message.path).where(Message.event == "same-file")
    with server.state.database.reading() as session:
        return [(text, path) for text, path in session.execute(rows.order_by(Message.id))]


def logged(server: Serving) -> Sequence[tuple[str, str, str, Any]]:
    """Return the entries of the audit log about such files."""
    with server.state.database.reading() as session:
        return [
            (entry.actor, entry.row, entry.subject, entry.details)
            for entry in entries(session)
            if entry.action == "same file"
        ]


def on_desk(server: Serving) -> str:
    """Return what the desk's first page says."""
    return said(signed_in(server, ORGANISER).get("/desk"))


def test_the_same_file_from_two_teams_is_told_at_once(
    server_on: Serving,
    open_server: OpenServer,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server = open_server(telling(server_on.state.settings), server_on.tokens)
    first = sent(server, OWNER)
    assert (messages(server), logged(server)) == ([], [])
    with caplog.at_level(logging.WARNING, "reverie_eval.server"):
        second = sent(server, OTHER)
    assert messages(server) == [(TOLD, "/desk")]
    assert logged(server) == [("server", f"submission:{second}", PRIVATE, {"same_as": [first]})]
    (line,) = [each for each in caplog.records if each.getMessage() == "same file from two teams"]
    with server.state.database.reading() as session:
        red = session.scalars(select(Team.id).where(Team.name == "Red")).one()
    fields = {"split": PRIVATE, "team": red, "submission": second, "same_as": [first]}
    assert line.fields == fields  # type: ignore[attr-defined]
    page = on_desk(server)
    assert f"{ON_DESK}, once in the last 30 days, the last time on {PRIVATE}." in page
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", server.state.settings.database)
    findings = examine(server.state.settings.folder)
    assert [each for each in findings if each.kind == "fault"] == []


def test_the_desk_forgets_it_after_30_days(told: Serving) -> None:
    sent(told, OWNER)
    sent(told, OTHER)
    told.clock.turn(days=29)
    sent(told, ORGANISER)
    assert f"{ON_DESK}, 2 times in the last 30 days" in on_desk(told)
    told.clock.turn(days=2)
    assert f"{ON_DESK}, once in the last 30 days" in on_desk(told)
    told.clock.turn(days=29)
    assert ON_DESK not in on_desk(told)


def test_it_says_which_of_several_was_published(told: Serving) -> None:
    sent(told, OWNER, GOOD, OPEN)
    published = sent(told, ORGANISER, GOOD, OPEN)
    told.ask(ORGANISER, "PATCH", f"/submissions/{published}", json={"published": True})
    sent(told, OTHER, GOOD, OPEN)
    text, _ = messages(told)[-1]
    expected = f"Red submitted to {OPEN} the file that other teams had submitted: "
    assert text == f"{expected}Organisers (published), Blue"


def test_a_file_that_the_organiser_submits_for_a_team_is_told_too(
    told: Serving, run: Run, tmp_path: Path
) -> None:
    sent(told, OWNER)
    (tmp_path / "sent.json").write_bytes(SECRET)
    words = ("--split", PRIVATE, "--team", "Red", "--person", OTHER, "--method", "Ours")
    received = f"{told.clock():%Y-%m-%dT%H:%M:%SZ}"
    place = str(told.state.settings.folder), str(tmp_path / "sent.json")
    assert run("server", "submit", *place, *words, "--received", received).status == 0
    assert len(logged(told)) == 1


@pytest.mark.parametrize(
    ("who", "content", "split", "status"),
    [
        pytest.param(OWNER, SECRET, PRIVATE, 200, id="the same person"),
        pytest.param(MATE, SECRET, PRIVATE, 200, id="the same team"),
        pytest.param(OTHER, SECRET + b" ", PRIVATE, 201, id="another file"),
        pytest.param(OTHER, GOOD, OPEN, 201, id="another split"),
        pytest.param(OTHER, SECRET[:-1], PRIVATE, 422, id="rejected"),
    ],
)
def test_nothing_else_is_told(
    who: str, content: bytes, split: str, status: int, told: Serving
) -> None:
    sent(told, OWNER)
    assert told.upload(who, content, split).status_code == status
    assert (messages(told), logged(told)) == ([], [])
    assert ON_DESK not in on_desk(told)


def test_no_participant_learns_that_another_team_sent_the_file(told: Serving) -> None:
    """A file that nobody else sent gets the same replies."""
    first = sent(told, OWNER)
    reply = told.upload(OTHER, SECRET, PRIVATE)
    told.clock.turn(days=2)
    alone = told.upload(OTHER, SECRET + b" ", PRIVATE)
    assert shape(reply.json()) == shape(alone.json())
    same, other = (each.json()["submission"]["id"] for each in (reply, alone))
    carl, ada = signed_in(told, OTHER), signed_in(told, OWNER)
    pages = [said(carl.get(f"/submissions/{each}")) for each in (same, other)]
    assert [text.count("by Carl") for text in pages] == [2, 2]
    assert len({len(text) for text in pages}) == 1
    person = told.ask(ORGANISER, "GET", f"/organiser/people/{told.person(OTHER).id}")
    for text in (reply.text, *pages, said(carl.get("/team")), person.text):
        assert first not in text
        assert "Blue" not in text
        assert "same file" not in text.lower()
        assert "same_as" not in text
    read = said(ada.get(f"/submissions/{first}")) + said(ada.get("/team"))
    assert "Red" not in read
    assert same not in read


def shape(value: Any) -> Any:
    """Return the names and kinds of everything in a reply."""
    if isinstance(value, dict):
        return {name: shape(each) for name, each in value.items()}
    return [shape(each) for each in value] if isinstance(value, list) else type(value)


def test_what_is_not_stored_is_not_told(told: Serving) -> None:
    """The notice is written with the submission, or not at all."""
    sent(told, OWNER)
    for serial in range(3):
        told.upload(OTHER, SECRET + b" " * (1 + serial), PRIVATE)
    assert told.upload(OTHER, SECRET, PRIVATE).status_code == 429
    assert (messages(told), logged(told)) == ([], [])
