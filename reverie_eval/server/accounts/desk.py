"""What organisers do with teams, people and their tokens, over the API and at their desk.

``/desk/people``: teams, people and their tokens; ``/desk/people/3``: a person. ``/desk/requests``:
requests to join, several of which can be answered at once.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, get_args

from fastapi import APIRouter, Path, Query
from fastapi.responses import Response

from reverie_eval.schemas import organising as schemas
from reverie_eval.schemas.people import (
    AcceptedRequest,
    JoinRequestReport,
    NewPeopleImport,
    PeopleImportReport,
    PersonalData,
    PersonInvitation,
    Rejection,
)
from reverie_eval.schemas.service import Role
from reverie_eval.schemas.wire import LONGEST_NAME
from reverie_eval.server.accounts import joining, people, people_files, personal_data, tokens
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.http import desk as forms
from reverie_eval.server.http.api import Number, Paging, organiser_router, problems
from reverie_eval.server.http.callers import (
    Call,
    CallReading,
    Desk,
    Organiser,
    Posted,
    TokenHint,
)
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.rendering import address_of_site, page
from reverie_eval.server.identity import TOKEN_NAMES

routes, pages = organiser_router(), APIRouter()

PAGE, REQUESTS = "/desk/people", "/desk/requests"
_TOKEN_USERS: Mapping[schemas.TokenKind, str] = {"invite": "people", "access": "scripts"}
"""In the order of the form."""
_REFUSALS = problems("not-found", "conflict")
TeamName = Annotated[str, Path(max_length=LONGEST_NAME, examples=["Blue"])]


@forms.shown_at(pages, PAGE, "people.html")
def draw(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
    """Show all teams, people and tokens, and the forms to add more."""
    session, browser = reading.session, reading.browser
    everybody = people.everybody(session)
    return {
        "teams": people.list_teams(session, forms.page_at(desk, "teams")),
        "team_names": people.names_of_teams(session),
        "known": {(person.team, person.name): person for person in everybody},
        "person_names": {str(person.id): f"{person.name}, {person.team}" for person in everybody},
        "tokens": tokens.list_tokens(session, forms.page_at(desk, "tokens")),
        "own": browser and browser.token.hint,
        "roles": get_args(Role),
        "token_kinds": {
            kind: f"{TOKEN_NAMES[kind]}, for {users}" for kind, users in _TOKEN_USERS.items()
        },
    }


@routes.get("/teams")
def list_teams(organiser: Organiser, paging: Paging) -> list[schemas.TeamReport]:
    """List the teams by name, with their people."""
    return paging.read(organiser, people.list_teams)


@routes.post("/teams", status_code=201, responses=problems("conflict"))
def add_team(new: schemas.NewTeam, organiser: Organiser) -> schemas.TeamReport:
    """Add a team."""
    return organiser.perform(people.add_team, new)


@pages.post(f"{PAGE}/teams")
def add_team_at_desk(desk: Desk, form: Posted) -> Response:
    """Add a team."""
    typed = forms.typed_into(form)
    forms.show_faults(desk, {"team_name": typed.get("name", "")}, draw)
    desk.perform(people.add_team, read_model(schemas.NewTeam, typed))
    return forms.done(PAGE, "team")


@routes.post("/teams/merge", responses=_REFUSALS)
def merge_teams(new: schemas.NewMerge, organiser: Organiser) -> schemas.MergeReport:
    """Give one team's people, submissions and grants to another."""
    return organiser.perform(people.merge_teams, new)


@pages.post(f"{PAGE}/teams/merge")
def merge_teams_at_desk(desk: Desk, form: Posted) -> Response:
    """Merge two teams."""
    typed = forms.typed_by(desk, form, draw)
    new = read_model(schemas.NewMerge, typed)
    if not forms.is_confirmed(form):
        question = f"Merge {new.team} into {new.into}?"
        remark = (
            f"All people, submissions and grants of {new.team} go to {new.into}. Quotas count the "
            "submissions of both. This cannot be undone."
        )
        return forms.ask(desk, typed, question=question, remark=remark, yes="Merge", back=PAGE)
    desk.perform(people.merge_teams, new)
    return forms.done(PAGE, "merged")


