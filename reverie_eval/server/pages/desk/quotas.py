"""``/desk/quotas``: further submissions for a team."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewGrant
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.pages.desk.forms import (
    AtDesk,
    Done,
    Here,
    Typed,
    done,
    end_of_day,
    read,
    typed_into,
)
from reverie_eval.server.pages.visitors import Posted
from reverie_eval.server.service import grants, people

router = APIRouter()

PAGE = "/desk/quotas"


def draw(
    here: AtDesk, typed: Typed, problem: ProblemDocument | None = None, what: str = ""
) -> Response:
    """Show the quotas of splits, what was given beyond them, and the form to give more."""
    with here.server.database.reading() as session:
        given = grants.all_grants(session)
        teams = people.all_teams(session)
    return here.draw(
        "desk/quotas.html",
        problem,
        given=given,
        teams=teams,
        boards=here.server.boards.values(),
        now=here.now(),
        typed=typed,
        done=what,
    )


@router.get(PAGE)
def show_quotas(here: Here, done: Done = "") -> Response:
    """Show the quotas and what was given beyond them."""
    return draw(here, {}, what=done)


@router.post(PAGE)
def give(here: Here, form: Posted) -> Response:
    """Raise every limit of a team on a split until a date."""
    typed = typed_into(form)
    here.keep(typed, draw)
    asked = {name: typed.get(name, "") for name in ("team", "split", "extra", "reason")}
    new = read(NewGrant, {**asked, "expires_at": end_of_day(typed.get("until", "")) or ""})
    with here.server.database.writing() as session:
        grants.grant(
            session,
            new.team,
            new.split,
            new.extra,
            splits=here.server.boards,
            reason=new.reason,
            now=here.now(),
            expires_at=new.expires_at,
            actor=here.name,
        )
    return done(PAGE, "given")
