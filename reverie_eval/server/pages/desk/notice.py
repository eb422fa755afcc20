"""``/desk/notice``: the banner, and pausing submissions."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewNotice
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.pages.desk.forms import (
    AtDesk,
    Done,
    Here,
    Typed,
    done,
    is_confirmed,
    read,
    typed_into,
)
from reverie_eval.server.pages.visitors import Posted
from reverie_eval.server.service.notices import latest_notice, post_notice

router = APIRouter()

PAGE = "/desk/notice"


def draw(
    here: AtDesk, typed: Typed, problem: ProblemDocument | None = None, what: str = ""
) -> Response:
    """Show what holds, and the form to change it."""
    with here.server.database.reading() as session:
        posted = latest_notice(session)
        standing = here.server.notices.standing(session)
    return here.draw(
        "desk/notice.html",
        problem,
        posted=posted,
        standing=standing,
        settled=here.server.notices.settled,
        typed=typed,
        done=what,
    )


@router.get(PAGE)
def show_notice(here: Here, done: Done = "") -> Response:
    """Show what is said to everybody, with what holds in the form."""
    with here.server.database.reading() as session:
        posted = latest_notice(session)
    typed = {"banner": posted.banner if posted else ""}
    if posted and posted.paused:
        typed["paused"] = "true"
    return draw(here, typed, what=done)


@router.post(PAGE)
def post(here: Here, form: Posted) -> Response:
    """Show what everybody would see; say it to them once that was looked at."""
    typed = typed_into(form)
    here.keep(typed, draw)
    new = read(NewNotice, {**typed, "paused": typed.get("paused") == "true"})
    notices = here.server.notices
    if not is_confirmed(form):
        return here.ask(
            typed,
            "desk/notice-preview.html",
            now_standing=notices.now(),
            standing=notices.above_settings(new.banner, new.paused),
        )
    with here.server.database.writing() as session:
        post_notice(session, new.banner, paused=new.paused, now=here.now(), actor=here.name)
    return done(PAGE, "posted")
