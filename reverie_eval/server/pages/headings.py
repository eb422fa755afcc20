"""What a page of a problem is headed by, in place of HTTP's words."""

from collections.abc import Mapping

from reverie_eval.schemas.service import ProblemDocument

_HEADINGS: Mapping[str, str] = {
    "submission-rejected": "The file was rejected",
    "malformed-request": "Something is not as it should be",
    "not-signed-in": "Sign in first",
    "not-allowed": "Not allowed",
    "csrf": "This form is out of date",
    "not-found": "Nothing is here",
    "method-not-allowed": "Nothing can be sent here",
    "conflict": "Something stands against it",
    "not-open": "Not open now",
    "too-slow": "Too slow",
    "too-large": "Too large",
    "quota-spent": "No try is left",
    "too-many-requests": "Too many requests",
    "busy": "Too many uploads at once",
    "storage-full": "No room is left",
    "internal": "The server failed",
}


def heading(problem: ProblemDocument) -> str:
    """Head a problem by its code; what has none of ours keeps HTTP's words."""
    return _HEADINGS.get(problem.code, problem.title)
