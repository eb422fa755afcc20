"""Atom feeds (RFC 4287) of each leaderboard and of all."""

from collections.abc import Iterable
from datetime import UTC, datetime
from urllib.parse import quote

from fastapi import APIRouter, Request
from fastapi.responses import Response

from reverie_eval.server.http.callers import Server
from reverie_eval.server.pages.rendering import address_of_site, render
from reverie_eval.server.service.feed import MOST_ITEMS, Item, items_of, items_of_news, latest
from reverie_eval.server.service.news import latest_news
from reverie_eval.server.state import ServerState

router = APIRouter()

_BEFORE_ALL = datetime(2000, 1, 1, tzinfo=UTC)
"""When a feed without items was updated: Atom requires a time."""


@router.get("/feed.atom")
def show_feed(request: Request, server: Server) -> Response:
    """Return the feed of all leaderboards."""
    return _feed(request, "", server.settings.title, _items(server, server.boards))


@router.get("/boards/{split}/feed.atom")
def show_feed_of_board(split: str, request: Request, server: Server) -> Response:
    """Return the feed of a leaderboard."""
    title = f"{server.board(split).name} leaderboard, {server.settings.title}"
    return _feed(request, f"/boards/{quote(split)}", title, _items(server, [split]))


def _items(server: ServerState, splits: Iterable[str]) -> list[Item]:
    with server.database.reading() as session:
        items = [*items_of_news(latest_news(session, MOST_ITEMS))]
        for split in splits:
            items += items_of(server.ranking(session, split, None))
    return items


def _feed(request: Request, board: str, title: str, items: Iterable[Item]) -> Response:
    shown = latest(items)
    xml = render(
        "feed.atom",
        title=title,
        organiser=request.app.title,
        address=address_of_site(request),
        page=board or "/",
        path=f"{board}/feed.atom",
        items=shown,
        updated=max((item.at for item in shown), default=_BEFORE_ALL),
    )
    return Response(xml, media_type="application/atom+xml")
