"""Common parts of the desk's pages: reading forms, showing problems, asking for confirmation.

Actions that are hard to undo need confirmation: the first reply describes the action, and has a
form with the same fields to confirm it.
"""

import typing
from collections.abc import Callable, Mapping
from datetime import date
from functools import wraps
from typing import Annotated, Any, TypeAlias

from fastapi import APIRouter, Query, Response
from starlette.datastructures import FormData, UploadFile

from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.schemas.wire import wrong_field
from reverie_eval.server.errors import WRONG_FORM, MalformedError
from reverie_eval.server.http.callers import Call, CallReading, Desk
from reverie_eval.server.http.rendering import page, see_other, show_faults_with
from reverie_eval.server.store.paging import Page

ON_A_PAGE = 100
"""The number of rows on a page of a list."""
ENTRIES_ON_A_PAGE = 50
"""The number of rows on a page of the audit log, which take more space."""
_LONGEST_NUMBER = 10
"""Digits that may be more than a database can count."""
_OURS = frozenset({"csrf_token", "confirmed"})

Typed: TypeAlias = Mapping[str, str]
"""The input of a form, by the names of its fields."""
Draw: TypeAlias = Callable[[Call, Typed, ProblemDocument], Response]
"""Shows a page again, with the input of its form and a problem."""
Shown: TypeAlias = Mapping[str, Any]
"""What a template needs besides what all pages of the desk have."""
Content: TypeAlias = Callable[[Call, CallReading, Typed], Shown]
"""Returns what is on a page, given the input of its form."""
Done = Annotated[str, Query(max_length=20)]
"""The outcome of a form, by which the page chooses a message."""
Cursor = Annotated[str | None, Query(max_length=200)]
LONGEST_SOUGHT = 200
Sought = Annotated[str, Query(max_length=LONGEST_SOUGHT)]


class FormPage(typing.Protocol):
    """A page with forms."""

    def __call__(
        self, desk: Call, typed: Typed, problem: ProblemDocument | None = None, what: str = ""
    ) -> Response:
        """Show the page, with the input of a form, a problem, and what was done."""


def shown_by(template: str) -> Callable[[Content], FormPage]:
    """Make a page with forms out of a function that returns what a template needs besides."""

    def page_of(content: Content) -> FormPage:
        @wraps(content)
        def draw(
            desk: Call, typed: Typed, problem: ProblemDocument | None = None, what: str = ""
        ) -> Response:
            with desk.reading() as reading:
                count = number(desk.request.query_params.get("count", ""))
                done = {"typed": typed, "done": what, "count": count}
                shown = {**done, **content(desk, reading, typed)}
                return page(reading, f"desk/{template}", problem, **shown)

        return draw

    return page_of


def shown_at(router: APIRouter, path: str, template: str) -> Callable[[Content], FormPage]:
    """Do what :func:`shown_by` does, and show the page at its address, its forms empty."""

    def page_of(content: Content) -> FormPage:
        draw = shown_by(template)(content)

        @router.get(path)
        def show(desk: Desk, done: Done = "") -> Response:
            return draw(desk, {}, what=done)

        return draw

    return page_of


def show_faults(desk: Call, typed: Typed, draw: Draw) -> None:
    """Show further problems on the form's page, with its input."""
    desk.person()  # others may not see the page, even with a problem
    show_faults_with(desk.request, lambda problem: draw(desk, typed, problem))


def ask(desk: Call, typed: Typed, template: str = "confirm.html", **content: Any) -> Response:
    """Ask for confirmation of an action."""
    with desk.reading() as reading:
        action = desk.request.url.path
        return page(reading, f"desk/{template}", fields=typed, action=action, **content)


def page_at(desk: Call, name: str) -> Page:
    """Return the requested page of a list, by the name of its cursor in the query."""
    return Page(ON_A_PAGE, desk.request.query_params.get(name))


def typed_into(form: FormData) -> Typed:
    """Return the input of a form."""
    return {
        name: value.strip()
        for name, value in form.items()
        if isinstance(value, str) and name not in _OURS
    }


def typed_by(desk: Call, form: FormData, draw: Draw) -> Typed:
    """Return an organiser's input of a form, and show further problems with it."""
    typed = typed_into(form)
    show_faults(desk, typed, draw)
    return typed


def file_or_text(form: FormData, name: str, text: str) -> str:
    """Return the text of a file in a form, or another text if no file was chosen.

    Raises
    ------
    MalformedError
        If it is not UTF-8.
    """
    file = form.get(name)
    if not isinstance(file, UploadFile) or not file.filename:
        return text
    try:
        return file.file.read().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MalformedError(f"{file.filename}: invalid UTF-8 from byte {error.start} on") from None


def number(text: str) -> int:
    """Return the number of a row that was chosen in a form, or 0 if it is not a number.

    >>> number("12"), number("Ada")
    (12, 0)
    """
    return int(text) if text.isascii() and text.isdigit() and len(text) < _LONGEST_NUMBER else 0


def is_confirmed(form: FormData) -> bool:
    """Whether the form was sent to confirm an action."""
    return form.get("confirmed") == "yes"


def end_of_day(typed: Typed, name: str) -> Typed:
    """Return a field for a day as the last second of it in UTC; nothing if it is empty.

    Raises
    ------
    MalformedError
        If it is not a day.

    Examples
    --------
    >>> end_of_day({"expires_at": "2027-06-01"}, "expires_at")
    {'expires_at': '2027-06-01T23:59:59Z'}
    """
    day = typed.get(name)
    if not day:
        return {}
    try:
        return {name: f"{date.fromisoformat(day)}T23:59:59Z"}
    except ValueError:
        problem = wrong_field(name, f"{day!r} is not a day; write it as 2027-06-01")
        raise MalformedError(WRONG_FORM, [problem]) from None


def done(path: str, what: str, count: int = 0) -> Response:
    """Redirect to the page of a form, with a message about its outcome, which may have a count."""
    return see_other(f"{path}?done={what}&count={count}" if count else f"{path}?done={what}")
