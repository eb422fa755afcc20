"""``/desk/news`` and ``/desk/notice``: news, the banner, and pausing submissions."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewNews, NewNotice
from reverie_eval.server.http.callers import Call, Desk, Posted, Snapshot
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service import news
from reverie_eval.server.service.notices import latest_notice

router = APIRouter()

NEWS, NOTICE = "/desk/news", "/desk/notice"


@forms.shown_at(router, NEWS, "news.html")
def draw_news(desk: Call, snapshot: Snapshot, _: forms.Typed) -> forms.Shown:
    """Show all entries, and the form to add one."""
    return {
        "entries": news.list_news(snapshot.session, forms.page_at(desk, "entries")),
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
def draw_notice(desk: Call, snapshot: Snapshot, typed: forms.Typed) -> forms.Shown:
    """Show the current notice, and the form to change it, with its input or the posted notice."""
    notices, posted = desk.server.notices, latest_notice(snapshot.session)
    if posted and not typed:
        typed = {"banner": posted.banner, **({"paused": "true"} if posted.paused else {})}
    return {
        "posted": posted,
        "standing": notices.current(snapshot.session),
        "settled": notices.of_settings,
        "typed": typed,
    }


@router.post(NOTICE)
def post_notice(desk: Desk, form: Posted) -> Response:
    """Show a preview of a notice; post it if it was confirmed."""
    typed = forms.typed_by(desk, form, draw_notice)
    new = read_model(NewNotice, {**typed, "paused": typed.get("paused") == "true"})
    notices = desk.server.notices
    if not forms.is_confirmed(form):
        with desk.snapshot() as snapshot:
            current = notices.current(snapshot.session)
        coming = notices.if_posted(new, snapshot.now)
        return forms.ask(desk, typed, "notice-preview.html", now_standing=current, standing=coming)
    desk.perform(notices.post, new)
    return forms.done(NOTICE, "posted")
