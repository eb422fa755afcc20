"""The web pages, rendered on the server; they work without scripts."""

from fastapi import FastAPI
from starlette.middleware.gzip import GZipMiddleware

from reverie_eval.server.pages import (
    access,
    boards,
    desk,
    episodes,
    guide,
    home,
    play,
    submissions,
    submitting,
    teams,
)
from reverie_eval.server.pages.rendering import STATIC, StaticPages


def add_pages(app: FastAPI) -> None:
    """Add the pages; they are not part of the API's description."""
    parts = (access, boards, desk, episodes, guide, home, play, submissions, submitting, teams)
    for part in parts:
        app.include_router(part.router, include_in_schema=False)
    # Pages are not packed: beside what somebody else chose to have in them, their length would
    # tell of the CSRF token. What is in no way secret is.
    app.mount(STATIC, GZipMiddleware(StaticPages()), name="static")
