"""``/organiser``: routes for organisers only."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import StreamingResponse

from reverie_eval.schemas import organising as schemas
from reverie_eval.schemas.evidence import EvidenceReport
from reverie_eval.schemas.people import PersonalData
from reverie_eval.schemas.service import NewsReport, SnapshotEntry
from reverie_eval.schemas.wire import LONGEST_NAME
from reverie_eval.server.http.callers import Organiser, TokenHint
from reverie_eval.server.http.exchange import API, exchange_of
from reverie_eval.server.http.openapi import BINARY, file_reply, problems
from reverie_eval.server.http.paging import Number, Paging
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.uploads import (
    FILE_BODY,
    METHOD_PARAMETERS,
    OF_UPLOADS,
    ReceivedByOrganiser,
    ScoringTurn,
    fields_of,
    method_from,
    parameters_of,
)
from reverie_eval.server.routes.splits import SplitName
from reverie_eval.server.service import (
    attempts,
    audit,
    merging,
    news,
    people,
    personal_data,
    quotas,
    reported,
    reviews,
    tokens,
)
from reverie_eval.server.service.bulk import archive_of

router = APIRouter(
    prefix=f"{API}/organiser",
    tags=["organiser"],
    responses=problems("not-signed-in", "not-allowed"),
)

Team = Annotated[str | None, Query(max_length=LONGEST_NAME, examples=["Blue"])]
TeamName = Annotated[str, Path(max_length=LONGEST_NAME, examples=["Blue"])]


@router.post(
    "/submissions",
    status_code=201,
    responses={
        200: {
            "model": schemas.EmailedFileReport,
            "description": "The reply to the same file, again",
        },
        **problems(*OF_UPLOADS),
    },
    openapi_extra={
        **FILE_BODY,
        "parameters": [*parameters_of(schemas.EmailedFile, "Required."), *METHOD_PARAMETERS],
    },
)
def submit_emailed_file(
    request: Request, organiser: Organiser, upload: ReceivedByOrganiser, response: Response
) -> schemas.EmailedFileReport:
    """Submit a file for the person who sent it, as if they had uploaded it when it was received.

    The reply has a text for that person; so does a problem document about a refused file.
    Describe the file and the method in the query, or in fields of the form.
    """
    given = fields_of(request, upload)
    own = {name: given.pop(name) for name in schemas.EmailedFile.model_fields if name in given}
    file, method = read_model(schemas.EmailedFile, own), method_from(given)
    report = organiser.server.emailed_files.submit(
        organiser.person(), file, upload.filename, upload.packed, method
    )
    exchange_of(request.scope).note(report)
    response.status_code = 200 if report.is_repeat else 201
    return report


@router.get("/teams")
def list_teams(organiser: Organiser, paging: Paging) -> list[schemas.TeamReport]:
    """List the teams by name, with their people."""
    return paging.read(organiser, people.list_teams)


@router.post("/teams", status_code=201, responses=problems("conflict"))
def add_team(new: schemas.NewTeam, organiser: Organiser) -> schemas.TeamReport:
    """Add a team."""
    return organiser.perform(people.add_team, new)


@router.post("/teams/merge", responses=problems("not-found", "conflict"))
def merge_teams(new: schemas.NewMerge, organiser: Organiser) -> schemas.MergeReport:
    """Merge two teams, as if they had always been one."""
    return organiser.perform(merging.merge_teams, new)


@router.patch("/teams/{name:path}", responses=problems("not-found", "conflict"))
def rename_team(name: TeamName, new: schemas.NewTeam, organiser: Organiser) -> schemas.TeamReport:
    """Rename a team; its receipts keep the name under which they were signed."""
    return organiser.perform(people.rename_team, name, new)


@router.get("/people")
def list_people(organiser: Organiser, paging: Paging) -> list[schemas.PersonReport]:
    """List all people in the order in which they were added."""
    return paging.read(organiser, people.list_people)


@router.post("/people", status_code=201, responses=problems("not-found", "conflict"))
def add_person(new: schemas.NewPerson, organiser: Organiser) -> schemas.PersonReport:
    """Add a person to a team."""
    return organiser.perform(people.add_person, new)


@router.get("/people/{person_id}", responses=problems("not-found"))
def show_personal_data(person_id: Number, organiser: Organiser) -> PersonalData:
    """Return all that the server stores about a person."""
    with organiser.snapshot() as snapshot:
        return personal_data.personal_data(
            snapshot.session, person_id, organiser.server.settings.organiser
        )


@router.delete("/people/{person_id}", responses=problems("not-found", "conflict"))
def delete_person(person_id: Number, organiser: Organiser) -> schemas.PersonReport:
    """Remove a person's name and address, and revoke their tokens; results and the log stay."""
    return organiser.perform(personal_data.delete_person, person_id)


