"""``/join``: anyone may ask the organiser for accounts."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, Form
from fastapi.responses import Response

from reverie_eval.schemas.joining import MOST_PEOPLE, NewJoinRequest
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.http.callers import Call, Visitor, own_page
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.pages.rendering import page, show_faults_with
from reverie_eval.server.service.joining import receive_request

router = APIRouter()

_LONGEST = 5000
"""Characters of a field; those of the request have bounds of their own."""
Text = Annotated[str, Form(max_length=_LONGEST)]


@router.get("/join")
def show_join(visitor: Visitor) -> Response:
    """Show the form, or that this server accepts no requests."""
    return _draw(visitor, {})


@router.post("/join", dependencies=[Depends(own_page)])
def ask_to_join(
    *,
    visitor: Visitor,
    runtime: Runtime,
    team: Text = "",
    people: Text = "",
    institution: Text = "",
    purpose: Text = "",
) -> Response:
    """Keep a request for the organiser."""
    typed = {"team": team, "people": people, "institution": institution, "purpose": purpose}
    show_faults_with(visitor.request, lambda problem: _draw(visitor, typed, problem))
    new = read_model(NewJoinRequest, {**typed, "people": people_in(people)})
    server = visitor.server
    reply = receive_request(
        server.transactions,
        new,
        are_accepted=server.settings.accept_requests_to_join,
        count=partial(runtime.joining.count, visitor.request.scope),
    )
    return _draw(visitor, {}, done=reply.message)


def people_in(text: str) -> Sequence[Mapping[str, str]]:
    """Return the people that lines of a text name, each with an address after the last comma.

    >>> people_in("Ada, ada@example.org")
    [{'name': 'Ada', 'email': 'ada@example.org'}]
    """
    lines = [line.rpartition(",") for line in text.splitlines() if line.strip()]
    return [{"name": name.strip(), "email": email.strip()} for name, _, email in lines]


def _draw(
    visitor: Call, typed: Mapping[str, str], problem: ProblemDocument | None = None, done: str = ""
) -> Response:
    with visitor.snapshot() as snapshot:
        return page(
            snapshot,
            "join.html",
            problem,
            typed=typed,
            done=done,
            most_people=MOST_PEOPLE,
            is_open=visitor.server.settings.accept_requests_to_join,
        )
