"""Leaderboards, news, and what organisers decide about them: reviews, reported results, phases."""

from typing import Annotated

from fastapi import APIRouter, Query, Response
from fastapi.responses import PlainTextResponse

from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.service import Leaderboard, NewsReport
from reverie_eval.server.boards import news
from reverie_eval.server.boards.leaderboard import Rankings, as_csv, as_json
from reverie_eval.server.boards.news import corrections_of
from reverie_eval.server.http.api import API, TEXT, Paging, file_reply, problems
from reverie_eval.server.http.callers import BoardName, Server, SplitName
from reverie_eval.server.state import ServerState

router = APIRouter(prefix=f"{API}/splits", tags=["splits"])
public = APIRouter(prefix=API, tags=["access"])

_SORTABLE = [key for key, metric in CATALOGUE.items() if metric.better != "neither"]
"""The metrics of all tasks; a leaderboard has those of its own."""
SortedBy = Annotated[str | None, Query(json_schema_extra={"enum": _SORTABLE})]

LEADERBOARD_CSV = (
    "rank,submission_id,team,published_at,...\n1,5f2b0c9a4d7e1f36,Blue,2027-06-02T12:00:00Z,...\n"
)
_OF_CSV = file_reply(
    "text/csv", "malformed-request", "not-found", schema=TEXT, example=LEADERBOARD_CSV
)


@router.get(
    "/{split}/leaderboard",
    response_model=Leaderboard,
    responses=problems("malformed-request", "not-found"),
)
def show_leaderboard(split: SplitName, server: Server, metric: SortedBy = None) -> Response:
    """Rank the published submissions by a metric; by default the split's primary one.

    Reported results are among the others, without a rank. Results that are disqualified, on another
    version of the dataset, or scored under other rules are in `apart`.
    """
    return _as_json(server, metric, split)


@router.get(
    "/{split}/leaderboard.csv",
    response_class=Response,
    responses=_OF_CSV,
)
def download_leaderboard(split: SplitName, server: Server, metric: SortedBy = None) -> Response:
    """Return the leaderboard as CSV."""
    return _as_csv(server, metric, split)


@router.get(
    "/{split}/boards/{board}/leaderboard",
    response_model=Leaderboard,
    responses=problems("malformed-request", "not-found"),
)
def show_named_leaderboard(
    split: SplitName, board: BoardName, server: Server, metric: SortedBy = None
) -> Response:
    """Rank the submissions on another leaderboard of the split."""
    return _as_json(server, metric, split, board)


@router.get(
    "/{split}/boards/{board}/leaderboard.csv",
    response_class=Response,
    responses=_OF_CSV,
)
def download_named_leaderboard(
    split: SplitName, board: BoardName, server: Server, metric: SortedBy = None
) -> Response:
    """Return another leaderboard of the split as CSV."""
    return _as_csv(server, metric, split, board)


# Who asks for a leaderboard makes no difference, so a token that ended is not refused.
def _as_json(server: ServerState, metric: str | None, split: str, name: str = "") -> Response:
    board = server.board(split, name)
    with server.database.reading() as session:
        ranking = server.get(Rankings).detailed(session, board, metric)
        corrections = corrections_of(session, board)
    content = as_json(ranking, corrections, server.settings.organiser)
    return Response(content, media_type="application/json")


def _as_csv(server: ServerState, metric: str | None, split: str, name: str = "") -> Response:
    board = server.board(split, name)
    with server.database.reading() as session:
        ranking = server.get(Rankings).detailed(session, board, metric)
    return PlainTextResponse(as_csv(ranking), media_type="text/csv")


@public.get("/news")
def show_news(server: Server, paging: Paging) -> list[NewsReport]:
    """List the organiser's news, the latest first."""
    with server.database.reading() as session:
        return paging.reply(news.list_news(session, paging.page))
