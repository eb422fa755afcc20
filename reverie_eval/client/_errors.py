"""What keeps a participant from a reply.

ServiceError
    UnreachableError      nothing answers there, or the connection was dropped again and again
    NotAServerError       what answers is no evaluation server that this version can talk to
    RefusedError          the server said no, and why
        QuotaSpentError   no submission is left; says when one is

A submission that the server rejects is a SubmissionError, as at home.
"""

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.text import earliest_time_text, printable


class ServiceError(ReverieEvalError):
    """There is no reply to go on with."""


class UnreachableError(ServiceError):
    """Nothing answers there, or the connection was dropped again and again."""


class NotAServerError(ServiceError):
    """What answers is no evaluation server that this version can talk to."""


class RefusedError(ServiceError):
    """The server said no; ``document`` is what it said."""

    def __init__(self, document: ProblemDocument, said: str | None = None) -> None:
        self.document = document
        places = [f"{problem.where}: {problem.message}" for problem in document.problems]
        request = [f"request {document.request_id}"] if document.request_id else []
        super().__init__(printable("; ".join([said or document.detail, *places, *request])))


class QuotaSpentError(RefusedError):
    """No submission is left."""

    def __init__(self, document: ProblemDocument) -> None:
        instant = document.quota.next_at if document.quota else None
        when = (
            f"the next is possible at {earliest_time_text(instant)}"
            if instant
            else "ask the organiser"
        )
        super().__init__(document, f"no submission is left; {when}. Nothing was scored or spent")
