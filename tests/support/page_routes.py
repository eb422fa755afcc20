"""Every page there is, and how each is asked for."""

import re
from collections.abc import Iterator
from typing import NamedTuple

from fastapi import FastAPI
from fastapi.routing import iter_route_contexts

from reverie_eval.server.http.api import API
from reverie_eval.tasks import DEFAULT_TASK
from tests.support.demo_site import (
    BOLD,
    ENDLESS,
    MARKED,
    OPEN,
    ORGANISER,
    OWNER,
    PRIVATE,
    WALKER,
    WORDY,
    Site,
)
from tests.support.serving import GROUNDING


class Example(NamedTuple):
    """A page as somebody sees it."""

    route: str
    """As the application knows it; ``{submission_id}`` is the owner's best."""
    who: str | None = None
    query: str = ""

    @property
    def name(self) -> str:
        """What to call it in files and of tests."""
        text = f"{self.route}{self.query} {(self.who or '')[:8]}"
        return "-".join(re.findall(r"\w+", text)).lower() or "home"

    def path(self, site: Site) -> str:
        """Return where it is on a server."""
        parts = {
            "split": OPEN,
            "task": DEFAULT_TASK,
            "board": GROUNDING,
            "submission_id": site.ids.get((OPEN, WALKER)),
            "other_id": site.ids.get((OPEN, BOLD)),
            "wordy_id": site.ids.get((OPEN, ENDLESS)),
            "result_id": "1",
            "number": "1",
            "person_id": "1",
            "team_id": "1",
            "instr_id": site.instr_id,
            "scan": site.scan,
            "private_id": site.ids.get((PRIVATE, "Shortest paths")),
        }
        return (self.route + self.query).format(**parts)


EXAMPLES = (
    Example("/"),
    Example("/splits/{split}"),
    Example("/splits/{split}", OWNER, "?metric=spl&extra_data=without&columns=all"),
    Example("/splits/{split}", None, "?text=nothing+is+called+so"),
    Example("/splits/{split}/boards/{board}"),
    Example("/splits/{split}/compare", None, "?result={submission_id}&result={other_id}"),
    Example("/splits/{split}/boards/{board}/compare"),
    Example("/splits/{split}/snapshots/{number}"),
    Example("/sign-in"),
    Example("/join"),
    Example("/submit", OWNER),
    Example("/submissions/{submission_id}"),
    Example("/submissions/{submission_id}", OWNER),
    Example("/submissions/{other_id}"),
    Example("/submissions/{wordy_id}", WORDY),
    Example("/submissions/{submission_id}/analysis"),
    Example("/teams/{team_id}"),
    Example("/team", OWNER),
    Example("/team", MARKED),
    Example("/team", WORDY),
    Example("/episodes"),
    Example("/episodes/{split}"),
    Example("/episodes/{split}", ORGANISER, "?submission={submission_id}&other={other_id}"),
    Example("/episodes/{split}", None, "?scan={scan}"),
    Example("/episodes/{split}/{instr_id}"),
    Example(
        "/episodes/{split}/{instr_id}",
        ORGANISER,
        "?submission={submission_id}&other={other_id}",
    ),
    Example("/play/{split}"),
    Example("/play/{split}/{number}"),
    Example("/play/{split}/{number}", None, "?answer=none"),
    Example("/guide"),
    Example("/guide/submitting"),
    Example("/guide/submitting/{task}"),
    Example("/guide/metrics"),
    Example("/guide/metrics/{task}"),
    Example("/guide/protocols"),
    Example("/guide/protocols/{task}"),
    Example("/guide/rules"),
    Example("/guide/api"),
    Example("/guide/privacy"),
    Example("/desk", ORGANISER),
    Example("/desk/attempts", ORGANISER),
    Example("/desk/reviews", ORGANISER),
    Example("/desk/reviews", ORGANISER, "?submission={wordy_id}"),
    Example("/desk/reported", ORGANISER),
    Example("/desk/emailed-files", ORGANISER),
    Example("/desk/corrections", ORGANISER),
    Example("/desk/reported/import", ORGANISER),
    Example("/desk/reported/{result_id}", ORGANISER),
    Example("/desk/quotas", ORGANISER),
    Example("/desk/phases", ORGANISER),
    Example("/desk/snapshots", ORGANISER),
    Example("/desk/requests", ORGANISER),
    Example("/desk/people", ORGANISER),
    Example("/desk/people/import", ORGANISER),
    Example("/desk/people/{person_id}", ORGANISER),
    Example("/desk/news", ORGANISER),
    Example("/desk/notice", ORGANISER),
    Example("/desk/audit", ORGANISER),
    Example("/no-such-page"),
)
NO_PAGES = frozenset(
    {
        "/feed.atom",
        "/splits/{split}/feed.atom",
        "/splits/{split}/chart",
        "/splits/{split}/latex",
        "/splits/{split}/bibtex",
        "/episodes/{split}/{instr_id}/view",
        "/splits/{split}/boards/{board}/feed.atom",
        "/splits/{split}/boards/{board}/chart",
        "/splits/{split}/boards/{board}/latex",
        "/splits/{split}/boards/{board}/bibtex",
        "/desk/people/{person_id}/data",
    }
)
"""What leads elsewhere or is a file."""
FILES = tuple(
    Example(route, ORGANISER if route.startswith("/desk") else None) for route in sorted(NO_PAGES)
)
"""Routes of files, as somebody downloads them."""


def page_routes(app: FastAPI) -> Iterator[tuple[str, str]]:
    """Yield method and path of every route that is a page's."""
    for route in iter_route_contexts(app.routes):
        path = route.path or ""
        if route.methods and not route.include_in_schema and not path.startswith(API):
            yield from ((method, path) for method in sorted(route.methods - {"HEAD"}))
