"""Who may see which page, and send which form."""

import re
from collections.abc import Mapping
from typing import NamedTuple

import httpx
import pytest

from reverie_eval.schemas.organising import NewNews, NewSnapshot
from reverie_eval.schemas.service import Method
from reverie_eval.server.app import create_app
from reverie_eval.server.boards.news import add_news
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.store.tables import ReportedResult
from tests.support.acting import NOON, ask_to_join, create_token, review
from tests.support.page_routes import page_routes
from tests.support.serving import (
    GOOD,
    GROUNDING,
    MATE,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    Serving,
)

ROLES = {
    "anonymous": None,
    "other": OTHER,
    "mate": MATE,
    "owner": OWNER,
    "organiser": ORGANISER,
}
SIGN_IN = "sign-in"
"""A cell: the reply leads to where one signs in."""

TABLE = """
                                    anonymous  other     mate      owner     organiser
GET  /                              200        200       200       200       200
GET  /splits/{split}                200        200       200       200       200
GET  /splits/{split}/snapshots/{number} 200     200       200       200       200
GET  /splits/{split}/chart          200        200       200       200       200
GET  /splits/{split}/latex          200        200       200       200       200
GET  /splits/{split}/bibtex         200        200       200       200       200
GET  /splits/{split}/compare        400        400       400       400       400
GET  /splits/{split}/boards/{board}/compare   400  400    400       400       400
GET  /splits/{split}/feed.atom      200        200       200       200       200
GET  /splits/{split}/boards/{board}           200  200    200       200       200
GET  /splits/{split}/boards/{board}/chart     200  200    200       200       200
GET  /splits/{split}/boards/{board}/latex     200  200    200       200       200
GET  /splits/{split}/boards/{board}/bibtex    200  200    200       200       200
GET  /splits/{split}/boards/{board}/feed.atom 200  200    200       200       200
GET  /feed.atom                     200        200       200       200       200
GET  /sign-in                       200        200       200       200       200
POST /sign-in                       401        303       303       303       303
POST /sign-in/invitation            401        401       401       401       401
GET  /join                          200        200       200       200       200
POST /join                          200        200       200       200       200
POST /sign-out                      sign-in    303       303       303       303
GET  /submit                        sign-in    200       200       200       200
POST /submit                        sign-in    303       303       303       303
GET  /team                          sign-in    200       200       200       200
GET  /submissions/{submission_id}   404        404       200       200       200
POST /submissions/{submission_id}   sign-in    404       303       303       303
GET  /submissions/{submission_id}/analysis  404  404     200       200       200
GET  /teams/{team_id}               404        404       404       404       404
GET  /episodes                      200        200       200       200       200
GET  /episodes/{split}              200        200       200       200       200
GET  /episodes/{split}/{instr_id}   200        200       200       200       200
GET  /episodes/{split}/{instr_id}/view 400     400       400       400       400
GET  /play/{split}                  200        200       200       200       200
GET  /play/{split}/{number}         200        200       200       200       200
GET  /guide                         200        200       200       200       200
GET  /guide/submitting              200        200       200       200       200
GET  /guide/submitting/{task}       200        200       200       200       200
GET  /guide/metrics                 200        200       200       200       200
GET  /guide/metrics/{task}          200        200       200       200       200
GET  /guide/protocols               200        200       200       200       200
GET  /guide/protocols/{task}        200        200       200       200       200
GET  /guide/rules                   200        200       200       200       200
GET  /guide/api                     200        200       200       200       200
GET  /guide/privacy                 200        200       200       200       200
GET  /desk                          sign-in    403       403       403       200
GET  /desk/attempts                  sign-in    403       403       403       200
GET  /desk/reviews                  sign-in    403       403       403       200
POST /desk/reviews                  sign-in    403       403       403       303
POST /desk/reviews/{review_id}/lift sign-in    403       403       403       303
GET  /desk/emailed-files            sign-in    403       403       403       200
POST /desk/emailed-files            sign-in    403       403       403       200
GET  /desk/reported                 sign-in    403       403       403       200
POST /desk/reported                 sign-in    403       403       403       303
GET  /desk/reported/import          sign-in    403       403       403       200
POST /desk/reported/import          sign-in    403       403       403       303
GET  /desk/reported/{result_id}     sign-in    403       403       403       200
POST /desk/reported/{result_id}     sign-in    403       403       403       303
POST /desk/reported/{result_id}/remove sign-in 403       403       403       303
GET  /desk/corrections              sign-in    403       403       403       200
GET  /desk/quotas                   sign-in    403       403       403       200
POST /desk/quotas                   sign-in    403       403       403       303
GET  /desk/phases                   sign-in    403       403       403       200
POST /desk/phases                   sign-in    403       403       403       303
GET  /desk/snapshots                sign-in    403       403       403       200
POST /desk/snapshots                sign-in    403       403       403       303
GET  /desk/requests                 sign-in    403       403       403       200
POST /desk/requests                 sign-in    403       403       403       303
GET  /desk/people                   sign-in    403       403       403       200
POST /desk/people                   sign-in    403       403       403       303
POST /desk/people/teams/merge       sign-in    403       403       403       303
GET  /desk/people/import            sign-in    403       403       403       200
POST /desk/people/import            sign-in    403       403       403       303
GET  /desk/people/{person_id}       sign-in    403       403       403       200
GET  /desk/people/{person_id}/data  sign-in    403       403       403       200
POST /desk/people/{person_id}/delete sign-in   403       403       403       303
POST /desk/people/{person_id}       sign-in    403       403       403       303
POST /desk/people/teams             sign-in    403       403       403       303
POST /desk/people/teams/rename      sign-in    403       403       403       303
POST /desk/people/tokens            sign-in    403       403       403       200
POST /desk/people/tokens/{hint}/revoke sign-in 403       403       403       303
GET  /desk/news                     sign-in    403       403       403       200
POST /desk/news                     sign-in    403       403       403       303
POST /desk/news/{news_id}/remove    sign-in    403       403       403       303
GET  /desk/notice                   sign-in    403       403       403       200
POST /desk/notice                   sign-in    403       403       403       303
GET  /desk/audit                    sign-in    403       403       403       200
"""
ROWS = {" ".join(line.split()[:2]): line.split()[2:] for line in TABLE.splitlines()[2:]}
every_form = pytest.mark.parametrize("row", [row for row in ROWS if row.startswith("POST")])

