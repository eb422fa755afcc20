"""Rendering pages from templates, and formatting numbers and times in them."""

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from html import unescape
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args
from urllib.parse import quote, urlsplit

from fastapi import Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from jinja2 import ChoiceLoader, Environment, FileSystemLoader, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from reverie_eval import server as package
from reverie_eval.metrics import CATALOGUE
from reverie_eval.metrics.uncertainty import CONFIDENCE
from reverie_eval.reporting.service import (
    METHOD_COSTS,
    METHOD_FLAGS,
    WINDOW_LENGTHS,
    flags_of,
    headline_of,
    known_task,
    undeclared_of,
)
from reverie_eval.schemas import wire
from reverie_eval.schemas.organising import MOST_EXTRA
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import InputClass, Method, ProblemDocument
from reverie_eval.server import errors
from reverie_eval.server.http.api import API
from reverie_eval.server.http.callers import CallReading, exchange_of, state_of, visit_of
from reverie_eval.server.http.labels import name_fields, place_of
from reverie_eval.server.identity import TOKEN_NAMES, Sessions, token_state
from reverie_eval.server.messages.notices import NO_NOTICE, current_notice
from reverie_eval.server.rooms import Tab, desk_of
from reverie_eval.server.store.tables import Person
from reverie_eval.tasks import DEFAULT_TASK, Task
from reverie_eval.text import amount_text, category_text, count_text
from reverie_eval.version import __version__

STATIC = "/static"
STATIC_FOLDERS = (
    ("reverie_eval.server.http", "static"),
    ("reverie_eval.reporting", "resources/shared"),
)
"""Packages and folders of static files; the second is shared with reports."""
_FOR_A_YEAR = "public, max-age=31536000, immutable"
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; connect-src 'self'; form-action 'self'; base-uri 'none'; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "same-origin",
}
"""Pages load nothing from other hosts, and run no inline scripts."""
_LINK = re.compile(r' (href|src|action|data-source|data-submission)="([^"]*)"')
"""An attribute with an address. No value can look like one: quotes in it are escaped."""
_SHORT_FLAGS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "extra_data": ("+data", "+d"),
        "pre_exploration": ("explored", "ex"),
        "ground_truth_objects": ("+objects", "+o"),
        "ensemble": ("ensemble", "en"),
        "navigation_only": ("nav only", "nav"),
        "human": ("human", "hu"),
    }
)
"""What a method discloses, where there is little room, and on a phone."""
_NOT_PAGES = (f"{API}/", f"{STATIC}/", "/healthz", "/readyz", "/metrics")


@dataclass(frozen=True, slots=True)
class Place:
    """An entry of the menu."""

    name: str
    url: str
    is_demo: bool = False
    """Whether it is of the demo world, on a server that also has real data."""


@dataclass(frozen=True, slots=True)
class Site:
    """The frame of every page: menu, banner, the person signed in."""

    title: str
    banner: str
    is_paused: bool
    """Whether the organiser accepts no submissions at all now."""
    places: Sequence[Place]
    tasks: Sequence[Task]
    """The tasks of the server's splits."""
    path: str
    person: Person | None
    csrf_token: str
    organiser: str
    """The public name of the organiser."""
    contact: str
    links: Mapping[str, str]
    address: str
    """The address of the server, from its settings; may be empty."""
    url: str
    """The address of the page, without its query."""
    preview: str
    """The address of the picture for links to the site."""
    desk: Mapping[str, Sequence[Tab]]
    """The pages of the desk, by group."""
    explores: bool
    """Whether there are pages of episodes."""
    copied_at: datetime | None
    """The time of a copy that is read without the server; None on the server itself."""
    version: str = __version__

    @property
    def contact_link(self) -> Markup:
        """The organiser, as a link to the contact; empty if the settings have none."""
        if not self.contact:
            return Markup("")
        address = self.contact if self.contact.startswith("https://") else f"mailto:{self.contact}"
        return Markup('<a href="{}">{}</a>').format(address, self.contact)

    @property
    def csrf_field(self) -> Markup:
        """The hidden field that every form needs which changes something."""
        return Markup('<input type="hidden" name="csrf_token" value="{}">').format(self.csrf_token)


