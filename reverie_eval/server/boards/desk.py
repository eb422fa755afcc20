"""What organisers do about results and leaderboards, over the API and at their desk.

``/desk/reviews``: public verdicts on submissions. ``/desk/reported``: results that papers and other
leaderboards report. ``/desk/notice`` and ``/desk/news``: the banner, pausing submissions, and news.
``/desk/phases``: when splits accept submissions and show scores.
"""

import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import Annotated, Any, get_args

from fastapi import APIRouter, Query, Response
from sqlalchemy.orm import Session

from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.service import METHOD_FLAGS
from reverie_eval.schemas import organising as schemas
from reverie_eval.schemas.service import NewsReport, ReleaseScores, ReportedMethod
from reverie_eval.schemas.wire import LONGEST_ID
from reverie_eval.server.boards import news, reported, reviews, schedules
from reverie_eval.server.boards.entries import is_anonymous
from reverie_eval.server.boards.reported_files import as_printed, read_change
from reverie_eval.server.boards.schedules import Schedules, Timetable, View
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.http import desk as forms
from reverie_eval.server.http.api import Number, Paging, organiser_router, problems
from reverie_eval.server.http.callers import Call, CallReading, Desk, Organiser, Posted, SplitName
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.messages.notices import current_notice, post_notice
from reverie_eval.server.store.tables import Submission
from reverie_eval.tasks import Task

routes, pages = organiser_router(), APIRouter()

NEWS, NOTICE, PHASES = "/desk/news", "/desk/notice", "/desk/phases"
REPORTED = "/desk/reported"
REVIEWS = "/desk/reviews"
A_FEW = 30
"""Submissions that can be chosen for a review, at most."""
_HARMFUL = frozenset({"flagged", "disqualified"})
"""Verdicts that need confirmation."""
_MARKS = (*METHOD_FLAGS, "reference")
"""What is yes, no or not declared of a reported result."""
_RESULT = ("team", "source", "date", "dataset", "paper", "code", *_MARKS, *CATALOGUE)
"""The fields of the form for a reported result, besides the name of its method."""
_RELEASES: Mapping[ReleaseScores, str] = {
    "at-once": "at once",
    "phase-end": "when the phase ends",
}
"""When scores are shown, in words."""
_FIELDS = ("name", "opens", "closes")
_NAME = re.compile(r"name-([0-9]{1,3})")
"""The form has a row of fields for each phase."""
_CHANGES: Mapping[str, schedules.Change] = {
    "pause": schedules.pause,
    "resume": schedules.resume,
    "close": schedules.close,
    "reset": schedules.reset,
}
"""The functions of the buttons on the page."""


@forms.shown_by("reviews.html")
def draw_reviews(desk: Call, reading: CallReading, typed: forms.Typed) -> forms.Shown:
    """Show the reviews, and the form to review a submission."""
    session = reading.session
    chosen = _chosen(session, typed)
    standing, lifted = forms.page_at(desk, "standing"), forms.page_at(desk, "lifted")
    return {
        "standing": reviews.review_rows(session, standing, standing=True),
        "lifted": reviews.review_rows(session, lifted, standing=False),
        "latest": reviews.latest_submissions(session, A_FEW),
        "chosen": chosen,
        "is_anonymous": chosen is not None and is_anonymous(chosen, reading.now),
        "report": None if chosen is None else View.of(reading).score_report(chosen),
        "verdicts": reviews.VERDICTS,
    }


@routes.get("/reviews")
def list_reviews(organiser: Organiser, paging: Paging) -> list[schemas.ReviewEntry]:
    """List all reviews, lifted or not, the latest first."""
    return paging.read(organiser, reviews.list_reviews)


@pages.get(REVIEWS)
def show_reviews(
    desk: Desk,
    submission: Annotated[str, Query(max_length=LONGEST_ID)] = "",
    done: forms.Done = "",
) -> Response:
    """Show the reviews; the query can select a submission to review."""
    return draw_reviews(desk, {"submission_id": submission}, what=done)


@routes.post("/reviews", status_code=201, responses=problems("not-found"))
def review_submission(new: schemas.NewReview, organiser: Organiser) -> schemas.ReviewEntry:
    """Verify, flag or disqualify a submission, or mark it as a baseline; the reason is public."""
    return organiser.perform(reviews.review, new)


@pages.post(REVIEWS)
def review(desk: Desk, form: Posted) -> Response:
    """Review a submission; flagging and disqualifying need confirmation."""
    typed = forms.typed_by(desk, form, draw_reviews)
    new = read_model(schemas.NewReview, typed)
    if new.verdict in _HARMFUL and not forms.is_confirmed(form):
        with desk.reading() as reading:
            row = reviews.any_submission(reading.session, new.submission_id)
        about = {"row": row, "verdict": new.verdict, "effect": reviews.VERDICTS[new.verdict]}
        return forms.ask(desk, typed, "confirm-review.html", **about)
    desk.perform(reviews.review, new)
    return forms.done(REVIEWS, new.verdict)


