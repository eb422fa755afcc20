"""The ways in: signing in and out, invitations, asking to join, who one is, and public keys.

What a program does by a route, a browser does by the form beside it; only browsers have sessions.
"""

import re
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Form, Request, Response
from fastapi.responses import PlainTextResponse

from reverie_eval.schemas import service as schemas
from reverie_eval.schemas.people import MOST_PEOPLE, JoinReply, NewJoinRequest
from reverie_eval.schemas.wire import EXAMPLE_KEY, LONGEST_SECRET
from reverie_eval.server.accounts.joining import receive_request
from reverie_eval.server.accounts.tokens import accept_invitation
from reverie_eval.server.audit.signing import list_keys
from reverie_eval.server.errors import NotSignedInError
from reverie_eval.server.http import callers
from reverie_eval.server.http.api import API, file_reply, problems
from reverie_eval.server.http.callers import Caller, CallReading, Server, Visitor
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.rendering import page, see_other, show_faults_with
from reverie_eval.server.http.runtime import Runtime, RuntimeState
from reverie_eval.server.identity import Sessions
from reverie_eval.server.messages.notices import current_notice
from reverie_eval.version import __version__

routes, pages = APIRouter(prefix=API, tags=["access"]), APIRouter()

_LONGEST = 5000
"""Characters of a field of `/join`; those of the request have bounds of their own."""
_NAMED_ADDRESS = re.compile(r"([^<>;]*)<([^<>]*)>[\s,;]*")
"""A person as mail programs copy them; there may be several in a line."""
_BETWEEN = " \t,;"
"""What may be between a name and an address, as spreadsheets and lists have them."""
Text = Annotated[str, Form(max_length=_LONGEST)]
Secret = Annotated[str, Form(max_length=LONGEST_SECRET)]
Back = Annotated[str, Form()]


