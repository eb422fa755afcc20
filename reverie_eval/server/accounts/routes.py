"""The caller, signing in and out, joining, public keys; for organisers, teams and people."""

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request, Response
from fastapi.responses import PlainTextResponse

from reverie_eval.schemas import organising as schemas
from reverie_eval.schemas.people import (
    AcceptedRequest,
    JoinReply,
    JoinRequestReport,
    NewJoinRequest,
    NewPeopleImport,
    PeopleImportReport,
    PersonalData,
    Rejection,
)
from reverie_eval.schemas.service import (
    Invitation,
    KeyReport,
    Me,
    ServerReport,
    SessionReport,
    SignIn,
    Welcome,
)
from reverie_eval.schemas.wire import EXAMPLE_KEY, LONGEST_NAME
from reverie_eval.server.accounts import (
    joining,
    people,
    people_files,
    personal_data,
    tokens,
)
from reverie_eval.server.accounts.tokens import accept_invitation
from reverie_eval.server.audit.keys import list_keys
from reverie_eval.server.errors import NotSignedInError
from reverie_eval.server.http.callers import (
    Anybody,
    Caller,
    CallReading,
    Organiser,
    Server,
    TokenHint,
    drop_cookie,
    own_page,
    set_cookie,
)
from reverie_eval.server.http.exchange import API
from reverie_eval.server.http.openapi import file_reply, organiser_router, problems
from reverie_eval.server.http.paging import Number, Paging
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.identity import Sessions
from reverie_eval.server.messages.notices import Notices
from reverie_eval.server.store.tables import BrowserSession, Person
from reverie_eval.version import __version__

router = APIRouter(prefix=API, tags=["access"])


organising = organiser_router()
_REFUSALS = problems("not-found", "conflict")
TeamName = Annotated[str, Path(max_length=LONGEST_NAME, examples=["Blue"])]


@router.get("/server")
def show_server(server: Server) -> ServerReport:
    """Show the server's version, its settings and the organiser's notice."""
    with server.database.reading() as session:
        notice = server.get(Notices).current(session)
    return ServerReport(
        title=server.settings.title,
        version=__version__,
        banner=notice.banner,
        paused=notice.paused,
        key_id=server.signer.key_id,
        required_metadata=list(server.settings.required_metadata),
        organiser=server.settings.organiser,
        contact=server.settings.contact,
        links={text: str(url) for text, url in server.settings.links.items()},
    )


@router.get("/me", responses=problems("not-signed-in"))
def show_me(caller: Caller) -> Me:
    """Show who you are."""
    return _me(caller.person())


@router.post("/tokens", status_code=201, responses=problems("not-signed-in"))
def exchange_invitation(invitation: Invitation, server: Server) -> Welcome:
    """Exchange an invitation for a token; this works once."""
    with server.transactions.begin("") as transaction:
        return accept_invitation(transaction, invitation.invitation)


@router.get("/keys")
def show_keys(server: Server) -> list[KeyReport]:
    """List all keys that verify receipts, the earliest first; the last is in use."""
    with server.database.reading() as session:
        return list_keys(session)


@router.get(
    "/key",
    response_class=PlainTextResponse,
    responses=file_reply("text/plain", example=EXAMPLE_KEY),
)
def show_key(server: Server) -> str:
    """Return the public key in use, in PEM form."""
    return server.signer.public_pem


@router.post(
    "/session",
    status_code=201,
    dependencies=[Depends(own_page)],
    responses=problems("not-signed-in", "not-allowed"),
)
def sign_in(shown: SignIn, request: Request, response: Response, server: Server) -> SessionReport:
    """Exchange a token for a browser session: a cookie and a CSRF token."""
    with server.database.writing() as session:
        now = server.clock()
        begun = server.get(Sessions).begin(session, shown.token, now)
        set_cookie(request, response, begun.cookie, begun.session.expires_at - now)
        return _report(begun.session, begun.csrf_token)


@router.get("/session", responses=problems("not-signed-in"))
def show_session(call: Anybody, server: Server) -> SessionReport:
    """Show who is signed in, and the session's CSRF token."""
    with call.reading() as reading:
        browser = _signed_in(reading)
        return _report(browser, server.get(Sessions).csrf_token(browser.id))


