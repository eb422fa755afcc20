"""``/desk/reported``: results that papers report, on the leaderboards."""

from collections.abc import Mapping
from decimal import Decimal, InvalidOperation
from math import isfinite

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting._leaderboard import METHOD_FLAGS
from reverie_eval.schemas.organising import NewReported
from reverie_eval.schemas.service import Method, ProblemDocument
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.http.callers import Call, Desk, Posted
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service import reported

router = APIRouter()

PAGE = "/desk/reported"
_PER_CENT = 100


def draw(
    desk: Call, typed: forms.Typed, problem: ProblemDocument | None = None, what: str = ""
) -> Response:
    """Show the reported results, and the form to add one."""
    with desk.snapshot() as snapshot:
        return forms.desk_page(
            desk,
            snapshot,
            "reported.html",
            problem,
            results=reported.list_reported(snapshot.session, forms.page_at(desk, "results")),
            splits=list(desk.server.boards),
            catalogue=CATALOGUE.values(),
            method_fields=Method.model_fields,
            typed=typed,
            done=what,
        )


@router.get(PAGE)
def show_reported(desk: Desk, done: forms.Done = "") -> Response:
    """Show the reported results."""
    return draw(desk, {}, what=done)


@router.post(PAGE)
def add(desk: Desk, form: Posted) -> Response:
    """Add a reported result to a leaderboard."""
    typed = forms.typed_by(desk, form, draw)
    method = {
        "name": typed.get("name", ""),
        "paper": typed.get("source", ""),
        "code": typed.get("code") or None,
        **{name: True for name in METHOD_FLAGS if name in typed},
    }
    new = read_model(
        NewReported,
        {
            "split": typed.get("split", ""),
            "team": typed.get("team", ""),
            "source": typed.get("source", ""),
            "method": method,
            "scores": scores_of(typed),
        },
    )
    desk.perform(reported.add_reported, new, desk.server.boards)
    return forms.done(PAGE, "added")


def scores_of(typed: forms.Typed) -> Mapping[str, float]:
    """Return the scores of the form, which has them as papers print them: percent, metres.

    Raises
    ------
    MalformedError
        Naming what is no number, or none that the metric can have.

    Examples
    --------
    >>> scores_of({"success": "52.51", "path_length": "12.3", "spl": "", "name": "Walker"})
    {'path_length': 12.3, 'success': 0.5251}
    """
    scores = {}
    for metric in CATALOGUE.values():
        text = typed.get(metric.key, "").removesuffix("%").strip()
        if not text:
            continue
        try:
            value = float(Decimal(text) / (_PER_CENT if metric.unit == "fraction" else 1))
        except InvalidOperation:
            raise MalformedError(f"{metric.label}: {text!r} is not a number") from None
        if not isfinite(value) or not 0 <= value <= metric.upper_bound:
            expected = "from 0 to 100" if metric.unit == "fraction" else "0 or more"
            raise MalformedError(f"{metric.heading}: {text} is not {expected}")
        scores[metric.key] = value
    return scores


@router.post(f"{PAGE}/{{result_id}}/remove")
def remove(result_id: Number, desk: Desk, form: Posted) -> Response:
    """Remove a reported result from the leaderboard."""
    forms.show_faults(desk, {}, draw)
    if not forms.is_confirmed(form):
        question = "Remove this reported result from the leaderboard?"
        remark = "You can enter it again. The audit log keeps a record."
        return forms.ask(desk, {}, question=question, remark=remark, yes="Remove it", back=PAGE)
    desk.perform(reported.remove_reported, result_id)
    return forms.done(PAGE, "removed")
