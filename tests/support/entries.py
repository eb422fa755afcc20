"""Results on a board, with scores that a test makes up, and what the board's pages show."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import html5lib
import httpx

from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.schemas.organising import NewReported
from reverie_eval.schemas.service import ReportedMethod
from reverie_eval.server.boards.entries import Entry, Row
from reverie_eval.server.boards.leaderboard import Ranking
from reverie_eval.server.boards.reported import add_reported
from reverie_eval.server.scoring.boards import Board, load_board
from reverie_eval.server.settings import Split
from reverie_eval.server.store.tables import Submission
from tests.support.acting import NOON
from tests.support.serving import OPEN, ORGANISER, OWNER, Serving

Scores = Mapping[str, float]
HTML = "{http://www.w3.org/1999/xhtml}"
BOARD = f"/splits/{OPEN}"


def entered(
    server: Serving,
    scores: Scores | None = None,
    who: str = OWNER,
    split: str = OPEN,
    report: Mapping[str, Any] | None = None,
    **change: Any,
) -> str:
    """Put a submission on the board and return its id.

    With these scores, if they are given, and then what else is given of the report.
    """
    sent = server.upload(who, server.distinct(split), split, **_sent_as(change))
    submission: str = sent.json()["submission"]["id"]
    if scores is not None:
        with server.state.database.writing() as session:
            row = session.get_one(Submission, submission)
            row.report = {**row.report, "scores": scores, **(report or {})}
    reply = server.ask(
        who, "PATCH", f"/submissions/{submission}", json={"published": True, **change}
    )
    assert reply.status_code == 200, reply.text
    server.clock.turn(seconds=1)
    return submission


def _sent_as(change: Mapping[str, Any]) -> Mapping[str, str]:
    """Return the name of a method, which the audit log has from the upload on."""
    name = change.get("method", {}).get("name")
    return {} if name is None else {"name": name}


def report_result(
    server: Serving,
    name: str,
    source: str = "https://example.org/paper.pdf",
    date: str | None = None,
    dataset: str = "",
    *,
    human: bool | None = None,
    reference: bool = False,
    **scores: float,
) -> None:
    """Put a result of others on the board."""
    new = NewReported(
        split=OPEN,
        method=ReportedMethod(name=name, human=human, reference=reference),
        team="Qi et al.",
        scores=scores,
        source=source,
        date=date,
        dataset=dataset,
    )
    with server.acting(ORGANISER) as transaction:
        add_reported(transaction, new, server.state.settings.tasks)


def get(server: Serving, query: str = "", path: str = BOARD, status: int = 200) -> httpx.Response:
    """Look at a page of a board."""
    reply = server.client.get(path + query)
    assert reply.status_code == status, reply.text
    return reply


def tables(reply: httpx.Response) -> list[list[list[str]]]:
    """Return the cells of every table's body, each in words; HTML with an error is refused.

    Without those that only some screens show, as others show the same elsewhere.
    """
    document = html5lib.HTMLParser(strict=True).parse(reply.text)
    return [
        [
            [
                " ".join("".join(cell.itertext()).split())
                for cell in row
                if cell.get("class") not in {"first", "team"}
            ]
            for row in body.iter(f"{HTML}tr")
        ]
        for body in document.iter(f"{HTML}tbody")
    ]


def named(name: str, **more: Any) -> Mapping[str, Any]:
    """Return what is said of a method."""
    return {"method": {"name": name, **more}}


@cache
def demo_board() -> Board:
    """Return the open split of the demo world, without a server."""
    path = DEMO_BUNDLES / f"{OPEN}.npz"
    return load_board(OPEN, Split(visibility="open", bundle=path), path)


def entry(name: str = "Walker", **changes: Any) -> Entry:
    """Return a result of the team Blue, which it published at noon."""
    about = {
        "submission_id": name.lower(),
        "team_id": 7,
        "team": "Blue",
        "method": {"name": name},
        "published_at": NOON,
        "anonymous_until": None,
        "scores": {},
    }
    return Entry(**{**about, **changes})


def ranking_of(*rows: Row, **changes: Any) -> Ranking:
    """Return a leaderboard at noon with these rows; the team Blue has sent three submissions."""
    about = {"metric": "spl", "apart": (), "metrics": frozenset(), "now": NOON, "counts": {7: 3}}
    return Ranking(rows=rows, **{"board": demo_board(), **about, **changes})
