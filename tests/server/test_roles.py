"""Who may do what: every route, and everybody who may try it."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest
from fastapi.routing import iter_route_contexts
from starlette.requests import Request

from reverie_eval.schemas.organising import NewNews, NewReported, NewSnapshot, NewTeam
from reverie_eval.schemas.service import Method
from reverie_eval.server.accounts.people import add_team
from reverie_eval.server.accounts.tokens import revoke_token
from reverie_eval.server.app import create_app
from reverie_eval.server.boards.news import add_news
from reverie_eval.server.boards.reported import add_reported
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.errors import NotAllowedError
from reverie_eval.server.http.callers import call_of
from tests.support.acting import ask_to_join, create_token, review
from tests.support.description import API, Description
from tests.support.serving import (
    GOOD,
    GROUNDING,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    Serving,
    submission_for,
)

ROLES = ("anonymous", "other team", "team mate", "owner", "organiser", "revoked", "invitation")
"""The last two: a token of the owner's that was revoked, and an invitation shown as a token."""

TABLE = """
                                            anonymous  other  mate  owner  organiser  revoked  invitation
GET    /openapi.json                              200    200   200    200        200      200         200
GET    /healthz                                   200    200   200    200        200      200         200
GET    /readyz                                    200    200   200    200        200      200         200
GET    /metrics                                   401    403   403    403        200      401         401
GET    /server                                    200    200   200    200        200      200         200
GET    /key                                       200    200   200    200        200      200         200
GET    /news                                      200    200   200    200        200      200         200
GET    /keys                                      200    200   200    200        200      200         200
GET    /me                                        401    200   200    200        200      401         401
POST   /tokens                                    401    401   401    401        401      401         201
GET    /splits                                    200    200   200    200        200      401         401
GET    /splits/{split}                            200    200   200    200        200      401         401
GET    /splits/{split}/episodes.txt               200    200   200    200        200      200         200
GET    /splits/{split}/leaderboard                200    200   200    200        200      200         200
GET    /splits/{split}/leaderboard.csv            200    200   200    200        200      200         200
GET    /splits/{split}/boards/{board}/leaderboard      200  200   200    200        200      200         200
GET    /splits/{split}/boards/{board}/leaderboard.csv  200  200   200    200        200      200         200
GET    /splits/{split}/snapshots                  200    200   200    200        200      200         200
GET    /splits/{split}/snapshots/{number}         200    200   200    200        200      200         200
GET    /splits/{split}/snapshots/{number}.csv     200    200   200    200        200      200         200
POST   /splits/{split}/validate                   401    200   200    200        200      401         401
POST   /splits/{split}/submissions                401    201   200    200        201      401         401
GET    /submissions                               401    200   200    200        200      401         401
GET    /submissions/{submission_id}               401    404   200    200        200      401         401
PATCH  /submissions/{submission_id}               401    404   200    200        200      401         401
GET    /submissions/{submission_id}/receipt       401    404   200    200        200      401         401
GET    /submissions/{submission_id}/boards/{board}/receipt  401  404  200  200  200    401         401
GET    /submissions/{submission_id}/file          401    404   200    200        200      401         401
GET    /submissions/{submission_id}/episodes      401    404   200    200        200      401         401
GET    /submissions/{private_id}/episodes         401    404   404    404        404      401         401
POST   /join                                      202    202   202    202        202      202         202
GET    /organiser/requests                        401    403   403    403        200      401         401
POST   /organiser/requests/{request_id}/accept    401    403   403    403        200      401         401
POST   /organiser/requests/{request_id}/reject    401    403   403    403        204      401         401
POST   /organiser/submissions                     401    403   403    403        201      401         401
GET    /organiser/teams                           401    403   403    403        200      401         401
POST   /organiser/teams                           401    403   403    403        201      401         401
PATCH  /organiser/teams/{name:path}              401    403   403    403        200      401         401
GET    /organiser/people                          401    403   403    403        200      401         401
POST   /organiser/people                          401    403   403    403        201      401         401
POST   /organiser/teams/merge                     401    403   403    403        200      401         401
POST   /organiser/people/import                   401    403   403    403        200      401         401
GET    /organiser/people/{person_id}              401    403   403    403        200      401         401
DELETE /organiser/people/{person_id}              401    403   403    403        200      401         401
PATCH  /organiser/people/{person_id}              401    403   403    403        200      401         401
GET    /organiser/tokens                          401    403   403    403        200      401         401
POST   /organiser/tokens                          401    403   403    403        201      401         401
DELETE /organiser/tokens/{hint}                   401    403   403    403        200      401         401
GET    /organiser/grants                          401    403   403    403        200      401         401
POST   /organiser/grants                          401    403   403    403        201      401         401
GET    /organiser/audit                           401    403   403    403        200      401         401
GET    /organiser/reviews                         401    403   403    403        200      401         401
POST   /organiser/reviews                         401    403   403    403        201      401         401
DELETE /organiser/reviews/{review_id}             401    403   403    403        200      401         401
GET    /organiser/reported                        401    403   403    403        200      401         401
POST   /organiser/reported                        401    403   403    403        201      401         401
POST   /organiser/reported/import                 401    403   403    403        200      401         401
PATCH  /organiser/reported/{result_id}            401    403   403    403        200      401         401
DELETE /organiser/reported/{result_id}            401    403   403    403        200      401         401
POST   /organiser/news                            401    403   403    403        201      401         401
DELETE /organiser/news/{news_id}                  401    403   403    403        200      401         401
GET    /organiser/notice                          401    403   403    403        200      401         401
PUT    /organiser/notice                          401    403   403    403        200      401         401
GET    /organiser/splits/{split}/submissions.tar  401    403   403    403        200      401         401
GET    /organiser/schedules                       401    403   403    403        200      401         401
PUT    /organiser/schedules/{split}               401    403   403    403        200      401         401
POST   /organiser/snapshots                       401    403   403    403        201      401         401
GET    /organiser/attempts                        401    403   403    403        200      401         401
"""  # noqa: E501  # a row is a line
OUTSIDE = ("/healthz", "/readyz", "/metrics")
"""Routes that are not of the API."""
ROWS = {" ".join(line.split()[:2]): line.split()[2:] for line in TABLE.splitlines()[2:]}

