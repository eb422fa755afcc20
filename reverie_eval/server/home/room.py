"""``/``: what is asked of an agent, who leads in each task, and how to take part; and the guide."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from fastapi import APIRouter, Response
from sqlalchemy.orm import Session

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.schemas.service import Schedule
from reverie_eval.server.boards.entries import Entry, Row
from reverie_eval.server.boards.leaderboard import Ranking, Rankings, paper_of, sort_by
from reverie_eval.server.boards.news import latest_news
from reverie_eval.server.boards.pages import NEWS_SHOWN, Scale
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.errors import BusyError
from reverie_eval.server.home import guide_page
from reverie_eval.server.http.callers import Visitor
from reverie_eval.server.http.rendering import page
from reverie_eval.server.jobs import Job
from reverie_eval.server.rooms import Room, Showcase, rooms
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.state import ServerState
from reverie_eval.tasks import DEFAULT_TASK

router = APIRouter()

MOST_LEADERS = 5
_MOST_COLUMNS = 3
"""Besides the primary metric."""
_OF_REVERIE = ("success", "spl", "rgs")
_OF_PEOPLE = ("rgs", "success")
"""Metrics by which methods are compared with people who have no value for the primary one."""


@dataclass(frozen=True, slots=True)
class Leaders:
    """The first rows of a leaderboard."""

    board: Board
    ranking: Ranking | None
    """None if a result cannot be read."""
    schedule: Schedule
    rows: Sequence[Row]
    references: Sequence[object]
    """What reference agents score; empty if there are results, the solution is private, or they
    have not walked yet since the server started."""
    scale: Scale
    """The scale of the bars of intervals."""

    @property
    def columns(self) -> Sequence[Metric]:
        """Metrics that are shown besides the primary one."""
        task, primary = self.board.task, self.board.primary
        keys = _OF_REVERIE if task.name == DEFAULT_TASK else task.headline
        shown = [task.metric(key) for key in keys if CATALOGUE[key].better != "neither"]
        return [metric for metric in shown if metric != primary][:_MOST_COLUMNS]


@dataclass(frozen=True, slots=True)
class Standing:
    """How far a leaderboard is, in one line."""

    leaders: Leaders
    metric: Metric
    best: Row
    human: float | None
    """The best human result; None if no person has one."""
    methods: int
    """All results that are not of people or references, also those of other versions."""

    @classmethod
    def of(cls, leaders: Leaders) -> Self | None:
        """Sum up a leaderboard; None if it has no method with a value.

        If people have no value for the primary metric, it is by one that they have.
        """
        if leaders.ranking is None:
            return None
        rows = [*leaders.ranking.rows]
        people = [row for row in rows if row.entry.method.get("human")]
        keys = (leaders.board.primary.key, *_OF_PEOPLE)
        has_value = [key for key in keys if any(key in row.entry.scores for row in people)]
        metric = CATALOGUE[next(iter(has_value), keys[0])]
        methods = [row for row in rows if _is_method(row.entry)]
        scored = [row for row in methods if row.entry.is_ranked] or methods
        best = next(
            (row for row in sort_by(scored, metric) if metric.key in row.entry.scores), None
        )
        if best is None:
            return None
        told = [row.entry.scores[metric.key] for row in sort_by(people, metric)[:1] if has_value]
        apart = [row for row in leaders.ranking.apart if _is_method(row.entry)]
        return cls(leaders, metric, best, next(iter(told), None), len(methods) + len(apart))


def _is_method(entry: Entry) -> bool:
    return not (entry.method.get("human") or entry.method.get("reference"))


@router.get("/")
def show_home(visitor: Visitor) -> Response:
    """Show the task by an example, the first of every leaderboard, and how to take part."""
    server = visitor.server
    # Nobody waits for what a job is computing; a moment later, it is there.
    showcase = None if server.warming.is_set() else _showcase_of(server)
    links = {name.casefold(): str(url) for name, url in server.settings.links.items()}
    task, *_ = server.tasks
    with visitor.reading() as reading:
        leaders = _leaders(server, reading.session, showcase)
        real = [each for each in leaders[task.title] if not each.board.truth.is_demo]
        return page(
            reading,
            "home.html",
            task=task,
            leaders=leaders,
            standings=[standing for each in real if (standing := Standing.of(each))],
            example=None if showcase is None else showcase.example(),
            # A link in the settings comes before what is known of the task.
            data=links.get("data", f"https://{task.source}"),
            paper_page=links.get("paper", task.paper.url if task.paper else ""),
            papers="\n".join(map(paper_of, server.tasks)),
            news=latest_news(reading.session, NEWS_SHOWN),
        )


def warm_up(server: ServerState) -> None:
    """Compute what the first page shows and takes long the first time.

    Reference agents walk only where it shows them: on a split of real size, they take seconds.
    """
    showcase = _showcase_of(server)
    if showcase is not None:
        showcase.example()
    with server.database.reading() as session:
        _leaders(server, session, showcase)


def _showcase_of(server: ServerState) -> Showcase | None:
    """Return what a room shows here, if one does."""
    kinds = (room.showcase for room in rooms().values())
    return next((server.get(kind) for kind in kinds if kind is not None), None)


def _leaders(
    server: ServerState, session: Session, showcase: Showcase | None
) -> Mapping[str, Sequence[Leaders]]:
    """Return the first rows of every leaderboard, by the title of its task."""
    schedules = server.get(Schedules).in_effect(session)
    found: dict[str, list[Leaders]] = {task.title: [] for task in server.tasks}
    boards = sorted(server.boards.values(), key=lambda board: board.truth.is_demo)
    for board, ranking in zip(boards, server.get(Rankings).rankings(session, boards), strict=True):
        all_rows = () if ranking is None else ranking.rows
        rows = all_rows[:MOST_LEADERS]
        has_results = any(row.entry.is_ranked for row in all_rows)
        references = [] if has_results or showcase is None else showcase.references(board)
        scale = Scale.of(rows, board.primary.key)
        found[board.task.title].append(
            Leaders(board, ranking, schedules[board.split], rows, references, scale)
        )
    return found


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that fills the caches of pages, so that their first readers need not wait."""

    def work() -> None:
        try:
            warm_up(server)
        except BusyError:  # a scoring process was killed; another has taken its place
            warm_up(server)
        finally:
            server.warming.clear()

    yield Job("warm-up", work, None)


ROOM = Room(pages=[router, guide_page.router], jobs=jobs)
