"""Who is calling, by a token or signed in with a browser, and what is noted of a request.

A token in the Authorization header is sent on purpose. Browsers send cookies with requests from any
site, so a cookie is only accepted from this server's own pages, and every request that changes
something needs the session's CSRF token as well. Pages accept only cookies. The API accepts both, a
cookie only for reading: pages link what it returns.

The log, the metrics and problem documents read the notes, which contain few values that the sender
chose: a route, a method, an address, a token's hint.
"""

import secrets
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import timedelta
from typing import Annotated, Any, Concatenate, ParamSpec, TypeVar
from urllib.parse import urlsplit

from fastapi import Depends, Path, Request, Response
from fastapi.dependencies.models import Dependant
from fastapi.security import APIKeyCookie, HTTPAuthorizationCredentials, HTTPBearer
from fastapi.security.utils import get_authorization_scheme_param
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session
from starlette.datastructures import FormData, Headers
from starlette.requests import HTTPConnection
from starlette.types import Scope

from reverie_eval.schemas.service import Accepted, QuotaReport, Role
from reverie_eval.schemas.wire import EXAMPLE_TOKEN
from reverie_eval.server import identity
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import ForgedError, NotAllowedError, NotSignedInError, RequestError
from reverie_eval.server.state import Reading, ServerState
from reverie_eval.server.store.tables import BrowserSession, Person

Given = ParamSpec("Given")
Report = TypeVar("Report")

SplitName = Annotated[str, Path(examples=["test"])]
BoardName = Annotated[str, Path(examples=["grounding"])]
TokenHint = Annotated[
    str,
    Path(
        pattern=rf"^{identity.PREFIX}[\w-]{{{identity.HINT_LENGTH - len(identity.PREFIX)}}}$",
        examples=[EXAMPLE_TOKEN[: identity.HINT_LENGTH]],
    ),
]
"""The first characters of a token, in a path."""

COOKIE = "reverie_eval_session"

OK = "ok"
"""The outcome of a request without a problem."""

_KEY = "reverie_eval.exchange"
_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_OWN_PAGES = frozenset({"same-origin", "none"})
"""Accepted values of Sec-Fetch-Site; ``none`` is an address typed into the browser."""

_Bearer = HTTPBearer(auto_error=False, description="A token from the organiser: `rv_...`")
_Cookie = APIKeyCookie(
    name=COOKIE, auto_error=False, description="A browser session, which pages begin; for reading"
)
ByToken = Annotated[HTTPAuthorizationCredentials | None, Depends(_Bearer)]
ByCookie = Annotated[str | None, Depends(_Cookie)]
"""Ways to sign in, for the API's description: calls are made of the request itself."""


@dataclass(frozen=True, slots=True)
class CallReading(Reading):
    """The database as one request sees it, and the caller."""

    request: Request
    browser: BrowserSession | None
    """The browser session of the caller, if any."""
    caller: Person | None

    @property
    def person(self) -> Person:
        """The caller. Raises NotSignedInError if the request has no token and no session."""
        if self.caller is None:
            raise NotSignedInError("send your token: `Authorization: Bearer rv_...`")
        return self.caller


