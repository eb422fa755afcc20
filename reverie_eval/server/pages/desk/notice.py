"""``/desk/notice``: the banner, and pausing submissions."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewNotice
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.http.callers import Call, Desk, Posted
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service.notices import latest_notice

router = APIRouter()

PAGE = "/desk/notice"


def draw(
    desk: Call, typed: forms.Typed | None, problem: ProblemDocument | None = None, what: str = ""
) -> Response:
    """Show the current notice, and the form to change it, with its input or the posted notice."""
    notices = desk.server.notices
    with desk.snapshot() as snapshot:
        posted = latest_notice(snapshot.session)
        if typed is None:
            typed = {"banner": posted.banner if posted else ""}
            typed |= {"paused": "true"} if posted and posted.paused else {}
        return forms.desk_page(
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
def show_notice(desk: Desk, done: forms.Done = "") -> Response:
    """Show the current notice and the form to change it."""
    return draw(desk, None, what=done)


@router.post(PAGE)
def post(desk: Desk, form: Posted) -> Response:
    """Show a preview of a notice; post it if it was confirmed."""
    typed = forms.typed_by(desk, form, draw)
    new = read_model(NewNotice, {**typed, "paused": typed.get("paused") == "true"})
    notices = desk.server.notices
    if not forms.is_confirmed(form):
        with desk.snapshot() as snapshot:
            current = notices.current(snapshot.session)
        coming = notices.if_posted(new, snapshot.person.name, snapshot.now)
        return forms.ask(desk, typed, "notice-preview.html", now_standing=current, standing=coming)
    desk.perform(notices.post, new)
    return forms.done(PAGE, "posted")
