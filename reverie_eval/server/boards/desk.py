"""What the organiser tells everyone, and when splits accept submissions, by pages.

``/desk/news`` and ``/desk/notice``: news, the banner, and pausing submissions. ``/desk/phases``:
when splits accept submissions and show scores.
"""

import re
from collections.abc import Mapping
from datetime import datetime
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewNews, NewNotice, NewSchedule
from reverie_eval.schemas.service import ReleaseScores
from reverie_eval.server.boards import news, schedules
from reverie_eval.server.boards.schedules import Schedules, Timetable
from reverie_eval.server.http import desk as forms
from reverie_eval.server.http.callers import Call, CallReading, Desk, Posted
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.messages.notices import Notices, latest_notice

router = APIRouter()

PHASES = "/desk/phases"

NEWS, NOTICE = "/desk/news", "/desk/notice"


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


@forms.shown_at(router, NEWS, "news.html")
def draw_news(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
    """Show all entries, and the form to add one."""
    return {
        "entries": news.list_news(reading.session, forms.page_at(desk, "entries")),
    }


@router.post(NEWS)
def add_news(desk: Desk, form: Posted) -> Response:
    """Post an entry."""
    typed = forms.typed_by(desk, form, draw_news)
    desk.perform(news.add_news, read_model(NewNews, {"text": typed.get("text", "")}))
    return forms.done(NEWS, "added")


@router.post(f"{NEWS}/{{news_id}}/remove")
def remove_news(desk: Desk, news_id: Number, form: Posted) -> Response:
    """Remove an entry."""
    forms.typed_by(desk, form, draw_news)
    desk.perform(news.remove_news, news_id)
    return forms.done(NEWS, "removed")


@forms.shown_at(router, NOTICE, "notice.html")
def draw_notice(desk: Call, reading: CallReading, typed: forms.Typed) -> forms.Shown:
    """Show the current notice, and the form to change it, with its input or the posted notice."""
    notices, posted = desk.server.get(Notices), latest_notice(reading.session)
    if posted and not typed:
        typed = {"banner": posted.banner, **({"paused": "true"} if posted.paused else {})}
    return {
        "posted": posted,
        "standing": notices.current(reading.session),
        "settled": notices.of_settings,
        "typed": typed,
    }


@router.post(NOTICE)
def post_notice(desk: Desk, form: Posted) -> Response:
    """Show a preview of a notice; post it if it was confirmed."""
    typed = forms.typed_by(desk, form, draw_notice)
    new = read_model(NewNotice, {**typed, "paused": typed.get("paused") == "true"})
    notices = desk.server.get(Notices)
    if not forms.is_confirmed(form):
        with desk.reading() as reading:
            current = notices.current(reading.session)
        coming = notices.if_posted(new, reading.now)
        return forms.ask(desk, typed, "notice-preview.html", now_standing=current, standing=coming)
    desk.perform(notices.post, new)
    return forms.done(NOTICE, "posted")


@forms.shown_by("phases.html")
def draw_phases(desk: Call, reading: CallReading, typed: forms.Typed) -> forms.Shown:
    """Compare settings and desk, and show the form of a split, with its input or what applies."""
    timetables = desk.server.get(Schedules).read(reading.session)
    chosen = typed.get("split", "")
    split = chosen if chosen in timetables else next(iter(timetables))
    return {
        "reports": [timetable.report(name) for name, timetable in timetables.items()],
        "split": split,
        "releases": _RELEASES,
        "is_private": desk.server.board(split).is_private,
        "typed": {**_written(timetables[split]), **typed},
    }


@router.get(PHASES)
def show_phases(
    desk: Desk, split: Annotated[str, Query(max_length=64)] = "", done: forms.Done = ""
) -> Response:
    """Show the phases of all splits, and the form to change those of one."""
    return draw_phases(desk, {"split": split}, what=done)


@router.post(PHASES)
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


def _typed_schedule(typed: forms.Typed, timetable: Timetable, _: datetime) -> NewSchedule:
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
    return read_model(NewSchedule, fields, {"phases": [*phases]})


def _written(timetable: Timetable) -> forms.Typed:
    """Return the schedule in effect as the fields of the form."""
    schedule = timetable.latest.model_dump(mode="json")
    phases = {
        f"{field}-{number}": phase[field] or ""
        for number, phase in enumerate(schedule["phases"])
        for field in _FIELDS
    }
    return {**phases, "release_scores": schedule["release_scores"]}
