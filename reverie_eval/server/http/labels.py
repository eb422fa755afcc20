"""What logs and metrics may contain about a request: few values, none chosen by its sender."""

from fastapi.security.utils import get_authorization_scheme_param
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import Scope

from reverie_eval.server.http.callers import COOKIE
from reverie_eval.server.service.sessions import name_in
from reverie_eval.server.service.tokens import HINT_LENGTH, PREFIX

UNMATCHED = "unmatched"
"""The route of a request that matches none."""
API = "/api/v1"

_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


def route_of(scope: Scope) -> str:
    """Return the template of the route that a request matched: ``/api/v1/splits/{split}``."""
    template: str | None = getattr(scope.get("route"), "path", None)
    if template is None:
        return UNMATCHED
    # Later versions of FastAPI give the path relative to the router that includes the route.
    is_below = scope["path"].startswith(f"{API}/") and not template.startswith(API)
    return f"{API}{template}" if is_below else template


def method_of(scope: Scope) -> str:
    """Return the method, or ``other`` if it is not a standard one."""
    method: str = scope["method"]
    return method if method in _METHODS else "other"


def address_of(scope: Scope) -> str:
    """Return the sender's address, from the connection or a trusted proxy."""
    client = scope.get("client")
    return str(client[0]) if client else "unknown"


def token_of(scope: Scope) -> str:
    """Return the token of a request, parsed as the routes do; empty if it has none."""
    return get_authorization_scheme_param(Headers(scope=scope).get("authorization"))[1]


def session_of(scope: Scope) -> str:
    """Return the name of the browser session in the cookie; empty if there is none."""
    return name_in(HTTPConnection(scope).cookies.get(COOKIE, ""))


def hint_of(scope: Scope) -> str:
    """Return the first characters of a token, by which the organiser knows it; never more."""
    token = token_of(scope)
    return token[:HINT_LENGTH] if token.startswith(PREFIX) else ""
