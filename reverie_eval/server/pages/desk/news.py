"""``/desk/news``: short dated entries for the leaderboards and their feeds."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewNews
from reverie_eval.server.http.callers import Call, Desk, Posted, Snapshot
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service import news

router = APIRouter()

PAGE = "/desk/news"


@forms.shown_at(router, PAGE, "news.html")
def draw(desk: Call, snapshot: Snapshot, _: forms.Typed) -> forms.Shown:
    """Show all entries, and the form to add one."""
    return {
        "entries": news.list_news(snapshot.session, forms.page_at(desk, "entries")),
    }


@router.post(PAGE)
def add(desk: Desk, form: Posted) -> Response:
    """Post an entry."""
    typed = forms.typed_by(desk, form, draw)
    desk.perform(news.add_news, read_model(NewNews, {"text": typed.get("text", "")}))
    return forms.done(PAGE, "added")


@router.post(f"{PAGE}/{{news_id}}/remove")
def remove(desk: Desk, news_id: Number, form: Posted) -> Response:
    """Remove an entry."""
    forms.typed_by(desk, form, draw)
    desk.perform(news.remove_news, news_id)
    return forms.done(PAGE, "removed")