@router.patch("/people/{person_id}", responses=problems("not-found", "conflict"))
def change_person(
    person_id: Number, change: schemas.PersonChange, organiser: Organiser
) -> schemas.PersonReport:
    """Rename a person, change their e-mail address, or move them to another team."""
    return organiser.perform(people.change_person, person_id, change)


@router.get("/tokens")
def list_tokens(organiser: Organiser, paging: Paging) -> list[schemas.TokenReport]:
    """List tokens and invitations without their text, the latest first."""
    return paging.read(organiser, tokens.list_tokens)


@router.post("/tokens", status_code=201, responses=problems("not-found", "conflict"))
def create_token(new: schemas.NewToken, organiser: Organiser) -> schemas.NewTokenReport:
    """Create an invitation or a token for a person; its text is returned only once."""
    return organiser.perform(tokens.create_token, new)


@router.delete("/tokens/{hint}", responses=problems("not-found", "conflict"))
def revoke_token(hint: TokenHint, organiser: Organiser) -> schemas.TokenReport:
    """Revoke a token, with the browser sessions that began with it."""
    return organiser.perform(tokens.revoke_token, hint)


@router.get("/grants")
def list_grants(organiser: Organiser, paging: Paging) -> list[schemas.GrantReport]:
    """List the extra submissions granted to teams, the latest first."""
    return paging.read(organiser, quotas.list_grants)


@router.post("/grants", status_code=201, responses=problems("not-found"))
def grant(new: schemas.NewGrant, organiser: Organiser) -> schemas.GrantReport:
    """Raise every limit of a team on a split until a date; the reason is logged."""
    return organiser.perform(quotas.grant, new, organiser.server.boards)


@router.get("/reviews")
def list_reviews(organiser: Organiser, paging: Paging) -> list[schemas.ReviewEntry]:
    """List all reviews, lifted or not, the latest first."""
    return paging.read(organiser, reviews.list_reviews)


@router.post("/reviews", status_code=201, responses=problems("not-found"))
def review_submission(new: schemas.NewReview, organiser: Organiser) -> schemas.ReviewEntry:
    """Verify, flag or disqualify a submission, or mark it as a baseline; the reason is public."""
    return organiser.perform(reviews.review, new)


@router.delete("/reviews/{review_id}", responses=problems("not-found", "conflict"))
def lift_review(review_id: Number, organiser: Organiser) -> schemas.ReviewEntry:
    """Lift a review; it stays in this list."""
    return organiser.perform(reviews.lift_review, review_id)


@router.get("/reported")
def list_reported(organiser: Organiser, paging: Paging) -> list[schemas.ReportedEntry]:
    """List the reported results on leaderboards, the latest first."""
    return paging.read(organiser, reported.list_reported)


@router.post("/reported", status_code=201, responses=problems("not-found", "conflict"))
def add_reported_result(new: schemas.NewReported, organiser: Organiser) -> schemas.ReportedEntry:
    """Add a result that a paper or another leaderboard reports."""
    return organiser.perform(reported.add_reported, new, organiser.server.settings.tasks)


@router.post("/reported/import", responses=problems("malformed-request", "not-found"))
def import_reported_results(new: schemas.NewImport, organiser: Organiser) -> schemas.ImportReport:
    """Add the results in a file, or none if there is a problem; repeating it changes nothing."""
    return organiser.perform(reported.import_reported, new, organiser.server.settings.tasks)


@router.patch("/reported/{result_id}", responses=problems("not-found", "conflict"))
def change_reported_result(
    result_id: Number, change: schemas.ReportedChange, organiser: Organiser
) -> schemas.ReportedEntry:
    """Change a reported result; the audit log keeps the earlier values."""
    tasks = organiser.server.settings.tasks
    return organiser.perform(reported.change_reported, result_id, change, tasks)


@router.delete("/reported/{result_id}", responses=problems("not-found"))
def remove_reported_result(result_id: Number, organiser: Organiser) -> schemas.ReportedEntry:
    """Remove a reported result from the leaderboard."""
    return organiser.perform(reported.remove_reported, result_id)