@dataclass(frozen=True, slots=True)
class Call:
    """A request that can use the database, with the required role of the caller.

    Routes use the database in one thread: a request that held a connection or the write lock while
    it waited for another thread could block all others.
    """

    request: Request
    server: ServerState
    token: str | None
    session_id: str | None
    """The id of a browser session, which may have ended."""
    required: Role | None = None
    """The role that the caller must have; None if anyone may call."""

    @contextmanager
    def reading(self) -> Iterator[CallReading]:
        """Read the database as it is now, after checking the caller.

        Raises
        ------
        NotSignedInError
            If signing in is required; or if the token is invalid, even where it is not required.
        NotAllowedError
            If only organisers may call.
        """
        with self.server.database.reading() as session:
            browser, caller = self._sender(session)
            reading = CallReading(
                self.server, session, self.server.clock(), self.request, browser, caller
            )
            if self.required is not None:
                person = reading.person
                if self.required == "organiser" and not person.is_organiser:
                    raise NotAllowedError("only organisers may do this")
            yield reading

    def person(self) -> Person:
        """Return the caller; raises the errors of :meth:`reading`."""
        with self.reading() as reading:
            return reading.person

    def perform(
        self,
        action: Callable[Concatenate[Transaction, Given], Report],
        *given: Given.args,
        **named: Given.kwargs,
    ) -> Report:
        """Run an organiser's action as the caller; also raises the errors of :meth:`reading`.

        Raises
        ------
        NotAllowedError
            If the caller is no organiser, even where others may use the door.
        ConflictError
            If no organiser could sign in afterwards, which only commands may bring about (see
            :func:`check_organiser_left`).
        """
        organiser = replace(self, required="organiser").person()
        with self.server.transactions.begin(organiser) as transaction:
            report = action(transaction, *given, **named)
            identity.check_organiser_left(transaction)
            return report

    def _sender(self, session: Session) -> tuple[BrowserSession | None, Person | None]:
        """Return the sender of the request, which is looked up only once."""
        state = self.request.state
        if not hasattr(state, "sender"):
            state.sender = self._find_sender(session)
        sender: tuple[BrowserSession | None, Person | None] = state.sender
        return sender

    def _find_sender(self, session: Session) -> tuple[BrowserSession | None, Person | None]:
        now, sessions = self.server.clock(), self.server.get(identity.Sessions)
        if self.token is not None:
            return None, identity.valid_token(session, self.token, "access", now).person
        if self.session_id is None:
            return None, None
        browser = sessions.find(session, self.session_id, now)
        return browser, None if browser is None else browser.token.person


def is_of_another_site(request: Request) -> bool:
    """Whether the headers say that a page of another site made this request.

    Requests without Sec-Fetch-Site are from programs, or from browsers before 2020, which send
    Origin with every request that changes something.

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
    """Refuse forms that other sites send: they could sign a visitor in as another person."""
    if is_of_another_site(request):
        raise NotAllowedError("this request came from another site; use this server's own pages")


def session_id_of(request: Request, cookie: str | None) -> str | None:
    """Return the id of the browser session, if the request is from this server's own pages."""
    if cookie is None or is_of_another_site(request):
        return None
    return state_of(request).get(identity.Sessions).id_in(cookie)


def state_of(request: Request) -> ServerState:
    """Return the server that answers a request."""
    state: ServerState = request.app.state.server
    return state


# Fast dependencies are asynchronous: each synchronous one would occupy a thread.
async def server_of(request: Request) -> ServerState:
    """Return the state of the server."""
    return state_of(request)


Server = Annotated[ServerState, Depends(server_of)]


def call_of(request: Request) -> Call:
    """Return a request to the API as a call that anyone may make."""
    scheme, token = get_authorization_scheme_param(request.headers.get("authorization"))
    cookie = request.cookies.get(COOKIE) if request.method in _SAFE_METHODS else None
    is_token = scheme.lower() == "bearer" and token
    session_id = session_id_of(request, cookie)
    return Call(request, state_of(request), token if is_token else None, session_id)


async def anybody(request: Request, _: ByToken, __: ByCookie) -> Call:
    """Return a call that anyone may make; the API's description names the ways to sign in."""
    return call_of(request)


class OfRole:
    """The dependency of routes for people with a role; ``make`` makes a call of a request."""

    def __init__(self, role: Role, make: Callable[[Request], Call]) -> None:
        self._role, self._make = role, make

    async def __call__(self, request: Request, _: ByToken, __: ByCookie) -> Call:
        """Return a call that only people with the role may make."""
        return self.call_of(request)

    def call_of(self, request: Request) -> Call:
        """Do the same outside a route."""
        return replace(self._make(request), required=self._role)


def refusal_of(request: Request) -> RequestError | None:
    """Return why the sender may not make a request, whatever it contains; None if they may.

    The framework reads and checks a request before it calls a route. So senders of an invalid one
    would correct it first, and then learn that they may not send it.
    """
    try:
        for of_role in _roles_in(getattr(request.scope.get("route"), "dependant", None)):
            of_role.call_of(request).person()
    except RequestError as refusal:
        return refusal
    except SQLAlchemyError:  # a valid request will say so
        return None
    return None


def _roles_in(dependant: Dependant | None) -> Iterator[OfRole]:
    if dependant is not None:
        if isinstance(dependant.call, OfRole):
            yield dependant.call
        for each in dependant.dependencies:
            yield from _roles_in(each)


Anybody = Annotated[Call, Depends(anybody)]
Caller = Annotated[Call, Depends(OfRole("participant", call_of))]
"""A call that only people with a token or a session may make."""
Organiser = Annotated[Call, Depends(OfRole("organiser", call_of))]


