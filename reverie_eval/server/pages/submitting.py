"""``/submit``: a file is checked for nothing, and scored if its team wants to spend a try.

The form is one plain multipart form; a script sends the same form piece by piece and puts what the
page would have said in place.

Its CSRF token is a field like that of every form, and no part of its address, which ends up in
histories and logs of proxies. So the body is read before the token is compared. That costs no more
than an upload of whoever is signed in: a request of another site's page has no session here, which
is known before its body is read.
"""

from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import RedirectResponse, Response

from reverie_eval.schemas.service import Method, ProblemDocument
from reverie_eval.server.errors import MalformedError, RejectedFileError
from reverie_eval.server.http.callers import Server
from reverie_eval.server.http.dependencies import content_of, method_from
from reverie_eval.server.http.exchange import exchange_of
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.http.uploading import Upload, receive
from reverie_eval.server.pages.faults import show_faults_with
from reverie_eval.server.pages.quotas import split_quotas
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.pages.visitors import Member
from reverie_eval.server.service.boards import Board
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import BrowserSession

router = APIRouter()
OK = 200
SEE_OTHER = 303

_NOTHING = dict.fromkeys(("split", *Method.model_fields), "")


@dataclass(frozen=True)
class UploadForm:
    """The page with the form, for somebody who is signed in."""

    request: Request
    server: ServerState
    member: BrowserSession

    def draw(self, typed: Mapping[str, str], status: int = OK, **outcome: Any) -> Response:
        """Show the form with what was typed into it, and what came of it."""
        found = {"problem": None, "report": None, **outcome}
        return page(
            self.request,
            "submit.html",
            self.member,
            status,
            typed={**_NOTHING, **typed},
            splits=split_quotas(self.server, self.member.token.person),
            required=self.server.settings.required_metadata,
            said=Method.model_fields,
            is_paused=self.server.notices.now().paused,
            limit=self.server.settings.limits.upload_mebibytes,
            **found,
        )

    def draw_fault(self, typed: Mapping[str, str], problem: ProblemDocument) -> Response:
        """Show the form with what is wrong; what is found by a check is what was asked for."""
        is_answer = typed.get("what") == "check" and problem.code == RejectedFileError.code
        return self.draw(typed, OK if is_answer else problem.status, problem=problem)


async def posted_upload(
    request: Request, found: Member, server: Server, runtime: Runtime
) -> AsyncIterator[Upload]:
    """Take the form off the wire once there is room for it; faults keep what was typed.

    Raises
    ------
    MalformedError
        If no file was chosen; nothing else is said of it then.
    """
    exchange = exchange_of(request.scope)
    exchange.uploaded_to = ""
    async with runtime.admission.hold(found.token.person_id):
        upload = await receive(request, server.settings.limits)
        is_to_be_scored = upload.fields.get("what") == "score"
        exchange.uploaded_to = upload.fields.get("split", "") if is_to_be_scored else None
        server.sessions.demand_csrf_token(found, upload.fields.get("csrf_token", ""))
        form = UploadForm(request, server, found)

        show_faults_with(request, lambda problem: form.draw_fault(upload.fields, problem))
        if not upload.filename:
            raise MalformedError("choose a file first")
        async with runtime.admission.score():
            yield upload


PostedUpload = Annotated[Upload, Depends(posted_upload, scope="function")]


@router.get("/submit")
def show_submit(
    request: Request,
    server: Server,
    member: Member,
    split: Annotated[str, Query(max_length=64)] = "",
) -> Response:
    """Show the form; a link may choose the split."""
    return UploadForm(request, server, member).draw({"split": split})


@router.post("/submit")
def submit(request: Request, server: Server, member: Member, upload: PostedUpload) -> Response:
    """Check a file, or score it and lead to its page; the same file leads to the same page."""
    typed = upload.fields
    board = server.board(typed.get("split", ""))
    if typed.get("what") != "score":
        return _checked(UploadForm(request, server, member), board, upload)
    said = {name: typed[name] for name in Method.model_fields if name in typed}
    accepted = server.intake.submit(
        member.token.person, board.name, upload.packed, method_from(said), key=None
    )
    exchange_of(request.scope).is_repeat = accepted.is_repeat
    came = "again" if accepted.is_repeat else "scored"
    return RedirectResponse(f"/submissions/{accepted.submission.id}?done={came}", SEE_OTHER)


def _checked(form: UploadForm, board: Board, upload: Upload) -> Response:
    content = content_of(upload, form.server)
    report = form.server.intake.validate(form.member.token.person, board.name, content)
    return form.draw(upload.fields, report=report)
