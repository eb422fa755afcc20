"""``/desk/news``: short dated entries for the leaderboards and their feeds."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewNews
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.http.callers import Call, Desk, Posted
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service import news

router = APIRouter()

PAGE = "/desk/news"


def draw(
    desk: Call, typed: forms.Typed, problem: ProblemDocument | None = None, what: str = ""
) -> Response:
    """Show all entries, and the form to add one."""
    with desk.snapshot() as snapshot:
        return forms.desk_page(
            desk,
            snapshot,
            "news.html",
            problem,
            entries=news.list_news(snapshot.session, forms.page_at(desk, "entries")),
            typed=typed,
            done=what,
        )


@router.get(PAGE)
def show_news(desk: Desk, done: forms.Done = "") -> Response:
    """Show the entries."""
    return draw(desk, {}, what=done)


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
