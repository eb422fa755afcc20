"""From errors to replies: the one place that knows status codes.

Every reply that is no success is a problem document (RFC 9457) with a stable ``code``; a page says
the same in words.
"""

import logging
from collections.abc import Sequence
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException

from reverie_eval.errors import ReverieEvalError, SubmissionError
from reverie_eval.schemas.report import ProblemReport
from reverie_eval.schemas.service import ProblemDocument, QuotaReport
from reverie_eval.server import errors
from reverie_eval.server.edge.exchange import exchange_of
from reverie_eval.server.pages.faults import fault_page, is_page
from reverie_eval.server.service.reports import quota_report
from reverie_eval.server.state import state_of
from reverie_eval.server.store.space import is_full
from reverie_eval.server.wrong_values import unreadable_json, wrong_value

MEDIA_TYPE = "application/problem+json"
LOGGER = logging.getLogger("reverie_eval.server")

STATUS_OF: dict[type[ReverieEvalError], tuple[HTTPStatus, str]] = {
    SubmissionError: (HTTPStatus.UNPROCESSABLE_ENTITY, "submission-rejected"),
    errors.NotSignedInError: (HTTPStatus.UNAUTHORIZED, "not-signed-in"),
    errors.NotAllowedError: (HTTPStatus.FORBIDDEN, "not-allowed"),
    errors.ForgedError: (HTTPStatus.FORBIDDEN, "csrf"),
    errors.NotFoundError: (HTTPStatus.NOT_FOUND, "not-found"),
    errors.NotOpenError: (HTTPStatus.CONFLICT, "not-open"),
    errors.ConflictError: (HTTPStatus.CONFLICT, "conflict"),
    errors.MalformedError: (HTTPStatus.BAD_REQUEST, "malformed-request"),
    errors.QuotaSpentError: (HTTPStatus.TOO_MANY_REQUESTS, "quota-spent"),
    errors.TooManyError: (HTTPStatus.TOO_MANY_REQUESTS, "too-many-requests"),
    errors.TooLargeError: (HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "too-large"),
    errors.TooSlowError: (HTTPStatus.REQUEST_TIMEOUT, "too-slow"),
    errors.BusyError: (HTTPStatus.SERVICE_UNAVAILABLE, "busy"),
}

_IN_WORDS = {
    HTTPStatus.NOT_FOUND: "there is nothing at this address",
    HTTPStatus.METHOD_NOT_ALLOWED: errors.NO_SUCH_METHOD,
}
"""What the framework refuses, as whoever asked should read it."""

FAULT = "internal"
"""The code of what is nobody's fault but ours."""
NO_SPACE = "storage-full"


def add_error_handlers(app: FastAPI) -> None:
    """Turn whatever is raised into a problem document."""
    app.add_exception_handler(ReverieEvalError, _on_error)
    app.add_exception_handler(RequestValidationError, _on_invalid)
    app.add_exception_handler(HTTPException, _on_http)


def reply_to(request: Request, error: Exception) -> Response:
    """Return the reply to a request that ended outside the routes, whatever the error was.

    The database is not asked: it may be what failed, and a refusal must cost little.
    """
    exchange_of(request.scope).asks_database = False
    is_ours = isinstance(error, ReverieEvalError)
    return _on_error(request, error) if is_ours else _on_fault(request, error)


def log_fault(request: Request, error: Exception) -> None:
    """Tell the log alone what went wrong."""
    exchange = exchange_of(request.scope)
    exchange.outcome = FAULT
    LOGGER.error("fault", exc_info=error, extra={"fields": {"id": exchange.id}})


def _on_error(request: Request, error: Exception) -> Response:
    kind = next((kind for kind in STATUS_OF if isinstance(error, kind)), None)
    if kind is None:
        return _on_fault(request, error)
    status, code = STATUS_OF[kind]
    if isinstance(error, SubmissionError):
        found = [ProblemReport.model_validate(problem) for problem in error.problems]
        count = len(found)
        detail = f"{count} problem{'s' * (count != 1)}; nothing was scored and nothing was spent"
        return _reply(request, status, code, detail, problems=found)
    if isinstance(error, errors.QuotaSpentError):
        quota = quota_report(error.state, state_of(request).clock())
        wait = quota.seconds_to_next or None
        return _reply(request, status, code, str(error), quota=quota, retry_after=wait)
    if isinstance(error, errors.TooManyError | errors.BusyError):
        return _reply(request, status, code, str(error), retry_after=error.seconds)
    return _reply(request, status, code, str(error))


def _on_invalid(request: Request, error: Exception) -> Response:
    details = error.errors() if isinstance(error, RequestValidationError) else ()
    found = [wrong_value(detail) for detail in details]
    said = "the request is not of the documented form"
    return _reply(request, HTTPStatus.BAD_REQUEST, "malformed-request", said, problems=found)


def _on_http(request: Request, error: Exception) -> Response:
    if isinstance(error.__cause__, errors.RequestError):
        # The framework says of whatever stops a body that it could not be read.
        return _on_error(request, error.__cause__)
    status = HTTPStatus(error.status_code if isinstance(error, HTTPException) else 500)
    if status is HTTPStatus.BAD_REQUEST:
        return _on_unreadable(request, error)
    code = status.phrase.lower().replace(" ", "-")
    said = _IN_WORDS.get(status, status.description or status.phrase)
    reply = _reply(request, status, code, said)
    reply.headers.update((isinstance(error, HTTPException) and error.headers) or {})
    return reply


def _on_unreadable(request: Request, error: Exception) -> Response:
    """Say what the framework could not read: a form, of which it says why, or JSON."""
    status, code = STATUS_OF[errors.MalformedError]
    cause = error.__cause__
    if cause is None and isinstance(error, HTTPException):
        return _reply(request, status, code, f"the form cannot be read: {error.detail}")
    if isinstance(cause, RecursionError | ValueError):
        found = [unreadable_json(cause)]
        return _reply(request, status, code, "the body cannot be read", problems=found)
    raise cause or error


def _on_fault(request: Request, error: Exception) -> Response:
    """Say that it was our fault, and to the log alone what it was."""
    log_fault(request, error)
    exchange = exchange_of(request.scope)
    exchange.asks_database, identity = False, exchange.id
    if is_full(error):
        status = HTTPStatus.INSUFFICIENT_STORAGE
        return _reply(request, status, NO_SPACE, errors.NO_ROOM, request_id=identity)
    said = errors.FAILED.format(id=identity)
    return _reply(request, HTTPStatus.INTERNAL_SERVER_ERROR, FAULT, said, request_id=identity)


def _reply(
    request: Request,
    status: HTTPStatus,
    code: str,
    detail: str,
    *,
    problems: Sequence[ProblemReport] = (),
    quota: QuotaReport | None = None,
    retry_after: int | None = None,
    request_id: str | None = None,
) -> Response:
    exchange = exchange_of(request.scope)
    exchange.outcome = code
    if quota is None and exchange.quota and exchange.asks_database:
        quota = exchange.quota()
    document = ProblemDocument(
        title=status.phrase,
        status=status,
        detail=detail,
        code=code,
        problems=list(problems),
        quota=quota,
        request_id=request_id,
    )
    reply = fault_page(request, document) if is_page(request) else _document(document)
    if retry_after is not None:
        reply.headers["Retry-After"] = str(retry_after)
    return reply


def _document(document: ProblemDocument) -> Response:
    is_unknown = document.status == HTTPStatus.UNAUTHORIZED
    headers = {"WWW-Authenticate": "Bearer"} if is_unknown else {}
    return JSONResponse(document.model_dump(mode="json"), document.status, headers, MEDIA_TYPE)
