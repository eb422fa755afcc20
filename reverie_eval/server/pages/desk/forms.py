"""What the desk's pages have in common: reading forms, showing what is wrong, asking again.

A form that does harm is sent twice: the first reply repeats what is to be done and asks whether it
shall be, with the same fields.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeAlias

from fastapi import Query
from fastapi.responses import Response
from starlette.datastructures import FormData

from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.http.callers import Call, Snapshot
from reverie_eval.server.pages.rendering import page, see_other, show_faults_with
from reverie_eval.server.service.paging import Page

ON_A_PAGE = 100
"""Rows of a list."""
_OURS = frozenset({"csrf_token", "confirmed"})

Typed: TypeAlias = Mapping[str, str]
"""What somebody typed into a form, by the names of its fields."""
Draw: TypeAlias = Callable[[Call, Typed, ProblemDocument], Response]
"""Shows a page again, with what was typed into its form and what is wrong with it."""
Done = Annotated[str, Query(max_length=20)]
"""What a form has just done; a page words those that it knows."""


def desk_page(
    desk: Call,
    snapshot: Snapshot,
    template: str,
    problem: ProblemDocument | None = None,
    **content: Any,
) -> Response:
    """Show a page of the desk, and what was wrong with a form on it."""
    status = problem.status if problem else 200
    content |= {"problem": problem, "now": snapshot.now}
    return page(desk.request, f"desk/{template}", snapshot, status, **content)


def show_faults(desk: Call, typed: Typed, draw: Draw) -> None:
    """Let an organiser see from now on what is wrong beside what was typed."""
    desk.person()  # nobody else sees the page, with or without a fault
    show_faults_with(desk.request, lambda problem: draw(desk, typed, problem))


def ask(desk: Call, typed: Typed, template: str = "confirm.html", **content: Any) -> Response:
    """Ask whether it shall really be done."""
    with desk.snapshot() as snapshot:
        action = desk.request.url.path
        return desk_page(desk, snapshot, template, fields=typed, action=action, **content)


def page_at(desk: Call, name: str) -> Page:
    """Return which page of a list is to be shown, by the name of its cursor in the address."""
    return Page(ON_A_PAGE, desk.request.query_params.get(name))


def typed_into(form: FormData) -> Typed:
    """Return what somebody typed into a form."""
    return {
        name: value.strip()
        for name, value in form.items()
        if isinstance(value, str) and name not in _OURS
    }


def typed_by(desk: Call, form: FormData, draw: Draw) -> Typed:
    """Return what an organiser typed into a form, and show further problems beside it."""
    typed = typed_into(form)
    show_faults(desk, typed, draw)
    return typed


def is_confirmed(form: FormData) -> bool:
    """Whether somebody was asked, and said yes."""
    return form.get("confirmed") == "yes"


def end_of_day(date: str) -> str | None:
    """Return the last second of a date in UTC, or None for an empty text.

    >>> end_of_day("2027-06-01"), end_of_day("")
    ('2027-06-01T23:59:59Z', None)
    """
    return f"{date}T23:59:59Z" if date else None


def done(path: str, what: str) -> Response:
    """Lead back to the page of a form, which says what was done."""
    return see_other(f"{path}?done={what}")
