"""What organisers do that must last, over the API and at their desk.

``/desk/snapshots``: signed states of leaderboards, which never change. ``/desk/corrections``: what
has to be scored again, which a command does. ``/desk/audit``: who did what.
"""

from collections import Counter
from functools import partial

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas import organising as schemas
from reverie_eval.schemas.service import SnapshotEntry
from reverie_eval.server.audit.log import details_in_words, list_entries, list_reports, names_in
from reverie_eval.server.corrections.corrections import count_outdated, list_corrections
from reverie_eval.server.corrections.snapshots import Snapshots, list_snapshots
from reverie_eval.server.http import desk as forms
from reverie_eval.server.http.api import Paging, organiser_router, problems
from reverie_eval.server.http.callers import Call, CallReading, Desk, Organiser, Posted
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.rendering import page
from reverie_eval.server.store.damage import if_readable
from reverie_eval.server.store.paging import Page

routes, pages = organiser_router(), APIRouter()

SNAPSHOTS = "/desk/snapshots"


@forms.shown_at(pages, SNAPSHOTS, "snapshots.html")
def draw_snapshots(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
    """Show all snapshots, and the form to take one."""
    return {
        "snapshots": list_snapshots(reading.session, forms.page_at(desk, "snapshots")),
        "splits": list(desk.server.boards),
    }


@routes.post("/snapshots", status_code=201, responses=problems("not-found"))
def take_snapshot(new: schemas.NewSnapshot, organiser: Organiser) -> SnapshotEntry:
    """Take a signed snapshot of a leaderboard, which never changes, nor do names in it."""
    return organiser.perform(organiser.server.get(Snapshots).take, new)


@pages.post(SNAPSHOTS)
def take_snapshot_at_desk(desk: Desk, form: Posted) -> Response:
    """Take a snapshot, if that was confirmed: it cannot be removed."""
    typed = forms.typed_by(desk, form, draw_snapshots)
    new = read_model(
        schemas.NewSnapshot,
        {name: typed.get(name, "") for name in schemas.NewSnapshot.model_fields},
    )
    desk.server.board(new.split)
    if not forms.is_confirmed(form):
        question = f"Take a snapshot of {new.split}?"
        remark = "It is public at once, and can be neither changed nor removed."
        return forms.ask(
            desk, typed, question=question, remark=remark, yes="Take it", back=SNAPSHOTS
        )
    desk.perform(desk.server.get(Snapshots).take, new)
    return forms.done(SNAPSHOTS, "taken")


@forms.shown_at(pages, "/desk/corrections", "corrections.html")
def draw_corrections(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
    """Show the splits with submissions to score again, and all corrections."""
    outdated, unread = Counter[str](), []
    for board in desk.server.all_boards:
        number = if_readable(board.label, partial(count_outdated, reading.session, board))
        outdated[board.split] += number or 0
        if number is None:
            unread.append(board.label)
    return {
        "outdated": +outdated,
        "unread": unread,
        "corrections": list_corrections(reading.session, forms.page_at(desk, "corrections")),
    }


@routes.get("/audit")
def list_audit(organiser: Organiser, paging: Paging) -> list[schemas.AuditReport]:
    """List the audit log, the oldest entry first; `server doctor` checks its chain."""
    return paging.read(organiser, list_reports)


@pages.get("/desk/audit")
def show_audit(
    desk: Desk,
    cursor: forms.Cursor = None,
    actor: forms.Sought = "",
    subject: forms.Sought = "",
    whole: forms.Sought = "",
) -> Response:
    """Show the audit log, the latest entry first, and whether it is unchanged.

    The entries on the page are always checked; the whole chain, which may be long, on request.
    """
    actor, subject, audit_log = _findable(actor), _findable(subject), desk.server.audit_log
    with desk.reading() as reading:
        session, wanted = reading.session, Page(forms.ENTRIES_ON_A_PAGE, cursor)
        listed = list_entries(session, wanted, actor=actor, subject=subject, newest_first=True)
        altered = (
            audit_log.broken_links(session) if whole else audit_log.altered(session, listed.rows)
        )
        return page(
            reading,
            "desk/audit.html",
            entries=listed,
            in_words=details_in_words,
            names=names_in(session, listed.rows),
            is_first=cursor is None,
            actor=actor,
            subject=subject,
            broken=list(altered),
            is_whole=bool(whole),
            longest_sought=forms.LONGEST_SOUGHT,
        )


def _findable(text: str) -> str:
    """Remove zero bytes, which PostgreSQL does not allow in texts."""
    return text.replace("\0", "").strip()
