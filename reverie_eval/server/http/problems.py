"""Turning errors into replies.

Every error is a problem document (RFC 9457) with a stable ``code``; pages show the same as HTML.
Each error's class has its status and code.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from types import MappingProxyType
from typing import Any, TypeAlias, TypeVar

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ValidationError
from starlette.exceptions import HTTPException

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.schemas.wire import unreadable_json, wrong_value
from reverie_eval.server import errors
from reverie_eval.server.http.api import MEDIA_TYPE
from reverie_eval.server.http.callers import exchange_of, refusal_of
from reverie_eval.server.store.damage import damage_in
from reverie_eval.server.store.database import is_full, is_unreachable
from reverie_eval.server.store.uploads import DamagedUploadError, UploadsError

Model = TypeVar("Model", bound=BaseModel)

NO_ROWS: Mapping[str, Sequence[int]] = MappingProxyType({})
LOGGER = logging.getLogger("reverie_eval.server")

FaultPage: TypeAlias = Callable[[Request, ProblemDocument], Response | None]
"""Renders a problem as a page; None if the request is not for a page."""


def add_error_handlers(app: FastAPI, fault_page: FaultPage) -> None:
    """Turn every exception into a problem document, or into a page for browsers."""
    app.state.fault_page = fault_page
    for kind in (ReverieEvalError, RequestValidationError, HTTPException):
        app.add_exception_handler(kind, _on_error)


def read_model(
    model: type[Model], fields: Mapping[str, Any], rows: Mapping[str, Sequence[int]] = NO_ROWS
) -> Model:
    """Return the model that the fields of a form or a query describe, as if they were a JSON body.

    Some rows of a form may be empty: ``rows`` has the numbers of those in each list of the model.

    Raises RequestValidationError, which names each field that is wrong.
    """
    try:
        return model.model_validate(fields)
    except ValidationError as error:
        details = error.errors()
        for detail in details:
            match detail["loc"]:
                case (str(name), int(index), *rest) if name in rows:
                    detail["loc"] = (name, rows[name][index], *rest)
        raise RequestValidationError(details) from None


def reply_to(request: Request, error: Exception) -> Response:
    """Return the reply to a request that failed outside the routes.

    It does not query the database, which may be what failed; and refusing must be cheap.
    """
    exchange_of(request.scope).asks_database = False
    return _on_error(request, error)


def log_fault(request: Request, error: Exception) -> None:
    """Write the exception to the log."""
    exchange = exchange_of(request.scope)
    exchange.outcome = errors.FaultError.code
    LOGGER.error("fault", exc_info=error, extra={"fields": {"id": exchange.id}})


def _on_error(request: Request, error: Exception) -> Response:
    if isinstance(error, RequestValidationError):
        values = [wrong_value(detail) for detail in error.errors()]
        known: errors.RequestError | None = errors.MalformedError(errors.WRONG_FORM, values)
    elif isinstance(error, HTTPException):
        known = _of_framework(error)
    else:
        known = errors.request_error(error)
    if isinstance(known, errors.MalformedError) and exchange_of(request.scope).asks_database:
        known = refusal_of(request) or known
    reply = _reply(request, known or _fault(request, error))
    if isinstance(error, HTTPException):
        reply.headers.update(error.headers or {})
    return reply


def _of_framework(error: HTTPException) -> errors.RequestError | None:
    """Return one of the framework's errors with a message of ours."""
    cause = error.__cause__
    if isinstance(cause, errors.RequestError):
        return cause  # the framework wraps every error that is raised while it reads a body
    match error.status_code:
        case HTTPStatus.NOT_FOUND:
            return errors.NotFoundError("there is no page at this address")
        case HTTPStatus.METHOD_NOT_ALLOWED:
            return errors.WrongMethodError()
        case HTTPStatus.BAD_REQUEST if cause is None:
            return errors.MalformedError(f"the form cannot be read: {error.detail}")
        case HTTPStatus.BAD_REQUEST if isinstance(cause, RecursionError | ValueError):
            return errors.MalformedError(
                "the body cannot be read as JSON", [unreadable_json(cause)]
            )
        case HTTPStatus.BAD_REQUEST if cause is not None:
            raise cause
    return None


def _fault(request: Request, error: Exception) -> errors.RequestError:
    """Log an unexpected exception; the reply does not say what it was."""
    log_fault(request, error)
    exchange = exchange_of(request.scope)
    exchange.asks_database = False
    if is_full(error):
        return errors.StorageFullError(exchange.id)
    if damage_in(error) is not None or isinstance(error, DamagedUploadError):
        return errors.DamagedError(exchange.id)
    if isinstance(error, UploadsError):
        return errors.StoreDownError(exchange.id)
    return (errors.DatabaseDownError if is_unreachable(error) else errors.FaultError)(exchange.id)


def _reply(request: Request, error: errors.RequestError) -> Response:
    exchange = exchange_of(request.scope)
    exchange.outcome = error.code
    document = error.document()
    if document.quota is None and exchange.quota and exchange.asks_database:
        document = document.model_copy(update={"quota": exchange.quota()})
    show: FaultPage = request.app.state.fault_page
    reply = show(request, document) or _document(document)
    wait = error.seconds
    if isinstance(error, errors.QuotaSpentError) and document.quota is not None:
        wait = document.quota.seconds_to_next or None
    if wait is not None:
        reply.headers["Retry-After"] = str(wait)
    return reply


def _document(document: ProblemDocument) -> Response:
    is_unknown = document.code == errors.NotSignedInError.code
    headers = {"WWW-Authenticate": "Bearer"} if is_unknown else {}
    return JSONResponse(document.model_dump(mode="json"), document.status, headers, MEDIA_TYPE)
