"""``/desk/people``: teams, who is in them, and their tokens."""

from typing import Annotated

from fastapi import APIRouter, Path
from fastapi.responses import Response

from reverie_eval.schemas.organising import NewPerson, NewTeam, NewToken
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.http.callers import Call
from reverie_eval.server.pages.desk.forms import (
    Done,
    Typed,
    ask,
    desk_page,
    done,
    end_of_day,
    is_confirmed,
    page_at,
    read,
    show_faults,
    typed_into,
)
from reverie_eval.server.pages.visitors import Desk, Posted
from reverie_eval.server.service import people, tokens

router = APIRouter()
Hint = Annotated[str, Path(pattern=r"^rv_[\w-]{8}$")]

PAGE = "/desk/people"


def draw(
    desk: Call, typed: Typed, problem: ProblemDocument | None = None, what: str = ""
) -> Response:
    """Show everybody, their tokens, and the forms to add more."""
    with desk.snapshot() as snapshot:
        session, browser = snapshot.session, snapshot.browser
        everybody = people.names_and_roles(session)
        return desk_page(
            desk,
            snapshot,
            "people.html",
            problem,
            teams=people.list_teams(session, page_at(desk, "teams")),
            team_names=people.names_of_teams(session),
            everybody=everybody,
            tokens=tokens.list_tokens(session, page_at(desk, "tokens")),
            own=browser and browser.token.hint,
            typed=typed,
            done=what,
        )


@router.get(PAGE)
def show_people(desk: Desk, done: Done = "") -> Response:
    """Show everybody and their tokens."""
    return draw(desk, {}, what=done)


@router.post(f"{PAGE}/teams")
def add_team(desk: Desk, form: Posted) -> Response:
    """Add a team."""
    typed = typed_into(form)
    show_faults(desk, {"team_name": typed.get("name", "")}, draw)
    with desk.transaction() as transaction:
        people.add_team(transaction, read(NewTeam, typed))
    return done(PAGE, "team")


@router.post(f"{PAGE}/teams/rename")
def rename_team(desk: Desk, form: Posted) -> Response:
    """Rename a team."""
    typed = typed_into(form)
    team, name = typed.get("team", ""), typed.get("name", "")
    show_faults(desk, {"old_name": team, "new_name": name}, draw)
    with desk.transaction() as transaction:
        people.rename_team(transaction, team, read(NewTeam, {"name": name}))
    return done(PAGE, "renamed")


@router.post(PAGE)
def add_person(desk: Desk, form: Posted) -> Response:
    """Add a person to a team; an organiser, only once it was asked for twice."""
    typed = typed_into(form)
    show_faults(desk, typed, draw)
    new = read(NewPerson, typed)
    if new.role == "organiser" and not is_confirmed(form):
        question = f"Make {new.name} an organiser?"
        remark = "Organisers see everything at this desk and may do all that you may."
        return ask(desk, typed, question=question, remark=remark, yes="Add them", back=PAGE)
    with desk.transaction() as transaction:
        people.add_person(transaction, new)
    return done(PAGE, "person")


@router.post(f"{PAGE}/tokens")
def create_token(desk: Desk, form: Posted) -> Response:
    """Create an invitation or a token, and show its text in this one reply."""
    typed = typed_into(form)
    show_faults(desk, typed, draw)
    asked = {name: typed.get(name, "") for name in ("person", "kind")}
    new = read(NewToken, {**asked, "expires_at": end_of_day(typed.get("until", ""))})
    with desk.transaction() as transaction:
        created = tokens.create_token(transaction, new)
    sign_in = str(desk.request.url_for("show_sign_in"))
    with desk.snapshot() as snapshot:
        return desk_page(desk, snapshot, "token.html", created=created, sign_in=sign_in)


@router.post(f"{PAGE}/tokens/{{hint}}/revoke")
def revoke_token(hint: Hint, desk: Desk, form: Posted) -> Response:
    """Revoke a token."""
    show_faults(desk, {}, draw)
    if not is_confirmed(form):
        question = f"Revoke the token that begins with {hint}?"
        remark = "Whoever uses it is signed out at once, and needs another."
        return ask(desk, {}, question=question, remark=remark, yes="Revoke it", back=PAGE)
    with desk.transaction() as transaction:
        tokens.revoke_token(transaction, hint)
    return done(PAGE, "revoked")
