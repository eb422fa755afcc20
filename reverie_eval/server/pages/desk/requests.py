"""``/desk/requests``: requests to join, several of which can be answered at once."""

from collections.abc import Collection
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response

from reverie_eval.schemas.joining import Rejection
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.http.callers import Call, Desk, Posted
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.service import joining

router = APIRouter()

PAGE = "/desk/requests"


def draw(
    ticked: Collection[int] | None,
    desk: Call,
    typed: forms.Typed,
    problem: ProblemDocument | None = None,
    what: str = "",
) -> Response:
    """Show the open requests, with a tick at some of them, or with None at all."""
    with desk.snapshot() as snapshot:
        return page(
            snapshot,
            "desk/requests.html",
            problem,
            requests=joining.list_requests(snapshot.session, forms.page_at(desk, "requests")),
            cursor=desk.request.query_params.get("requests", ""),
            are_accepted=desk.server.settings.accept_requests_to_join,
            ticked=ticked,
            typed=typed,
            done=what,
        )


@router.get(PAGE)
def show_requests(
    desk: Desk, done: forms.Done = "", tick: Annotated[str, Query(max_length=20)] = ""
) -> Response:
    """Show the open requests, all of them ticked if the query says so."""
    return draw(None if tick == "all" else (), desk, {}, what=done)


@router.post(PAGE)
def answer(desk: Desk, form: Posted) -> Response:
    """Accept the ticked requests, and show the invitations in this one reply; or reject them."""
    ticked = [forms.number(text) for text in form.getlist("request") if isinstance(text, str)]
    typed = forms.typed_by(desk, form, partial(draw, ticked))
    if not ticked:
        raise MalformedError("tick the requests that you want to answer first")
    if typed.get("what") == "accept":
        accepted = desk.perform(joining.accept_requests, ticked)
        return forms.show_invitations(
            desk, [each for one in accepted for each in one.invitations], PAGE
        )
    rejection = read_model(Rejection, {"reason": typed.get("reason", "")})
    desk.perform(joining.reject_requests, ticked, rejection)
    return forms.done(PAGE, "rejected")
