"""``/desk/snapshots``: signed states of leaderboards, which never change."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewSnapshot
from reverie_eval.server.http.callers import Call, Desk, Posted, Snapshot
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service.entries import list_snapshots

router = APIRouter()

PAGE = "/desk/snapshots"


@forms.shown_at(router, PAGE, "snapshots.html")
def draw(desk: Call, snapshot: Snapshot, _: forms.Typed) -> forms.Shown:
    """Show all snapshots, and the form to take one."""
    return {
        "snapshots": list_snapshots(snapshot.session),
        "splits": list(desk.server.boards),
    }


@router.post(PAGE)
def take_snapshot(desk: Desk, form: Posted) -> Response:
    """Take a snapshot, if that was confirmed: it cannot be removed."""
    typed = forms.typed_by(desk, form, draw)
    new = read_model(NewSnapshot, {name: typed.get(name, "") for name in NewSnapshot.model_fields})
    desk.server.board(new.split)
    if not forms.is_confirmed(form):
        return forms.ask(
            desk,
            typed,
            question=f"Take a snapshot of {new.split}?",
            remark="It is public at once, and can be neither changed nor removed.",
            yes="Take it",
            back=PAGE,
        )
    desk.perform(desk.server.snapshots.take, new)
    return forms.done(PAGE, "taken")