@routes.patch("/teams/{name:path}", responses=_REFUSALS)
def rename_team(name: TeamName, new: schemas.NewTeam, organiser: Organiser) -> schemas.TeamReport:
    """Rename a team; its receipts keep the name under which they were signed."""
    return organiser.perform(people.rename_team, name, new)


@pages.post(f"{PAGE}/teams/rename")
def rename_team_at_desk(desk: Desk, form: Posted) -> Response:
    """Rename a team."""
    typed = forms.typed_into(form)
    team, name = typed.get("team", ""), typed.get("name", "")
    forms.show_faults(desk, {"old_name": team, "new_name": name}, draw)
    desk.perform(people.rename_team, team, read_model(schemas.NewTeam, {"name": name}))
    return forms.done(PAGE, "renamed")


@routes.get("/people")
def list_people(organiser: Organiser, paging: Paging) -> list[schemas.PersonReport]:
    """List all people in the order in which they were added."""
    return paging.read(organiser, people.list_people)


@routes.post("/people", status_code=201, responses=_REFUSALS)
def add_person(new: schemas.NewPerson, organiser: Organiser) -> schemas.PersonReport:
    """Add a person to a team."""
    return organiser.perform(people.add_person, new)


@pages.post(PAGE)
def add_person_at_desk(desk: Desk, form: Posted) -> Response:
    """Add a person to a team; adding an organiser needs confirmation."""
    typed = forms.typed_by(desk, form, draw)
    new = read_model(schemas.NewPerson, {**typed, "email": typed.get("email") or None})
    if new.role == "organiser" and not forms.is_confirmed(form):
        question = f"Make {new.name} an organiser?"
        remark = "Organisers see everything at this desk and may do all that you may."
        return forms.ask(desk, typed, question=question, remark=remark, yes="Add them", back=PAGE)
    desk.perform(people.add_person, new)
    return forms.done(PAGE, "person")


@routes.get("/tokens")
def list_tokens(organiser: Organiser, paging: Paging) -> list[schemas.TokenReport]:
    """List tokens and invitations without their text, the latest first."""
    return paging.read(organiser, tokens.list_tokens)


@routes.post("/tokens", status_code=201, responses=_REFUSALS)
def create_token(new: schemas.NewToken, organiser: Organiser) -> schemas.NewTokenReport:
    """Create an invitation or a token for a person; its text is returned only once."""
    return organiser.perform(tokens.create_token, new)


@pages.post(f"{PAGE}/tokens")
def create_token_at_desk(desk: Desk, form: Posted) -> Response:
    """Create an invitation or a token, and show its text in this one reply."""
    typed = forms.typed_by(desk, form, draw)
    with desk.reading() as reading:
        owner = people.find_person(reading.session, forms.number(typed.get("person", "")))
    asked = {"person": owner.name, "team": owner.team.name, "kind": typed.get("kind", "")}
    new = read_model(schemas.NewToken, {**asked, **forms.end_of_day(typed, "expires_at")})
    created = desk.perform(tokens.create_token, new)
    sign_in = address_of_site(desk.request, "/sign-in")
    with desk.reading() as reading:
        return page(reading, "desk/token.html", created=created, sign_in=sign_in)


@routes.delete("/tokens/{hint}", responses=_REFUSALS)
def revoke_token(hint: TokenHint, organiser: Organiser) -> schemas.TokenReport:
    """Revoke a token, with the browser sessions that began with it."""
    return organiser.perform(tokens.revoke_token, hint)


