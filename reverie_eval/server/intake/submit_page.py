"""``/submit``: checking files, and scoring them.

This is one multipart form. With scripts, a chosen file is checked at once: the same form is sent in
the background, and the outcome is inserted into the page.

The CSRF token is a form field, not part of the address, because addresses are stored in browser
histories and proxy logs. So the body is read before the token is checked. Only people who are
signed in can cause that: requests from other sites have no session, which is known before the body
is read.
"""

from collections.abc import AsyncIterator, Callable, Mapping
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from reverie_eval.schemas.service import Method, ProblemDocument
from reverie_eval.server.errors import MalformedError, RejectedFileError
from reverie_eval.server.http.callers import Call, Member, Server
from reverie_eval.server.http.exchange import exchange_of
from reverie_eval.server.http.rendering import page, see_other, show_faults_with
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.identity import Sessions
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.intake.team_page import split_quotas
from reverie_eval.server.intake.uploads import Began, ReceivedFile, method_from, taken

router = APIRouter()
OK = 200

NOTHING = dict.fromkeys(("split", *Method.model_fields), "")
"""The input of an empty form."""


def draw(member: Call, typed: Mapping[str, str], status: int = OK, **outcome: Any) -> Response:
    """Show the form with its input and the outcome."""
    server = member.server
    with member.reading() as reading:
        return page(
            reading,
            "submit.html",
            status=status,
            typed={**NOTHING, **typed},
            splits=split_quotas(server, reading),
            required=server.settings.required_metadata,
            limit=server.settings.limits.upload_mebibytes,
            **{"report": None, "other_split": "", **outcome},
        )


def draw_fault(member: Call, typed: Mapping[str, str], problem: ProblemDocument) -> Response:
    """Show the form with a problem; problems found by a check have status 200."""
    is_answer = typed.get("what") == "check" and problem.code == RejectedFileError.code
    status = OK if is_answer else problem.status
    splits = [each.split for each in problem.problems if each.split in member.server.boards]
    return draw(member, typed, status, problem=problem, other_split=next(iter(splits), ""))


def check_form(
    call: Call,
    file: ReceivedFile,
    draw_fault: Callable[[Call, Mapping[str, str], ProblemDocument], Response],
) -> None:
    """Check that one of this server's pages sent a form, with a file; it shows further problems.

    Raises
    ------
    ForgedError
        If it has no valid CSRF token.
    MalformedError
        If no file was chosen.
    """
    # First, so that a form of an earlier session keeps what was typed: no other site can send a
    # request of this session.
    show_faults_with(call.request, partial(draw_fault, call, file.fields))
    call.server.get(Sessions).check_csrf_token(
        call.session_id or "", file.fields.get("csrf_token", "")
    )
    if not file.filename:
        raise MalformedError("choose a file first")


async def posted_file(
    request: Request, member: Member, server: Server, runtime: Runtime, began: Began
) -> AsyncIterator[ReceivedFile]:
    """Read the form when a place is free; after a problem, the input is kept."""
    exchange = exchange_of(request.scope)
    exchange.uploaded_to = ""
    person = await run_in_threadpool(member.person)
    async with taken(request, server, runtime, began, person) as file:
        is_to_be_scored = file.fields.get("what") == "score"
        exchange.uploaded_to = file.fields.get("split", "") if is_to_be_scored else None
        check_form(member, file, draw_fault)
        async with runtime.scoring.hold(person.team_id):
            yield file


PostedFile = Annotated[ReceivedFile, Depends(posted_file, scope="function")]


@router.get("/submit")
def show_submit(
    member: Member,
    split: Annotated[str, Query(max_length=64)] = "",
    human: Literal["", "true"] = "",
) -> Response:
    """Show the form; the query can select the split, and say that people walked."""
    return draw(member, {"split": split, "human": human})


@router.post("/submit")
def submit(member: Member, file: PostedFile) -> Response:
    """Check a file, or score it and redirect to its page."""
    server, person, typed = member.server, member.person(), file.fields
    board = server.board(typed.get("split", ""))
    if typed.get("what") != "score":
        report = server.get(Intake).validate(person, board.split, file.packed)
        return draw(member, typed, report=report)
    method = method_from({name: typed[name] for name in Method.model_fields if name in typed})
    accepted = server.get(Intake).submit(
        person, board.split, file.packed, method, key=None, arrived=file.arrived
    )
    exchange_of(member.request.scope).note(accepted)
    place = f"/submissions/{accepted.submission.id}"
    if not accepted.is_repeat:
        return see_other(f"{place}?done=scored")
    ignored = "".join(f"&ignored={name}" for name in accepted.ignored)
    return see_other(f"{place}?done=again{ignored}")
