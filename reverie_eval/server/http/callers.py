"""Who is calling: a person with a token, or signed in with a browser.

A token in the Authorization header is sent on purpose. A cookie is sent by the browser, whoever
made the page: so it counts for requests of our own pages only, and what changes something needs the
session's CSRF token as well. The API takes both, pages take cookies alone.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Annotated, Any, Concatenate, ParamSpec, TypeVar
from urllib.parse import urlsplit

from fastapi import Depends, Request, Response
from fastapi.security import APIKeyCookie, HTTPAuthorizationCredentials, HTTPBearer
from sqlalchemy.orm import Session
from starlette.datastructures import FormData

from reverie_eval.schemas.service import Role
from reverie_eval.server.errors import ForgedError, NotAllowedError, NotSignedInError
from reverie_eval.server.service.tokens import valid_token
from reverie_eval.server.service.transactions import Transaction
from reverie_eval.server.state import ServerState, state_of
from reverie_eval.server.store.tables import BrowserSession, Person

Given = ParamSpec("Given")
Report = TypeVar("Report")

COOKIE = "reverie_eval_session"
CSRF_HEADER = "X-CSRF-Token"

_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_OWN_PAGES = frozenset({"same-origin", "none"})
"""Of Sec-Fetch-Site; ``none`` is what somebody typed into the address bar."""

_Bearer = HTTPBearer(auto_error=False, description="A token of the organiser's: `rv_...`")
_Cookie = APIKeyCookie(
    name=COOKIE, auto_error=False, description="A browser's session, from `POST /api/v1/session`"
)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What a request sees of the database: one state of it, and who is calling."""

    session: Session
    now: datetime
    browser: BrowserSession | None
    """The browser session of the caller, if there is one."""
    caller: Person | None

    @property
    def person(self) -> Person:
        """Who is calling.

        Raises
        ------
        NotSignedInError
            If nobody says so.
        """
        if self.caller is None:
            raise NotSignedInError("send your token: `Authorization: Bearer rv_...`")
        return self.caller


@dataclass(frozen=True, slots=True)
class Call:
    """A request that may ask the database, and who must have sent it.

    It is asked where the route runs, in one thread: a request that held a connection, or its turn
    to write, while it waited for another thread could keep all others waiting.
    """

    request: Request
    server: ServerState
    token: str | None
    session_id: str | None
    """Of a browser's session, which may be over."""
    csrf_token: str | None = None
    """That was shown in a header; None where a form shows it."""
    required: Role | None = None
    """Who must be calling, at least; None if it may be anybody."""

    @contextmanager
    def snapshot(self) -> Iterator[Snapshot]:
        """Look at one state of the database, once it is known who is calling.

        Raises
        ------
        NotSignedInError
            If nobody is, and somebody must be; or the token is wrong, which is not nobody.
        NotAllowedError
            If an organiser must be.
        ForgedError
            If something is to be changed from a browser without the session's CSRF token.
        """
        with self.server.database.reading() as session:
            browser, caller = self._sender(session)
            snapshot = Snapshot(session, self.server.clock(), browser, caller)
            if self.required is not None:
                role = snapshot.person.role
                if self.required == "organiser" and role != "organiser":
                    raise NotAllowedError("only the organiser may do this")
            yield snapshot

    def person(self) -> Person:
        """Return who is calling; errors are those of :meth:`snapshot`."""
        with self.snapshot() as snapshot:
            return snapshot.person

    def perform(
        self,
        action: Callable[Concatenate[Transaction, Given], Report],
        *given: Given.args,
        **named: Given.kwargs,
    ) -> Report:
        """Change something as the caller; may also raise the errors of :meth:`snapshot`."""
        with self.server.transactions.begin(self.person().name) as transaction:
            return action(transaction, *given, **named)

    def _sender(self, session: Session) -> tuple[BrowserSession | None, Person | None]:
        """Return who has sent the request, looked up once."""
        state = self.request.state
        if not hasattr(state, "sender"):
            state.sender = self._find_sender(session)
        sender: tuple[BrowserSession | None, Person | None] = state.sender
        return sender

    def _find_sender(self, session: Session) -> tuple[BrowserSession | None, Person | None]:
        now, sessions = self.server.clock(), self.server.sessions
        if self.token is not None:
            return None, valid_token(session, self.token, "access", now).person
        if self.session_id is None:
            return None, None
        browser = sessions.find(session, self.session_id, now)
        if browser is None:
            return None, None
        if self.csrf_token is not None and self.request.method not in _SAFE_METHODS:
            sessions.demand_csrf_token(browser.id, self.csrf_token)
        return browser, browser.token.person


