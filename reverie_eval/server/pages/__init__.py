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
    # Pages are not compressed: next to text chosen by an attacker, the compressed length could leak
    # the CSRF token (BREACH). Static files hold no secrets, so they are.
    app.mount(STATIC, GZipMiddleware(StaticPages()), name="static")
