"""The errors that a request can end in.

Each class has the status, the code and the heading of its page; its docstring says what happened.
Problem documents, pages, the OpenAPI description and the metrics all take them from here.
"""

from collections.abc import Iterable, Mapping, Sequence
from datetime import timedelta
from http import HTTPStatus
from types import MappingProxyType
from typing import ClassVar, Self

from reverie_eval.errors import Problem, RejectedError, ReverieEvalError, SubmissionError
from reverie_eval.schemas.report import ProblemReport
from reverie_eval.schemas.service import ProblemDocument, QuotaReport
from reverie_eval.text import count_text, did_you_mean

_PHRASES: Mapping[HTTPStatus, str] = MappingProxyType(
    {
        HTTPStatus.REQUEST_ENTITY_TOO_LARGE: "Content Too Large",
        HTTPStatus.UNPROCESSABLE_ENTITY: "Unprocessable Content",
    }
)
"""Reasons as RFC 9110 has them; Python has older ones before version 3.13."""
WRONG_FORM = "the request is invalid; see the list of problems"


def phrase_of(status: HTTPStatus) -> str:
    """Return the reason for a status, the same with every version of Python."""
    return _PHRASES.get(status, status.phrase)


class RequestError(ReverieEvalError):
    """A request was refused or failed."""

    status: ClassVar[HTTPStatus]
    code: ClassVar[str]
    """Stable, for programs."""
    heading: ClassVar[str]
    """The heading of the error's page."""

    problems: Sequence[Problem | ProblemReport] = ()
    seconds: int | None = None
    """When to try again."""
    quota: QuotaReport | None = None
    """The submissions left, if the quota is why the request was refused."""
    reply: str | None = None
    """The reply to the sender, if an organiser submitted the file."""
    request_id: str | None = None

    def document(self) -> ProblemDocument:
        """Return the problem document of the reply."""
        return ProblemDocument(
            title=phrase_of(self.status),
            status=self.status,
            detail=str(self),
            code=self.code,
            problems=[ProblemReport.model_validate(problem) for problem in self.problems],
            quota=self.quota,
            reply=self.reply,
            request_id=self.request_id,
        )


class RejectedFileError(RequestError):
    """The submission has problems."""

    status = HTTPStatus.UNPROCESSABLE_ENTITY
    code = "submission-rejected"
    heading = "File rejected"

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = problems
        count = len(problems)
        super().__init__(
            f"{count} problem{'s' * (count != 1)}; nothing was scored and no submission was used"
        )


class NotSignedInError(RequestError):
    """There is no token or session, or it is no longer valid."""

    status = HTTPStatus.UNAUTHORIZED
    code = "not-signed-in"
    heading = "Sign in first"


class NotAllowedError(RequestError):
    """The caller may not do this."""

    status = HTTPStatus.FORBIDDEN
    code = "not-allowed"
    heading = "Not allowed"


class ForgedError(RequestError):
    """A form came without the session's CSRF token; another site may have sent it."""

    status = HTTPStatus.FORBIDDEN
    code = "csrf"
    heading = "Form expired"


class NotFoundError(RequestError):
    """What was asked for does not exist, or the caller may not see it."""

    status = HTTPStatus.NOT_FOUND
    code = "not-found"
    heading = "Not found"


def no_split(name: str, known: Iterable[str]) -> NotFoundError:
    """Return the error for a split that the server does not have."""
    return NotFoundError(f"there is no split {name!r} here{did_you_mean(name, known)}")


class NotOpenError(RequestError):
    """The split accepts no submissions now."""

    status = HTTPStatus.CONFLICT
    code = "not-open"
    heading = "Submissions are closed"


class ConflictError(RequestError):
    """The request is not possible in the current state."""

    status = HTTPStatus.CONFLICT
    code = "conflict"
    heading = "Not possible now"


class MalformedError(RequestError):
    """The request is invalid, not the submission in it."""

    status = HTTPStatus.BAD_REQUEST
    code = "malformed-request"
    heading = "Invalid request"

    def __init__(self, message: str, problems: Sequence[ProblemReport] = ()) -> None:
        self.problems = problems
        super().__init__(message)


class QuotaSpentError(RequestError):
    """No submissions are left."""

    status = HTTPStatus.TOO_MANY_REQUESTS
    code = "quota-spent"
    heading = "No submissions left"

    def __init__(self, quota: QuotaReport) -> None:
        self.quota = quota
        super().__init__(
            f"no submissions left; {_next(quota)}. Nothing was scored; checking is still free"
        )


def _next(quota: QuotaReport) -> str:
    if quota.next_at is None:
        return "the quota of this split is zero"
    whole = quota.next_at + timedelta(microseconds=999_999)  # rounded up, not down
    return f"next possible at {whole.isoformat(timespec='seconds')}"


class BytesSpentError(RequestError):
    """The submissions of a team in 24 hours are larger than the limit."""

    status = HTTPStatus.TOO_MANY_REQUESTS
    code = "bytes-spent"
    heading = "Too much data today"

    def __init__(self, limit: int, used: int, size: int, seconds: int | None) -> None:
        """Take the limit in MiB, what the team has sent and wants to send, and when it may."""
        self.seconds = seconds
        remedy = "leave out fields other than instr_id, trajectory and the answer"
        later = "" if seconds is None else f", or try again in {seconds:,} seconds"
        super().__init__(
            f"your team may send {limit:,} MiB of submissions in 24 hours, unpacked, and has sent "
            f"{used / (1 << 20):,.1f} MiB; this one is {size / (1 << 20):,.1f} MiB. Make it "
            f"smaller: {remedy}{later}. No submission was used"
        )