@pages.post(f"{PAGE}/tokens/{{hint}}/revoke")
def revoke_token_at_desk(hint: TokenHint, desk: Desk, form: Posted) -> Response:
    """Revoke a token."""
    forms.show_faults(desk, {}, draw)
    if not forms.is_confirmed(form):
        question = f"Revoke the token that begins with {hint}?"
        remark = "Anyone signed in with it is signed out at once and needs another."
        return forms.ask(desk, {}, question=question, remark=remark, yes="Revoke it", back=PAGE)
    desk.perform(tokens.revoke_token, hint)
    return forms.done(PAGE, "revoked")


@routes.post("/people/import", responses=problems("malformed-request"))
def import_people(new: NewPeopleImport, organiser: Organiser) -> PeopleImportReport:
    """Add the people in a file, or nobody if there is a problem; repeating it changes nothing."""
    return organiser.perform(people_files.import_people, new)


@forms.shown_at(pages, f"{PAGE}/import", "people-import.html")
def draw_import(*_: object) -> forms.Shown:
    """Show the form to import a file of people."""
    return {}


@pages.post(f"{PAGE}/import")
def import_file(desk: Desk, form: Posted) -> Response:
    """Show what a file would add; add it if that was confirmed, and show the invitations."""
    typed = forms.typed_by(desk, form, draw_import)
    typed = {**typed, "text": forms.file_or_text(form, "file", typed.get("text", ""))}
    new = read_model(NewPeopleImport, {**typed, "dry_run": not forms.is_confirmed(form)})
    report = desk.perform(people_files.import_people, new)
    if new.dry_run:
        return forms.ask(desk, typed, "confirm-people.html", report=report)
    if not report.invitations:
        return forms.done(PAGE, "imported", len(report.added))
    return show_invitations(desk, report.invitations, PAGE)


def page_of_person(person_id: int) -> forms.FormPage:
    """Return the page of a person, with the form to change them."""

    @forms.shown_by("person.html")
    def draw(_: Call, reading: CallReading, typed: forms.Typed) -> forms.Shown:
        person = people.person_report(people.find_person(reading.session, person_id))
        own = {"name": person.name, "email": person.email or "", "team": person.team}
        return {
            "person": person,
            "team_names": people.names_of_teams(reading.session),
            "typed": typed or own,
        }

    return draw


@pages.get(f"{PAGE}/{{person_id}}")
def show_person(person_id: Number, desk: Desk, done: forms.Done = "") -> Response:
    """Show a person."""
    return page_of_person(person_id)(desk, {}, what=done)


@routes.get("/people/{person_id}", responses=problems("not-found"))
def show_personal_data(person_id: Number, organiser: Organiser) -> PersonalData:
    """Return all that the server stores about a person."""
    with organiser.reading() as reading:
        return personal_data.personal_data(
            reading.session, person_id, organiser.server.settings.organiser
        )


@pages.get(f"{PAGE}/{{person_id}}/data")
def download_data(person_id: Number, desk: Desk) -> Response:
    """Return all that the server stores about a person, as a file."""
    with desk.reading() as reading:
        data = personal_data.personal_data(
            reading.session, person_id, desk.server.settings.organiser
        )
    headers = {"Content-Disposition": f'attachment; filename="person-{person_id}.json"'}
    return Response(data.model_dump_json(indent=2), media_type="application/json", headers=headers)


@routes.delete("/people/{person_id}", responses=_REFUSALS)
def delete_person(person_id: Number, organiser: Organiser) -> schemas.PersonReport:
    """Remove a person's name and address, and revoke their tokens; results and the log stay."""
    return organiser.perform(personal_data.delete_person, person_id)


@pages.post(f"{PAGE}/{{person_id}}/delete")
def delete_person_at_desk(person_id: Number, desk: Desk, form: Posted) -> Response:
    """Remove a person's name and address."""
    forms.show_faults(desk, {}, page_of_person(person_id))
    if not forms.is_confirmed(form):
        with desk.reading() as reading:
            name = people.find_person(reading.session, person_id).name
        question = f"Delete {name}?"
        remark = (
            "Their name and e-mail address are removed everywhere on this server, and their tokens "
            "are revoked. Results of their team stay. This cannot be undone."
        )
        back = f"{PAGE}/{person_id}"
        return forms.ask(desk, {}, question=question, remark=remark, yes="Delete them", back=back)
    desk.perform(personal_data.delete_person, person_id)
    return forms.done(PAGE, "deleted")


