"""``/desk/quotas``: quotas, and granting extra submissions."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewGrant
from reverie_eval.server.http.callers import Call, Desk, Posted, Snapshot
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.service import people, quotas

router = APIRouter()

PAGE = "/desk/quotas"


@forms.shown_at(router, PAGE, "quotas.html")
def draw(desk: Call, snapshot: Snapshot, _: forms.Typed) -> forms.Shown:
    """Show the quotas of splits, all grants, and the form to grant more."""
    return {
        "given": quotas.list_grants(snapshot.session, forms.page_at(desk, "given")),
        "team_names": people.names_of_teams(snapshot.session),
        "boards": desk.server.boards.values(),
    }


@router.post(PAGE)
def grant(desk: Desk, form: Posted) -> Response:
    """Raise every limit of a team on a split until a date."""
    typed = forms.typed_by(desk, form, draw)
    asked = {name: typed.get(name, "") for name in ("team", "split", "extra", "reason")}
    new = read_model(
        NewGrant, {**asked, "expires_at": forms.end_of_day(typed.get("until", "")) or ""}
    )
    desk.perform(quotas.grant, new, desk.server.boards)
    return forms.done(PAGE, "given")