def page(
    reading: CallReading,
    template: str,
    problem: ProblemDocument | None = None,
    *,
    status: int | None = None,
    **content: Any,
) -> HTMLResponse:
    """Render a page of what a request sees; after a problem, with its status unless it is given."""
    usual = problem.status if problem else HTTPStatus.OK
    content |= {"problem": problem, "now": reading.now}
    return _page(reading.request, reading, template, status or usual, **content)


def _page(
    request: Request, reading: CallReading | None, template: str, status: int, **content: Any
) -> HTMLResponse:
    """Render a page; without a reading, the database is not used."""
    site = _site(request, reading)
    html = _environment().get_template(template).render(site=site, **content)
    html = name_fields(html, request.url.path)
    prefix = state_of(request).settings.path_prefix
    if prefix:
        html = with_links(html, lambda link: prefix + link if link.startswith("/") else link)
    return HTMLResponse(html, status, HEADERS)


def render(template: str, **content: Any) -> str:
    """Render a template that is not a page."""
    return _environment().get_template(template).render(**content)


def with_links(html: str, change: Callable[[str], str | None]) -> str:
    """Change every address in a rendered page; one that becomes None loses its attribute.

    Templates are written for a server that has a host to itself. This is the one place that knows
    of other addresses.

    >>> with_links('<a href="/guide?a&amp;b">Guide</a> <a href="#top">Top</a>', "/reverie{}".format)
    '<a href="/reverie/guide?a&amp;b">Guide</a> <a href="/reverie#top">Top</a>'
    """

    def changed(found: re.Match[str]) -> str:
        link = change(unescape(found[2]))
        return "" if link is None else f' {found[1]}="{escape(link)}"'

    return _LINK.sub(changed, html)


def links_of(html: str) -> Iterator[str]:
    """Return every address in a rendered page."""
    return (unescape(link) for _, link in _LINK.findall(html))


def drawn(picture: str) -> Markup:
    """Mark a drawing as safe HTML: all text in it was escaped when it was drawn."""
    return Markup(picture)  # noqa: S704


def address_of_site(request: Request, path: str = "") -> str:
    """Return the server's public address, or that of one of its pages."""
    return f"{request.app.state.address}{path}"


def see_other(path: str) -> RedirectResponse:
    """Redirect after a form, to a page for GET."""
    return RedirectResponse(path, 303)


