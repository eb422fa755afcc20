"""``/desk/phases``: when splits accept submissions and show scores."""

import re
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewSchedule
from reverie_eval.server.http.callers import Call, Desk, Posted, Snapshot
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service.schedules import Timetable, closed

router = APIRouter()

PAGE = "/desk/phases"
_FIELDS = ("name", "opens", "closes")
_NAME = re.compile(r"name-([0-9]{1,3})")
"""The form has a row of fields for each phase."""


@forms.shown_by("phases.html")
def draw(desk: Call, snapshot: Snapshot, typed: forms.Typed) -> forms.Shown:
    """Compare settings and desk, and show the form of a split, with its input or what applies."""
    timetables = desk.server.schedules.read(snapshot.session)
    chosen = typed.get("split", "")
    split = chosen if chosen in timetables else next(iter(timetables))
    return {
        "reports": [timetable.report(name) for name, timetable in timetables.items()],
        "split": split,
        "is_private": desk.server.board(split).is_private,
        "typed": {**_written(timetables[split]), **typed},
    }


@router.get(PAGE)
def show_phases(
    desk: Desk, split: Annotated[str, Query(max_length=64)] = "", done: forms.Done = ""
) -> Response:
    """Show the phases of all splits, and the form to change those of one."""
    return draw(desk, {"split": split}, what=done)


@router.post(PAGE)
def set_phases(desk: Desk, form: Posted) -> Response:
    """Show what a change would do; make it if it was confirmed."""
    typed = forms.typed_by(desk, form, draw)
    schedules, split = desk.server.schedules, typed.get("split", "")
    with desk.snapshot() as snapshot:
        timetable = schedules.of(snapshot.session, split)
        new = _asked(timetable, typed, snapshot.now)
        after, shown = schedules.if_set(snapshot.session, split, new, snapshot.now)
    if not forms.is_confirmed(form):
        return forms.ask(
            desk,
            typed,
            "phases-preview.html",
            split=split,
            before=timetable.latest,
            after=after,
            new=new,
            shown=shown,
        )
    desk.perform(schedules.set, split, new)
    return forms.done(PAGE, "set")


def _asked(timetable: Timetable, typed: forms.Typed, now: datetime) -> NewSchedule:
    """Return what one of the forms on the page asks for."""
    match typed.get("what"):
        case "close":
            return closed(timetable.latest, now)
        case "pause":
            return timetable.desk.model_copy(update={"paused": True})
        case "resume":
            return timetable.desk.model_copy(update={"paused": False})
        case "reset":
            return timetable.desk.model_copy(update={"phases": None, "release_scores": None})
        case _:
            return _typed_schedule(typed, paused=timetable.latest.paused)


def _typed_schedule(typed: forms.Typed, *, paused: bool) -> NewSchedule:
    numbers = sorted(int(found[1]) for found in map(_NAME.fullmatch, typed) if found)
    rows = [
        {field: value for field in _FIELDS if (value := typed.get(f"{field}-{number}"))}
        for number in numbers
    ]
    phases = [row for row in rows if row]
    release_scores = typed.get("release_scores", "at-once")
    fields = {"phases": phases, "release_scores": release_scores, "paused": paused}
    return read_model(NewSchedule, fields)


def _written(timetable: Timetable) -> forms.Typed:
    """Return the schedule in effect as the fields of the form."""
    schedule = timetable.latest.model_dump(mode="json")
    phases = {
        f"{field}-{number}": phase[field] or ""
        for number, phase in enumerate(schedule["phases"])
        for field in _FIELDS
    }
    return {**phases, "release_scores": schedule["release_scores"]}
