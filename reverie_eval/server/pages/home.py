"""``/``: what is asked of an agent, who leads in each task, and how to take part."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from fastapi import APIRouter
from fastapi.responses import Response
from markupsafe import Markup
from sqlalchemy.orm import Session

from reverie_eval.analysis import Episode
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.answer_svg import answer_svg
from reverie_eval.reporting.answers import AnswerView
from reverie_eval.reporting.map_svg import map_svg
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.schemas.service import Schedule
from reverie_eval.server.http.callers import Visitor
from reverie_eval.server.pages.boards import NEWS_SHOWN, Scale
from reverie_eval.server.pages.rendering import drawn, page
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.entries import Row
from reverie_eval.server.service.episodes import EpisodeService, Reference
from reverie_eval.server.service.leaderboard import Ranking, paper_of
from reverie_eval.server.service.news import latest_news
from reverie_eval.server.state import ServerState
from reverie_eval.tasks import DEFAULT_TASK

router = APIRouter()

MOST_LEADERS = 5
_MOST_COLUMNS = 3
"""Besides the primary metric."""
_OF_REVERIE = ("success", "spl", "rgs")


@dataclass(frozen=True, slots=True)
class Leaders:
    """The first rows of a leaderboard."""

    board: Board
    ranking: Ranking | None
    """None if a result cannot be read."""
    schedule: Schedule
    rows: Sequence[Row]
    references: Sequence[Reference]
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


@router.get("/")
def show_home(visitor: Visitor) -> Response:
    """Show the task by an example, the first of every leaderboard, and how to take part."""
    server, episodes = visitor.server, visitor.server.episodes
    links = {name.casefold(): str(url) for name, url in server.settings.links.items()}
    task, *_ = server.tasks
    with visitor.snapshot() as snapshot:
        return page(
            snapshot,
            "home.html",
            task=task,
            leaders=_leaders(server, snapshot.session),
            # Nobody waits for what a job is computing; a moment later, it is there.
            example=None if server.warming.is_set() else _example(episodes, episodes.signatures),
            # A link in the settings comes before what is known of the task.
            data=links.get("data", f"https://{task.source}"),
            paper_page=links.get("paper", task.paper.url if task.paper else ""),
            papers="\n".join(map(paper_of, server.tasks)),
            news=latest_news(snapshot.session, NEWS_SHOWN),
        )


def warm_up(server: ServerState) -> None:
    """Compute what takes long the first time: the example, reference agents, leaderboards."""
    _example(server.episodes, server.episodes.signatures)
    for board in server.episodes.boards:
        server.episodes.references(board)
    with server.database.reading() as session:
        _leaders(server, session)


@dataclass(frozen=True, slots=True)
class Example:
    """An episode of the first task, as drawings."""

    board: Board
    episode: Episode
    is_browsable: bool
    """Whether the server has a page for it."""
    picture: Markup
    answer: Markup | None


@lru_cache(1)
def _example(episodes: EpisodeService, _signatures: tuple[str, ...]) -> Example | None:
    """Draw the example once for these signatures: it takes longer than the rest of the page."""
    if episodes.example is None:
        return None
    board, episode = episodes.example
    view = AnswerView.at_path_end(episode)
    return Example(
        board=board,
        episode=episode,
        is_browsable=board in episodes.boards,
        picture=drawn(map_svg(EpisodeMap.of({"": episode}).without_routes())),
        answer=None if view is None else drawn(answer_svg(view, 1)),
    )


def _leaders(server: ServerState, session: Session) -> Mapping[str, Sequence[Leaders]]:
    """Return the first rows of every leaderboard, by the title of its task."""
    schedules = server.schedules.in_effect(session)
    found: dict[str, list[Leaders]] = {task.title: [] for task in server.tasks}
    boards = sorted(server.boards.values(), key=lambda board: board.truth.is_demo)
    for board, ranking in zip(boards, server.rankings(session, boards), strict=True):
        all_rows = () if ranking is None else ranking.rows
        rows = all_rows[:MOST_LEADERS]
        has_results = any(row.entry.is_ranked for row in all_rows)
        references = (
            [] if has_results or server.warming.is_set() else server.episodes.references(board)
        )
        scale = Scale.of(rows, board.primary.key)
        found[board.task.title].append(
            Leaders(board, ranking, schedules[board.name], rows, references, scale)
        )
    return found
