"""Signing in with a token or an invitation, signing out, and asking the organiser for accounts."""

import re
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Form
from fastapi.responses import Response

from reverie_eval.schemas.people import MOST_PEOPLE, NewJoinRequest
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.schemas.wire import LONGEST_SECRET
from reverie_eval.server.accounts.joining import receive_request
from reverie_eval.server.accounts.tokens import accept_invitation
from reverie_eval.server.errors import NotSignedInError
from reverie_eval.server.http.callers import (
    Call,
    CallReading,
    Posted,
    Visitor,
    drop_cookie,
    own_page,
    set_cookie,
)
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.rendering import page, see_other, show_faults_with
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.identity import Sessions

router = APIRouter()

_LONGEST = 5000
"""Characters of a field of `/join`; those of the request have bounds of their own."""
_NAMED_ADDRESS = re.compile(r"([^<>;]*)<([^<>]*)>[\s,;]*")
"""A person as mail programs copy them; there may be several in a line."""
Text = Annotated[str, Form(max_length=_LONGEST)]


@router.get("/sign-in")
def show_sign_in(visitor: Visitor, back: str = "/team", form: Literal["", "kept"] = "") -> Response:
    """Ask for a token or an invitation; ``form`` says that a form was sent without a session."""
    return _draw_sign_in(visitor, own_path(back), is_form_kept=form == "kept")


@router.post("/sign-in", dependencies=[Depends(own_page)])
def sign_in(
    visitor: Visitor,
    token: Annotated[str, Form(max_length=LONGEST_SECRET)] = "",
    back: Annotated[str, Form()] = "/team",
) -> Response:
    """Begin a session, or show why the token is refused."""
    server, now = visitor.server, visitor.server.clock()
    try:
        with server.database.writing() as session:
            begun = server.get(Sessions).begin(session, token.strip(), now)
    except NotSignedInError as error:
        return _draw_sign_in(visitor, own_path(back), "token", error)
    reply = see_other(own_path(back))
    set_cookie(visitor.request, reply, begun.cookie, begun.session.expires_at - now)
    return reply


@router.post("/sign-in/invitation", dependencies=[Depends(own_page)])
def use_invitation(
    visitor: Visitor,
    invitation: Annotated[str, Form(max_length=LONGEST_SECRET)] = "",
    back: Annotated[str, Form()] = "/team",
) -> Response:
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
    set_cookie(request, reply, begun.cookie, begun.session.expires_at - now)
    return reply


@router.post("/sign-out")
def sign_out(visitor: Visitor, _: Posted) -> Response:
    """End the session."""
    with visitor.server.database.writing() as session:
        visitor.server.get(Sessions).end(session, visitor.session_id or "")
    reply = see_other("/")
    drop_cookie(visitor.request, reply)
    return reply


def own_path(path: str) -> str:
    """Return a path if it is on this server, else ``/team``: a link could point to another site."""
    is_own = path.startswith("/") and not path.startswith(("//", "/\\")) and path.isprintable()
    return path if is_own else "/team"


def _draw_sign_in(
    visitor: Call,
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


@router.get("/join")
def show_join(visitor: Visitor) -> Response:
    """Show the form, or that this server does not accept requests."""
    return _draw_join(visitor, {})


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
    show_faults_with(visitor.request, lambda problem: _draw_join(visitor, typed, problem))
    listed = list(people_in(people))
    fields = {**typed, "people": [person for _, person in listed]}
    new = read_model(NewJoinRequest, fields, {"people": [line for line, _ in listed]})
    server = visitor.server
    reply = receive_request(
        server.transactions,
        new,
        are_accepted=server.settings.accept_requests_to_join,
        count=partial(runtime.joining.count, visitor.request.scope),
    )
    return _draw_join(visitor, {}, done=reply.message)


def people_in(text: str) -> Iterator[tuple[int, Mapping[str, str]]]:
    """Return the people that lines of a text name, each with the number of the line.

    An address follows the last comma, or is in angle brackets, as mail programs copy it.

    >>> list(people_in('Ada, ada@example.org'))
    [(0, {'name': 'Ada', 'email': 'ada@example.org'})]
    >>> list(people_in('"Byron, Ada" <ada@example.org>'))
    [(0, {'name': 'Byron, Ada', 'email': 'ada@example.org'})]
    """
    for number, line in enumerate(text.splitlines()):
        named = _NAMED_ADDRESS.findall(line)
        if _NAMED_ADDRESS.sub("", line).strip():  # text that is not of this form
            named = [line.rpartition(",")[::2]]
        for name, email in named:
            yield number, {"name": name.strip(' ,"'), "email": email.strip()}


def _draw_join(
    visitor: Call, typed: Mapping[str, str], problem: ProblemDocument | None = None, done: str = ""
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
