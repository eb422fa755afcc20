"""What organisers do about uploads, over the API and at their desk.

``/desk/emailed-files``: files that people sent by e-mail, submitted for them. ``/desk/quotas``:
extra submissions for a team. ``/desk/attempts``: every upload with its outcome. Over the API alone:
all submissions to a split.
"""

from collections.abc import AsyncIterator, Mapping
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse

from reverie_eval.schemas import organising as schemas
from reverie_eval.schemas.service import Method, ProblemDocument
from reverie_eval.server.accounts import people
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.http import desk as forms
from reverie_eval.server.http.api import BINARY, Paging, file_reply, organiser_router, problems
from reverie_eval.server.http.callers import (
    Call,
    CallReading,
    Desk,
    Organiser,
    Posted,
    SplitName,
    exchange_of,
)
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.rendering import page
from reverie_eval.server.intake import attempts, quotas, uploads
from reverie_eval.server.intake.bulk import archive_of
from reverie_eval.server.intake.intake import submit_for_sender
from reverie_eval.server.intake.pages import NOTHING, check_form

routes, pages = organiser_router(), APIRouter()

EMAILED_FILES, QUOTAS, ATTEMPTS = "/desk/emailed-files", "/desk/quotas", "/desk/attempts"


def draw_files(
    desk: Call,
    typed: Mapping[str, str],
    problem: ProblemDocument | None = None,
    report: schemas.EmailedFileReport | None = None,
    filename: str = "",
) -> Response:
    """Show the form, and the reply to the last file."""
    with desk.reading() as reading:
        everybody = people.everybody(reading.session)
        return page(
            reading,
            "desk/emailed-files.html",
            problem,
            typed={**NOTHING, "person": "", "received_at": "", "publish": "", **typed},
            person_names={str(each.id): f"{each.name}, {each.team}" for each in everybody},
            splits=list(desk.server.boards),
            required=desk.server.settings.required_metadata,
            limit=desk.server.settings.limits.upload_mebibytes,
            report=report,
            filename=filename,
        )


async def posted_file(upload: uploads.Arriving, desk: Desk) -> AsyncIterator[uploads.ReceivedFile]:
    """Read the form when a place is free; after a problem, the input is kept."""
    check = partial(check_form, desk, draw_problem=draw_files)
    async with upload.take(await run_in_threadpool(desk.person), check) as file:
        yield file


PostedFile = Annotated[uploads.ReceivedFile, Depends(posted_file, scope="function")]


@pages.get(EMAILED_FILES)
def show_form(desk: Desk) -> Response:
    """Show the form."""
    return draw_files(desk, {})


@routes.post(
    "/submissions",
    status_code=201,
    responses={
        200: {
            "model": schemas.EmailedFileReport,
            "description": "The reply to the same file, again",
        },
        **problems(*uploads.OF_UPLOADS),
    },
    openapi_extra={
        **uploads.FILE_BODY,
        "parameters": [
            *uploads.parameters_of(schemas.EmailedFile, "Required."),
            *uploads.METHOD_PARAMETERS,
        ],
    },
)
def submit_emailed_file(
    request: Request, organiser: Organiser, file: uploads.ReceivedByOrganiser, response: Response
) -> schemas.EmailedFileReport:
    """Submit a file for the person who sent it, as if they had uploaded it when it was received.

    The reply has a text for that person; so does a problem document about a refused file.
    Describe the file and the method in the query, or in fields of the form.
    """
    given = uploads.fields_of(request, file)
    own = {name: given.pop(name) for name in schemas.EmailedFile.model_fields if name in given}
    emailed, method = read_model(schemas.EmailedFile, own), uploads.method_from(given)
    report = submit_for_sender(
        organiser.server,
        organiser.person(),
        emailed,
        file.packed,
        method,
        filename=file.filename,
    )
    exchange_of(request.scope).note(report)
    response.status_code = 200 if report.is_repeat else 201
    return report


@pages.post(EMAILED_FILES)
def submit_emailed_file_at_desk(desk: Desk, file: PostedFile) -> Response:
    """Submit a file for the person who sent it, and show the reply to them."""
    typed = file.fields
    if not typed.get("person"):
        raise MalformedError("choose the person who sent the file")
    with desk.reading() as reading:
        sender = people.find_person(reading.session, forms.number(typed["person"]))
    given: dict[str, Any] = {name: typed.get(name, "") for name in ("split", "received_at")}
    given |= {"team": sender.team.name, "person": sender.name, "publish": "publish" in typed}
    method = uploads.method_from(
        {name: typed[name] for name in Method.model_fields if name in typed}
    )
    emailed = read_model(schemas.EmailedFile, given)
    report = submit_for_sender(
        desk.server, desk.person(), emailed, file.packed, method, filename=file.filename
    )
    exchange_of(desk.request.scope).note(report)
    return draw_files(desk, typed, report=report, filename=file.filename)


@forms.shown_at(pages, QUOTAS, "quotas.html")
def draw_quotas(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
    """Show the quotas of splits, all grants, and the form to grant more."""
    return {
        "given": quotas.list_grants(reading.session, forms.page_at(desk, "given")),
        "team_names": people.names_of_teams(reading.session),
        "boards": desk.server.boards.values(),
    }


@routes.get("/grants")
def list_grants(organiser: Organiser, paging: Paging) -> list[schemas.GrantReport]:
    """List the extra submissions granted to teams, the latest first."""
    return paging.read(organiser, quotas.list_grants)


@routes.post("/grants", status_code=201, responses=problems("not-found"))
def grant(new: schemas.NewGrant, organiser: Organiser) -> schemas.GrantReport:
    """Raise every limit of a team on a split until a date; the reason is logged."""
    return organiser.perform(quotas.grant, new, organiser.server.boards)


@pages.post(QUOTAS)
def grant_at_desk(desk: Desk, form: Posted) -> Response:
    """Raise every limit of a team on a split until a date."""
    typed = forms.typed_by(desk, form, draw_quotas)
    asked = {name: typed.get(name, "") for name in ("team", "split", "extra", "reason")}
    new = read_model(schemas.NewGrant, {**asked, **forms.end_of_day(typed, "expires_at")})
    desk.perform(quotas.grant, new, desk.server.boards)
    return forms.done(QUOTAS, "given")


@routes.get("/attempts")
def list_attempts(organiser: Organiser, paging: Paging) -> list[schemas.AttemptReport]:
    """List uploads with their outcomes, the latest first."""
    return paging.read(organiser, attempts.list_attempts)


@forms.shown_at(pages, ATTEMPTS, "attempts.html")
def draw_attempts(desk: Call, reading: CallReading, _: forms.Typed) -> forms.Shown:
    """List uploads, the latest first."""
    shown = forms.page_at(desk, "attempts")
    return {"attempts": attempts.list_attempts(reading.session, shown), "days": attempts.DAYS_KEPT}


@routes.get(
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
    with organiser.reading() as reading:
        board = server.board(split)
        archive = archive_of(reading.session, board, server.uploads, View.of(reading))
    headers = {
        "Content-Length": str(archive.length),
        "Content-Disposition": 'attachment; filename="submissions.tar"',
    }
    return StreamingResponse(archive.pieces(), media_type="application/x-tar", headers=headers)
