"""What a request can come to besides success.

Each class says how the reply is marked and shows an example. Problem documents, pages, the OpenAPI
description and the metrics all read it here.

RequestError
    RejectedFileError     the submission is wrong; lists everything that is
    NotSignedInError      there is no such token, or it is not valid any more
    NotAllowedError       somebody else's
    ForgedError           a browser's request without the session's token, perhaps another site's
    NotFoundError         there is no such thing, or it is not the caller's to see
    NotOpenError          the split takes no submissions now
    ConflictError         what is there already stands against it
    MalformedError        the request, not the submission in it, is wrong
    QuotaSpentError       nothing is left; says when something is
    TooManyError          more requests than an address or a token may make
    TooLargeError         more bytes than the server takes
    TooSlowError          the upload did not arrive in time
    BusyError             more uploads than the server can hold
    WrongMethodError      the address takes other methods
    StorageFullError      the server cannot keep anything more
    FaultError            the server failed
"""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from http import HTTPStatus
from types import MappingProxyType
from typing import Any, ClassVar, Self

from reverie_eval.errors import Problem, ReverieEvalError, SubmissionError
from reverie_eval.schemas.report import ProblemReport
from reverie_eval.schemas.service import ProblemDocument, QuotaReport, QuotaWindow

EXAMPLE_NOW = datetime(2027, 6, 1, 12, tzinfo=UTC)
"""When the examples happen."""
_EXAMPLE_REQUEST = "5f0c1be2a97d4e36"
WRONG_FORM = "the request is not of the documented form"


class RequestError(ReverieEvalError):
    """A request that comes to nothing, and why."""

    status: ClassVar[HTTPStatus]
    code: ClassVar[str]
    """Stable, for programs."""
    heading: ClassVar[str]
    """Of a page, in place of HTTP's words."""
    example_arguments: ClassVar[tuple[Any, ...]]
    """What :meth:`example` is made with."""

    problems: Sequence[Problem | ProblemReport] = ()
    """What is wrong, each with its place."""
    seconds: int | None = None
    """After which to try again."""
    quota: QuotaReport | None = None
    """What is left, where that is what stopped the request."""
    request_id: str | None = None

    @classmethod
    def example(cls) -> Self:
        """Return such an error, for documentation."""
        return cls(*cls.example_arguments)

    def document(self) -> ProblemDocument:
        """Return what is sent to whoever asked."""
        return ProblemDocument(
            title=self.status.phrase,
            status=self.status,
            detail=str(self),
            code=self.code,
            problems=[ProblemReport.model_validate(problem) for problem in self.problems],
            quota=self.quota,
            request_id=self.request_id,
        )


class RejectedFileError(RequestError):
    """The submission is wrong."""

    status = HTTPStatus.UNPROCESSABLE_ENTITY
    code = "submission-rejected"
    heading = "The file was rejected"
    example_arguments = (
        [
            Problem(
                "unknown-viewpoint",
                "[3].trajectory[0]",
                "there is no viewpoint 0c0f3d11 in this building; see connectivity/",
            )
        ],
    )

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = problems
        count = len(problems)
        super().__init__(
            f"{count} problem{'s' * (count != 1)}; nothing was scored and nothing was spent"
        )


class NotSignedInError(RequestError):
    """There is no such token, or it is not valid any more."""

    status = HTTPStatus.UNAUTHORIZED
    code = "not-signed-in"
    heading = "Sign in first"
    example_arguments = ("send your token: `Authorization: Bearer rv_...`",)


class NotAllowedError(RequestError):
    """What was asked for belongs to somebody else."""

    status = HTTPStatus.FORBIDDEN
    code = "not-allowed"
    heading = "Not allowed"
    example_arguments = ("only the organiser may do this",)


class ForgedError(RequestError):
    """A browser's request without the session's token: perhaps another site has made it."""

    status = HTTPStatus.FORBIDDEN
    code = "csrf"
    heading = "This form is out of date"
    example_arguments = (
        "send the session's csrf_token as X-CSRF-Token; GET /api/v1/session tells it",
    )


class NotFoundError(RequestError):
    """There is no such thing, or it is not the caller's to see."""

    status = HTTPStatus.NOT_FOUND
    code = "not-found"
    heading = "Nothing is here"
    example_arguments = ("there is no submission '5f2b0c9a4d7e1f36' of your team",)


class NotOpenError(RequestError):
    """The split takes no submissions now."""

    status = HTTPStatus.CONFLICT
    code = "not-open"
    heading = "Not open now"
    example_arguments = (
        "test takes no submissions now; the next phase opens 2027-07-01T12:00:00+00:00",
    )


class ConflictError(RequestError):
    """What is there already stands against it."""

    status = HTTPStatus.CONFLICT
    code = "conflict"
    heading = "Something stands against it"
    example_arguments = ("a withdrawn submission is not published; restore it first",)