@router.delete("/session", status_code=204, responses=problems("not-signed-in"))
def sign_out(call: Anybody, response: Response, server: Server) -> None:
    """End the session; its cookie is no longer valid."""
    with call.reading() as reading:
        browser = _signed_in(reading)
    with server.database.writing() as session:
        server.get(Sessions).end(session, browser.id)
    drop_cookie(call.request, response)


def _signed_in(reading: CallReading) -> BrowserSession:
    if reading.browser is None:
        raise NotSignedInError("there is no session; sign in with POST /api/v1/session")
    return reading.browser


def _me(person: Person) -> Me:
    return Me(person=person.name, team=person.team.name, role=person.role, email=person.email)


def _report(browser: BrowserSession, csrf_token: str) -> SessionReport:
    me = _me(browser.token.person)
    return SessionReport(**dict(me), csrf_token=csrf_token, expires_at=browser.expires_at)


@router.post("/join", status_code=202, responses=problems("not-allowed", "conflict"))
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


@organising.get("/teams")
def list_teams(organiser: Organiser, paging: Paging) -> list[schemas.TeamReport]:
    """List the teams by name, with their people."""
    return paging.read(organiser, people.list_teams)


@organising.post("/teams", status_code=201, responses=problems("conflict"))
def add_team(new: schemas.NewTeam, organiser: Organiser) -> schemas.TeamReport:
    """Add a team."""
    return organiser.perform(people.add_team, new)


@organising.post("/teams/merge", responses=problems("not-found", "conflict"))
def merge_teams(new: schemas.NewMerge, organiser: Organiser) -> schemas.MergeReport:
    """Merge two teams, as if they had always been one."""
    return organiser.perform(people.merge_teams, new)


@organising.patch("/teams/{name:path}", responses=problems("not-found", "conflict"))
def rename_team(name: TeamName, new: schemas.NewTeam, organiser: Organiser) -> schemas.TeamReport:
    """Rename a team; its receipts keep the name under which they were signed."""
    return organiser.perform(people.rename_team, name, new)


@organising.get("/people")
def list_people(organiser: Organiser, paging: Paging) -> list[schemas.PersonReport]:
    """List all people in the order in which they were added."""
    return paging.read(organiser, people.list_people)


@organising.post("/people", status_code=201, responses=problems("not-found", "conflict"))
def add_person(new: schemas.NewPerson, organiser: Organiser) -> schemas.PersonReport:
    """Add a person to a team."""
    return organiser.perform(people.add_person, new)


@organising.get("/people/{person_id}", responses=problems("not-found"))
def show_personal_data(person_id: Number, organiser: Organiser) -> PersonalData:
    """Return all that the server stores about a person."""
    with organiser.reading() as reading:
        return personal_data.personal_data(
            reading.session, person_id, organiser.server.settings.organiser
        )


@organising.delete("/people/{person_id}", responses=problems("not-found", "conflict"))
def delete_person(person_id: Number, organiser: Organiser) -> schemas.PersonReport:
    """Remove a person's name and address, and revoke their tokens; results and the log stay."""
    return organiser.perform(personal_data.delete_person, person_id)


@organising.patch("/people/{person_id}", responses=problems("not-found", "conflict"))
def change_person(
    person_id: Number, change: schemas.PersonChange, organiser: Organiser
) -> schemas.PersonReport:
    """Rename a person, change their e-mail address, or move them to another team."""
    return organiser.perform(people.change_person, person_id, change)


@organising.get("/tokens")
def list_tokens(organiser: Organiser, paging: Paging) -> list[schemas.TokenReport]:
    """List tokens and invitations without their text, the latest first."""
    return paging.read(organiser, tokens.list_tokens)


@organising.post("/tokens", status_code=201, responses=problems("not-found", "conflict"))
def create_token(new: schemas.NewToken, organiser: Organiser) -> schemas.NewTokenReport:
    """Create an invitation or a token for a person; its text is returned only once."""
    return organiser.perform(tokens.create_token, new)


@organising.delete("/tokens/{hint}", responses=problems("not-found", "conflict"))
def revoke_token(hint: TokenHint, organiser: Organiser) -> schemas.TokenReport:
    """Revoke a token, with the browser sessions that began with it."""
    return organiser.perform(tokens.revoke_token, hint)
