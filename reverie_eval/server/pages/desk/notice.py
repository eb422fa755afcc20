"""``/desk/notice``: the banner, and pausing submissions."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewNotice
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.http.callers import Call
from reverie_eval.server.pages.desk.forms import (
    Done,
    Typed,
    ask,
    desk_page,
    done,
    is_confirmed,
    read,
    show_faults,
    typed_into,
)
from reverie_eval.server.pages.visitors import Desk, Posted
from reverie_eval.server.service.notices import latest_notice

router = APIRouter()

PAGE = "/desk/notice"


def draw(
    desk: Call, typed: Typed | None, problem: ProblemDocument | None = None, what: str = ""
) -> Response:
    """Show what holds, and the form to change it, filled with what was typed or else posted."""
    notices = desk.server.notices
    with desk.snapshot() as snapshot:
        posted = latest_notice(snapshot.session)
        if typed is None:
            typed = {"banner": posted.banner if posted else ""}
            typed |= {"paused": "true"} if posted and posted.paused else {}
        return desk_page(
            desk,
            snapshot,
            "notice.html",
            problem,
            posted=posted,
            standing=notices.current(snapshot.session),
            settled=notices.of_settings,
            typed=typed,
            done=what,
        )


@router.get(PAGE)
def show_notice(desk: Desk, done: Done = "") -> Response:
    """Show what is said to everybody, with what holds in the form."""
    return draw(desk, None, what=done)


@router.post(PAGE)
def post(desk: Desk, form: Posted) -> Response:
    """Show what everybody would see; say it to them once that was looked at."""
    typed = typed_into(form)
    show_faults(desk, typed, draw)
    new = read(NewNotice, {**typed, "paused": typed.get("paused") == "true"})
    notices = desk.server.notices
    if not is_confirmed(form):
        with desk.snapshot() as snapshot:
            current = notices.current(snapshot.session)
        coming = notices.if_posted(new, snapshot.person.name, snapshot.now)
        return ask(desk, typed, "notice-preview.html", now_standing=current, standing=coming)
    with desk.transaction() as transaction:
        notices.post(transaction, new)
    return done(PAGE, "posted")
