"""Leaderboards as pages and over the API, their charts, feeds and exports; a team's public results.

Who asks for a leaderboard makes no difference, so over the API a token that ended is not refused.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import ceil
from typing import Annotated, Literal, NamedTuple, Self, TypeVar

import msgspec
from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import PlainTextResponse
from starlette.middleware.gzip import GZipMiddleware
from starlette.types import Receive, Scope, Send

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.service import METHOD_COSTS
from reverie_eval.schemas.service import Leaderboard, NewsReport
from reverie_eval.server.boards import news
from reverie_eval.server.boards.charts import chart_of, rank_chart, timeline_of, whole_timeline
from reverie_eval.server.boards.entries import Entry, Row
from reverie_eval.server.boards.leaderboard import (
    Ranking,
    Rankings,
    as_bibtex,
    as_csv,
    as_json,
    as_latex,
    sort_by,
)
from reverie_eval.server.boards.query import LONGEST_SOUGHT, BoardQuery
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.http.api import API, TEXT, Number, Paging, file_reply, problems
from reverie_eval.server.http.callers import BoardName, Server, SplitName, Visitor
from reverie_eval.server.http.rendering import address_of_site, page, render
from reverie_eval.server.scoring.boards import Board, without_version
from reverie_eval.server.state import ServerState
from reverie_eval.tasks import DEFAULT_TASK

PER_PAGE = 50
"""With more, the page of all metrics would weigh over 300 kB, charts included."""
MOST_APART = 120
"""Results that are shown below the ranking, at most: enough for a leaderboard of six years."""
PATHS = ("/splits/{split}", "/splits/{split}/boards/{board}")
"""The URL paths of a split's main leaderboard, and of the others."""
NEWS_SHOWN = 5
_BEFORE_ALL = datetime(2000, 1, 1, tzinfo=UTC)
"""When a feed without items was updated: Atom requires a time."""
_AS_PAPERS = ("success", "oracle_success", "spl", "path_length")
"""REVERIE's metrics of navigation in the order of its paper's tables; the others follow."""
_SORTABLE = [key for key, metric in CATALOGUE.items() if metric.better != "neither"]
"""The metrics of all tasks; a leaderboard has those of its own."""
SortedBy = Annotated[str | None, Query(json_schema_extra={"enum": _SORTABLE})]

LEADERBOARD_CSV = (
    "rank,submission_id,team,published_at,...\n1,5f2b0c9a4d7e1f36,Blue,2027-06-02T12:00:00Z,...\n"
)
_OF_CSV = file_reply(
    "text/csv", "malformed-request", "not-found", schema=TEXT, example=LEADERBOARD_CSV
)

router = APIRouter()
routes = APIRouter(prefix=f"{API}/splits", tags=["splits"])
news_routes = APIRouter(prefix=API, tags=["access"])

Endpoint = TypeVar("Endpoint", bound=Callable[..., Response])


def named(split: str, server: Server, request: Request) -> Board:
    """Return the leaderboard that an address names."""
    return server.board(split, request.path_params.get("board", ""))


NamedBoard = Annotated[Board, Depends(named)]


async def asked(board: NamedBoard, query: Annotated[BoardQuery, Query()]) -> BoardQuery:
    """Return the query, with the leaderboard's own metrics where it asks for none."""
    return query.on(board)


Asked = Annotated[BoardQuery, Depends(asked)]


def ranked(board: NamedBoard, server: Server, query: Asked) -> Ranking:
    """Return the requested leaderboard, ranked."""
    with server.database.reading() as session:
        return server.get(Rankings).ranking(session, board, query.ranked_by(board))


Ranked = Annotated[Ranking, Depends(ranked)]


@dataclass(frozen=True, slots=True)
class BoardPage:
    """The rows of one page of a leaderboard."""

    rows: Sequence[Row]
    first: int
    """The number of rows on earlier pages."""
    count: int
    """The number of rows on all pages."""
    number: int
    pages: int


@dataclass(frozen=True, slots=True)
class Scale:
    """Where values lie on the bars of intervals, which all rows of a table share."""

    low: float
    high: float

    @classmethod
    def of(cls, rows: Sequence[Row], metric: str) -> Self:
        """Return the scale from the lowest to the highest end of any interval."""
        ends = [end for row in rows for end in row.entry.intervals.get(metric, ())]
        return cls(min(ends, default=0.0), max(ends, default=1.0))

    def at(self, value: float) -> float:
        """Return the place of a value, from 0 on the left to 100 on the right."""
        width = self.high - self.low
        return round(100 * (value - self.low) / width, 1) if width else 50.0


