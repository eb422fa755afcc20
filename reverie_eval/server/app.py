"""The application: routes, errors, and what every reply has in common."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

from fastapi import Depends, FastAPI
from starlette.middleware.gzip import GZipMiddleware
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from reverie_eval.server.http import middleware
from reverie_eval.server.http.api import describe, known_query
from reverie_eval.server.http.problems import add_error_handlers
from reverie_eval.server.http.rendering import STATIC, StaticPages, fault_page
from reverie_eval.server.http.runtime import RuntimeState
from reverie_eval.server.http.telemetry import RequestTelemetry
from reverie_eval.server.jobs import Jobs
from reverie_eval.server.messages.queue import tell_fault
from reverie_eval.server.operations.health import Health
from reverie_eval.server.operations.room import monitoring
from reverie_eval.server.rooms import rooms
from reverie_eval.server.settings import Settings
from reverie_eval.server.state import ServerState
from reverie_eval.version import __version__


def create_app(server: ServerState, address: str = "http://localhost") -> FastAPI:
    """Make the application around an opened server.

    ``address`` is printed where people copy the server's address, unless the settings have another:
    what a request's Host header says is anybody's choice.
    """
    jobs = jobs_of(server)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        work_out_routes(app)
        server.warming.set()  # before the first visitor
        with jobs.running():
            yield
        server.database.close()

    app = FastAPI(
        title=server.settings.title,
        description="Scores submissions to REVERIE and benchmarks on the same graphs.",
        version=__version__,
        contact=contact_of(server.settings),
        lifespan=lifespan,
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,  # the redirect would contain the Host header
    )
    app.state.server = server
    app.state.address = server.settings.public_address or address
    app.state.is_copy = False
    app.state.rooms = rooms()
    app.state.runtime = RuntimeState.of(server, jobs)
    app.state.health = Health(server, jobs)
    app.include_router(monitoring)
    add_rooms(app)
    add_error_handlers(app, fault_page)
    add_edge(app, server.settings)
    describe(app, server.settings.path_prefix)
    return app


def jobs_of(server: ServerState) -> Jobs:
    """Return the jobs of all rooms."""
    jobs = [job for room in rooms().values() for job in room.jobs(server)]
    return Jobs(jobs, server.database, server.clock, partial(tell_fault, server))


def add_rooms(app: FastAPI) -> None:
    """Add the routes and the pages of all rooms, and the files that pages use."""
    for room in rooms().values():
        for routes in room.routes:
            app.include_router(routes, dependencies=[Depends(known_query)])
        for pages in room.pages:
            app.include_router(pages, include_in_schema=False)
    # Pages are not compressed: next to text chosen by an attacker, the compressed length could leak
    # the CSRF token (BREACH). Static files hold no secrets, so they are.
    app.mount(STATIC, GZipMiddleware(StaticPages()), name="static")


def work_out_routes(app: FastAPI) -> None:
    """Let FastAPI work out what all routes take, before it accepts requests.

    It would do so on the event loop when the first request comes, and let everyone wait.
    """
    nowhere = {"type": "http", "method": "GET", "path": "\0", "root_path": "", "headers": []}
    for route in app.routes:
        route.matches(nowhere)


def contact_of(settings: Settings) -> dict[str, str] | None:
    """Return how to reach the organiser, as the API's description has it."""
    if not settings.contact:
        return None
    kind = "url" if settings.contact.startswith("https://") else "email"
    return {"name": settings.organiser, kind: settings.contact}


def add_edge(app: FastAPI, settings: Settings) -> None:
    """Put around the routes what every request passes, the innermost first."""
    limits, runtime = settings.limits, app.state.runtime
    app.add_middleware(middleware.HeadRequests)
    app.add_middleware(
        middleware.BodyLimits,
        seconds=limits.seconds_for_body,
        kibibytes_per_second=limits.kibibytes_per_second,
    )
    app.add_middleware(
        middleware.RateLimits, per_minute=limits.requests_per_minute, counts=runtime.counts
    )
    app.add_middleware(middleware.OwnCookies)
    app.add_middleware(RequestTelemetry, metrics=runtime.metrics)
    app.add_middleware(middleware.SecurityHeaders)
    if settings.trusted_proxies:
        trusted = [str(network) for network in settings.trusted_proxies]
        app.add_middleware(ProxyHeadersMiddleware, trusted_hosts=trusted)
    if settings.path_prefix:
        app.add_middleware(middleware.PathPrefix, prefix=settings.path_prefix)
