"""The ways a request to a server can fail.

ServiceError
    UnreachableError      no server replies, or the connection was dropped on every attempt
    NotAServerError       not an evaluation server, or one of an incompatible version
    RefusedError          the server refused the request and says why
        QuotaSpentError   no submissions are left; says when the quota resets

A submission that the server rejects is a SubmissionError, as it is without a server.
"""

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.text import earliest_time_text, printable


class ServiceError(ReverieEvalError):
    """The request to a server failed."""


class UnreachableError(ServiceError):
    """No server replies, or the connection was dropped on every attempt."""


class NotAServerError(ServiceError):
    """Not an evaluation server, or one of an incompatible version."""


class RefusedError(ServiceError):
    """The server refused the request; ``document`` is its reply."""

    def __init__(self, document: ProblemDocument, detail: str | None = None) -> None:
        self.document = document
        places = [f"{problem.where}: {problem.message}" for problem in document.problems]
        request = [f"request {document.request_id}"] if document.request_id else []
        super().__init__(printable("; ".join([detail or document.detail, *places, *request])))


class QuotaSpentError(RefusedError):
    """No submissions are left."""

    def __init__(self, document: ProblemDocument) -> None:
        instant = document.quota.next_at if document.quota else None
        when = f"next possible at {earliest_time_text(instant)}" if instant else "ask the organiser"
        super().__init__(document, f"no submissions left; {when}. Nothing was scored")
