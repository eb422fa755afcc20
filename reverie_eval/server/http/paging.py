"""Pages of the API's lists: ``limit`` and ``cursor`` in, a Link to the next page out (RFC 8288)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, TypeVar
from urllib.parse import urlencode

from fastapi import Depends, Path, Query, Request, Response
from fastapi.dependencies.models import Dependant
from sqlalchemy.orm import Session

from reverie_eval.schemas.report import ProblemReport
from reverie_eval.server.errors import WRONG_FORM, MalformedError
from reverie_eval.server.http.callers import Call
from reverie_eval.server.store.paging import LARGEST, LONGEST, Listed, Page
from reverie_eval.text import did_you_mean

Report = TypeVar("Report")
Number = Annotated[int, Path(ge=1, le=LARGEST, examples=[1])]
"""The number of a row, in a path."""


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
        raise MalformedError(WRONG_FORM, problems)


def _parameters(dependant: Dependant) -> Iterator[str]:
    yield from (field.alias for field in dependant.query_params)
    for dependency in dependant.dependencies:
        yield from _parameters(dependency)