REQUEST = {
    "team": "Green",
    "people": [{"name": "Dora", "email": "dora@example.org"}],
    "institution": "Somewhere",
}
BODIES: Mapping[str, dict[str, Any]] = {
    "POST /splits/{split}/validate": {"content": GOOD},
    "POST /splits/{split}/submissions": {"content": GOOD, "params": {"name": "Walker"}},
    "PATCH /submissions/{submission_id}": {"json": {"published": True}},
    "POST /organiser/submissions": {
        "content": submission_for(PRIVATE),
        "params": {
            "split": PRIVATE,
            "team": "Red",
            "person": OTHER,
            "received_at": "2026-03-02T12:00:00Z",
            "name": "Walker",
        },
    },
    "POST /organiser/teams": {"json": {"name": "Green"}},
    "PATCH /organiser/teams/{name:path}": {"json": {"name": "Azure"}},
    "POST /join": {"json": REQUEST},
    "POST /organiser/requests/{request_id}/reject": {"json": {}},
    "POST /organiser/teams/merge": {"json": {"team": "Red", "into": "Blue"}},
    "POST /organiser/people/import": {"json": {"text": "team,person\nGreen,Dora"}},
    "POST /organiser/people": {"json": {"name": "Dora", "team": "Red"}},
    "PATCH /organiser/people/{person_id}": {"json": {"email": "ada@example.org"}},
    "POST /organiser/tokens": {"json": {"person": OWNER}},
    "POST /organiser/grants": {
        "json": {
            "team": "Blue",
            "split": PRIVATE,
            "extra": 1,
            "reason": "our disk was full",
            "expires_at": "2026-04-01T00:00:00Z",
        }
    },
    "POST /organiser/reported": {
        "json": {
            "split": PRIVATE,
            "method": {"name": "Pointer"},
            "team": "Qi et al.",
            "scores": {"success": 0.1},
            "source": "https://example.org/paper",
        }
    },
    "POST /organiser/reported/import": {
        "json": {"split": PRIVATE, "source": "Qi et al.", "text": "team,SR\nQi et al.,10\n"}
    },
    "PATCH /organiser/reported/{result_id}": {"json": {"team": "Qi et al., 2020"}},
    "PUT /organiser/schedules/{split}": {"json": {"paused": True}},
    "POST /organiser/snapshots": {"json": {"split": OPEN, "title": "CVPR 2027"}},
    "POST /organiser/news": {"json": {"text": "See you at the workshop."}},
    "PUT /organiser/notice": {"json": {"banner": "Back at noon."}},
}


class Stocked(NamedTuple):
    """A server with everything that has an address."""

    server: Serving
    tokens: Mapping[str, str | None]
    """What everybody shows."""
    parts: Mapping[str, str]
    """What stands for the braces of a path: what belongs to the owner."""
    description: Description


