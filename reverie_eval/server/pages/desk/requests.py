"""``/desk/requests``: requests to join."""

from collections.abc import Mapping
from typing import Any

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.joining import Rejection
from reverie_eval.server.http.callers import Call, Desk, Posted, Snapshot
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.pages.rendering import address_of_site
from reverie_eval.server.service import joining

router = APIRouter()

PAGE = "/desk/requests"


@forms.shown_by("requests.html")
def draw(desk: Call, snapshot: Snapshot, _: forms.Typed) -> Mapping[str, Any]:
    """Show the open requests."""
    return {
        "requests": joining.list_requests(snapshot.session, forms.page_at(desk, "requests")),
        "are_accepted": desk.server.settings.accept_requests_to_join,
    }


@router.get(PAGE)
def show_requests(desk: Desk, done: forms.Done = "") -> Response:
    """Show the open requests."""
    return draw(desk, {}, what=done)


@router.post(f"{PAGE}/{{request_id}}/accept")
def accept(request_id: Number, desk: Desk, _: Posted) -> Response:
    """Accept a request, and show the invitations in this one reply."""
    forms.show_faults(desk, {}, draw)
    accepted = desk.perform(joining.accept_request, request_id)
    sign_in = address_of_site(desk.request, "/sign-in")
    with desk.snapshot() as snapshot:
        return forms.desk_page(
            desk,
            snapshot,
            "invitations.html",
            team=accepted.team,
            invitations=accepted.invitations,
            sign_in=sign_in,
            back=PAGE,
        )


@router.post(f"{PAGE}/{{request_id}}/reject")
def reject(request_id: Number, desk: Desk, form: Posted) -> Response:
    """Reject a request."""
    typed = forms.typed_by(desk, form, draw)
    desk.perform(joining.reject_request, request_id, read_model(Rejection, typed))
    return forms.done(PAGE, "rejected")
