"""Pages of the API's lists: ``limit`` and ``cursor`` in, a Link to the next page out (RFC 8288)."""

from collections.abc import Iterator
from typing import Annotated, TypeVar
from urllib.parse import urlencode

from fastapi import Depends, Path, Query, Request, Response
from fastapi.dependencies.models import Dependant

from reverie_eval.schemas.report import ProblemReport
from reverie_eval.server.errors import WRONG_FORM, MalformedError
from reverie_eval.server.service.paging import LARGEST, LONGEST, Listed, Page
from reverie_eval.text import did_you_mean

Report = TypeVar("Report")
Number = Annotated[int, Path(ge=1, le=LARGEST, examples=[1])]
"""Of a row."""


class Pager:
    """Which page is asked for, and the reply to lead on from."""

    def __init__(
        self,
        response: Response,
        limit: Annotated[int, Query(ge=1, le=LONGEST)] = 100,
        cursor: Annotated[
            str | None,
            Query(max_length=200, description="From the Link header of the page before."),
        ] = None,
    ) -> None:
        self._response = response
        self.page = Page(limit, cursor)

    def reply(self, listed: Listed[Report]) -> list[Report]:
        """Return the rows of a page, and link the next one."""
        if listed.next_cursor is not None:
            query = urlencode({"limit": self.page.limit, "cursor": listed.next_cursor})
            self._response.headers["Link"] = f'<?{query}>; rel="next"'
        return listed.rows


Paging = Annotated[Pager, Depends()]


async def known_query(request: Request) -> None:
    """Refuse parameters that a route does not have, which would be ignored.

    Raises
    ------
    MalformedError
        Naming each, and what was perhaps meant.
    """
    route = request.scope["route"]
    known = set(_parameters(route.dependant))
    known |= {each["name"] for each in (route.openapi_extra or {}).get("parameters", ())}
    unknown = sorted(set(request.query_params) - known)
    if unknown:
        problems = []
        for name in unknown:
            remedy = did_you_mean(name, sorted(known)) if known else "; leave it out"
            message = f"is not known here{remedy}"
            problems.append(ProblemReport(code="wrong-value", where=name, message=message))
        raise MalformedError(WRONG_FORM, problems)


def _parameters(dependant: Dependant) -> Iterator[str]:
    yield from (field.alias for field in dependant.query_params)
    for dependency in dependant.dependencies:
        yield from _parameters(dependency)
