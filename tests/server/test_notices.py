"""The banner and the pause, changed while the server runs."""

import re
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import httpx
import pytest

from reverie_eval.schemas.organising import NewNotice
from reverie_eval.server.audit.log import entries
from reverie_eval.server.messages.notices import NO_NOTICE, current_notice, post_notice
from reverie_eval.server.store.database import Database
from tests.support.acting import NOON, acting
from tests.support.flat_world import Run
from tests.support.serving import (
    GOOD,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    OpenServer,
    Serving,
    settings_of,
)
from tests.support.visiting import signed_in

BANNER = "Down until 14:00 UTC."


def post(server: Serving, banner: str = "", *, paused: bool = False) -> httpx.Response:
    said = {"banner": banner, "paused": paused}
    return server.ask(ORGANISER, "PUT", "/organiser/notice", json=said)


def shown(server: Serving) -> tuple[str, bool]:
    said = server.ask(None, "GET", "/server").json()
    return said["banner"], said["paused"]


def test_before_the_first_there_is_none(server: Serving) -> None:
    said = server.ask(ORGANISER, "GET", "/organiser/notice").json()
    assert said == {"banner": "", "paused": False, "created_at": None}


def test_the_latest_holds_at_once_and_is_written_down(server_on: Serving) -> None:
    posted = post(server_on, f" {BANNER} ", paused=True).json()
    assert posted == {
        "banner": BANNER,
        "paused": True,
        "created_at": "2026-03-02T12:00:00Z",
    }
    assert shown(server_on) == (BANNER, True)
    post(server_on)
    assert shown(server_on) == ("", False)
    with server_on.state.database.reading() as session:
        found = [
            (entry.row, entry.subject, entry.details)
            for entry in entries(session)
            if entry.action == "notice posted"
        ]
    assert found == [
        ("notice:1", "server", {"banner": BANNER, "paused": True}),
        ("notice:2", "server", {"banner": "", "paused": False}),
    ]


def test_an_earlier_notice_is_known_from_its_moment_on(sqlite: Database) -> None:
    second = timedelta(seconds=1)
    with acting(sqlite, "Olga") as first:
        session = first.session
        assert current_notice(session) == NO_NOTICE
        post_notice(first, NewNotice(banner=BANNER, paused=True))
        last = post_notice(replace(first, now=NOON + second), NewNotice(banner="Welcome"))
        assert current_notice(session) == last
        assert last.model_dump() == {
            "banner": "Welcome",
            "paused": False,
            "created_at": NOON + second,
        }
        shown = [current_notice(session, NOON + each * second) for each in (-1, 0, 1, 2)]
    assert [each.paused for each in shown] == [False, True, False, False]
    assert [each.created_at for each in shown] == [None, NOON, NOON + second, NOON + second]


def test_a_pause_stops_uploads_and_nothing_else(server: Serving) -> None:
    assert server.upload(OWNER).status_code == 201
    post(server, BANNER, paused=True)
    refused = server.upload(OTHER, server.distinct())
    assert (refused.status_code, refused.json()["code"]) == (409, "not-open")
    assert refused.json()["detail"] == f"the organiser has paused submissions: {BANNER}"
    assert server.upload(OWNER).status_code == 200
    assert server.ask(OTHER, "POST", f"/splits/{OPEN}/validate", content=GOOD).status_code == 200
    post(server)
    assert server.upload(OTHER, server.distinct()).status_code == 201


def test_a_pause_of_all_splits_is_shown_wherever_a_split_is(server: Serving) -> None:
    visitor = signed_in(server, ORGANISER)
    assert server.ask(None, "GET", "/splits/test").json()["paused"] is False
    post(server, paused=True)
    for place in ("/", "/splits/test", "/guide/rules", "/submit", "/desk", "/desk/phases"):
        page = visitor.get(place).text
        assert '<span class="badge bad">paused</span>' in page, place
        assert ">open</span>" not in page, place
    assert server.ask(None, "GET", "/splits/test").json()["paused"] is True
    assert all(each["paused"] for each in server.ask(None, "GET", "/splits").json())
    assert "Resume" not in visitor.get("/desk/phases").text  # no split is paused by itself
    post(server)
    assert ">open</span>" in visitor.get("/splits/test").text
    assert server.ask(None, "GET", "/splits/test").json()["paused"] is False


def test_it_holds_after_a_restart(server: Serving, folder: Path, open_server: OpenServer) -> None:
    post(server, BANNER, paused=True)
    assert shown(open_server(settings_of(folder), server.tokens)) == (BANNER, True)


@pytest.mark.parametrize("banner", ["two\nlines", "x" * 501, "\u202eback"])
def test_a_banner_is_a_line(banner: str, server: Serving) -> None:
    assert post(server, banner).status_code == 400
    assert shown(server) == ("", False)


def test_pages_show_it_escaped(server: Serving) -> None:
    post(server, "<b>Down</b>")
    assert "&lt;b&gt;Down&lt;/b&gt;" in server.client.get("/sign-in").text


# Commands.


def test_commands_post_a_banner_and_pause_and_leave_the_other_as_it_is(
    server: Serving, folder: Path, run: Run
) -> None:
    def said(words: str, *text: str) -> str:
        group, command = words.split()
        outcome = run("server", group, command, str(folder), *text)
        assert (outcome.status, outcome.err) == (0, "")
        return outcome.out

    def standing() -> list[str]:
        return re.split("  +", said("phase show").splitlines()[1].strip())

    assert standing() == ["all splits", "-", "-", "not paused"]
    assert said("news banner", f" {BANNER} ") == f"not paused; banner: {BANNER}\n"
    assert said("phase pause") == f"paused; banner: {BANNER}\n"
    assert shown(server) == (BANNER, True)
    assert standing() == ["all splits", "-", *2 * [f"paused; banner: {BANNER}"]]
    assert said("news banner", "") == "paused\n"
    assert shown(server) == ("", True)
    assert said("phase resume") == "not paused\n"
    assert shown(server) == ("", False)
    post(server, "Welcome", paused=True)
    assert said("phase resume") == "not paused; banner: Welcome\n"
    found = [each["actor"] for each in server.ask(ORGANISER, "GET", "/organiser/audit").json()]
    assert all(each.endswith(" (command line)") for each in found[-6:-2])


@pytest.mark.parametrize("banner", ["two\nlines", "x" * 501])
def test_a_banner_of_a_command_is_a_line(
    banner: str, server: Serving, folder: Path, run: Run
) -> None:
    refused = run("server", "news", "banner", str(folder), banner)
    assert refused.status == 2
    assert "banner" in refused.err
    assert shown(server) == ("", False)
