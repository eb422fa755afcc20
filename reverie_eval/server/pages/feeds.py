"""Atom feeds (RFC 4287) of each leaderboard and of all."""

from collections.abc import Iterable
from datetime import UTC, datetime

from fastapi import APIRouter, Request
from fastapi.responses import Response

from reverie_eval.server.http.callers import Server
from reverie_eval.server.pages.boards import PATHS, NamedBoard
from reverie_eval.server.pages.rendering import address_of_site, render
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.feed import MOST_ITEMS, Item, items_of, items_of_news, latest
from reverie_eval.server.service.news import latest_news
from reverie_eval.server.state import ServerState

router = APIRouter()
of_board = APIRouter()

_BEFORE_ALL = datetime(2000, 1, 1, tzinfo=UTC)
"""When a feed without items was updated: Atom requires a time."""


@router.get("/feed.atom")
def show_feed(request: Request, server: Server) -> Response:
    """Return the feed of all splits, with the scores on their own leaderboards."""
    items = _items(server, server.boards.values())
    return _feed(request, "", server.settings.title, items)


@of_board.get("/feed.atom")
def show_feed_of_board(board: NamedBoard, request: Request, server: Server) -> Response:
    """Return the feed of a leaderboard."""
    title = f"{board.label} leaderboard, {server.settings.title}"
    return _feed(request, f"/boards/{board.path}", title, _items(server, [board]))


for path in PATHS:
    router.include_router(of_board, prefix=path)


def _items(server: ServerState, boards: Iterable[Board]) -> list[Item]:
    with server.database.reading() as session:
        items = [*items_of_news(latest_news(session, MOST_ITEMS))]
        for board in boards:
            items += items_of(server.ranking(session, board))
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
