"""How heavy the pages of a full server are: all that a browser fetches for them, unpacked."""

import re

from sqlalchemy import select, update

from fixtures.many_submissions import SAMPLE, fill
from reverie_eval.server.boards.pages import PER_PAGE
from reverie_eval.server.store.tables import Submission
from tests.support.serving import OPEN, ORGANISER, Serving
from tests.support.visiting import signed_in

MOST = 300_000
"""Bytes."""
PAGES = (
    "/",
    f"/splits/{OPEN}",
    f"/splits/{OPEN}?columns=all",
    f"/episodes/{OPEN}",
    "/teams/1",
    "/guide/api",
    "/desk/reviews",
)
NEEDED = re.compile(r'(?:src|href)="(/static/[^"]+)"')


def test_pages_stay_light(server: Serving) -> None:
    fill(server.state, submissions=PER_PAGE + 1, published=PER_PAGE + 1, teams=17)
    board = server.state.boards[OPEN]
    report = board.score(board.read(SAMPLE)).with_intervals().to_report()
    with server.state.database.writing() as session:
        shown = {"report": report.model_dump(mode="json"), "shows_episodes": True}
        session.execute(update(Submission).values(**shown))
        analysis = f"/submissions/{session.scalars(select(Submission.id)).first()}/analysis"
    visitor = signed_in(server, ORGANISER)
    for path in (*PAGES, analysis):
        page = visitor.get(path)
        needed = [visitor.get(each) for each in set(NEEDED.findall(page.text))]
        weights = [len(each.content) for each in (page, *needed)]
        assert len(weights) > 3
        assert sum(weights) < MOST, (path, weights)
