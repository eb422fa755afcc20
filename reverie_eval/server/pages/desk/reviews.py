"""``/desk/reviews``: verifying, flagging and disqualifying submissions, for all to read."""

from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewReview
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.pages.desk.forms import (
    AtDesk,
    Done,
    Here,
    Number,
    Typed,
    done,
    is_confirmed,
    read,
    typed_into,
)
from reverie_eval.server.pages.visitors import Posted
from reverie_eval.server.service import reviews

router = APIRouter()

PAGE = "/desk/reviews"
A_FEW = 30
VERDICTS: Mapping[str, str] = {
    "verified": "You have checked it: its code was run, or its files were compared.",
    "baseline": "A reference to compare with. It says nothing of its worth.",
    "flagged": "Something is doubtful. It keeps its rank.",
    "disqualified": "It broke the rules. It loses its rank and stays visible.",
}
_HARMFUL = frozenset({"flagged", "disqualified"})


def draw(
    here: AtDesk, typed: Typed, problem: ProblemDocument | None = None, what: str = ""
) -> Response:
    """Show what is said of submissions, and the form to say something of one."""
    with here.server.database.reading() as session:
        said = reviews.all_reviews(session)
        latest = reviews.latest_submissions(session, A_FEW)
        try:
            chosen = reviews.demand_submission(session, typed.get("submission_id", ""))
        except NotFoundError:
            chosen = None
    return here.draw(
        "desk/reviews.html",
        problem,
        standing=[each for each in said if each.lifted_at is None],
        lifted=[each for each in said if each.lifted_at is not None],
        latest=latest,
        chosen=chosen,
        verdicts=VERDICTS,
        now=here.now(),
        typed=typed,
        done=what,
    )


@router.get(PAGE)
def show_reviews(
    here: Here,
    submission: Annotated[str, Query(max_length=32)] = "",
    done: Done = "",
) -> Response:
    """Show what is said of submissions; a link may choose one to say something of."""
    return draw(here, {"submission_id": submission}, what=done)


@router.post(PAGE)
def review(here: Here, form: Posted) -> Response:
    """Say something of a submission; what does harm, only once it was asked for twice."""
    typed = typed_into(form)
    here.keep(typed, draw)
    new = read(NewReview, typed)
    with here.server.database.reading() as session:
        row = reviews.demand_submission(session, new.submission_id)
    if new.verdict in _HARMFUL and not is_confirmed(form):
        return here.ask(
            typed,
            "desk/confirm-review.html",
            row=row,
            verdict=new.verdict,
            effect=VERDICTS[new.verdict],
        )
    with here.server.database.writing() as session:
        reviews.review(
            session,
            new.submission_id,
            new.verdict,
            new.reason,
            now=here.now(),
            actor=here.name,
        )
    return done(PAGE, new.verdict)


@router.post(f"{PAGE}/{{review_id}}/lift")
def lift(review_id: Number, here: Here, form: Posted) -> Response:
    """Take back what was said of a submission."""
    here.keep({}, draw)
    if not is_confirmed(form):
        question = "Take back what was said of this submission?"
        remark = "It disappears from the board; that it was said, and lifted, stays on record."
        return here.ask({}, question=question, remark=remark, yes="Lift it", back=PAGE)
    with here.server.database.writing() as session:
        reviews.lift(session, review_id, now=here.now(), actor=here.name)
    return done(PAGE, "lifted")