class Packed(Response):
    """A response that is gzipped if the client accepts it; only for content without secrets."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response."""
        await GZipMiddleware(super().__call__, compresslevel=5)(scope, receive, send)


def of_every_board(router: APIRouter, path: str) -> Callable[[Endpoint], Endpoint]:
    """Add a route below the path of a split's main leaderboard, and of the others.

    Not by a router that is included with a prefix, as the log and the metrics would then have the
    route's path without it.
    """

    def add(endpoint: Endpoint) -> Endpoint:
        for board in PATHS:
            router.get(f"{board}{path}")(endpoint)
        return endpoint

    return add


@of_every_board(router, "")
def show_board(board: NamedBoard, visitor: Visitor, query: Asked) -> Response:
    """Show the published results, ranked."""
    with visitor.reading() as reading:
        session, server = reading.session, visitor.server
        ranking = server.get(Rankings).detailed(session, board, query.ranked_by(board))
        shown, apart = (query.shown(rows, ranking) for rows in (ranking.rows, ranking.apart))
        part = _part(shown, query)
        is_copy = visitor.request.app.state.is_copy
        return page(
            reading,
            "board.html",
            board=board,
            of_split=server.board(board.split).all,
            ranking=ranking,
            query=query,
            groups=_groups(ranking.board, query, [*part.rows, *apart]),
            columns=_columns(ranking.board, query, [*part.rows, *apart]),
            bands=_bands(ranking, apart[:MOST_APART], query),
            costs=_costs(query, part.rows),
            scale=Scale.of(part.rows, query.metric),
            schedule=server.get(Schedules).in_effect(session)[board.split],
            own_team=reading.caller and reading.caller.team_id,
            axes={
                metric.key: f"{metric.label}: {metric.name}"
                for metric in CATALOGUE.values()
                if metric.key in {*ranking.metrics, query.x, query.y}
            },
            primary=ranking.board.primary.key,
            part=part,
            rows=part.rows,
            announced=news.announcements(session, board, NEWS_SHOWN),
            reviewed=[row for row in (*part.rows, *apart[:MOST_APART]) if row.entry.reviews],
            has_intervals=any(query.metric in row.entry.intervals for row in part.rows),
            has_charts=bool(shown) and len(ranking.metrics) > 1,
            timeline=timeline_of(ranking, [*shown, *apart], query.metric)
            if query.is_filtered
            else whole_timeline(ranking, query.metric),
            # A page that is opened as a file cannot load its data.
            chart=chart_of(ranking, shown, query.x, query.y) if is_copy else None,
            counts=_counts(ranking, apart),
            numbers=_numbers(part.number, part.pages),
            longest_sought=LONGEST_SOUGHT,
        )


@of_every_board(router, "/chart")
def show_chart(ranking: Ranked, query: Asked) -> Response:
    """Return the data of the charts."""
    rows = query.shown(ranking.rows, ranking)
    drawn = chart_of(ranking, rows, query.x, query.y)
    return Packed(msgspec.json.encode(drawn), media_type="application/json")


@of_every_board(router, "/latex")
def show_latex(ranking: Ranked, request: Request, query: Asked) -> Response:
    """Return the rows of a page as a LaTeX table; its signature is that of scored results only."""
    rows = _cited(ranking, query)
    scored = {key for row in rows for key in row.entry.scores}
    metrics = [metric for metric in _columns(ranking.board, query, rows) if metric.key in scored]
    return PlainTextResponse(as_latex(ranking, rows, metrics, _address(request, query)))


@of_every_board(router, "/bibtex")
def show_bibtex(ranking: Ranked, request: Request, server: Server, query: Asked) -> Response:
    """Return BibTeX entries for the leaderboard and for each result that was scored on a page."""
    rows = _cited(ranking, query)
    title, site = server.settings.title, address_of_site(request)
    return PlainTextResponse(as_bibtex(ranking, rows, title, site, _address(request, query)))


@router.get("/feed.atom")
def show_feed(request: Request, server: Server) -> Response:
    """Return the Atom feed (RFC 4287) of all splits, with the scores on their main leaderboards."""
    return _feed(request, server, [*server.boards.values()], "", server.settings.title)


@of_every_board(router, "/feed.atom")
def show_feed_of_board(board: NamedBoard, request: Request, server: Server) -> Response:
    """Return the feed of a leaderboard."""
    title = f"{board.label} leaderboard, {server.settings.title}"
    return _feed(request, server, [board], f"/splits/{board.path}", title)


