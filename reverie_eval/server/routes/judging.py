"""``/organiser``: what is said of results and to everybody, and what uploads came to."""

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query

from reverie_eval.schemas.organising import (
    AttemptReport,
    NewNotice,
    NewReported,
    NewReview,
    NoticeReport,
    ReportedEntry,
    ReviewEntry,
)
from reverie_eval.server.http.callers import Organiser, Server, organiser
from reverie_eval.server.http.openapi import problems
from reverie_eval.server.service import attempts, notices, reported, reviews
from reverie_eval.server.store.tables import Attempt

router = APIRouter(
    prefix="/organiser",
    tags=["organiser"],
    dependencies=[Depends(organiser)],
    responses=problems("not-signed-in", "not-allowed"),
)

_LARGEST = 2**31 - 1
Number = Annotated[int, Path(ge=1, le=_LARGEST, examples=[1])]


@router.get("/reviews")
def list_reviews(server: Server) -> list[ReviewEntry]:
    """List what was said of submissions, lifted or not, the latest first."""
    with server.database.reading() as session:
        return [ReviewEntry.model_validate(said) for said in reviews.all_reviews(session)]


@router.post("/reviews", status_code=201, responses=problems("not-found"))
def review_submission(new: NewReview, server: Server, person: Organiser) -> ReviewEntry:
    """Verify, flag or disqualify a submission, or call it a baseline, with a public reason."""
    with server.database.writing() as session:
        said = reviews.review(
            session,
            new.submission_id,
            new.verdict,
            new.reason,
            now=server.clock(),
            actor=person.name,
        )
        return ReviewEntry.model_validate(said)


@router.delete("/reviews/{review_id}", responses=problems("not-found", "conflict"))
def lift_review(review_id: Number, server: Server, person: Organiser) -> ReviewEntry:
    """Take back what was said of a submission; it stays on record."""
    with server.database.writing() as session:
        said = reviews.lift(session, review_id, now=server.clock(), actor=person.name)
        return ReviewEntry.model_validate(said)


@router.get("/reported")
def list_reported(server: Server) -> list[ReportedEntry]:
    """List the results on boards that papers report, the latest first."""
    with server.database.reading() as session:
        return [ReportedEntry.model_validate(each) for each in reported.all_reported(session)]


@router.post("/reported", status_code=201, responses=problems("not-found", "conflict"))
def add_reported_result(new: NewReported, server: Server, person: Organiser) -> ReportedEntry:
    """Put a result on a board that a paper reports and no server has scored."""
    with server.database.writing() as session:
        added = reported.add_reported(
            session,
            new.split,
            new.method,
            team=new.team,
            scores=new.scores,
            source=str(new.source),
            splits=server.boards,
            now=server.clock(),
            actor=person.name,
        )
        return ReportedEntry.model_validate(added)


@router.delete("/reported/{result_id}", responses=problems("not-found"))
def remove_reported_result(result_id: Number, server: Server, person: Organiser) -> ReportedEntry:
    """Take a reported result off its board."""
    with server.database.writing() as session:
        removed = reported.remove_reported(
            session, result_id, now=server.clock(), actor=person.name
        )
        return ReportedEntry.model_validate(removed)


@router.get("/notice")
def show_notice(server: Server) -> NoticeReport:
    """Show what is said to everybody, and whether submissions are taken."""
    with server.database.reading() as session:
        standing, posted = server.notices.standing(session), notices.latest_notice(session)
    return NoticeReport(
        banner=standing.banner,
        paused=standing.paused,
        posted_by=posted and posted.posted_by,
        created_at=posted and posted.created_at,
    )


@router.put("/notice")
def change_notice(new: NewNotice, server: Server, person: Organiser) -> NoticeReport:
    """Say something to everybody, pause submissions, or take them again, at once."""
    with server.database.writing() as session:
        notices.post_notice(
            session, new.banner, paused=new.paused, now=server.clock(), actor=person.name
        )
    return show_notice(server)


@router.get("/attempts")
def list_attempts(
    server: Server,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    before: Annotated[int | None, Query(ge=1, le=_LARGEST)] = None,
) -> list[AttemptReport]:
    """List uploads and what they came to, the latest first, or the latest before one of them."""
    with server.database.reading() as session:
        return [_attempt(each) for each in attempts.latest_attempts(session, limit, before)]


def _attempt(attempt: Attempt) -> AttemptReport:
    return AttemptReport(
        id=attempt.id,
        at=attempt.at,
        person=attempt.person.name,
        team=attempt.person.team.name,
        split=attempt.split,
        outcome=attempt.outcome,
        problems=attempt.problems,
        size=attempt.size,
        milliseconds=attempt.milliseconds,
    )