def _site(request: Request, reading: CallReading | None) -> Site:
    server = state_of(request)
    person, csrf_token = None, ""
    notice = current_notice(reading.session) if reading else NO_NOTICE
    if reading is not None and reading.browser is not None:
        person, csrf_token = reading.caller, server.get(Sessions).csrf_token(reading.browser.id)
    is_copy = request.app.state.is_copy
    has_real = not all(board.truth.is_demo for board in server.boards.values())
    boards = [
        Place(name, f"/splits/{name}", has_real and board.truth.is_demo)
        for name, board in server.boards.items()
    ]
    explores = "explore" in request.app.state.rooms
    episodes = [Place("Episodes", "/episodes")] if explores else []
    # Anyone may look for the way in: who is not signed in is led to how to get an account.
    submit = [] if is_copy else [Place("Submit", "/submit")]
    desk = [Place("Desk", "/desk")] if person is not None and person.is_organiser else []
    return Site(
        title=server.settings.title,
        banner=notice.banner,
        is_paused=notice.paused,
        places=[*boards, *episodes, *submit, Place("Guide", "/guide"), *desk],
        tasks=server.tasks,
        path=request.url.path,
        person=person,
        csrf_token=csrf_token,
        organiser=server.settings.organiser,
        contact=server.settings.contact,
        links={text: str(url) for text, url in server.settings.links.items()},
        address=server.settings.public_address,
        url=address_of_site(request, request.url.path),
        preview=address_of_site(request, static_url("preview.png")),
        desk=desk_of(request.app.state.rooms),
        explores=explores,
        copied_at=server.clock() if is_copy else None,
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=ChoiceLoader(
            [
                FileSystemLoader(sorted(Path(package.__path__[0]).glob("*/templates"))),
                PackageLoader("reverie_eval.reporting", "resources"),  # what reports also draw
            ]
        ),
        autoescape=True,  # XML is escaped like HTML
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {
        # Errors that templates show in a way of their own, by the names of their classes.
        **{
            kind.__name__: kind
            for kind in (
                errors.ForgedError,
                errors.NotAllowedError,
                errors.QuotaSpentError,
                errors.RejectedFileError,
            )
        },
        "called": TOKEN_NAMES,
        "confidence": f"{100 * CONFIDENCE:g}",  # in percent
        "flags": METHOD_FLAGS,
        "flag_meanings": {flag: Method.model_fields[flag].description for flag in METHOD_FLAGS},
        "short_flags": {flag: short for flag, (short, _) in _SHORT_FLAGS.items()},
        "brief_flags": {flag: brief for flag, (_, brief) in _SHORT_FLAGS.items()},
        "longest": {
            "email": wire.LONGEST_EMAIL,
            "id": wire.LONGEST_ID,
            "line": wire.LONGEST_LINE,
            "link": wire.LONGEST_LINK,
            "name": wire.LONGEST_NAME,
            "secret": wire.LONGEST_SECRET,
            "text": wire.LONGEST_TEXT,
        },
        "flags_of": flags_of,
        "costs_of_methods": METHOD_COSTS,
        "input_classes": get_args(InputClass),
        "guide": guide_address,
        "method_fields": Method.model_fields,
        "metrics": CATALOGUE,
        "most_extra": MOST_EXTRA,
        "static": static_url,
        "token_state": token_state,
        "undeclared_of": undeclared_of,
        "window_lengths": WINDOW_LENGTHS,
    }
    environment.filters |= {
        "amount": amount_text,
        "attributes": attributes,
        "category": category_text,
        "counted": count_text,
        "drawn": drawn,
        "headline": lambda report: headline_of(report.signature, report.scores),
        "heading": lambda problem: errors.ERRORS[problem.code].heading,
        "instant": instant,
        "metric": lambda value, key: CATALOGUE[key].display(value),
        "number": "{:,}".format,
        "ordinal": ordinal,
        "place": place_of,
        "primary": primary_of,
        "sentence": sentence,
        "task": lambda report: known_task(report.signature),
        "widest": widest,
    }
    return environment


def guide_address(chapter: str, task: Task | None) -> str:
    """Return the address of a chapter of the guide that each task has."""
    own = "" if task is None or task.name == DEFAULT_TASK else f"/{quote(task.name)}"
    return f"/guide/{chapter}{own}"


def primary_of(report: ScoreReport) -> str:
    """Return the metric that ranks a result; the first one, if its task is not installed."""
    task = known_task(report.signature)
    if task is not None and report.scores:
        return task.primary_metric(report.scores).key
    return next(iter(report.scores), "")


def attributes(values: Mapping[str, object]) -> Markup:
    """Write attributes of an HTML element, each after a space.

    True is an attribute without a value; False and None are left out.

    >>> attributes({"required": True, "disabled": False, "min": 1, "title": "<1>"})
    Markup(' required min="1" title="&lt;1&gt;"')
    """
    return Markup("").join(
        Markup(" {}").format(name) if value is True else Markup(' {}="{}"').format(name, value)
        for name, value in values.items()
        if value is not None and value is not False
    )


@cache
def static_url(name: str) -> str:
    """Return the address of a static file, which includes a digest of its content."""
    files_named = (files(package).joinpath(folder, name) for package, folder in STATIC_FOLDERS)
    content = next(file for file in files_named if file.is_file()).read_bytes()
    return f"{STATIC}/{name}?{hashlib.sha256(content).hexdigest()[:12]}"


def instant(moment: datetime | None) -> Markup:
    """Write a time in UTC; a script adds the viewer's local time.

    >>> instant(datetime(2027, 6, 1, 21, 5, tzinfo=UTC))
    Markup('<time datetime="2027-06-01T21:05:00+00:00">2027-06-01 21:05 UTC</time>')
    """
    if moment is None:
        return Markup("-")
    utc = moment.astimezone(UTC)
    return Markup('<time datetime="{}">{:%Y-%m-%d %H:%M} UTC</time>').format(utc.isoformat(), utc)


def ordinal(number: int) -> str:
    """Write an ordinal number.

    >>> [ordinal(number) for number in (1, 2, 3, 4, 11, 21, 112, 1003)]
    ['1st', '2nd', '3rd', '4th', '11th', '21st', '112th', '1,003rd']
    """
    is_teen = number // 10 % 10 == 1
    ending = "th" if is_teen else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number:,}{ending}"


