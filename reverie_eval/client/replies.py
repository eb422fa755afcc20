"""From replies to what they mean: a success, or the error that says what happened."""

from http import HTTPStatus

import httpx
from pydantic import ValidationError

from reverie_eval.client.addresses import API
from reverie_eval.client.errors import (
    NotAServerError,
    QuotaSpentError,
    RefusedError,
    UnreachableError,
)
from reverie_eval.errors import Problem, ReverieEvalError, SubmissionError
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.version import __version__
from reverie_eval.wording import printable

_FAULT = 500
_EVERYWHERE = ("/server", "/splits", "/me", "/key", "/tokens")
"""What every server of this version of the API has."""


def problem_of(response: httpx.Response) -> ProblemDocument | None:
    """Return what the server says is wrong, if it is one of ours that says so."""
    try:
        return ProblemDocument.model_validate_json(response.content, extra="ignore")
    except ValidationError:
        return None


def failure(response: httpx.Response, server: str) -> ReverieEvalError:
    """Return the error that a reply stands for that is no success."""
    status = f"{response.status_code} {response.reason_phrase}".rstrip()
    location = response.headers.get("location")
    if location is not None:
        elsewhere = printable(_server_in(str(response.url.join(location))))
        return NotAServerError(f"{server} leads to {elsewhere}; if that is right, give that URL")
    document = problem_of(response)
    if document is None and response.status_code >= _FAULT:
        return UnreachableError(f"{server} is not available, it answers {printable(status)}")
    if document is None:
        return NotAServerError(f"{server} is no evaluation server, it answers {printable(status)}")
    is_missing = response.status_code == HTTPStatus.NOT_FOUND
    if is_missing and response.url.path.endswith(tuple(API + path for path in _EVERYWHERE)):
        return another_version(server)
    return _said(document)


def another_version(server: str) -> NotAServerError:
    """Return the error for a server whose replies this version does not understand."""
    return NotAServerError(
        f"{server} does not speak as reverie-eval {__version__} does (API v1); install the version "
        "that its organiser names"
    )


def _said(document: ProblemDocument) -> ReverieEvalError:
    match document.code:
        case "submission-rejected":
            return SubmissionError(
                [
                    Problem(p.code, printable(p.where), printable(p.message))
                    for p in document.problems
                ]
            )
        case "quota-spent":
            return QuotaSpentError(document)
        case _:
            return RefusedError(document)


def _server_in(url: str) -> str:
    """Return the part of a URL that names the server."""
    return url.partition(API)[0].rstrip("/")
