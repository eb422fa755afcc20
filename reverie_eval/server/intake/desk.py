"""What the organiser does with submissions, by pages.

``/desk/reviews``: public reviews. ``/desk/emailed-files``: files that people sent by e-mail,
submitted for them. ``/desk/quotas``: extra submissions for a team. ``/desk/attempts``: every upload
with its outcome.
"""

from collections.abc import AsyncIterator, Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import EmailedFile, EmailedFileReport, NewGrant, NewReview
from reverie_eval.schemas.service import Method, ProblemDocument
from reverie_eval.schemas.wire import LONGEST_ID
from reverie_eval.server.accounts import people
from reverie_eval.server.boards import reviews
from reverie_eval.server.boards.embargo import View
from reverie_eval.server.boards.entries import is_anonymous
from reverie_eval.server.errors import MalformedError, NotFoundError
from reverie_eval.server.http import desk as forms
from reverie_eval.server.http.callers import Call, CallReading, Desk, Posted, Server
from reverie_eval.server.http.exchange import exchange_of
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.rendering import page
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.intake import quotas
from reverie_eval.server.intake.attempts import DAYS_KEPT, FAILURES, list_attempts
from reverie_eval.server.intake.emailed_files import EmailedFiles
from reverie_eval.server.intake.submit_page import NOTHING, check_form
from reverie_eval.server.intake.uploads import Began, ReceivedFile, method_from, taken
from reverie_eval.server.store.paging import Page
from reverie_eval.server.store.tables import Submission

router = APIRouter()

REVIEWS, EMAILED_FILES, QUOTAS = "/desk/reviews", "/desk/emailed-files", "/desk/quotas"
A_FEW = 30
ALL_OUTCOMES = ("scored", "repeat", *(kind.code for kind in FAILURES))
_HARMFUL = frozenset({"flagged", "disqualified"})


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


@router.get(REVIEWS)
def show_reviews(
    desk: Desk,
    submission: Annotated[str, Query(max_length=LONGEST_ID)] = "",
    done: forms.Done = "",
) -> Response:
    """Show the reviews; the query can select a submission to review."""
    return draw_reviews(desk, {"submission_id": submission}, what=done)


@router.post(REVIEWS)
def review(desk: Desk, form: Posted) -> Response:
    """Review a submission; flagging and disqualifying need confirmation."""
    typed = forms.typed_by(desk, form, draw_reviews)
    new = read_model(NewReview, typed)
    if new.verdict in _HARMFUL and not forms.is_confirmed(form):
        with desk.reading() as reading:
            row = reviews.any_submission(reading.session, new.submission_id)
        about = {"row": row, "verdict": new.verdict, "effect": reviews.VERDICTS[new.verdict]}
        return forms.ask(desk, typed, "confirm-review.html", **about)
    desk.perform(reviews.review, new)
    return forms.done(REVIEWS, new.verdict)


@router.post(f"{REVIEWS}/{{review_id}}/lift")
def lift_review(review_id: Number, desk: Desk, form: Posted) -> Response:
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


def draw_files(
    desk: Call,
    typed: Mapping[str, str],
    problem: ProblemDocument | None = None,
    report: EmailedFileReport | None = None,
    filename: str = "",
) -> Response:
    """Show the form, and the reply to the last file."""
    with desk.reading() as reading:
        everybody = people.everybody(reading.session)
        return page(
            reading,
            "desk/emailed-files.html",
            problem,
            typed={**NOTHING, "person": "", "received_at": "", "publish": "", **typed},
            person_names={str(each.id): f"{each.name}, {each.team}" for each in everybody},
            splits=list(desk.server.boards),
            required=desk.server.settings.required_metadata,
            limit=desk.server.settings.limits.upload_mebibytes,
            report=report,
            filename=filename,
        )


async def posted_file(
    request: Request, desk: Desk, server: Server, runtime: Runtime, began: Began
) -> AsyncIterator[ReceivedFile]:
    """Read the form when a place is free; after a problem, the input is kept."""
    organiser = await run_in_threadpool(desk.person)
    async with taken(request, server, runtime, began, organiser) as file:
        check_form(desk, file, draw_files)
        async with runtime.scoring.hold(organiser.team_id):
            yield file


PostedFile = Annotated[ReceivedFile, Depends(posted_file, scope="function")]


@router.get(EMAILED_FILES)
def show_form(desk: Desk) -> Response:
    """Show the form."""
    return draw_files(desk, {})


@router.post(EMAILED_FILES)
def submit_emailed_file(desk: Desk, file: PostedFile) -> Response:
    """Submit a file for the person who sent it, and show the reply to them."""
    typed = file.fields
    if not typed.get("person"):
        raise MalformedError("choose the person who sent the file")
    with desk.reading() as reading:
        sender = people.find_person(reading.session, forms.number(typed["person"]))
    given: dict[str, Any] = {name: typed.get(name, "") for name in ("split", "received_at")}
    given |= {"team": sender.team.name, "person": sender.name, "publish": "publish" in typed}
    method = method_from({name: typed[name] for name in Method.model_fields if name in typed})
    report = desk.server.get(EmailedFiles).submit(
        desk.person(), read_model(EmailedFile, given), file.filename, file.packed, method
    )
    exchange_of(desk.request.scope).note(report)
    return draw_files(desk, typed, report=report, filename=file.filename)


@forms.shown_at(router, QUOTAS, "quotas.html")
def draw_quotas(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
    """Show the quotas of splits, all grants, and the form to grant more."""
    return {
        "given": quotas.list_grants(reading.session, forms.page_at(desk, "given")),
        "team_names": people.names_of_teams(reading.session),
        "boards": desk.server.boards.values(),
    }


@router.post(QUOTAS)
def grant(desk: Desk, form: Posted) -> Response:
    """Raise every limit of a team on a split until a date."""
    typed = forms.typed_by(desk, form, draw_quotas)
    asked = {name: typed.get(name, "") for name in ("team", "split", "extra", "reason")}
    new = read_model(NewGrant, {**asked, **forms.end_of_day(typed, "expires_at")})
    desk.perform(quotas.grant, new, desk.server.boards)
    return forms.done(QUOTAS, "given")


@router.get("/desk/attempts")
def show_attempts(desk: Desk, cursor: forms.Cursor = None, outcome: forms.Sought = "") -> Response:
    """List uploads, the latest first."""
    chosen = outcome if outcome in ALL_OUTCOMES else ""
    with desk.reading() as reading:
        return page(
            reading,
            "desk/attempts.html",
            attempts=list_attempts(reading.session, Page(forms.ENTRIES_ON_A_PAGE, cursor), chosen),
            is_first=cursor is None,
            outcome=chosen,
            outcomes=ALL_OUTCOMES,
            days=DAYS_KEPT,
        )