@routes.delete("/reviews/{review_id}", responses=problems("not-found", "conflict"))
def lift_review(review_id: Number, organiser: Organiser) -> schemas.ReviewEntry:
    """Lift a review; it stays in this list."""
    return organiser.perform(reviews.lift_review, review_id)


@pages.post(f"{REVIEWS}/{{review_id}}/lift")
def lift_review_at_desk(review_id: Number, desk: Desk, form: Posted) -> Response:
    """Lift a review."""
    forms.show_faults(desk, {}, draw_reviews)
    if not forms.is_confirmed(form):
        question = "Lift this review?"
        remark = "It disappears from the leaderboard; the audit log keeps a record."
        return forms.ask(desk, {}, question=question, remark=remark, yes="Lift it", back=REVIEWS)
    desk.perform(reviews.lift_review, review_id)
    return forms.done(REVIEWS, "lifted")


def _chosen(session: Session, typed: forms.Typed) -> Submission | None:
    try:
        return reviews.any_submission(session, typed.get("submission_id", ""))
    except NotFoundError:
        return None


@forms.shown_at(pages, REPORTED, "reported.html")
def draw_reported(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
    """Show the reported results, and the form to add one."""
    return {
        "results": reported.list_reported(reading.session, forms.page_at(desk, "results")),
        "splits": list(desk.server.boards),
        **_scores_asked(desk.server.tasks),
        "method_fields": ReportedMethod.model_fields,
    }


@forms.shown_at(pages, f"{REPORTED}/import", "reported-import.html")
def draw_reported_import(desk: Call, _snapshot: CallReading, _: forms.Typed) -> forms.Shown:
    """Show the form to import a file."""
    return {"splits": list(desk.server.boards), "rates": get_args(schemas.Rates)}


def page_of_result(result_id: int) -> forms.FormPage:
    """Return the page with the form to change a reported result."""

    @forms.shown_by("reported-result.html")
    def draw(desk: Call, reading: CallReading, typed: forms.Typed) -> forms.Shown:
        result = reported.find_reported(reading.session, result_id)
        task = desk.server.settings.tasks.get(result.split)
        return {
            "result": result,
            **_scores_asked([task] if task else desk.server.tasks),
            "method_fields": ReportedMethod.model_fields,
            "typed": typed or _typed_of(result),
        }

    return draw


@routes.get("/reported")
def list_reported(organiser: Organiser, paging: Paging) -> list[schemas.ReportedEntry]:
    """List the reported results on leaderboards, the latest first."""
    return paging.read(organiser, reported.list_reported)


@routes.post("/reported", status_code=201, responses=problems("not-found", "conflict"))
def add_reported_result(new: schemas.NewReported, organiser: Organiser) -> schemas.ReportedEntry:
    """Add a result that a paper or another leaderboard reports."""
    return organiser.perform(reported.add_reported, new, organiser.server.settings.tasks)


@pages.post(REPORTED)
def add_reported(desk: Desk, form: Posted) -> Response:
    """Add a reported result to a leaderboard."""
    typed = forms.typed_by(desk, form, draw_reported)
    new = read_change(schemas.NewReported, _cells(typed), split=typed.get("split", ""))
    desk.perform(reported.add_reported, new, desk.server.settings.tasks)
    return forms.done(REPORTED, "added")


@routes.post("/reported/import", responses=problems("malformed-request", "not-found"))
def import_reported_results(new: schemas.NewImport, organiser: Organiser) -> schemas.ImportReport:
    """Add the results in a file, or none if there is a problem; repeating it changes nothing."""
    return organiser.perform(reported.import_reported, new, organiser.server.settings.tasks)


@pages.post(f"{REPORTED}/import")
def import_reported(desk: Desk, form: Posted) -> Response:
    """Show what a file would add; add it if that was confirmed."""
    typed = forms.typed_by(desk, form, draw_reported_import)
    fields = {
        **typed,
        "date": typed.get("date") or None,
        **{what: typed.get(what, "").splitlines() for what in ("human", "reference")},
    }
    new = read_model(schemas.NewImport, {**fields, "dry_run": not forms.is_confirmed(form)})
    report = desk.perform(reported.import_reported, new, desk.server.settings.tasks)
    if new.dry_run:
        return forms.ask(desk, typed, "confirm-import.html", report=report, split=new.split)
    return forms.done(REPORTED, "imported", len(report.added))


@pages.get(f"{REPORTED}/{{result_id}}")
def show_reported_result(result_id: Number, desk: Desk) -> Response:
    """Show the form to change a reported result."""
    return page_of_result(result_id)(desk, {})


@routes.patch("/reported/{result_id}", responses=problems("not-found", "conflict"))
def change_reported_result(
    result_id: Number, change: schemas.ReportedChange, organiser: Organiser
) -> schemas.ReportedEntry:
    """Change a reported result; the audit log keeps the earlier values."""
    tasks = organiser.server.settings.tasks
    return organiser.perform(reported.change_reported, result_id, change, tasks)


@pages.post(f"{REPORTED}/{{result_id}}")
def change_reported(result_id: Number, desk: Desk, form: Posted) -> Response:
    """Change a reported result."""
    typed = forms.typed_by(desk, form, page_of_result(result_id))
    changed = read_change(schemas.ReportedChange, _cells(typed))
    desk.perform(reported.change_reported, result_id, changed, desk.server.settings.tasks)
    return forms.done(REPORTED, "changed")


@routes.delete("/reported/{result_id}", responses=problems("not-found"))
def remove_reported_result(result_id: Number, organiser: Organiser) -> schemas.ReportedEntry:
    """Remove a reported result from the leaderboard."""
    return organiser.perform(reported.remove_reported, result_id)


@pages.post(f"{REPORTED}/{{result_id}}/remove")
def remove_reported(result_id: Number, desk: Desk, form: Posted) -> Response:
    """Remove a reported result from the leaderboard."""
    forms.show_faults(desk, {}, draw_reported)
    if not forms.is_confirmed(form):
        question = "Remove this reported result from the leaderboard?"
        remark = "You can enter it again. The audit log keeps a record."
        return forms.ask(desk, {}, question=question, remark=remark, yes="Remove it", back=REPORTED)
    desk.perform(reported.remove_reported, result_id)
    return forms.done(REPORTED, "removed")


def _scores_asked(tasks: Sequence[Task]) -> Mapping[str, Any]:
    """Return the metrics that the form asks for: those of tables first, then the others."""
    known = {key for task in tasks for key in task.metrics}
    first = {key for task in tasks for key in task.headline}
    ordered = [metric for key, metric in CATALOGUE.items() if key in known]
    return {
        "headline": [metric for metric in ordered if metric.key in first],
        "other_metrics": [metric for metric in ordered if metric.key not in first],
    }


def _cells(typed: forms.Typed) -> Mapping[str, str]:
    """Return the fields of a result in the form, which has them as a table prints them."""
    return {"method": typed.get("name", ""), **{name: typed.get(name, "") for name in _RESULT}}


def _typed_of(result: schemas.ReportedEntry) -> forms.Typed:
    """Return the fields of a result as the form has them."""
    method = result.method.model_dump(mode="json")
    fields = {**method, **result.model_dump(include={"team", "source", "date", "dataset"})}
    texts = {name: "" if value is None else str(value) for name, value in fields.items()}
    flags = {name: texts[name].lower() for name in _MARKS}
    scores = {key: as_printed(CATALOGUE[key], value) for key, value in result.scores.items()}
    return texts | flags | scores


@forms.shown_at(pages, NOTICE, "notice.html")
def draw_notice(_: Call, reading: CallReading, typed: forms.Typed) -> forms.Shown:
    """Show the current notice, and the form to change it, with its input or the current notice."""
    standing = current_notice(reading.session)
    current = {"banner": standing.banner, **({"paused": "true"} if standing.paused else {})}
    return {"standing": standing, "typed": typed or current}


@routes.get("/notice")
def show_notice(organiser: Organiser) -> schemas.NoticeReport:
    """Show the current banner, and whether submissions are paused."""
    with organiser.reading() as reading:
        return current_notice(reading.session)


@routes.put("/notice")
def change_notice(new: schemas.NewNotice, organiser: Organiser) -> schemas.NoticeReport:
    """Set the banner, and pause or resume submissions; takes effect immediately."""
    return organiser.perform(post_notice, new)


@pages.post(NOTICE)
def post_notice_at_desk(desk: Desk, form: Posted) -> Response:
    """Show a preview of a notice; post it if it was confirmed."""
    typed = forms.typed_by(desk, form, draw_notice)
    new = read_model(schemas.NewNotice, {**typed, "paused": typed.get("paused") == "true"})
    if not forms.is_confirmed(form):
        with desk.reading() as reading:
            current = current_notice(reading.session)
        return forms.ask(desk, typed, "notice-preview.html", now_standing=current, standing=new)
    desk.perform(post_notice, new)
    return forms.done(NOTICE, "posted")


@forms.shown_by("phases.html")
def draw_phases(desk: Call, reading: CallReading, typed: forms.Typed) -> forms.Shown:
    """Compare settings and desk, and show the form of a split, with its input or what applies."""
    service = desk.server.get(Schedules)
    timetables = service.read(reading.session)
    chosen = typed.get("split", "")
    split = chosen if chosen in timetables else next(iter(timetables))
    return {
        "reports": service.list_all(reading.session),
        "split": split,
        "releases": _RELEASES,
        "is_private": desk.server.board(split).is_private,
        "typed": {**_written(timetables[split]), **typed},
    }


@routes.get("/schedules")
def list_schedules(organiser: Organiser) -> list[schemas.ScheduleReport]:
    """Compare when splits accept submissions: in the settings, at the desk, and in effect."""
    with organiser.reading() as reading:
        return organiser.server.get(Schedules).list_all(reading.session)


@pages.get(PHASES)
def show_phases(
    desk: Desk, split: Annotated[str, Query(max_length=64)] = "", done: forms.Done = ""
) -> Response:
    """Show the phases of all splits, and the form to change those of one."""
    return draw_phases(desk, {"split": split}, what=done)


@routes.put("/schedules/{split}", responses=problems("not-found", "conflict"))
def set_schedule(
    split: SplitName, new: schemas.NewSchedule, organiser: Organiser
) -> schemas.ScheduleReport:
    """Set a split's phases, when its scores are released, and whether it is paused.

    Fields that are left out are taken from the settings file. Takes effect immediately.
    """
    return organiser.perform(organiser.server.get(Schedules).set, split, new)


@pages.post(PHASES)
def set_phases(desk: Desk, form: Posted) -> Response:
    """Show what a change would do; make it if it was confirmed."""
    typed = forms.typed_by(desk, form, draw_phases)
    split = typed.get("split", "")
    change = _CHANGES.get(typed.get("what", "")) or partial(_typed_schedule, typed)
    if not forms.is_confirmed(form):
        with desk.reading() as reading:
            effect = desk.server.get(Schedules).if_changed(
                reading.session, split, change, reading.now
            )
        return forms.ask(desk, typed, "phases-preview.html", split=split, **effect._asdict())
    desk.perform(desk.server.get(Schedules).change, split, change)
    return forms.done(PHASES, "set")


def _typed_schedule(typed: forms.Typed, timetable: Timetable, _: datetime) -> schemas.NewSchedule:
    """Return the phases and the release of scores that were typed; a pause stays."""
    numbers = sorted(int(found[1]) for found in map(_NAME.fullmatch, typed) if found)
    rows = {
        number: {field: value for field in _FIELDS if (value := typed.get(f"{field}-{number}"))}
        for number in numbers
    }
    phases = {number: row for number, row in rows.items() if row}
    release_scores = typed.get("release_scores", "at-once")
    fields = {
        "phases": [*phases.values()],
        "release_scores": release_scores,
        "paused": timetable.latest.paused,
    }
    return read_model(schemas.NewSchedule, fields, {"phases": [*phases]})


def _written(timetable: Timetable) -> forms.Typed:
    """Return the schedule in effect as the fields of the form."""
    schedule = timetable.latest.model_dump(mode="json")
    phases = {
        f"{field}-{number}": phase[field] or ""
        for number, phase in enumerate(schedule["phases"])
        for field in _FIELDS
    }
    return {**phases, "release_scores": schedule["release_scores"]}


@forms.shown_at(pages, NEWS, "news.html")
def draw_news(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
    """Show all entries, and the form to add one."""
    return {
        "entries": news.list_news(reading.session, forms.page_at(desk, "entries")),
    }


@routes.post("/news", status_code=201)
def add_news(new: schemas.NewNews, organiser: Organiser) -> NewsReport:
    """Post a news entry; `GET /api/v1/news` lists them to everyone."""
    return organiser.perform(news.add_news, new)


@pages.post(NEWS)
def add_news_at_desk(desk: Desk, form: Posted) -> Response:
    """Post an entry."""
    typed = forms.typed_by(desk, form, draw_news)
    desk.perform(news.add_news, read_model(schemas.NewNews, {"text": typed.get("text", "")}))
    return forms.done(NEWS, "added")


@routes.delete("/news/{news_id}", responses=problems("not-found"))
def remove_news(news_id: Number, organiser: Organiser) -> NewsReport:
    """Remove a news entry."""
    return organiser.perform(news.remove_news, news_id)


@pages.post(f"{NEWS}/{{news_id}}/remove")
def remove_news_at_desk(desk: Desk, news_id: Number, form: Posted) -> Response:
    """Remove an entry."""
    forms.typed_by(desk, form, draw_news)
    desk.perform(news.remove_news, news_id)
    return forms.done(NEWS, "removed")
