"""What the routes of the API share: pages of lists, known parameters, problems, the description.

A list takes ``limit`` and ``cursor``, and links its next page (RFC 8288).

The description, OpenAPI 3.1, is made of what routes declare. Fields have examples, of which every
viewer of OpenAPI makes those of whole bodies. Added is what FastAPI does not know: that problems
have their own media type, which problems every operation can return, and that a cookie is for
reading only.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from http import HTTPStatus
from typing import Annotated, Any, TypeVar
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, FastAPI, Path, Query, Request, Response
from fastapi.dependencies.models import Dependant
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse
from sqlalchemy.orm import Session

from reverie_eval.schemas.report import ProblemReport
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server import errors
from reverie_eval.server.http.callers import Call
from reverie_eval.server.store.paging import LARGEST, LONGEST, Listed, Page
from reverie_eval.text import did_you_mean

API = "/api/v1"
Report = TypeVar("Report")
Number = Annotated[int, Path(ge=1, le=LARGEST, examples=[1])]
"""The number of a row, in a path."""
Document = dict[str, Any]

MEDIA_TYPE = "application/problem+json"
TEXT: Document = {"type": "string"}
"""The schema of a text."""
BINARY: Document = {**TEXT, "format": "binary"}
SUBMISSION = [
    {"instr_id": "4774_267_1", "trajectory": [["a68b5ae6571e", 3.14, 0.0]], "predObjId": 402}
]
"""An example of a result file."""

_MODELS = "#/components/schemas/"
_PROBLEM = {"$ref": f"{_MODELS}{ProblemDocument.__name__}"}
_EVERYWHERE: tuple[str, ...] = (
    errors.TooManyError.code,
    errors.DatabaseDownError.code,
    errors.StoreDownError.code,
    errors.DamagedError.code,
    errors.FaultError.code,
)
_OF_FASTAPI = ("HTTPValidationError", "ValidationError")
_CHANGING = frozenset({"post", "patch", "put", "delete"})


@dataclass(frozen=True, slots=True)
class Pager:
    """The requested page of a list, and the response that links the next page."""

    response: Response
    page: Page

    def read(self, call: Call, rows: Callable[[Session, Page], Listed[Report]]) -> list[Report]:
        """Return the rows of the page of a list, if the caller may see it, and link the next."""
        with call.reading() as reading:
            return self.reply(rows(reading.session, self.page))

    def reply(self, listed: Listed[Report]) -> list[Report]:
        """Return the rows of the page, and link the next page."""
        if listed.next_cursor is not None:
            query = urlencode({"limit": self.page.limit, "cursor": listed.next_cursor})
            self.response.headers["Link"] = f'<?{query}>; rel="next"'
        return listed.rows


async def pager(
    response: Response,
    limit: Annotated[int, Query(ge=1, le=LONGEST)] = 100,
    cursor: Annotated[
        str | None,
        Query(max_length=200, description="From the Link header of the previous page."),
    ] = None,
) -> Pager:
    """Return the pager of a request."""
    return Pager(response, Page(limit, cursor))


Paging = Annotated[Pager, Depends(pager)]


async def known_query(request: Request) -> None:
    """Refuse unknown query parameters, which would otherwise be ignored.

    Raises
    ------
    MalformedError
        If there are any; it names each, with the closest known parameter.
    """
    route = request.scope["route"]
    known = set(_parameters(route.dependant))
    known |= {each["name"] for each in (route.openapi_extra or {}).get("parameters", ())}
    unknown = sorted(set(request.query_params) - known)
    if unknown:
        problems = []
        for name in unknown:
            remedy = did_you_mean(name, sorted(known)) if known else "; remove it"
            message = f"unknown parameter{remedy}"
            problems.append(ProblemReport(code="wrong-value", where=name, message=message))
        raise errors.MalformedError(errors.WRONG_FORM, problems)


def _parameters(dependant: Dependant) -> Iterator[str]:
    yield from (field.alias for field in dependant.query_params)
    for dependency in dependant.dependencies:
        yield from _parameters(dependency)


def organiser_router() -> APIRouter:
    """Return a router for what only organisers may do over the API."""
    refusals = problems("not-signed-in", "not-allowed")
    return APIRouter(prefix=f"{API}/organiser", tags=["organiser"], responses=refusals)


def problems(*codes: str) -> dict[int | str, Document]:
    """Declare the problems that a route can return, by their codes."""
    kinds = [errors.ERRORS[code] for code in codes]
    return {
        status.value: _problem_reply(status, [kind.code for kind in kinds if kind.status is status])
        for status in dict.fromkeys(kind.status for kind in kinds)
    }


def _problem_reply(status: HTTPStatus, codes: Sequence[str]) -> Document:
    schema = {**_PROBLEM, "properties": {"code": {"enum": codes}}}
    return {
        "description": errors.phrase_of(status),
        "content": {MEDIA_TYPE: {"schema": schema}},
    }


def _codes_in(reply: Document) -> Sequence[str]:
    """Return the codes of the problems that a reply was declared with."""
    problem = reply.get("content", {}).get(MEDIA_TYPE)
    codes: Sequence[str] = problem["schema"]["properties"]["code"]["enum"] if problem else ()
    return codes


def file_reply(media_type: str, *codes: str, **content: Any) -> dict[int | str, Document]:
    """Declare a reply that is not JSON of a model, and the problems that a route can return."""
    return {200: {"content": {media_type: content}}, **problems(*codes)}


def describe(app: FastAPI, path_prefix: str) -> None:
    """Add the route of the description to an application below a path of its host.

    FastAPI's own route would render it on the event loop and delay all other requests.
    """

    @cache
    def description() -> Document:
        document = get_openapi(
            title=app.title,
            version=app.version,
            description=app.description,
            contact=app.contact,
            routes=app.routes,
            servers=[{"url": path_prefix or "/"}],
        )
        models = document["components"]["schemas"]
        for name in _OF_FASTAPI:
            models.pop(name, None)
        models[ProblemDocument.__name__] = ProblemDocument.model_json_schema(
            mode="serialization", ref_template=f"{_MODELS}{{model}}"
        )
        models |= models[ProblemDocument.__name__].pop("$defs")
        for operations in document["paths"].values():
            for method, operation in operations.items():
                _complete(method, operation)
        return document

    @app.get(f"{API}/openapi.json", dependencies=[Depends(known_query)], include_in_schema=False)
    def show_description() -> JSONResponse:
        return JSONResponse(description())


def _complete(method: str, operation: Document) -> None:
    """Add the problems that all operations share."""
    replies = operation["responses"]
    everywhere = _EVERYWHERE
    if "HTTPValidationError" in str(replies.get("422")):
        del replies["422"]
        everywhere += (errors.MalformedError.code,)
    if method in _CHANGING:
        everywhere += (errors.StorageFullError.code, errors.KeyReplacedError.code)
        if "security" in operation:
            ways = operation["security"]
            operation["security"] = [way for way in ways if "APIKeyCookie" not in way]
    own = (code for reply in replies.values() for code in _codes_in(reply))
    for status, reply in problems(*dict.fromkeys((*own, *everywhere))).items():
        replies.setdefault(str(status), reply)["content"] |= reply["content"]
    operation["responses"] = dict(sorted(replies.items()))