def _feed(
    request: Request, server: ServerState, boards: Sequence[Board], path: str, title: str
) -> Response:
    with server.database.reading() as session:
        items = [*news.items_of_news(news.latest_news(session, news.MOST_ITEMS))]
        rankings = server.get(Rankings).rankings(session, boards)
        for ranking in rankings:
            items += () if ranking is None else news.items_of_results(ranking)
        items += news.items_of_corrections(boards, news.corrections_of(session, *boards))
    shown = news.latest_items(items)
    xml = render(
        "feed.atom",
        title=title,
        organiser=server.settings.organiser,
        address=address_of_site(request),
        page=path or "/",
        path=f"{path}/feed.atom",
        items=shown,
        unread=[
            board.label for board, ranking in zip(boards, rankings, strict=True) if ranking is None
        ],
        updated=max((item.at for item in shown), default=_BEFORE_ALL),
    )
    return Response(xml, media_type="application/atom+xml")


@dataclass(frozen=True, slots=True)
class Band:
    """Results below the ranking that can only be compared with each other."""

    name: str
    why: str
    """Why they are not ranked."""
    rows: Sequence[Row]
    """The best first, by what the leaderboard is sorted by."""


def _bands(ranking: Ranking, apart: Sequence[Row], query: BoardQuery) -> Sequence[Band]:
    """Group the results that are not comparable with the ranking, by what they are comparable by.

    Results on other versions of the dataset come first, and disqualified ones last.
    """
    found: dict[tuple[int, str, str], list[Row]] = {}
    for row in sort_by(apart, CATALOGUE[query.metric]):
        found.setdefault(_band_of(row.entry, ranking.board), []).append(row)
    return [Band(name, why, found[key]) for key in sorted(found) for _, name, why in [key]]


def _band_of(entry: Entry, board: Board) -> tuple[int, str, str]:
    """Return the place, the name and the reason of the band that a result is in."""
    if entry.standing == "other-dataset":
        why = f"another version of the dataset: this leaderboard is on {board.truth.header.dataset}"
        return 0, f"On {entry.dataset}", why
    if entry.standing == "other-rules":
        return 1, "Under other rules", without_version(entry.signature)
    return 2, "Disqualified", "by the organiser, with the reasons below"


def _counts(ranking: Ranking, apart: Sequence[Row]) -> Mapping[str, int]:
    """Count what a leaderboard has, and the rows that are shown as not ranked.

    Anonymous teams are not counted: the count could reveal whether a named team also has anonymous
    results.
    """
    scored = [row.entry for row in ranking.rows if row.entry.is_ranked]
    teams = [ranking.team(entry) for entry in scored]
    return {
        "all": len(ranking.rows),
        "scored": len(scored),
        "teams": len({*teams} - {""}),
        "anonymous": teams.count(""),
        "reported": len(ranking.rows) - len(scored),
        "apart": len(apart),
    }


def _part(shown: Sequence[Row], query: BoardQuery) -> BoardPage:
    """Return the requested page of the rows that match, or the last one."""
    if CATALOGUE[query.metric].better == "neither":  # by others, they are already sorted
        shown = sort_by(shown, CATALOGUE[query.metric])
    pages = max(1, ceil(len(shown) / PER_PAGE))
    number = min(query.page, pages)
    first = PER_PAGE * (number - 1)
    return BoardPage(shown[first : first + PER_PAGE], first, len(shown), number, pages)


def _cited(ranking: Ranking, query: BoardQuery) -> Sequence[Row]:
    """Return the rows of the requested page that this server has scored."""
    part = _part(query.shown(ranking.rows, ranking), query)
    return [row for row in part.rows if row.entry.is_ranked]


@dataclass(frozen=True, slots=True)
class Group:
    """Columns under one heading."""

    name: Literal["Navigation", "Grounding"]
    columns: Sequence[Metric]


def _costs(query: BoardQuery, rows: Sequence[Row]) -> Mapping[str, str]:
    """Return the declared costs that have a column beside all metrics; there is no room for more.

    Beside headline metrics, a mark of the method has the money.
    """
    return {
        name: words
        for name, words in METHOD_COSTS.items()
        if query.columns == "all" and any(row.entry.method.get(name) is not None for row in rows)
    }


def _groups(board: Board, query: BoardQuery, rows: Sequence[Row]) -> Sequence[Group]:
    """Return the columns as papers order them: navigation, then grounding."""
    scored = {key for row in rows for key in row.entry.scores}
    headline = set(board.task.headline)
    keys = scored if query.columns == "all" else headline & scored
    keys |= {query.metric} | headline & set(board.metrics)
    first = _AS_PAPERS if board.task.name == DEFAULT_TASK else board.task.headline
    ordered = [board.task.metric(key) for key in dict.fromkeys((*first, *CATALOGUE)) if key in keys]
    groups = (
        Group("Navigation", [each for each in ordered if "answer" not in each.needs]),
        Group("Grounding", [each for each in ordered if "answer" in each.needs]),
    )
    return [group for group in groups if group.columns]


