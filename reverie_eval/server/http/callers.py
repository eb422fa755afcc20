"""Who is calling: whoever shows a token, or has signed in with a browser.

A token in the Authorization header is sent on purpose. A cookie is sent by the browser, whoever
made the page: so it counts for requests of our own pages only, and what changes something needs the
session's CSRF token as well.
"""

from datetime import timedelta
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import Depends, Request, Response
from fastapi.security import APIKeyCookie, HTTPAuthorizationCredentials, HTTPBearer

from reverie_eval.server.errors import NotAllowedError, NotSignedInError
from reverie_eval.server.service.people import who_shows
from reverie_eval.server.state import ServerState, state_of
from reverie_eval.server.store.tables import BrowserSession, Person

COOKIE = "reverie_eval_session"
CSRF_HEADER = "X-CSRF-Token"

_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_OWN_PAGES = frozenset({"same-origin", "none"})
"""Of Sec-Fetch-Site; ``none`` is what somebody typed into the address bar."""

Server = Annotated[ServerState, Depends(state_of)]
_Bearer = HTTPBearer(auto_error=False, description="A token of the organiser's: `rv_...`")
_Cookie = APIKeyCookie(
    name=COOKIE, auto_error=False, description="A browser's session, from `POST /api/v1/session`"
)


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


def session_if_any(
    request: Request, server: Server, cookie: Annotated[str | None, Depends(_Cookie)]
) -> BrowserSession | None:
    """Return the browser session that a request is part of."""
    if cookie is None or is_of_another_site(request):
        return None
    with server.database.reading() as session:
        return server.sessions.find(session, cookie, server.clock())


_Session = Annotated[BrowserSession | None, Depends(session_if_any)]
_Credentials = Annotated[HTTPAuthorizationCredentials | None, Depends(_Bearer)]


def own_session(request: Request, server: Server, found: _Session) -> BrowserSession:
    """Return the browser session; what changes something must show its CSRF token."""
    if found is None:
        raise NotSignedInError("there is no session; sign in with POST /api/v1/session")
    if request.method not in _SAFE_METHODS:
        server.sessions.demand_csrf_token(found, request.headers.get(CSRF_HEADER, ""))
    return found


def caller_if_any(
    request: Request, server: Server, credentials: _Credentials, found: _Session
) -> Person | None:
    """Return who is calling, if anybody says so; a wrong token is an error, not nobody."""
    if credentials is not None:
        with server.database.reading() as session:
            return who_shows(session, credentials.credentials, server.clock())
    return own_session(request, server, found).token.person if found else None


def caller(person: Annotated[Person | None, Depends(caller_if_any)]) -> Person:
    """Return who is calling."""
    if person is None:
        raise NotSignedInError("send your token: `Authorization: Bearer rv_...`")
    return person


def organiser(person: Annotated[Person, Depends(caller)]) -> Person:
    """Return who is calling, an organiser."""
    if person.role != "organiser":
        raise NotAllowedError("only the organiser may do this")
    return person


def own_page(request: Request) -> None:
    """Refuse what another site's page has made: it would sign somebody in as somebody else."""
    if is_of_another_site(request):
        raise NotAllowedError("another site may not sign you in; do it on this server's own pages")


Anybody = Annotated[Person | None, Depends(caller_if_any)]
Caller = Annotated[Person, Depends(caller)]
Organiser = Annotated[Person, Depends(organiser)]
OwnSession = Annotated[BrowserSession, Depends(own_session)]


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
