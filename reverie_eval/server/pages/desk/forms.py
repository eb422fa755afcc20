"""What the desk's pages have in common: who sits at it, reading forms, asking again.

A form that does harm is sent twice: the first reply repeats what is to be done and asks whether it
shall be, with the same fields.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Any, TypeAlias, TypeVar

from fastapi import Depends, Path, Query, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import RedirectResponse, Response
from pydantic import BaseModel, ValidationError
from starlette.datastructures import FormData

from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.http.callers import Server
from reverie_eval.server.pages.faults import show_faults_with
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.pages.visitors import Desk
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import BrowserSession

SEE_OTHER = 303
_OURS = frozenset({"csrf_token", "confirmed"})

Typed: TypeAlias = Mapping[str, str]
"""What somebody typed into a form, by the names of its fields."""
Said = TypeVar("Said", bound=BaseModel)
Done = Annotated[str, Query(max_length=20)]
"""What a form has just done; a page words those that it knows."""
Number = Annotated[int, Path(ge=1, le=2**31 - 1)]
"""Of a row."""


@dataclass(frozen=True)
class AtDesk:
    """The organiser, at one of the desk's pages."""

    request: Request
    server: ServerState
    session: BrowserSession

    @property
    def name(self) -> str:
        """Who it is, for the record."""
        return self.session.token.person.name

    def now(self) -> datetime:
        """Return the time."""
        return self.server.clock()

    def draw(
        self, template: str, problem: ProblemDocument | None = None, **content: Any
    ) -> Response:
        """Show a page, and what was wrong with a form on it."""
        status = problem.status if problem else 200
        return page(self.request, template, self.session, status, problem=problem, **content)

    def keep(
        self, typed: Typed, draw: Callable[["AtDesk", Typed, ProblemDocument], Response]
    ) -> None:
        """Let faults be shown from now on beside what was typed."""
        show_faults_with(self.request, lambda problem: draw(self, typed, problem))

    def ask(self, typed: Typed, template: str = "desk/confirm.html", **content: Any) -> Response:
        """Ask whether it shall really be done."""
        return self.draw(template, fields=typed, action=self.request.url.path, **content)


def at_desk(request: Request, server: Server, session: Desk) -> AtDesk:
    """Return the organiser, at the page."""
    return AtDesk(request, server, session)


Here = Annotated[AtDesk, Depends(at_desk)]


def typed_into(form: FormData) -> dict[str, str]:
    """Return what somebody typed into a form."""
    return {
        name: value.strip()
        for name, value in form.items()
        if isinstance(value, str) and name not in _OURS
    }


def is_confirmed(form: FormData) -> bool:
    """Whether somebody was asked, and said yes."""
    return form.get("confirmed") == "yes"


def read(model: type[Said], fields: Mapping[str, Any]) -> Said:
    """Return what a form says.

    Raises
    ------
    RequestValidationError
        Naming each field that is wrong.
    """
    try:
        return model.model_validate(fields)
    except ValidationError as error:
        raise RequestValidationError(error.errors()) from None


def end_of_day(date: str) -> str | None:
    """Return the last second of a date that was typed, in UTC; None if there is none.

    >>> end_of_day("2027-06-01"), end_of_day("")
    ('2027-06-01T23:59:59Z', None)
    """
    return f"{date}T23:59:59Z" if date else None


def done(path: str, what: str) -> Response:
    """Lead back to the page of a form, which says what was done."""
    return RedirectResponse(f"{path}?done={what}", SEE_OTHER)
