"""``/desk/corrections``: scoring again after the ground truth or the rules were corrected."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewCorrection
from reverie_eval.server.http.callers import Call, Desk, Posted, Snapshot
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.uploads import ScoringSlot
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service import rescoring

router = APIRouter()

PAGE = "/desk/corrections"


@forms.shown_at(router, PAGE, "corrections.html")
def draw(desk: Call, snapshot: Snapshot, _: forms.Typed) -> forms.Shown:
    """Show the splits with submissions to score again, and all corrections."""
    return {
        "outdated": {
            split: number
            for split, own in desk.server.boards.items()
            if (number := sum(rescoring.count_outdated(snapshot.session, b) for b in own.all))
        },
        "corrections": rescoring.list_corrections(
            snapshot.session, forms.page_at(desk, "corrections")
        ),
        "at_once": rescoring.AT_ONCE,
    }


@router.post(PAGE)
def rescore(desk: Desk, form: Posted, _: ScoringSlot) -> Response:
    """Score the next submissions to a split again."""
    typed = forms.typed_by(desk, form, draw)
    new = read_model(NewCorrection, {name: typed.get(name, "") for name in ("split", "reason")})
    report = desk.server.rescoring.rescore(desk.person().name, new)
    outcome = "rejected" if report.rejected else "more" if report.left else "scored"
    return forms.done(PAGE, outcome)
