"""What may be said of a request in a log or a metric: few words, none of the sender's choice."""

from fastapi.security.utils import get_authorization_scheme_param
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import Scope

from reverie_eval.server.http.callers import COOKIE
from reverie_eval.server.service.sessions import name_in
from reverie_eval.server.service.tokens import HINT_LENGTH, PREFIX

UNMATCHED = "unmatched"
"""The route of a request that none of ours answers."""
API = "/api/v1"

_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


def route_of(scope: Scope) -> str:
    """Return the template of the route that a request has come to: ``/api/v1/splits/{split}``."""
    template: str | None = getattr(scope.get("route"), "path", None)
    if template is None:
        return UNMATCHED
    # Later versions of FastAPI tell the path below the router that includes the route.
    is_below = scope["path"].startswith(f"{API}/") and not template.startswith(API)
    return f"{API}{template}" if is_below else template


def method_of(scope: Scope) -> str:
    """Return the method, if it is one that we know."""
    method: str = scope["method"]
    return method if method in _METHODS else "other"


def address_of(scope: Scope) -> str:
    """Return the sender's address, as the connection or a trusted proxy tells it."""
    client = scope.get("client")
    return str(client[0]) if client else "unknown"


def token_of(scope: Scope) -> str:
    """Return the token that the sender shows, if any, read as the routes read it."""
    return get_authorization_scheme_param(Headers(scope=scope).get("authorization"))[1]


def session_of(scope: Scope) -> str:
    """Return the name of the browser session that the sender's cookie tells, if any."""
    return name_in(HTTPConnection(scope).cookies.get(COOKIE, ""))


def hint_of(scope: Scope) -> str:
    """Return the first letters of a token, by which the organiser knows it; never more."""
    token = token_of(scope)
    return token[:HINT_LENGTH] if token.startswith(PREFIX) else ""