@routes.patch("/people/{person_id}", responses=_REFUSALS)
def change_person(
    person_id: Number, change: schemas.PersonChange, organiser: Organiser
) -> schemas.PersonReport:
    """Rename a person, change their e-mail address, or move them to another team."""
    return organiser.perform(people.change_person, person_id, change)


@pages.post(f"{PAGE}/{{person_id}}")
def change_person_at_desk(person_id: Number, desk: Desk, form: Posted) -> Response:
    """Rename a person, change their address, or move them to another team."""
    typed = forms.typed_by(desk, form, page_of_person(person_id))
    change = read_model(schemas.PersonChange, {**typed, "email": typed.get("email") or None})
    desk.perform(people.change_person, person_id, change)
    return forms.done(f"{PAGE}/{person_id}", "changed")


def page_of_requests(ticked: Collection[int] | None) -> forms.FormPage:
    """Return the page of the open requests, with a tick at some of them, or with None at all."""

    @forms.shown_by("requests.html")
    def draw(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
        return {
            "requests": joining.list_requests(reading.session, forms.page_at(desk, "requests")),
            "cursor": desk.request.query_params.get("requests", ""),
            "are_accepted": desk.server.settings.accept_requests_to_join,
            "ticked": ticked,
        }

    return draw


@routes.get("/requests")
def list_requests(organiser: Organiser, paging: Paging) -> list[JoinRequestReport]:
    """List the open requests to join, the earliest first."""
    return paging.read(organiser, joining.list_requests)


@pages.get(REQUESTS)
def show_requests(
    desk: Desk, done: forms.Done = "", tick: Annotated[str, Query(max_length=20)] = ""
) -> Response:
    """Show the open requests, all of them ticked if the query says so."""
    return page_of_requests(None if tick == "all" else ())(desk, {}, what=done)


@routes.post("/requests/{request_id}/accept", responses=_REFUSALS)
def accept_request(request_id: Number, organiser: Organiser) -> AcceptedRequest:
    """Add a request's people to its team; their invitations are returned only once."""
    return organiser.perform(joining.accept_request, request_id)


@routes.post("/requests/{request_id}/reject", status_code=204, responses=_REFUSALS)
def reject_request(request_id: Number, rejection: Rejection, organiser: Organiser) -> None:
    """Reject a request to join, and remove its names and addresses."""
    organiser.perform(joining.reject_request, request_id, rejection)


@pages.post(REQUESTS)
def answer_requests(desk: Desk, form: Posted) -> Response:
    """Accept the ticked requests, and show the invitations in this one reply; or reject them."""
    ticked = [forms.number(text) for text in form.getlist("request") if isinstance(text, str)]
    typed = forms.typed_by(desk, form, page_of_requests(ticked))
    if not ticked:
        raise MalformedError("tick the requests that you want to answer first")
    if typed.get("what") == "accept":
        accepted = desk.perform(joining.accept_requests, ticked)
        return show_invitations(
            desk, [each for one in accepted for each in one.invitations], REQUESTS
        )
    rejection = read_model(Rejection, {"reason": typed.get("reason", "")})
    desk.perform(joining.reject_requests, ticked, rejection)
    return forms.done(REQUESTS, "rejected")


def show_invitations(desk: Call, invitations: Sequence[PersonInvitation], back: str) -> Response:
    """Show invitations that can be shown only once, and a link back."""
    with desk.reading() as reading:
        return page(
            reading,
            "desk/invitations.html",
            invitations=invitations,
            table=people_files.invitations_csv(invitations),
            sign_in=address_of_site(desk.request, "/sign-in"),
            back=back,
        )