def widest(numbers: Iterable[str]) -> str:
    """Return the number that needs most room: all digits are equally wide; empty if there are none.

    >>> widest(["7.25", "-", "100.00"])
    '100.00'
    """
    return max(numbers, key=len, default="")


def sentence(text: str) -> str:
    """Capitalise the first letter of a text only, unless it begins with a name such as a split's.

    >>> sentence("the SPL is missing"), sentence("val_unseen has 84 episodes")
    ('The SPL is missing', 'val_unseen has 84 episodes')
    """
    return text if re.match(r"\w*[_\d]", text) else text[:1].upper() + text[1:]


class StaticPages(StaticFiles):
    """Serves the package's static files."""

    def __init__(self) -> None:
        super().__init__(packages=[*STATIC_FOLDERS])

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file; browsers may cache it if its address has a digest."""
        reply = await super().get_response(path, scope)
        if scope["query_string"]:
            reply.headers["Cache-Control"] = _FOR_A_YEAR
        return reply


def show_faults_with(request: Request, draw: Callable[[ProblemDocument], Response]) -> None:
    """Let a page with a form show further problems itself, so that the input is not lost."""
    request.state.draw_fault = draw


def fault_page(request: Request, problem: ProblemDocument) -> Response | None:
    """Show a problem, or redirect to the sign-in page if signing in is needed.

    Returns
    -------
    Response or None
        None if the request is not for a page.
    """
    if request.url.path.startswith(_NOT_PAGES):
        return None
    if problem.code == errors.NotSignedInError.code:
        kept = "" if request.method == "GET" else "&form=kept"
        return see_other(f"/sign-in?back={quote(_came_from(request))}{kept}")
    if not exchange_of(request.scope).asks_database:
        return _fault(request, None, problem)
    if hasattr(request.state, "draw_fault"):
        drawn: Response = request.state.draw_fault(problem)
        return drawn
    with visit_of(request).reading() as reading:
        return _fault(request, reading, problem)


def _fault(request: Request, reading: CallReading | None, problem: ProblemDocument) -> Response:
    ways_on = [Place("Home", "/")]
    # To the same leaderboard if only its query was invalid.
    if problem.code == errors.MalformedError.code and request.url.path.startswith("/splits/"):
        split, name = (request.path_params.get(name, "") for name in ("split", "board"))
        url = f"/splits/{quote(split)}" + (f"/boards/{quote(name)}" if name else "")
        ways_on.insert(0, Place(f"Back to the {split} leaderboard", url))
    if problem.status == HTTPStatus.NOT_FOUND:
        names = state_of(request).boards
        ways_on += [Place(f"{name} leaderboard", f"/splits/{quote(name)}") for name in names]
        ways_on += [Place("Your team's submissions", "/team"), Place("Guide", "/guide")]
    if problem.code == errors.NotAllowedError.code:
        back = quote(_came_from(request))
        ways_on.insert(0, Place("Sign in as somebody else", f"/sign-in?back={back}"))
    about = {"problem": problem, "ways_on": ways_on}
    return _page(request, reading, "fault.html", problem.status, **about)


def _came_from(request: Request) -> str:
    """Return the address to return to after signing in; for a form, the page that it is on."""
    if request.method == "GET":
        return f"{request.url.path}?{request.url.query}".removesuffix("?")
    path = urlsplit(request.headers.get("referer", "")).path
    return path.removeprefix(state_of(request).settings.path_prefix) or "/"
