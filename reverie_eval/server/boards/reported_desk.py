"""``/desk/reported``: results that papers and other leaderboards report."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, get_args

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.metrics import CATALOGUE, printed_value
from reverie_eval.reporting.service import METHOD_FLAGS
from reverie_eval.schemas.organising import (
    NewImport,
    NewReported,
    Rates,
    ReportedChange,
    ReportedEntry,
)
from reverie_eval.schemas.service import ProblemDocument, ReportedMethod
from reverie_eval.server.boards import reported
from reverie_eval.server.boards.reported_files import as_printed
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.http import desk as forms
from reverie_eval.server.http.callers import Call, CallReading, Desk, Posted
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.rendering import page
from reverie_eval.tasks import Task

router = APIRouter()

PAGE = "/desk/reported"
_MARKS = (*METHOD_FLAGS, "reference")
"""What is yes, no or not declared of a reported result."""


@forms.shown_at(router, PAGE, "reported.html")
def draw(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
    """Show the reported results, and the form to add one."""
    return {
        "results": reported.list_reported(reading.session, forms.page_at(desk, "results")),
        "splits": list(desk.server.boards),
        **_scores_asked(desk.server.tasks),
        "method_fields": ReportedMethod.model_fields,
    }


@forms.shown_at(router, f"{PAGE}/import", "reported-import.html")
def draw_import(desk: Call, _snapshot: CallReading, _: forms.Typed) -> forms.Shown:
    """Show the form to import a file."""
    return {"splits": list(desk.server.boards), "rates": get_args(Rates)}


def draw_result(
    result_id: int,
    desk: Call,
    typed: forms.Typed | None = None,
    problem: ProblemDocument | None = None,
) -> Response:
    """Show the form to change a reported result, with its fields unless others are given."""
    with desk.reading() as reading:
        result = reported.find_reported(reading.session, result_id)
        task = desk.server.settings.tasks.get(result.split)
        return page(
            reading,
            "desk/reported-result.html",
            problem,
            result=result,
            **_scores_asked([task] if task else desk.server.tasks),
            method_fields=ReportedMethod.model_fields,
            typed=_typed_of(result) if typed is None else typed,
        )


@router.post(PAGE)
def add(desk: Desk, form: Posted) -> Response:
    """Add a reported result to a leaderboard."""
    typed = forms.typed_by(desk, form, draw)
    fields = {"split": typed.get("split", ""), "scores": scores_of(typed), **_about(typed)}
    tasks = desk.server.settings.tasks
    desk.perform(reported.add_reported, read_model(NewReported, fields), tasks)
    return forms.done(PAGE, "added")


@router.post(f"{PAGE}/import")
def import_file(desk: Desk, form: Posted) -> Response:
    """Show what a file would add; add it if that was confirmed."""
    typed = forms.typed_by(desk, form, draw_import)
    marks = {what: typed.get(what, "").splitlines() for what in ("human", "reference")}
    new = read_model(NewImport, {**typed, **marks, "dry_run": not forms.is_confirmed(form)})
    report = desk.perform(reported.import_reported, new, desk.server.settings.tasks)
    if new.dry_run:
        return forms.ask(desk, typed, "confirm-import.html", report=report, split=new.split)
    return forms.done(PAGE, "imported")


@router.get(f"{PAGE}/{{result_id}}")
def show_result(result_id: Number, desk: Desk) -> Response:
    """Show the form to change a reported result."""
    return draw_result(result_id, desk)


@router.post(f"{PAGE}/{{result_id}}")
def change(result_id: Number, desk: Desk, form: Posted) -> Response:
    """Change a reported result."""
    typed = forms.typed_by(desk, form, partial(draw_result, result_id))
    scores = {**dict.fromkeys(CATALOGUE), **scores_of(typed)}
    changed = read_model(ReportedChange, {"scores": scores, **_about(typed)})
    desk.perform(reported.change_reported, result_id, changed, desk.server.settings.tasks)
    return forms.done(PAGE, "changed")


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


def _scores_asked(tasks: Sequence[Task]) -> Mapping[str, Any]:
    """Return the metrics that the form asks for: those of tables first, then the others."""
    known = {key for task in tasks for key in task.metrics}
    first = {key for task in tasks for key in task.headline}
    ordered = [metric for key, metric in CATALOGUE.items() if key in known]
    return {
        "headline": [metric for metric in ordered if metric.key in first],
        "other_metrics": [metric for metric in ordered if metric.key not in first],
    }


def scores_of(typed: forms.Typed) -> Mapping[str, float]:
    """Return the scores of the form, which has them as papers print them: percent, metres.

    Raises
    ------
    MalformedError
        Naming a value that is not a number, or not one that the metric can have.

    Examples
    --------
    >>> scores_of({"success": "52.51", "path_length": "12.3", "spl": "", "name": "Walker"})
    {'path_length': 12.3, 'success': 0.5251}
    """
    scores = {}
    for metric in CATALOGUE.values():
        if text := typed.get(metric.key):
            try:
                scores[metric.key] = printed_value(metric, text)
            except ValueError as error:
                raise MalformedError(str(error)) from None
    return scores


def _about(typed: forms.Typed) -> Mapping[str, Any]:
    """Return what the form says of a result besides its scores; empty fields are not known."""
    may_be_unknown = ("paper", "code", *_MARKS)
    return {
        "team": typed.get("team", ""),
        "source": typed.get("source", ""),
        "date": typed.get("date") or None,
        "dataset": typed.get("dataset", ""),
        "method": {
            "name": typed.get("name", ""),
            **{name: typed.get(name) or None for name in may_be_unknown},
        },
    }


def _typed_of(result: ReportedEntry) -> forms.Typed:
    """Return the fields of a result as the form has them."""
    method = result.method.model_dump(mode="json")
    fields = {**method, **result.model_dump(include={"team", "source", "date", "dataset"})}
    texts = {name: "" if value is None else str(value) for name, value in fields.items()}
    flags = {name: texts[name].lower() for name in _MARKS}
    scores = {key: as_printed(CATALOGUE[key], value) for key, value in result.scores.items()}
    return texts | flags | scores