FORMS: Mapping[str, dict[str, str]] = {
    "POST /submit": {"split": OPEN, "what": "score", "name": "Walker"},
    "POST /desk/reviews": {
        "submission_id": "{submission_id}",
        "verdict": "verified",
        "reason": "ran",
    },
    "POST /desk/reported": {
        "split": OPEN,
        "team": "Them",
        "name": "Theirs",
        "source": "https://example.org/",
        "spl": "7",
    },
    "POST /desk/reported/import": {"split": OPEN, "source": "Them", "text": "team,SPL\nThem,8"},
    "POST /desk/reported/{result_id}": {
        "team": "Them",
        "name": "Theirs, corrected",
        "source": "https://example.org/",
        "spl": "7",
    },
    "POST /desk/emailed-files": {
        "person": "1",
        "split": OPEN,
        "received_at": "2026-03-02T12:00:00Z",
        "name": "Walker",
    },
    "POST /desk/quotas": {
        "team": "Blue",
        "split": OPEN,
        "extra": "1",
        "reason": "disk",
        "expires_at": "2026-04-01",
    },
    "POST /desk/phases": {"split": OPEN, "what": "pause"},
    "POST /desk/snapshots": {"split": OPEN, "title": "CVPR 2027"},
    "POST /desk/requests": {"request": "{request_id}", "what": "reject"},
    "POST /desk/people": {"name": "Dora", "team": "Red", "role": "participant"},
    "POST /join": {"team": "Green", "people": "Dora, dora@example.org", "institution": "Here"},
    "POST /desk/people/teams/merge": {"team": "Red", "into": "Organisers"},
    "POST /desk/people/import": {"text": "team,person\nGreen,Dora"},
    "POST /desk/people/{person_id}": {"name": "Adele", "team": "Blue", "email": ""},
    "POST /desk/people/teams": {"name": "Green"},
    "POST /desk/people/teams/rename": {"team": "Red", "name": "Azure"},
    "POST /desk/people/tokens": {"person": "1", "kind": "invite"},
    "POST /desk/news": {"text": "Soon"},
    "POST /desk/notice": {"banner": "Soon"},
}
"""What a form's own fields hold."""
FILES = {
    form: {"file": ("answers.json", GOOD)} for form in ("POST /submit", "POST /desk/emailed-files")
}
FIELD = re.compile(r'name="csrf_token" value="([^"]+)"')


class Stocked(NamedTuple):
    """A server with every page that there can be."""

    server: Serving
    parts: Mapping[str, str]
    """What stands for the braces of a path: what belongs to the owner."""