class TooManyError(RequestError):
    """More requests than an address, a token or a session may make."""

    status = HTTPStatus.TOO_MANY_REQUESTS
    code = "too-many-requests"
    heading = "Too many requests"

    def __init__(self, seconds: int, message: str = "") -> None:
        self.seconds = seconds
        super().__init__(message or f"too many requests; try again in {seconds} seconds")


class TooLargeError(RequestError):
    """The body is larger than the limit."""

    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    code = "too-large"
    heading = "Too large"

    def __init__(self, limit: int) -> None:
        """Take the limit in bytes; only uploads may have a mebibyte or more."""
        super().__init__(
            f"the upload is larger than {limit >> 20} MiB; gzip it, and leave out fields other "
            "than instr_id, trajectory and the answer"
            if limit >> 20
            else f"the request is larger than {limit >> 10} KiB"
        )


class TooSlowError(RequestError):
    """The upload did not arrive in time."""

    status = HTTPStatus.REQUEST_TIMEOUT
    code = "too-slow"
    heading = "Upload timed out"


class BusyError(RequestError):
    """Too many uploads are waiting, or what scores them has to start again."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    code = "busy"
    heading = "Server busy"

    def __init__(self, seconds: int, why: str = "too many uploads are waiting") -> None:
        self.seconds = seconds
        self._given = seconds, why
        super().__init__(f"{why}; send yours again in {seconds} seconds. No submission was used")

    def __reduce__(self) -> tuple[type[Self], tuple[int, str]]:
        """Let processes that score raise it."""
        return type(self), self._given


class WrongMethodError(RequestError):
    """The address does not accept this method."""

    status = HTTPStatus.METHOD_NOT_ALLOWED
    code = "method-not-allowed"
    heading = "Method not allowed"

    def __init__(self) -> None:
        super().__init__("this URL does not support that method; see the Allow header")


class DatabaseDownError(RequestError):
    """The database does not answer."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    code = "database-down"
    heading = "Server unavailable"
    seconds = 10

    def __init__(self, request_id: str) -> None:
        self.request_id = request_id
        super().__init__(_no_answer("database", self.seconds))


class StoreDownError(RequestError):
    """The store of uploads does not answer, or refuses the server."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    code = "store-down"
    heading = "Uploads unavailable"
    seconds = 10

    def __init__(self, request_id: str) -> None:
        self.request_id = request_id
        super().__init__(_no_answer("store of uploads", self.seconds))


def _no_answer(part: str, seconds: int) -> str:
    wait = f"try again in {seconds} seconds: no file is counted twice"
    return f"the server's {part} does not answer; {wait}"


class DamagedError(RequestError):
    """Stored data cannot be read."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    code = "damaged"
    heading = "Server data is damaged"

    def __init__(self, request_id: str) -> None:
        self.request_id = request_id
        super().__init__(
            "data that the server has stored cannot be read; nothing was saved and no submission "
            "was used. Tell the organiser: `reverie-eval server doctor` finds what is damaged, and "
            "`reverie-eval server restore` restores the last backup"
        )


class KeyReplacedError(RequestError):
    """The signing key was replaced since this server started."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    code = "key-replaced"
    heading = "Server must be restarted"
    seconds = 10

    def __init__(self, ours: str, current: str) -> None:
        super().__init__(
            f"the signing key {ours} was replaced by {current} since this server started; nothing "
            "was saved and no submission was used. Try again once the organiser has restarted the "
            "server"
        )


class StorageFullError(RequestError):
    """The disk or the database is full."""

    status = HTTPStatus.INSUFFICIENT_STORAGE
    code = "storage-full"
    heading = "Server storage is full"

    def __init__(self, request_id: str) -> None:
        self.request_id = request_id
        super().__init__(
            "the server's storage is full; nothing was saved and no submission was used. Tell the "
            "organiser, and try again when there is space"
        )


class FaultError(RequestError):
    """The server failed."""

    status = HTTPStatus.INTERNAL_SERVER_ERROR
    code = "internal"
    heading = "Server error"

    def __init__(self, request_id: str) -> None:
        self.request_id = request_id
        super().__init__(
            "internal server error; your request was not at fault. It is safe to try again: no "
            "file is counted twice. If it fails again, send the organiser this request id: "
            f"{request_id}"
        )


ERRORS: Mapping[str, type[RequestError]] = MappingProxyType(
    {kind.code: kind for kind in RequestError.__subclasses__()}
)
"""All classes by code."""


class TableError(RejectedError):
    """A file that an organiser imports is invalid; nothing of it was added."""

    subject = "file"


def request_error(error: Exception) -> RequestError | None:
    """Return an exception as an error for the caller; None if it is a fault of the server."""
    if isinstance(error, SubmissionError):
        return RejectedFileError(error.problems)
    if isinstance(error, TableError):
        told = [ProblemReport.model_validate(problem) for problem in error.problems]
        return MalformedError(f"{count_text(len(told), 'problem')}; nothing was changed", told)
    return error if isinstance(error, RequestError) else None