def is_of_another_site(request: Request) -> bool:
    """Whether a browser says that another site's page has made this request.

    What says nothing of it is no browser, or one of before 2020 that sends Origin with whatever
    changes something.

    References
    ----------
    W3C, Fetch Metadata Request Headers; the rule is that of Go's ``http.CrossOriginProtection``.
    """
    site = request.headers.get("sec-fetch-site")
    if site is not None:
        return site not in _OWN_PAGES
    origin = request.headers.get("origin")
    return origin is not None and urlsplit(origin).netloc != request.headers.get("host")


def own_page(request: Request) -> None:
    """Refuse what another site's page has made: it would sign somebody in as somebody else."""
    if is_of_another_site(request):
        raise NotAllowedError("another site may not sign you in; do it on this server's own pages")


def session_id_of(request: Request, cookie: str | None) -> str | None:
    """Return the id of the browser session that a request of our own pages is part of."""
    if cookie is None or is_of_another_site(request):
        return None
    return state_of(request).sessions.id_in(cookie)


# Dependencies without anything slow in them are asynchronous: the others cost a thread each.
async def server_of(request: Request) -> ServerState:
    """Return the server that answers a request."""
    return state_of(request)


Server = Annotated[ServerState, Depends(server_of)]


async def anybody(
    request: Request,
    credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(_Bearer)],
    cookie: Annotated[str | None, Depends(_Cookie)],
) -> Call:
    """Return a call that anybody may make."""
    token = None if credentials is None else credentials.credentials
    shown = request.headers.get(CSRF_HEADER, "")
    return Call(request, state_of(request), token, session_id_of(request, cookie), shown)


async def caller(call: Annotated[Call, Depends(anybody)]) -> Call:
    """Return a call that only people with a token or a session may make."""
    return replace(call, required="participant")


async def organiser(call: Annotated[Call, Depends(anybody)]) -> Call:
    """Return a call that only organisers may make."""
    return replace(call, required="organiser")


Anybody = Annotated[Call, Depends(anybody)]
Caller = Annotated[Call, Depends(caller)]
Organiser = Annotated[Call, Depends(organiser)]


def visit_of(request: Request) -> Call:
    """Return the visit that a request is, of anybody."""
    cookie = request.cookies.get(COOKIE)
    return Call(request, state_of(request), None, session_id_of(request, cookie))


async def visitor(request: Request) -> Call:
    """Return the visit of anybody."""
    return visit_of(request)


async def member(visit: Annotated[Call, Depends(visitor)]) -> Call:
    """Return the visit of somebody who is signed in."""
    return replace(visit, required="participant")


async def desk(visit: Annotated[Call, Depends(visitor)]) -> Call:
    """Return the visit of an organiser."""
    return replace(visit, required="organiser")


async def posted(visit: Annotated[Call, Depends(visitor)]) -> FormData:
    """Return the fields of a form that one of our own pages sent.

    Raises
    ------
    NotSignedInError
        If nobody is signed in, before any of the form is read.
    ForgedError
        If it does not carry the session's CSRF token.
    """
    if visit.session_id is None:
        raise NotSignedInError("sign in to see this page")
    form = await visit.request.form()
    shown: Any = form.get("csrf_token", "")
    if not isinstance(shown, str):
        raise ForgedError("csrf_token must be text, not a file")
    visit.server.sessions.demand_csrf_token(visit.session_id, shown)
    return form


Visitor = Annotated[Call, Depends(visitor)]
Member = Annotated[Call, Depends(member)]
Desk = Annotated[Call, Depends(desk)]
Posted = Annotated[FormData, Depends(posted)]


def set_cookie(request: Request, response: Response, cookie: str, lifetime: timedelta) -> None:
    """Give a browser the cookie of its session: out of reach of scripts and of other sites."""
    response.set_cookie(
        COOKIE,
        cookie,
        max_age=int(lifetime.total_seconds()),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )


def drop_cookie(response: Response) -> None:
    """Let a browser forget the cookie."""
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")
