"""What the organiser decides about splits, by pages.

``/desk/quotas``: extra submissions for a team. ``/desk/phases``: when splits accept submissions and
show scores. ``/desk/snapshots``: signed states of leaderboards, which never change.
``/desk/corrections``: scoring again after the ground truth or the rules were corrected.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewCorrection, NewGrant, NewSchedule, NewSnapshot
from reverie_eval.schemas.service import ReleaseScores
from reverie_eval.server.http.callers import Call, Desk, Posted, Snapshot
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.uploads import ScoringTurn
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service import people, quotas, rescoring, schedules
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.schedules import Timetable
from reverie_eval.server.service.snapshots import list_snapshots
from reverie_eval.server.service.soundness import read_each

router = APIRouter()

QUOTAS, PHASES = "/desk/quotas", "/desk/phases"
SNAPSHOTS, CORRECTIONS = "/desk/snapshots", "/desk/corrections"
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


@forms.shown_at(router, QUOTAS, "quotas.html")
def draw_quotas(desk: Call, snapshot: Snapshot, _: forms.Typed) -> forms.Shown:
    """Show the quotas of splits, all grants, and the form to grant more."""
    return {
        "given": quotas.list_grants(snapshot.session, forms.page_at(desk, "given")),
        "team_names": people.names_of_teams(snapshot.session),
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


@forms.shown_by("phases.html")
def draw_phases(desk: Call, snapshot: Snapshot, typed: forms.Typed) -> forms.Shown:
    """Compare settings and desk, and show the form of a split, with its input or what applies."""
    timetables = desk.server.schedules.read(snapshot.session)
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
        with desk.snapshot() as snapshot:
            effect = desk.server.schedules.if_changed(snapshot.session, split, change, snapshot.now)
        return forms.ask(desk, typed, "phases-preview.html", split=split, **effect._asdict())
    desk.perform(desk.server.schedules.change, split, change)
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


@forms.shown_at(router, SNAPSHOTS, "snapshots.html")
def draw_snapshots(desk: Call, snapshot: Snapshot, _: forms.Typed) -> forms.Shown:
    """Show all snapshots, and the form to take one."""
    return {
        "snapshots": list_snapshots(snapshot.session, forms.page_at(desk, "snapshots")),
        "splits": list(desk.server.boards),
    }


@router.post(SNAPSHOTS)
def take_snapshot(desk: Desk, form: Posted) -> Response:
    """Take a snapshot, if that was confirmed: it cannot be removed."""
    typed = forms.typed_by(desk, form, draw_snapshots)
    new = read_model(NewSnapshot, {name: typed.get(name, "") for name in NewSnapshot.model_fields})
    desk.server.board(new.split)
    if not forms.is_confirmed(form):
        question = f"Take a snapshot of {new.split}?"
        remark = "It is public at once, and can be neither changed nor removed."
        return forms.ask(
            desk, typed, question=question, remark=remark, yes="Take it", back=SNAPSHOTS
        )
    desk.perform(desk.server.snapshots.take, new)
    return forms.done(SNAPSHOTS, "taken")


@forms.shown_at(router, CORRECTIONS, "corrections.html")
def draw_corrections(desk: Call, snapshot: Snapshot, _: forms.Typed) -> forms.Shown:
    """Show the splits with submissions to score again, and all corrections."""
    session, server = snapshot.session, desk.server

    def count(boards: Sequence[Board]) -> Sequence[int]:
        return [*rescoring.count_outdated(session, boards).values()]

    boards, outdated = server.leaderboards, Counter[str]()
    counts = read_each(boards, count)
    for board, number in zip(boards, counts, strict=True):
        outdated[board.name] += number or 0
    return {
        "outdated": +outdated,
        "unread": [
            each.label for each, number in zip(boards, counts, strict=True) if number is None
        ],
        "corrections": rescoring.list_corrections(session, forms.page_at(desk, "corrections")),
        "at_once": rescoring.AT_ONCE,
    }


@router.post(CORRECTIONS)
def rescore(desk: Desk, form: Posted, _: ScoringTurn) -> Response:
    """Score the next submissions to a split again."""
    typed = forms.typed_by(desk, form, draw_corrections)
    new = read_model(NewCorrection, {name: typed.get(name, "") for name in ("split", "reason")})
    report = desk.server.rescoring.rescore(desk.person(), new)
    outcome = "rejected" if report.rejected else "more" if report.left else "scored"
    return forms.done(CORRECTIONS, outcome)
