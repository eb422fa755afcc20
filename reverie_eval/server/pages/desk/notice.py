"""``/desk/notice``: the banner, and pausing submissions."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewNotice
from reverie_eval.server.http.callers import Call, Desk, Posted, Snapshot
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service.notices import latest_notice

router = APIRouter()

PAGE = "/desk/notice"


@forms.shown_at(router, PAGE, "notice.html")
def draw(desk: Call, snapshot: Snapshot, typed: forms.Typed) -> forms.Shown:
    """Show the current notice, and the form to change it, with its input or the posted notice."""
    notices, posted = desk.server.notices, latest_notice(snapshot.session)
    standing = notices.current(snapshot.session)
    if posted and not typed:
        typed = {"banner": posted.banner, **({"paused": "true"} if posted.paused else {})}
    return {
        "posted": posted,
        "standing": standing,
        "settled": notices.of_settings,
        "typed": typed,
    }


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