class MalformedError(RequestError):
    """The request, not the submission in it, is wrong."""

    status = HTTPStatus.BAD_REQUEST
    code = "malformed-request"
    heading = "Something is not as it should be"
    example_arguments = (
        WRONG_FORM,
        [ProblemReport(code="wrong-value", where="name", message="is missing")],
    )

    def __init__(self, message: str, problems: Sequence[ProblemReport] = ()) -> None:
        self.problems = problems
        super().__init__(message)


class QuotaSpentError(RequestError):
    """Nothing is left."""

    status = HTTPStatus.TOO_MANY_REQUESTS
    code = "quota-spent"
    heading = "No try is left"
    example_arguments = (
        QuotaReport(
            remaining=0,
            next_at=EXAMPLE_NOW + timedelta(days=1),
            seconds_to_next=24 * 60 * 60,
            windows=[
                QuotaWindow(name=name, limit=limit, remaining=limit - 2, resets_at=resets_at)
                for name, limit, resets_at in (
                    ("day", 2, EXAMPLE_NOW + timedelta(days=1)),
                    ("month", 10, EXAMPLE_NOW + timedelta(days=30)),
                    ("year", 40, EXAMPLE_NOW + timedelta(days=365)),
                )
            ],
        ),
    )

    def __init__(self, quota: QuotaReport) -> None:
        self.quota = quota
        super().__init__(
            f"no submission is left; {_next(quota)}. Nothing was scored, and `validate` stays free"
        )


def _next(quota: QuotaReport) -> str:
    if quota.next_at is None:
        return "the organiser's quota allows none"
    whole = quota.next_at + timedelta(microseconds=999_999)  # rounded up, not down
    return f"the next is possible from {whole.isoformat(timespec='seconds')}"


class TooManyError(RequestError):
    """More requests than an address or a token may make in a minute."""

    status = HTTPStatus.TOO_MANY_REQUESTS
    code = "too-many-requests"
    heading = "Too many requests"
    example_arguments = (7,)

    def __init__(self, seconds: int) -> None:
        self.seconds = seconds
        super().__init__(f"too many requests; try again in {seconds} seconds")


class TooLargeError(RequestError):
    """More bytes than the server takes."""

    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    code = "too-large"
    heading = "Too large"
    example_arguments = (
        (
            "the upload is larger than 32 MiB; gzip it, and send instr_id, trajectory and the "
            "answer only"
        ),
    )


class TooSlowError(RequestError):
    """The upload did not arrive in time."""

    status = HTTPStatus.REQUEST_TIMEOUT
    code = "too-slow"
    heading = "Too slow"
    example_arguments = (
        "the upload did not arrive within 60 seconds; gzip it, or try again: nothing was spent",
    )


class BusyError(RequestError):
    """More uploads have come at once than the server can hold."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    code = "busy"
    heading = "Too many uploads at once"
    example_arguments = (10,)

    def __init__(self, seconds: int) -> None:
        self.seconds = seconds
        super().__init__(
            f"too many uploads at once; nothing was spent, send yours again in {seconds} seconds"
        )


class WrongMethodError(RequestError):
    """The address takes other methods."""

    status = HTTPStatus.METHOD_NOT_ALLOWED
    code = "method-not-allowed"
    heading = "Nothing can be sent here"
    example_arguments = ()

    def __init__(self) -> None:
        super().__init__("this address is there for other methods; look at Allow")


class StorageFullError(RequestError):
    """The server cannot keep anything more."""

    status = HTTPStatus.INSUFFICIENT_STORAGE
    code = "storage-full"
    heading = "No room is left"
    example_arguments = (_EXAMPLE_REQUEST,)

    def __init__(self, request_id: str) -> None:
        self.request_id = request_id
        super().__init__(
            "the server has no room left to keep anything; nothing was spent. Tell the organiser, "
            "and send it again when there is room"
        )


class FaultError(RequestError):
    """The server failed, and nobody else."""

    status = HTTPStatus.INTERNAL_SERVER_ERROR
    code = "internal"
    heading = "The server failed"
    example_arguments = (_EXAMPLE_REQUEST,)

    def __init__(self, request_id: str) -> None:
        self.request_id = request_id
        super().__init__(
            "the server failed, not your file. Send it again, no file is counted twice; if it "
            f"fails again, tell the organiser this request's id: {request_id}"
        )


ERRORS: Mapping[str, type[RequestError]] = MappingProxyType(
    {kind.code: kind for kind in RequestError.__subclasses__()}
)
"""Every class by its code."""


def request_error(error: Exception) -> RequestError | None:
    """Return the refusal that an exception stands for; None if it is a fault of the server."""
    if isinstance(error, SubmissionError):
        return RejectedFileError(error.problems)
    return error if isinstance(error, RequestError) else None
