"""``/desk/quotas``: further submissions for a team."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewGrant
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.http.callers import Call
from reverie_eval.server.pages.desk.forms import (
    Done,
    Typed,
    desk_page,
    done,
    end_of_day,
    page_at,
    read,
    show_faults,
    typed_into,
)
from reverie_eval.server.pages.visitors import Desk, Posted
from reverie_eval.server.service import people, quotas

router = APIRouter()

PAGE = "/desk/quotas"


def draw(
    desk: Call, typed: Typed, problem: ProblemDocument | None = None, what: str = ""
) -> Response:
    """Show the quotas of splits, what was given beyond them, and the form to give more."""
    with desk.snapshot() as snapshot:
        return desk_page(
            desk,
            snapshot,
            "quotas.html",
            problem,
            given=quotas.list_grants(snapshot.session, page_at(desk, "given")),
            team_names=people.names_of_teams(snapshot.session),
            boards=desk.server.boards.values(),
            typed=typed,
            done=what,
        )


@router.get(PAGE)
def show_quotas(desk: Desk, done: Done = "") -> Response:
    """Show the quotas and what was given beyond them."""
    return draw(desk, {}, what=done)


@router.post(PAGE)
def grant(desk: Desk, form: Posted) -> Response:
    """Raise every limit of a team on a split until a date."""
    typed = typed_into(form)
    show_faults(desk, typed, draw)
    asked = {name: typed.get(name, "") for name in ("team", "split", "extra", "reason")}
    new = read(NewGrant, {**asked, "expires_at": end_of_day(typed.get("until", "")) or ""})
    with desk.transaction() as transaction:
        quotas.grant(transaction, new, desk.server.boards)
    return done(PAGE, "given")
