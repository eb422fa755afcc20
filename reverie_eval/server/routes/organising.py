"""``/organiser``: people and their tokens, further submissions, and who did what."""

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query

from reverie_eval.schemas.organising import (
    AuditReport,
    GrantReport,
    MintedReport,
    NewGrant,
    NewPerson,
    NewTeam,
    NewToken,
    PersonReport,
    TeamReport,
    TokenReport,
)
from reverie_eval.server.http.callers import Organiser, Server, organiser
from reverie_eval.server.http.openapi import problems
from reverie_eval.server.service import audit, grants, people
from reverie_eval.server.store.tables import Grant, Person, Team, Token

router = APIRouter(
    prefix="/organiser",
    tags=["organiser"],
    dependencies=[Depends(organiser)],
    responses=problems("not-signed-in", "not-allowed"),
)

Hint = Annotated[str, Path(pattern=r"^rv_[\w-]{8}$", examples=["rv_3Zk0b9Xw"])]
_LARGEST = 2**31 - 1


@router.get("/teams")
def list_teams(server: Server) -> list[TeamReport]:
    """List the teams by name, with who is in them."""
    with server.database.reading() as session:
        return [_team(team) for team in people.all_teams(session)]


@router.post("/teams", status_code=201, responses=problems("conflict"))
def add_team(new: NewTeam, server: Server, person: Organiser) -> TeamReport:
    """Add a team."""
    with server.database.writing() as session:
        return _team(people.add_team(session, new.name, now=server.clock(), actor=person.name))


@router.get("/people")
def list_people(server: Server) -> list[PersonReport]:
    """List everybody by name."""
    with server.database.reading() as session:
        return [_person(somebody) for somebody in people.all_people(session)]


@router.post("/people", status_code=201, responses=problems("not-found", "conflict"))
def add_person(new: NewPerson, server: Server, person: Organiser) -> PersonReport:
    """Add a person to a team."""
    now, actor = server.clock(), person.name
    with server.database.writing() as session:
        added = people.add_person(session, new.team, new.name, new.role, now=now, actor=actor)
        return _person(added)


@router.get("/tokens")
def list_tokens(server: Server) -> list[TokenReport]:
    """List what is known of tokens and invitations, in the order in which they were made."""
    with server.database.reading() as session:
        return [_token(token) for token in people.all_tokens(session)]


@router.post("/tokens", status_code=201, responses=problems("not-found"))
def mint_token(new: NewToken, server: Server, person: Organiser) -> MintedReport:
    """Make an invitation or a token for somebody; its text cannot be had again."""
    with server.database.writing() as session:
        minted = people.mint(
            session,
            people.person_named(session, new.person),
            new.kind,
            now=server.clock(),
            actor=person.name,
            expires_at=new.expires_at,
        )
        return MintedReport(**_token(minted.token).model_dump(), token=minted.text)


@router.delete("/tokens/{hint}", responses=problems("not-found"))
def revoke_token(hint: Hint, server: Server, person: Organiser) -> TokenReport:
    """Make a token worthless, with the browser sessions that began with it."""
    with server.database.writing() as session:
        return _token(people.revoke(session, hint, now=server.clock(), actor=person.name))


@router.get("/grants")
def list_grants(server: Server) -> list[GrantReport]:
    """List the further submissions that teams were given, the latest first."""
    with server.database.reading() as session:
        return [_grant(given) for given in grants.all_grants(session)]


@router.post("/grants", status_code=201, responses=problems("not-found"))
def give_more(new: NewGrant, server: Server, person: Organiser) -> GrantReport:
    """Raise every limit of a team on a split until a date; the reason goes on record."""
    with server.database.writing() as session:
        given = grants.grant(
            session,
            new.team,
            new.split,
            new.extra,
            splits=server.boards,
            reason=new.reason,
            now=server.clock(),
            expires_at=new.expires_at,
            actor=person.name,
        )
        return _grant(given)


@router.get("/audit")
def show_audit(
    server: Server,
    after: Annotated[int, Query(ge=0, le=_LARGEST)] = 0,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> list[AuditReport]:
    """Show who did what after an entry, the oldest first; `server doctor` checks the chain."""
    with server.database.reading() as session:
        found = audit.entries(session, after, limit)
        return [AuditReport.model_validate(entry) for entry in found]


def _team(team: Team) -> TeamReport:
    names = sorted(person.name for person in team.people)
    return TeamReport(name=team.name, people=names, created_at=team.created_at)


def _person(person: Person) -> PersonReport:
    return PersonReport(
        name=person.name, team=person.team.name, role=person.role, created_at=person.created_at
    )


def _token(token: Token) -> TokenReport:
    return TokenReport(
        hint=token.hint,
        kind=token.kind,
        person=token.person.name,
        created_at=token.created_at,
        expires_at=token.expires_at,
        revoked_at=token.revoked_at,
    )


def _grant(given: Grant) -> GrantReport:
    return GrantReport(
        team=given.team.name,
        split=given.split,
        extra=given.extra,
        reason=given.reason,
        created_at=given.created_at,
        expires_at=given.expires_at,
    )
