"""``/desk/people``: teams, who is in them, and their tokens."""

from typing import Annotated, Any

from fastapi import APIRouter, Path
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewPerson, NewTeam, NewToken
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.pages.desk.forms import (
    AtDesk,
    Done,
    Here,
    Typed,
    done,
    end_of_day,
    is_confirmed,
    read,
    typed_into,
)
from reverie_eval.server.pages.visitors import Posted
from reverie_eval.server.service import people

router = APIRouter()
Hint = Annotated[str, Path(pattern=r"^rv_[\w-]{8}$")]

PAGE = "/desk/people"


def draw(
    here: AtDesk, typed: Typed, problem: ProblemDocument | None = None, what: str = ""
) -> Response:
    """Show everybody, their tokens, and the forms to add more."""
    with here.server.database.reading() as session:
        content: dict[str, Any] = {
            "teams": [(team, team.people) for team in people.all_teams(session)],
            "everybody": people.all_people(session),
            "tokens": people.all_tokens(session)[::-1],
        }
    content |= {"typed": typed, "done": what, "now": here.now(), "own": here.session.token.hint}
    return here.draw("desk/people.html", problem, **content)


@router.get(PAGE)
def show_people(here: Here, done: Done = "") -> Response:
    """Show everybody and their tokens."""
    return draw(here, {}, what=done)


@router.post(f"{PAGE}/teams")
def add_team(here: Here, form: Posted) -> Response:
    """Add a team."""
    typed = typed_into(form)
    here.keep({"team_name": typed.get("name", "")}, draw)
    new = read(NewTeam, typed)
    with here.server.database.writing() as session:
        people.add_team(session, new.name, now=here.now(), actor=here.name)
    return done(PAGE, "team")


@router.post(PAGE)
def add_person(here: Here, form: Posted) -> Response:
    """Add a person to a team; an organiser, only once it was asked for twice."""
    typed = typed_into(form)
    here.keep(typed, draw)
    new = read(NewPerson, typed)
    if new.role == "organiser" and not is_confirmed(form):
        question = f"Make {new.name} an organiser?"
        remark = "Organisers see everything at this desk and may do all that you may."
        return here.ask(typed, question=question, remark=remark, yes="Add them", back=PAGE)
    with here.server.database.writing() as session:
        people.add_person(session, new.team, new.name, new.role, now=here.now(), actor=here.name)
    return done(PAGE, "person")


@router.post(f"{PAGE}/tokens")
def mint(here: Here, form: Posted) -> Response:
    """Make an invitation or a token, and show its text in this one reply."""
    typed = typed_into(form)
    here.keep(typed, draw)
    asked = {name: typed.get(name, "") for name in ("person", "kind")}
    new = read(NewToken, {**asked, "expires_at": end_of_day(typed.get("until", ""))})
    with here.server.database.writing() as session:
        minted = people.mint(
            session,
            people.person_named(session, new.person),
            new.kind,
            now=here.now(),
            actor=here.name,
            expires_at=new.expires_at,
        )
    sign_in = str(here.request.url_for("show_sign_in"))
    return here.draw("desk/token.html", minted=minted, person=new.person, sign_in=sign_in)


@router.post(f"{PAGE}/tokens/{{hint}}/revoke")
def revoke(hint: Hint, here: Here, form: Posted) -> Response:
    """Make a token worthless."""
    here.keep({}, draw)
    if not is_confirmed(form):
        question = f"Make the token that begins with {hint} worthless?"
        remark = "Whoever uses it is signed out at once, and needs another."
        return here.ask({}, question=question, remark=remark, yes="Revoke it", back=PAGE)
    with here.server.database.writing() as session:
        people.revoke(session, hint, now=here.now(), actor=here.name)
    return done(PAGE, "revoked")