@routes.get("/server")
def show_server(server: Server) -> schemas.ServerReport:
    """Show the server's version, its settings and the organiser's notice."""
    with server.database.reading() as session:
        notice = current_notice(session)
    return schemas.ServerReport(
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


@routes.get("/me", responses=problems("not-signed-in"))
def show_me(caller: Caller) -> schemas.Me:
    """Show who you are."""
    person = caller.person()
    return schemas.Me(
        person=person.name, team=person.team.name, role=person.role, email=person.email
    )


@routes.post("/tokens", status_code=201, responses=problems("not-signed-in"))
def exchange_invitation(invitation: schemas.Invitation, server: Server) -> schemas.Welcome:
    """Exchange an invitation for a token; this works once."""
    with server.transactions.begin("") as transaction:
        return accept_invitation(transaction, invitation.invitation)


@pages.post("/sign-in/invitation", dependencies=[Depends(callers.own_page)])
def use_invitation(visitor: Visitor, invitation: Secret = "", back: Back = "/team") -> Response:
    """Exchange an invitation for a token, show it once, and begin a session with it.

    Only this reply contains the token: it is never in an address, and the browser does not store
    it.
    """
    request, server = visitor.request, visitor.server
    try:
        with server.transactions.begin("") as transaction:
            session, now = transaction.session, transaction.now
            token = accept_invitation(transaction, invitation.strip()).token
            begun = server.get(Sessions).begin(session, token, now)
            own = CallReading(
                server, session, now, request, begun.session, begun.session.token.person
            )
            reply = page(own, "welcome.html", token=token, back=own_path(back))
    except NotSignedInError as error:
        return _draw_sign_in(visitor, own_path(back), "invitation", error)
    callers.set_cookie(request, reply, begun.cookie, begun.session.expires_at - now)
    return reply


@routes.get("/keys")
def show_keys(server: Server) -> list[schemas.KeyReport]:
    """List all keys that verify receipts, the earliest first; the last is in use."""
    with server.database.reading() as session:
        return list_keys(session)


@routes.get(
    "/key",
    response_class=PlainTextResponse,
    responses=file_reply("text/plain", example=EXAMPLE_KEY),
)
def show_key(server: Server) -> str:
    """Return the public key in use, in PEM form."""
    return server.signer.public_pem


@pages.get("/sign-in")
def show_sign_in(visitor: Visitor, back: str = "/team", form: Literal["", "kept"] = "") -> Response:
    """Ask for a token or an invitation; ``form`` says that a form was sent without a session."""
    return _draw_sign_in(visitor, own_path(back), is_form_kept=form == "kept")


@pages.post("/sign-in", dependencies=[Depends(callers.own_page)])
def sign_in_on_page(visitor: Visitor, token: Secret = "", back: Back = "/team") -> Response:
    """Begin a session, or show why the token is refused."""
    server, now = visitor.server, visitor.server.clock()
    try:
        with server.database.writing() as session:
            begun = server.get(Sessions).begin(session, token.strip(), now)
    except NotSignedInError as error:
        return _draw_sign_in(visitor, own_path(back), "token", error)
    reply = see_other(own_path(back))
    callers.set_cookie(visitor.request, reply, begun.cookie, begun.session.expires_at - now)
    return reply


@pages.post("/sign-out")
def sign_out_on_page(visitor: Visitor, _: callers.Posted) -> Response:
    """End the session."""
    with visitor.server.database.writing() as session:
        visitor.server.get(Sessions).end(session, visitor.session_id or "")
    reply = see_other("/")
    callers.drop_cookie(visitor.request, reply)
    return reply


def own_path(path: str) -> str:
    """Return a path if it is on this server, else ``/team``: a link could point to another site."""
    is_own = path.startswith("/") and not path.startswith(("//", "/\\")) and path.isprintable()
    return path if is_own else "/team"


def _draw_sign_in(
    visitor: callers.Call,
    back: str,
    wrong: str = "",
    refused: NotSignedInError | None = None,
    *,
    is_form_kept: bool = False,
) -> Response:
    with visitor.reading() as reading:
        return page(
            reading,
            "sign-in.html",
            status=None if refused is None else refused.status,
            fault=refused,
            wrong=wrong,
            back=back,
            is_form_kept=is_form_kept,
            accepts_requests=visitor.server.settings.accept_requests_to_join,
        )


@routes.post("/join", status_code=202, responses=problems("not-allowed", "conflict"))
def ask_to_join(request: Request, new: NewJoinRequest, runtime: Runtime) -> JoinReply:
    """Ask the organiser for accounts; the reply does not reveal who has an account.

    An address may send five requests a day.
    """
    return _receive(request, runtime, new)


@pages.get("/join")
def show_join(visitor: Visitor) -> Response:
    """Show the form, or that this server does not accept requests."""
    return _draw_join(visitor, {})


@pages.post("/join", dependencies=[Depends(callers.own_page)])
def ask_to_join_on_page(
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
    show_faults_with(visitor.request, lambda problem: _draw_join(visitor, typed, problem))
    listed = list(people_in(people))
    fields = {**typed, "people": [person for _, person in listed]}
    new = read_model(NewJoinRequest, fields, {"people": [line for line, _ in listed]})
    reply = _receive(visitor.request, runtime, new)
    return _draw_join(visitor, {}, done=reply.message)


def _receive(request: Request, runtime: RuntimeState, new: NewJoinRequest) -> JoinReply:
    server = callers.state_of(request)
    return receive_request(
        server.transactions,
        new,
        are_accepted=server.settings.accept_requests_to_join,
        count=partial(runtime.joining.count, request.scope),
    )


def people_in(text: str) -> Iterator[tuple[int, Mapping[str, str]]]:
    r"""Return the people that lines of a text name, each with the number of the line.

    An address is the last word of a line, or in angle brackets, as mail programs copy it. A line
    without an address, or with two that are not in brackets, is a name.

    >>> list(people_in('Ada, ada@example.org'))
    [(0, {'name': 'Ada', 'email': 'ada@example.org'})]
    >>> list(people_in('Byron, Ada\tada@example.org;'))
    [(0, {'name': 'Byron, Ada', 'email': 'ada@example.org'})]
    >>> list(people_in('Ada Byron'))
    [(0, {'name': 'Ada Byron', 'email': ''})]
    >>> list(people_in('"Byron, Ada" <ada@example.org>'))
    [(0, {'name': 'Byron, Ada', 'email': 'ada@example.org'})]
    """
    for number, line in enumerate(text.splitlines()):
        named = _NAMED_ADDRESS.findall(line)
        if _NAMED_ADDRESS.sub("", line).strip():  # text that is not of this form
            stripped = line.strip(_BETWEEN)
            email = re.split(f"[{_BETWEEN}]", stripped)[-1]
            name = stripped.removesuffix(email)
            named = [(name, email) if "@" in email and "@" not in name else (line, "")]
        for name, email in named:
            yield number, {"name": name.strip(f'{_BETWEEN}"'), "email": email.strip()}


def _draw_join(
    visitor: callers.Call,
    typed: Mapping[str, str],
    problem: schemas.ProblemDocument | None = None,
    done: str = "",
) -> Response:
    with visitor.reading() as reading:
        return page(
            reading,
            "join.html",
            problem,
            typed=typed,
            done=done,
            most_people=MOST_PEOPLE,
            is_open=visitor.server.settings.accept_requests_to_join,
        )
