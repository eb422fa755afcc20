"""Asking to join, the organiser's answers, and files of people."""

from functools import partial

from fastapi import APIRouter, Request

from reverie_eval.schemas.people import (
    AcceptedRequest,
    JoinReply,
    JoinRequestReport,
    NewJoinRequest,
    NewPeopleImport,
    PeopleImportReport,
    Rejection,
)
from reverie_eval.server.http.callers import Organiser, Server
from reverie_eval.server.http.exchange import API
from reverie_eval.server.http.openapi import problems
from reverie_eval.server.http.paging import Number, Paging
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.service import joining, people_files

router = APIRouter()
organising = APIRouter(
    prefix=f"{API}/organiser",
    tags=["organiser"],
    responses=problems("not-signed-in", "not-allowed"),
)
_REFUSALS = problems("not-found", "conflict")


@router.post(
    f"{API}/join", status_code=202, tags=["access"], responses=problems("not-allowed", "conflict")
)
def ask_to_join(
    request: Request, new: NewJoinRequest, server: Server, runtime: Runtime
) -> JoinReply:
    """Ask the organiser for accounts; the reply does not reveal who has an account.

    An address may send five requests a day.
    """
    return joining.receive_request(
        server.transactions,
        new,
        are_accepted=server.settings.accept_requests_to_join,
        count=partial(runtime.joining.count, request.scope),
    )


@organising.get("/requests")
def list_requests(organiser: Organiser, paging: Paging) -> list[JoinRequestReport]:
    """List the open requests to join, the earliest first."""
    return paging.read(organiser, joining.list_requests)


@organising.post("/requests/{request_id}/accept", responses=_REFUSALS)
def accept_request(request_id: Number, organiser: Organiser) -> AcceptedRequest:
    """Add a request's people to its team; their invitations are returned only once."""
    return organiser.perform(joining.accept_request, request_id)


@organising.post("/requests/{request_id}/reject", status_code=204, responses=_REFUSALS)
def reject_request(request_id: Number, rejection: Rejection, organiser: Organiser) -> None:
    """Reject a request to join, and remove its names and addresses."""
    organiser.perform(joining.reject_request, request_id, rejection)


@organising.post("/people/import", responses=problems("malformed-request"))
def import_people(new: NewPeopleImport, organiser: Organiser) -> PeopleImportReport:
    """Add the people in a file, or nobody if there is a problem; repeating it changes nothing."""
    return organiser.perform(people_files.import_people, new)


router.include_router(organising)