@pytest.fixture(scope="module")
def stocked(shared: Serving) -> Stocked:
    """Return a server for pages to be looked at; ``copied`` is one for forms to be sent to."""
    return Stocked(shared, stock(shared))


def stock(server: Serving) -> Mapping[str, str]:
    """Add something to every page."""
    ids = {
        split: server.upload(OWNER, server.distinct(split), split).json()["submission"]["id"]
        for split in (OPEN, PRIVATE)
    }
    with server.acting() as transaction:
        spare = create_token(transaction, OWNER).hint
        said = review(transaction, ids[OPEN], "verified").id
        news = add_news(transaction, NewNews(text="Soon")).id
        result = ReportedResult(
            split=OPEN,
            method=Method(name="Earlier").model_dump(mode="json"),
            team="Them",
            scores={"spl": 0.07},
            source="https://example.org/",
            dataset="",
            created_at=NOON,
        )
        transaction.add(result)
        taken = server.state.get(Snapshots).take(transaction, NewSnapshot(split=OPEN, title="2026"))
    return {
        "hint": spare,
        "person_id": "1",
        "team_id": "1",
        "request_id": str(ask_to_join(server.state.transactions)),
        "review_id": str(said),
        "news_id": str(news),
        "result_id": str(result.id),
        "number": str(taken.number),
        "split": OPEN,
        "task": "reverie",
        "board": GROUNDING,
        "submission_id": ids[OPEN],
        "private_id": ids[PRIVATE],
        "instr_id": "1196_0_0",
    }


def sign_in(server: Serving, who: str | None) -> str:
    """Sign in with the browser's form, and return the session's CSRF token."""
    server.client.cookies.clear()
    if who is None:
        return ""
    server.client.post("/sign-in", data={"token": server.tokens[who]})
    found = FIELD.search(server.client.get("/sign-in").text)
    assert found is not None
    return found[1]


def send(server: Serving, row: str, who: str | None, parts: Mapping[str, str]) -> httpx.Response:
    """Send a form as somebody."""
    token = sign_in(server, who)
    own = {name: value.format(**parts) for name, value in FORMS.get(row, {}).items()}
    form = {"csrf_token": token, "confirmed": "yes"} | own
    if row == "POST /sign-in":
        form["token"] = server.tokens[who] if who else "rv_none"
    path = row.removeprefix("POST ").format(**parts)
    return server.client.post(path, data=form, files=FILES.get(row))


def outcome(reply: httpx.Response) -> str:
    leads_in = reply.headers.get("location", "").startswith("/sign-in")
    return SIGN_IN if leads_in else str(reply.status_code)


@pytest.mark.parametrize("role", ROLES)
def test_who_may_see_what(role: str, stocked: Stocked) -> None:
    sign_in(stocked.server, ROLES[role])
    column = [*ROLES].index(role)
    expected = {row: cells[column] for row, cells in ROWS.items() if row.startswith("GET")}
    paths = {row: row.removeprefix("GET ").format(**stocked.parts) for row in expected}
    found = {row: outcome(stocked.server.client.get(path)) for row, path in paths.items()}
    assert found == expected


@every_form
def test_who_may_send_what(row: str, copied: Serving, stocked: Stocked) -> None:
    before = len(copied.actors())
    found = {role: outcome(send(copied, row, who, stocked.parts)) for role, who in ROLES.items()}
    assert found == dict(zip(ROLES, ROWS[row], strict=True))
    # The server itself tells the organiser that several teams sent the same file.
    assert {actor.partition(":")[0] for actor in copied.actors()[before:]} <= {"person", "server"}


def test_every_page_has_its_row(stocked: Stocked) -> None:
    routes = {f"{method} {path}" for method, path in page_routes(create_app(stocked.server.state))}
    assert routes == set(ROWS)


@every_form
def test_no_form_is_taken_of_another_site(row: str, stocked: Stocked) -> None:
    """Neither without the session's token, nor if the browser says where it comes from."""
    server, parts = stocked.server, stocked.parts
    method, path = row.split()
    sign_in(server, ORGANISER)
    if not path.startswith(("/sign-in", "/join")):
        forged = server.client.request(method, path.format(**parts), data={"csrf_token": "none"})
        assert forged.status_code == 403
    elsewhere = {"Sec-Fetch-Site": "cross-site"}
    token = {"token": server.tokens[ORGANISER], "invitation": "rv_none"}
    reply = server.client.request(method, path.format(**parts), data=token, headers=elsewhere)
    assert outcome(reply) in ("403", SIGN_IN)
    assert "set-cookie" not in reply.headers
