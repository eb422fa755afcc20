"""Leaderboards, news, and what organisers decide about them: reviews, reported results, phases."""

from typing import Annotated

from fastapi import APIRouter, Query, Response
from fastapi.responses import PlainTextResponse

from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas import organising as schemas
from reverie_eval.schemas.service import Leaderboard, NewsReport
from reverie_eval.server.boards import news, reported, reviews
from reverie_eval.server.boards.leaderboard import Rankings, as_csv, as_json
from reverie_eval.server.boards.news import corrections_of
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.http.callers import BoardName, Organiser, Server, SplitName
from reverie_eval.server.http.exchange import API
from reverie_eval.server.http.openapi import TEXT, file_reply, organiser_router, problems
from reverie_eval.server.http.paging import Number, Paging
from reverie_eval.server.messages.notices import Notices
from reverie_eval.server.state import ServerState

router = APIRouter(prefix=f"{API}/splits", tags=["splits"])
public = APIRouter(prefix=API, tags=["access"])
organising = organiser_router()

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
        ranking = server.get(Rankings).with_details(
            session, server.get(Rankings).ranking(session, board, metric)
        )
        corrections = corrections_of(session, [board])[board.split]
    content = as_json(ranking, corrections, server.settings.organiser)
    return Response(content, media_type="application/json")


def _as_csv(server: ServerState, metric: str | None, split: str, name: str = "") -> Response:
    board = server.board(split, name)
    with server.database.reading() as session:
        ranking = server.get(Rankings).with_details(
            session, server.get(Rankings).ranking(session, board, metric)
        )
    return PlainTextResponse(as_csv(ranking), media_type="text/csv")


@organising.get("/reviews")
def list_reviews(organiser: Organiser, paging: Paging) -> list[schemas.ReviewEntry]:
    """List all reviews, lifted or not, the latest first."""
    return paging.read(organiser, reviews.list_reviews)


@organising.post("/reviews", status_code=201, responses=problems("not-found"))
def review_submission(new: schemas.NewReview, organiser: Organiser) -> schemas.ReviewEntry:
    """Verify, flag or disqualify a submission, or mark it as a baseline; the reason is public."""
    return organiser.perform(reviews.review, new)


@organising.delete("/reviews/{review_id}", responses=problems("not-found", "conflict"))
def lift_review(review_id: Number, organiser: Organiser) -> schemas.ReviewEntry:
    """Lift a review; it stays in this list."""
    return organiser.perform(reviews.lift_review, review_id)


@organising.get("/reported")
def list_reported(organiser: Organiser, paging: Paging) -> list[schemas.ReportedEntry]:
    """List the reported results on leaderboards, the latest first."""
    return paging.read(organiser, reported.list_reported)


@organising.post("/reported", status_code=201, responses=problems("not-found", "conflict"))
def add_reported_result(new: schemas.NewReported, organiser: Organiser) -> schemas.ReportedEntry:
    """Add a result that a paper or another leaderboard reports."""
    return organiser.perform(reported.add_reported, new, organiser.server.settings.tasks)


@organising.post("/reported/import", responses=problems("malformed-request", "not-found"))
def import_reported_results(new: schemas.NewImport, organiser: Organiser) -> schemas.ImportReport:
    """Add the results in a file, or none if there is a problem; repeating it changes nothing."""
    return organiser.perform(reported.import_reported, new, organiser.server.settings.tasks)


@organising.patch("/reported/{result_id}", responses=problems("not-found", "conflict"))
def change_reported_result(
    result_id: Number, change: schemas.ReportedChange, organiser: Organiser
) -> schemas.ReportedEntry:
    """Change a reported result; the audit log keeps the earlier values."""
    tasks = organiser.server.settings.tasks
    return organiser.perform(reported.change_reported, result_id, change, tasks)


@organising.delete("/reported/{result_id}", responses=problems("not-found"))
def remove_reported_result(result_id: Number, organiser: Organiser) -> schemas.ReportedEntry:
    """Remove a reported result from the leaderboard."""
    return organiser.perform(reported.remove_reported, result_id)


@organising.get("/notice")
def show_notice(organiser: Organiser) -> schemas.NoticeReport:
    """Show the current banner, and whether submissions are paused."""
    with organiser.reading() as reading:
        return organiser.server.get(Notices).current(reading.session)


@organising.put("/notice")
def change_notice(new: schemas.NewNotice, organiser: Organiser) -> schemas.NoticeReport:
    """Set the banner, and pause or resume submissions; takes effect immediately."""
    return organiser.perform(organiser.server.get(Notices).post, new)


@organising.get("/schedules")
def list_schedules(organiser: Organiser) -> list[schemas.ScheduleReport]:
    """Compare when splits accept submissions: in the settings, at the desk, and in effect."""
    with organiser.reading() as reading:
        return organiser.server.get(Schedules).list_all(reading.session)


@organising.put("/schedules/{split}", responses=problems("not-found", "conflict"))
def set_schedule(
    split: SplitName, new: schemas.NewSchedule, organiser: Organiser
) -> schemas.ScheduleReport:
    """Set a split's phases, when its scores are released, and whether it is paused.

    Fields that are left out are taken from the settings file. Takes effect immediately.
    """
    return organiser.perform(organiser.server.get(Schedules).set, split, new)


@organising.post("/news", status_code=201)
def add_news(new: schemas.NewNews, organiser: Organiser) -> NewsReport:
    """Post a news entry; `GET /api/v1/news` lists them to everyone."""
    return organiser.perform(news.add_news, new)


@organising.delete("/news/{news_id}", responses=problems("not-found"))
def remove_news(news_id: Number, organiser: Organiser) -> NewsReport:
    """Remove a news entry."""
    return organiser.perform(news.remove_news, news_id)


@public.get("/news")
def show_news(server: Server, paging: Paging) -> list[NewsReport]:
    """List the organiser's news, the latest first."""
    with server.database.reading() as session:
        return paging.reply(news.list_news(session, paging.page))
