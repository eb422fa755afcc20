"""``/desk/emailed-files``: files that people sent by e-mail, submitted for them."""

from collections.abc import AsyncIterator, Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from reverie_eval.schemas.organising import EmailedFile, EmailedFileReport
from reverie_eval.schemas.service import Method, ProblemDocument
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.http.callers import Call, Desk, Server
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.http.uploads import Began, Upload, method_from, taken
from reverie_eval.server.pages.desk import forms
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.pages.submitting import NOTHING, check_form
from reverie_eval.server.service import people

router = APIRouter()

PAGE = "/desk/emailed-files"


def draw(
    desk: Call,
    typed: Mapping[str, str],
    problem: ProblemDocument | None = None,
    report: EmailedFileReport | None = None,
    filename: str = "",
) -> Response:
    """Show the form, and the reply to the last file."""
    with desk.snapshot() as snapshot:
        everybody = people.everybody(snapshot.session)
        return page(
            snapshot,
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


async def posted_file(
    request: Request, desk: Desk, server: Server, runtime: Runtime, began: Began
) -> AsyncIterator[Upload]:
    """Read the form when a slot is free; after a problem, the input is kept."""
    organiser = await run_in_threadpool(desk.person)
    async with taken(request, server, runtime, began, organiser) as upload:
        check_form(desk, upload, draw)
        async with runtime.admission.score():
            yield upload


PostedFile = Annotated[Upload, Depends(posted_file, scope="function")]


@router.get(PAGE)
def show_form(desk: Desk) -> Response:
    """Show the form."""
    return draw(desk, {})


@router.post(PAGE)
def submit_emailed_file(desk: Desk, upload: PostedFile) -> Response:
    """Submit a file for the person who sent it, and show the reply to them."""
    typed = upload.fields
    if not typed.get("person"):
        raise MalformedError("choose the person who sent the file")
    with desk.snapshot() as snapshot:
        sender = people.find_person(snapshot.session, forms.number(typed["person"]))
    given: dict[str, Any] = {name: typed.get(name, "") for name in ("split", "received_at")}
    given |= {"team": sender.team.name, "person": sender.name, "publish": "publish" in typed}
    method = method_from({name: typed[name] for name in Method.model_fields if name in typed})
    report = desk.server.emailed_files.submit(
        desk.person(), read_model(EmailedFile, given), upload.filename, upload.packed, method
    )
    return draw(desk, typed, report=report, filename=upload.filename)
