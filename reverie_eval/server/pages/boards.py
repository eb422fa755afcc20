"""The leaderboards, their charts, and export for papers."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf
from typing import Annotated

import msgspec
from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import PlainTextResponse, RedirectResponse, Response
from starlette.middleware.gzip import GZipMiddleware
from starlette.types import Receive, Scope, Send

from reverie_eval.metrics import CATALOGUE, PRIMARY_METRIC, Metric
from reverie_eval.server.http.callers import Server
from reverie_eval.server.pages.board_query import BoardQuery
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.pages.visitors import Visitor
from reverie_eval.server.service.charts import chart_of
from reverie_eval.server.service.citing import as_bibtex, as_latex
from reverie_eval.server.service.leaderboard import Ranking
from reverie_eval.server.service.standings import Row

PER_PAGE = 100

router = APIRouter()

Asked = Annotated[BoardQuery, Query()]


def ranked(split: str, server: Server, query: Asked) -> Ranking:
    """Return the board that is asked for."""
    with server.database.reading() as session:
        return server.ranking(session, split, query.ranked_by)


Ranked = Annotated[Ranking, Depends(ranked)]


@router.get("/")
def show_home(server: Server) -> Response:
    """Redirect to the first split's leaderboard."""
    return RedirectResponse(f"/boards/{next(iter(server.boards))}")


@dataclass(frozen=True, slots=True)
class Part:
    """The rows of one page of a leaderboard."""

    rows: Sequence[Row]
    first: int
    """The number of rows on earlier pages."""
    count: int
    """The number of rows on all pages."""
    number: int
    pages: int


class Packed(Response):
    """A response that is gzipped if the client accepts it; only for content without secrets."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response."""
        await GZipMiddleware(super().__call__, compresslevel=5)(scope, receive, send)


@router.get("/boards/{split}")
def show_board(split: str, visitor: Visitor, query: Asked) -> Response:
    """Show the published results, ranked."""
    with visitor.snapshot() as snapshot:
        ranking = visitor.server.ranking(snapshot.session, split, query.ranked_by)
        part, apart = _part(ranking, query), query.shown.of(ranking.apart, ranking)
        return page(
            visitor.request,
            "board.html",
            snapshot,
            board=ranking.board,
            ranking=ranking,
            query=query,
            columns=_columns(query, [*part.rows, *apart]),
            offered=[
                m for m in CATALOGUE.values() if m.key in {*ranking.metrics, query.x, query.y}
            ],
            primary=PRIMARY_METRIC,
            part=part,
            rows=part.rows,
            apart=apart[:PER_PAGE],
            reviewed=[row for row in part.rows if row.entry.reviews],
            has_intervals=any(query.metric in row.entry.intervals for row in part.rows),
            counts={"ranked": len(ranking.rows), "apart": len(apart)},
            numbers=_numbers(part.number, part.pages),
        )


@router.get("/boards/{split}/chart")  # noqa: FAST003  # of Ranked
def show_chart(ranking: Ranked, query: Asked) -> Response:
    """Return the data of the charts."""
    drawn = chart_of(ranking, query.shown.of(ranking.rows, ranking), query.x, query.y)
    return Packed(msgspec.json.encode(drawn), media_type="application/json")


@router.get("/boards/{split}/latex")  # noqa: FAST003  # of Ranked
def show_latex(ranking: Ranked, request: Request, query: Asked) -> Response:
    """Return the rows of a page as a LaTeX table."""
    rows = _part(ranking, query).rows
    metrics = [metric for metric in _columns(query, rows) if _is_scored(metric, rows)]
    return PlainTextResponse(as_latex(ranking, rows, metrics, _address(request, query)))


@router.get("/boards/{split}/bibtex")  # noqa: FAST003  # of Ranked
def show_bibtex(ranking: Ranked, request: Request, server: Server, query: Asked) -> Response:
    """Return BibTeX entries for the leaderboard and for each row of a page."""
    rows = _part(ranking, query).rows
    address = _address(request, query)
    return PlainTextResponse(as_bibtex(ranking, rows, server.settings.title, address))


def _part(ranking: Ranking, query: BoardQuery) -> Part:
    """Return the requested page, or the last one."""
    shown = _sorted(query.shown.of(ranking.rows, ranking), query)
    pages = max(1, ceil(len(shown) / PER_PAGE))
    number = min(query.page, pages)
    first = PER_PAGE * (number - 1)
    return Part(shown[first : first + PER_PAGE], first, len(shown), number, pages)


def _sorted(rows: Sequence[Row], query: BoardQuery) -> Sequence[Row]:
    """Sort by a metric without a better direction; for other metrics, rows are already sorted."""
    if query.ranked_by == query.metric:
        return rows
    return sorted(rows, key=lambda row: row.entry.scores.get(query.metric, inf))


def _columns(query: BoardQuery, rows: Sequence[Row]) -> Sequence[Metric]:
    """Return the columns: the primary metric, the metric sorted by, then the catalogue's order.

    A phone has room for only two columns beside the names.
    """
    keys = {key for key, metric in CATALOGUE.items() if metric.headline}
    if query.columns == "all":
        keys |= {key for row in rows for key in row.entry.scores}
    first = dict.fromkeys((PRIMARY_METRIC, query.metric))
    return [CATALOGUE[key] for key in first] + [
        metric for key, metric in CATALOGUE.items() if key in keys - first.keys()
    ]


def _numbers(here: int, pages: int) -> Sequence[int | None]:
    """Return the page numbers to link: both ends and those nearby; None marks a gap.

    >>> _numbers(7, 20)
    [1, None, 5, 6, 7, 8, 9, None, 20]
    """
    near = {number for number in range(here - 2, here + 3) if 1 <= number <= pages}
    numbers: list[int | None] = []
    for number in sorted({1, pages} | near):
        if numbers and numbers[-1] != number - 1:
            numbers.append(None)
        numbers.append(number)
    return numbers


def _is_scored(metric: Metric, rows: Sequence[Row]) -> bool:
    return any(metric.key in row.entry.scores for row in rows)


def _address(request: Request, query: BoardQuery) -> str:
    board = str(request.url_for("show_board", **request.path_params))
    return f"{board}{query.link()}".removesuffix("?")