def _columns(board: Board, query: BoardQuery, rows: Sequence[Row]) -> Sequence[Metric]:
    return [metric for group in _groups(board, query, rows) for metric in group.columns]


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


def _address(request: Request, query: BoardQuery) -> str:
    path = request.app.url_path_for("show_board", **request.path_params)
    return address_of_site(request, f"{path}{query.link()}").removesuffix("?")


class TeamResults(NamedTuple):
    """What a team has on a leaderboard."""

    board: Board
    rows: Sequence[Row]
    """At least one."""
    metrics: Sequence[Metric]
    rank_over_time: str
    """A picture; empty if no result has a rank."""


@router.get("/teams/{team_id}")
def show_public_team(team_id: Number, visitor: Visitor) -> Response:
    """Show what everyone may see of a team; results for which it is anonymous are left out."""
    server = visitor.server
    with visitor.reading() as reading:
        rankings = server.get(Rankings).rankings(reading.session, [*server.boards.values()])
        found = [each for ranking in rankings if ranking for each in _of_team(ranking, team_id)]
        if not found:
            raise NotFoundError("there is no team with published results here")
        name = found[0].rows[0].entry.team
        return page(reading, "public-team.html", name=name, results=found)


def _of_team(ranking: Ranking, team_id: int) -> Sequence[TeamResults]:
    """Return the results on a leaderboard; none if there are none, or all are anonymous."""

    def is_own(entry: Entry) -> bool:
        return entry.team_id == team_id and ranking.team(entry) != ""

    rows = [row for row in (*ranking.rows, *ranking.apart) if is_own(row.entry)]
    if not rows:
        return ()
    task = ranking.board.task
    metrics = task.headline_metrics({key for row in rows for key in row.entry.scores})
    title = f"Best rank of {rows[0].entry.team} on {ranking.board.label}"
    return [TeamResults(ranking.board, rows, metrics, rank_chart(ranking, title, is_own))]


@routes.get(
    "/{split}/leaderboard",
    response_model=Leaderboard,
    responses=problems("malformed-request", "not-found"),
)
def show_leaderboard(split: SplitName, server: Server, metric: SortedBy = None) -> Response:
    """Rank the published submissions by a metric; by default the split's primary one.

    Reported results are among the others, without a rank. Results that are disqualified, on another
    version of the dataset, or scored under other rules are in `apart`.
    """
    return _json_reply(server, metric, split)


@routes.get(
    "/{split}/leaderboard.csv",
    response_class=Response,
    responses=_OF_CSV,
)
def download_leaderboard(split: SplitName, server: Server, metric: SortedBy = None) -> Response:
    """Return the leaderboard as CSV."""
    return _csv_reply(server, metric, split)


@routes.get(
    "/{split}/boards/{board}/leaderboard",
    response_model=Leaderboard,
    responses=problems("malformed-request", "not-found"),
)
def show_named_leaderboard(
    split: SplitName, board: BoardName, server: Server, metric: SortedBy = None
) -> Response:
    """Rank the submissions on another leaderboard of the split."""
    return _json_reply(server, metric, split, board)


@routes.get(
    "/{split}/boards/{board}/leaderboard.csv",
    response_class=Response,
    responses=_OF_CSV,
)
def download_named_leaderboard(
    split: SplitName, board: BoardName, server: Server, metric: SortedBy = None
) -> Response:
    """Return another leaderboard of the split as CSV."""
    return _csv_reply(server, metric, split, board)


def _json_reply(server: ServerState, metric: str | None, split: str, name: str = "") -> Response:
    board = server.board(split, name)
    with server.database.reading() as session:
        ranking = server.get(Rankings).detailed(session, board, metric)
        corrections = news.corrections_of(session, board)
    content = as_json(ranking, corrections, server.settings.organiser)
    return Response(content, media_type="application/json")


def _csv_reply(server: ServerState, metric: str | None, split: str, name: str = "") -> Response:
    board = server.board(split, name)
    with server.database.reading() as session:
        ranking = server.get(Rankings).detailed(session, board, metric)
    return PlainTextResponse(as_csv(ranking), media_type="text/csv")


@news_routes.get("/news")
def show_news(server: Server, paging: Paging) -> list[NewsReport]:
    """List the organiser's news, the latest first."""
    with server.database.reading() as session:
        return paging.reply(news.list_news(session, paging.page))