@router.post("/corrections", responses=problems("not-found", "conflict"))
def rescore(
    new: schemas.NewCorrection, organiser: Organiser, _: ScoringTurn
) -> schemas.RescoringReport:
    """Score some submissions again after a correction of the ground truth or the rules.

    Each request scores the next few; `left` says how many remain. `server rescore` scores all.
    """
    return organiser.server.rescoring.rescore(organiser.person(), new)


@router.get("/notice")
def show_notice(organiser: Organiser) -> schemas.NoticeReport:
    """Show the current banner, and whether submissions are paused."""
    with organiser.snapshot() as snapshot:
        return organiser.server.notices.current(snapshot.session)


@router.put("/notice")
def change_notice(new: schemas.NewNotice, organiser: Organiser) -> schemas.NoticeReport:
    """Set the banner, and pause or resume submissions; takes effect immediately."""
    return organiser.perform(organiser.server.notices.post, new)


@router.get("/schedules")
def list_schedules(organiser: Organiser) -> list[schemas.ScheduleReport]:
    """Compare when splits accept submissions: in the settings, at the desk, and in effect."""
    with organiser.snapshot() as snapshot:
        return organiser.server.schedules.list_all(snapshot.session)


@router.put("/schedules/{split}", responses=problems("not-found", "conflict"))
def set_schedule(
    split: SplitName, new: schemas.NewSchedule, organiser: Organiser
) -> schemas.ScheduleReport:
    """Set a split's phases, when its scores are released, and whether it is paused.

    Fields that are left out are taken from the settings file. Takes effect immediately.
    """
    return organiser.perform(organiser.server.schedules.set, split, new)


@router.post("/snapshots", status_code=201, responses=problems("not-found"))
def take_snapshot(new: schemas.NewSnapshot, organiser: Organiser) -> SnapshotEntry:
    """Take a signed snapshot of a leaderboard, which never changes, nor do names in it."""
    return organiser.perform(organiser.server.snapshots.take, new)


@router.post("/news", status_code=201)
def add_news(new: schemas.NewNews, organiser: Organiser) -> NewsReport:
    """Post a news entry; `GET /api/v1/news` lists them to everyone."""
    return organiser.perform(news.add_news, new)


@router.delete("/news/{news_id}", responses=problems("not-found"))
def remove_news(news_id: Number, organiser: Organiser) -> NewsReport:
    """Remove a news entry."""
    return organiser.perform(news.remove_news, news_id)


@router.get("/attempts")
def list_attempts(organiser: Organiser, paging: Paging) -> list[schemas.AttemptReport]:
    """List uploads with their outcomes, the latest first."""
    return paging.read(organiser, attempts.list_attempts)


@router.get("/audit")
def list_audit(organiser: Organiser, paging: Paging) -> list[schemas.AuditReport]:
    """List the audit log, the oldest entry first; `server doctor` checks its chain."""
    return paging.read(organiser, audit.list_reports)


@router.get("/splits/{split}/evidence", responses=problems("not-found"))
def show_evidence(
    split: SplitName, organiser: Organiser, _: ScoringTurn, team: Team = None
) -> EvidenceReport:
    """Show what the files of a split have in common, and how those of each team differ.

    With a team, also list its submissions. Each request reads a hundred more submissions;
    `left` says how many remain. `server evidence` reads all.
    """
    evidence = organiser.server.evidence
    with organiser.snapshot() as snapshot:
        report, read = evidence.report(snapshot.session, split, team)
    evidence.keep(split, read)
    return report


@router.get(
    "/splits/{split}/submissions.tar",
    response_class=Response,
    responses=file_reply("application/x-tar", "not-found", schema=BINARY),
)
def download_submissions(split: SplitName, organiser: Organiser) -> Response:
    """Return all submissions to a split as a tar archive: metadata.csv, then every file, unpacked.

    Content-Length is the length of the whole archive: if an upload cannot be read, the connection
    is closed before that.
    """
    server = organiser.server
    with organiser.snapshot() as snapshot:
        board = server.board(split)
        archive = archive_of(snapshot.session, board, server.uploads, snapshot.view)
    headers = {
        "Content-Length": str(archive.length),
        "Content-Disposition": 'attachment; filename="submissions.tar"',
    }
    return StreamingResponse(archive.pieces(), media_type="application/x-tar", headers=headers)
