"""Submitting files for people who sent them to the organiser, by e-mail for example.

For each file there is a reply to its sender, as text, even if it is refused.
"""

from collections.abc import Iterator

from reverie_eval.errors import ReverieEvalError, SubmissionError
from reverie_eval.reporting.service import quota_lines, result_tables, submission_lines
from reverie_eval.schemas.organising import EmailedFile, EmailedFileReport
from reverie_eval.schemas.service import Accepted, Method, SubmissionChange
from reverie_eval.server.accounts.people import person_named
from reverie_eval.server.audit.transactions import Actor
from reverie_eval.server.errors import MalformedError, request_error
from reverie_eval.server.intake.attempts import FAILURES
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.intake.submissions import SubmissionService
from reverie_eval.server.state import ServerState
from reverie_eval.text import printable, time_text


def submit_for_sender(
    server: ServerState,
    organiser: Actor,
    file: EmailedFile,
    packed: bytes,
    method: Method,
    *,
    filename: str,
) -> EmailedFileReport:
    """Score a file as if its sender had uploaded it when it was received.

    This is possible during a pause. A file that was submitted before gets its earlier result.
    The reply names the file, if it has a name, and says how many submissions are left today.

    Raises
    ------
    NotFoundError
        If the team has no such person, or the server no such split.
    MalformedError
        If the time is in the future.
    RequestError
        If the file is refused, as an upload would be; the error has the reply to the sender.
    """
    server.board(file.split)  # or there is no such split
    with server.database.reading() as session:
        sender = person_named(session, file.person, file.team)
    if file.received_at > server.clock():
        raise MalformedError(
            f"the file was received at {time_text(file.received_at)}, which is in the future; "
            "give the time at which the e-mail arrived"
        )
    named = f"file {printable(filename)}" if filename else "file"
    about = f"Your {named}, received {time_text(file.received_at)}, was"
    try:
        accepted = server.get(Intake).submit(
            sender,
            file.split,
            packed,
            method,
            key=None,
            arrived=file.received_at,
            organiser=organiser,
        )
    except ReverieEvalError as error:
        refusal = request_error(error)
        if not isinstance(refusal, FAILURES):
            raise
        opening = f"{about} not scored, and no submission was used."
        refusal.reply = _letter(file, opening, _reason(error))
        raise refusal from error
    if accepted.is_repeat and accepted.submission.received_at != file.received_at:
        ignored = [*accepted.ignored, "received_at"]
        accepted = accepted.model_copy(update={"ignored": ignored})
    # A withdrawn submission stays withdrawn until its team restores it.
    if file.publish and accepted.submission.status == "unpublished":
        change = SubmissionChange(published=True)
        published = server.get(SubmissionService).change(
            sender, accepted.submission.id, change, organiser
        )
        accepted = accepted.model_copy(update={"submission": published})
    reply = _letter(
        file, f"{about} scored on {file.split}.", *_result(accepted, server.settings.title)
    )
    return EmailedFileReport(**dict(accepted), reply=reply)


def _letter(file: EmailedFile, opening: str, *lines: str) -> str:
    return "\n".join([f"Dear {file.team},", "", opening, "", *lines])


def _reason(error: ReverieEvalError) -> str:
    if isinstance(error, SubmissionError):
        return f"{error}\n\n`reverie-eval validate` finds the same problems before you send a file."
    return str(error)


def _result(accepted: Accepted, server: str) -> Iterator[str]:
    submission = accepted.submission
    for name, table in result_tables(submission, server).items():
        yield from [f"On the leaderboard {name}:"] if name else []
        yield table.to_text()
        yield ""
    to_publish = "answer this message if you want it on the leaderboard"
    to_change = "answer this message if it should be changed"
    yield from submission_lines(accepted, to_publish=to_publish, to_change=to_change)
    yield from quota_lines(accepted.quota, submission.split)
    yield ""
    yield f"The signed {'receipts are' if submission.boards else 'receipt is'} attached."