def visit_of(request: Request) -> Call:
    """Return a request for a page as a call that anyone may make."""
    cookie = request.cookies.get(COOKIE)
    return Call(request, state_of(request), None, session_id_of(request, cookie))


async def visitor(request: Request) -> Call:
    """Return a visit to a page that anyone may see."""
    return visit_of(request)


async def posted(visit: Annotated[Call, Depends(visitor)]) -> AsyncIterator[FormData]:
    """Return the fields of a form that one of this server's own pages sent; close its files later.

    Raises
    ------
    NotSignedInError
        If nobody is signed in; the form is then not read.
    ForgedError
        If the form has no valid CSRF token.
    """
    if visit.session_id is None:
        raise NotSignedInError("sign in to see this page")
    async with visit.request.form() as form:
        csrf_token: Any = form.get("csrf_token", "")
        if not isinstance(csrf_token, str):
            raise ForgedError("csrf_token must be text, not a file")
        visit.server.get(identity.Sessions).check_csrf_token(visit.session_id, csrf_token)
        yield form


Visitor = Annotated[Call, Depends(visitor)]
Member = Annotated[Call, Depends(OfRole("participant", visit_of))]
"""A visit to a page that requires signing in."""
Desk = Annotated[Call, Depends(OfRole("organiser", visit_of))]
"""A visit to a page for organisers."""
Posted = Annotated[FormData, Depends(posted)]


def set_cookie(request: Request, response: Response, cookie: str, lifetime: timedelta) -> None:
    """Set the cookie of a session; scripts cannot read it, and other sites cannot use it."""
    response.set_cookie(
        COOKIE,
        cookie,
        max_age=int(lifetime.total_seconds()),
        path=_cookie_path(request),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )


def drop_cookie(request: Request, response: Response) -> None:
    """Delete the cookie."""
    response.delete_cookie(COOKIE, _cookie_path(request), httponly=True, samesite="strict")


def _cookie_path(request: Request) -> str:
    return state_of(request).settings.path_prefix or "/"


@dataclass(slots=True)
class Exchange:
    """Notes about a request, taken while it is answered."""

    id: str = field(default_factory=lambda: secrets.token_hex(8))
    """By this, the organiser finds a request in the log when a participant reports it."""
    began: float = field(default_factory=time.perf_counter)
    received: int = 0
    """Bytes of the request's body."""
    sent: int = 0
    """Bytes of the reply's body."""
    status: int | None = None
    """None until the reply has begun."""
    outcome: str = OK
    """``ok``, or the code of the problem document."""
    uploaded_to: str | None = None
    """For an upload to be scored, the requested split; empty until it is known."""
    is_repeat: bool = False
    """Whether the same upload was scored before."""
    team: int | None = None
    """For an upload that was read, the number of the sender's team."""
    split: str = ""
    """For an upload that was read, the split that the sender wrote."""
    submission: str = ""
    """The id of the submission that an upload became or repeats."""
    quota: Callable[[], QuotaReport] | None = None
    """Returns the caller's submissions left, if a problem document should include them."""
    asks_database: bool = True
    """Whether the reply to a problem may query the database: not outside the routes, nor after a
    fault of the server."""

    def note(self, accepted: Accepted) -> None:
        """Note the outcome of an upload."""
        self.submission, self.is_repeat = accepted.submission.id, accepted.is_repeat

    @property
    def seconds(self) -> float:
        """The time since the request began."""
        return time.perf_counter() - self.began


def begin(scope: Scope) -> Exchange:
    """Attach new notes to a request."""
    exchange = Exchange()
    scope[_KEY] = exchange
    return exchange


def exchange_of(scope: Scope) -> Exchange:
    """Return the notes about a request."""
    exchange: Exchange = scope[_KEY]
    return exchange


def address_of(scope: Scope) -> str:
    """Return the sender's address, from the connection or a trusted proxy."""
    client = scope.get("client")
    return str(client[0]) if client else "unknown"


def token_of(scope: Scope) -> str:
    """Return the token of a request, parsed as the routes do; empty if it has none."""
    return get_authorization_scheme_param(Headers(scope=scope).get("authorization"))[1]


def session_of(scope: Scope) -> str:
    """Return the name of the browser session in the cookie; empty if there is none."""
    return identity.name_in(HTTPConnection(scope).cookies.get(COOKIE, ""))
