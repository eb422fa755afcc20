"""A server below a path of its host: nothing that it says leads out of that path."""

import json
from pathlib import Path

import pytest
from markupsafe import escape

from reverie_eval.server.http.callers import COOKIE
from tests.support.crawling import crawl, links_of
from tests.support.entries import entered
from tests.support.serving import (
    OPEN,
    ORGANISER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    settings_of,
    submission_for,
)
from tests.support.visiting import Visitor

PREFIX = "/reverie"
ADDRESS = f"https://lab.example.org{PREFIX}"


@pytest.fixture
def server(folder: Path, open_server: OpenServer) -> Serving:
    """Return a server below a path, with something on its boards."""
    server = open_server(settings_of(folder).model_copy(update={"public_address": ADDRESS}))
    for split in (OPEN, PRIVATE):
        sent = server.upload(OWNER, submission_for(split), split).json()["submission"]["id"]
        server.ask(OWNER, "PATCH", f"/submissions/{sent}", json={"published": True})
    return server


def signed_in(server: Serving, who: str) -> Visitor:
    reply = server.client.post(f"{PREFIX}/sign-in", data={"token": server.tokens[who]})
    assert f"Path={PREFIX};" in reply.headers["set-cookie"]
    server.client.cookies.clear()
    return Visitor(server, reply.cookies[COOKIE])


@pytest.mark.parametrize("who", [None, OWNER, ORGANISER])
def test_no_link_leads_out_of_it_or_nowhere(who: str | None, server: Serving) -> None:
    visitor = signed_in(server, who) if who else Visitor(server)
    outside, missing, pages = set(), set(), 0
    for path, reply in crawl(visitor.get, f"{PREFIX}/"):
        if reply.status_code == 404 or reply.is_server_error:
            missing.add((path, reply.status_code))
        found = [("location", reply.headers["location"])] if "location" in reply.headers else []
        if reply.headers.get("content-type", "").startswith("text/html"):
            pages += 1
            found += links_of(reply.text)
        outside |= {
            (path, name, link)
            for name, link in found
            if link.startswith("/") and not link.startswith(f"{PREFIX}/")
        }
    assert (outside, missing) == (set(), set())
    assert pages > (30 if who == ORGANISER else 15)


def test_who_signs_in_on_the_way_returns(server: Serving) -> None:
    asked = server.client.get(f"{PREFIX}/desk/audit?actor=Ada")
    assert asked.headers["location"] == f"{PREFIX}/sign-in?back=/desk/audit%3Factor%3DAda"
    typed = {"token": server.tokens[ORGANISER], "back": "/desk/audit?actor=Ada"}
    entered = server.client.post(f"{PREFIX}/sign-in", data=typed)
    assert entered.headers["location"] == f"{PREFIX}/desk/audit?actor=Ada"
    server.client.cookies.clear()
    page = {"referer": f"{ADDRESS}/submit"}
    late = server.client.post(f"{PREFIX}/submit", headers=page)
    assert late.headers["location"] == f"{PREFIX}/sign-in?back=/submit&form=kept"


def test_signing_out_ends_the_cookie_of_the_path(server: Serving) -> None:
    reply = signed_in(server, OWNER).send(f"{PREFIX}/sign-out", {})
    assert reply.headers["location"] == f"{PREFIX}/"
    assert f"Path={PREFIX};" in reply.headers["set-cookie"]
    assert "Max-Age=0" in reply.headers["set-cookie"]


def test_copied_addresses_have_the_path(server: Serving) -> None:
    bibtex = server.client.get(f"{PREFIX}/splits/{OPEN}/bibtex").text
    assert rf"\url{{{ADDRESS}/splits/{OPEN}}}" in bibtex
    assert rf"\url{{{ADDRESS}/submissions/" in bibtex
    description = server.client.get(f"{PREFIX}/api/v1/openapi.json").json()
    assert description["servers"] == [{"url": PREFIX}]


def test_names_that_look_like_links_stay_as_they_are(server: Serving) -> None:
    name = 'Walker" href="/evil" src="/evil'
    entered(server, method={"name": name})
    for path in (f"/splits/{OPEN}", "/team"):
        page = signed_in(server, OWNER).get(f"{PREFIX}{path}").text
        assert escape(name) in page
        assert f"{PREFIX}/evil" not in page


def test_lists_link_their_next_page_below_the_path(server: Serving) -> None:
    headers = {"Authorization": f"Bearer {server.tokens[OWNER]}"}
    first = server.client.get(f"{PREFIX}/api/v1/submissions?limit=1", headers=headers)
    following = first.links["next"]["url"]
    second = server.client.get(first.url.join(following), headers=headers)
    assert second.url.path == f"{PREFIX}/api/v1/submissions"
    ids = [each["id"] for each in (*first.json(), *second.json())]
    assert len(set(ids)) == 2


def test_a_monitor_need_not_know_the_path(server: Serving) -> None:
    for path in ("/healthz", f"{PREFIX}/healthz"):
        assert json.loads(server.client.get(path).content)["status"] == "ok"


def test_another_path_that_begins_alike_is_not_it(server: Serving) -> None:
    assert server.client.get(f"{PREFIX}-other/splits/{OPEN}").status_code == 404
    assert server.client.get(f"{PREFIX}{PREFIX}/splits/{OPEN}").status_code == 404