@pytest.fixture(scope="module")
def stocked(shared: Serving) -> Stocked:
    """Return a server to be read from; ``copied`` is one to be changed."""
    return Stocked(shared, show_tokens(shared), stock(shared), Description(shared))


def show_tokens(server: Serving) -> Mapping[str, str | None]:
    with server.acting() as transaction:
        revoked = create_token(transaction, OWNER)
        revoke_token(transaction, revoked.hint)
        invitation = create_token(transaction, OWNER, "invite")
    shown = [None, *(server.tokens[name] for name in (OTHER, "Ben", OWNER, ORGANISER))]
    return dict(zip(ROLES, [*shown, revoked.token, invitation.token], strict=True))


def stock(server: Serving) -> Mapping[str, str]:
    """Add something at every address."""
    ids = {
        split: server.upload(OWNER, server.distinct(split), split).json()["submission"]["id"]
        for split in (OPEN, PRIVATE)
    }
    server.upload(OWNER)
    reported = NewReported(
        split=OPEN,
        method=Method(name="Navigator"),
        team="Qi et al.",
        scores={"success": 0.1},
        source="https://example.org/paper",
    )
    with server.acting() as transaction:
        spare = create_token(transaction, OWNER)
        said = review(transaction, ids[OPEN], "verified")
        result = add_reported(transaction, reported, server.state.settings.tasks)
        taken = server.state.get(Snapshots).take(transaction, NewSnapshot(split=OPEN, title="2026"))
        told = add_news(transaction, NewNews(text="The workshop is on 12 June."))
    return {
        "split": OPEN,
        "board": GROUNDING,
        "name": "Red",
        "submission_id": ids[OPEN],
        "private_id": ids[PRIVATE],
        "hint": spare.hint,
        "person_id": "1",
        "request_id": str(ask_to_join(server.state.transactions)),
        "review_id": str(said.id),
        "result_id": str(result.id),
        "number": str(taken.number),
        "news_id": str(told.id),
    }


def statuses(row: str, server: Serving, stocked: Stocked) -> Mapping[str, str]:
    """Return what everybody is answered."""
    method, path = row.split()
    found = {}
    for role, token in stocked.tokens.items():
        body = BODIES.get(row, {})
        if row == "POST /organiser/reviews":
            said = {"verdict": "flagged", "reason": "looked at its answers"}
            body = {"json": {"submission_id": stocked.parts["submission_id"], **said}}
        if row == "POST /tokens":
            body = {"json": {"invitation": token or "rv_none"}}
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        server.client.cookies.clear()
        own = path.replace(":path", "").format(**stocked.parts)
        place = path if path in OUTSIDE else API + own
        reply = server.client.request(method, place, headers=headers, **body)
        if path != "/openapi.json":
            stocked.description.check(reply)
        found[role] = str(reply.status_code)
    return found


@pytest.mark.parametrize("row", [row for row in ROWS if row.startswith("GET")])
def test_who_may_read_what(row: str, stocked: Stocked) -> None:
    assert statuses(row, stocked.server, stocked) == dict(zip(ROLES, ROWS[row], strict=True))


@pytest.mark.parametrize("row", [row for row in ROWS if not row.startswith("GET")])
def test_who_may_change_what(row: str, copied: Serving, stocked: Stocked) -> None:
    before = len(copied.actors())
    assert statuses(row, copied, stocked) == dict(zip(ROLES, ROWS[row], strict=True))
    # The server itself tells the organiser that several teams sent the same file.
    assert {actor.partition(":")[0] for actor in copied.actors()[before:]} <= {"person", "server"}


def test_every_route_has_its_row(stocked: Stocked) -> None:
    """Every route but the pages', whose rows are beside those who look at them."""
    app = create_app(stocked.server.state)
    routes = {
        f"{method} {(route.path or '').removeprefix(API)}"
        for route in iter_route_contexts(app.routes)
        for method in (route.methods or set()) - {"HEAD"}
        if route.path in OUTSIDE or (route.path or "").startswith(API)
    }
    assert routes == set(ROWS) - {"GET /submissions/{private_id}/episodes"}


def test_a_door_that_asks_for_no_role_performs_organisers_actions_for_them_alone(
    stocked: Stocked,
) -> None:
    server = stocked.server
    app = SimpleNamespace(state=SimpleNamespace(server=server.state))
    headers = [(b"authorization", f"Bearer {server.tokens[OWNER]}".encode())]
    careless = call_of(Request({"type": "http", "method": "POST", "headers": headers, "app": app}))
    with pytest.raises(NotAllowedError):
        careless.perform(add_team, NewTeam(name="Mine"))
