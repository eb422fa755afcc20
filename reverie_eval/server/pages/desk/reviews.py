"""``/desk/reviews``: public reviews of submissions."""

from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import NewReview
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.http.callers import Call, Desk, Posted, Snapshot
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service import reviews
from reverie_eval.server.store.tables import Submission

router = APIRouter()

PAGE = "/desk/reviews"
A_FEW = 30
VERDICTS: Mapping[str, str] = {
    "verified": "You have checked it: its code was run, or its files were compared.",
    "baseline": "A reference for comparison.",
    "flagged": "Something is doubtful. It keeps its rank.",
    "disqualified": "It broke the rules. It loses its rank and stays visible.",
}
_HARMFUL = frozenset({"flagged", "disqualified"})


@forms.shown_by("reviews.html")
def draw(desk: Call, snapshot: Snapshot, typed: forms.Typed) -> forms.Shown:
    """Show the reviews, and the form to review a submission."""
    session = snapshot.session
    chosen = _chosen(session, typed)
    standing, lifted = forms.page_at(desk, "standing"), forms.page_at(desk, "lifted")
    return {
        "standing": reviews.review_rows(session, standing, standing=True),
        "lifted": reviews.review_rows(session, lifted, standing=False),
        "latest": reviews.latest_submissions(session, A_FEW),
        "chosen": chosen,
        "report": None if chosen is None else snapshot.view.score_report(chosen),
        "verdicts": VERDICTS,
    }


@router.get(PAGE)
def show_reviews(
    desk: Desk,
    submission: Annotated[str, Query(max_length=32)] = "",
    done: forms.Done = "",
) -> Response:
    """Show the reviews; the query can select a submission to review."""
    return draw(desk, {"submission_id": submission}, what=done)


@router.post(PAGE)
def review(desk: Desk, form: Posted) -> Response:
    """Review a submission; flagging and disqualifying need confirmation."""
    typed = forms.typed_by(desk, form, draw)
    new = read_model(NewReview, typed)
    if new.verdict in _HARMFUL and not forms.is_confirmed(form):
        with desk.snapshot() as snapshot:
            row = reviews.any_submission(snapshot.session, new.submission_id)
        about = {"row": row, "verdict": new.verdict, "effect": VERDICTS[new.verdict]}
        return forms.ask(desk, typed, "confirm-review.html", **about)
    desk.perform(reviews.review, new)
    return forms.done(PAGE, new.verdict)


@router.post(f"{PAGE}/{{review_id}}/lift")
def lift_review(review_id: Number, desk: Desk, form: Posted) -> Response:
    """Lift a review."""
    forms.show_faults(desk, {}, draw)
    if not forms.is_confirmed(form):
        question = "Lift this review?"
        remark = "It disappears from the leaderboard; the audit log keeps a record."
        return forms.ask(desk, {}, question=question, remark=remark, yes="Lift it", back=PAGE)
    desk.perform(reviews.lift_review, review_id)
    return forms.done(PAGE, "lifted")


def _chosen(session: Session, typed: forms.Typed) -> Submission | None:
    try:
        return reviews.any_submission(session, typed.get("submission_id", ""))
    except NotFoundError:
        return None
