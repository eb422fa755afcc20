"""``/``: what REVERIE asks of an agent, who leads, and how to take part."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fastapi import APIRouter
from fastapi.responses import Response
from markupsafe import Markup

from reverie_eval.reporting._answer_svg import answer_svg
from reverie_eval.reporting._answer_views import AnswerView
from reverie_eval.reporting._map_svg import map_svg
from reverie_eval.reporting._maps import EpisodeMap
from reverie_eval.schemas.service import Schedule
from reverie_eval.scoring import Scores
from reverie_eval.server.http.callers import Snapshot, Visitor
from reverie_eval.server.pages.boards import NEWS_SHOWN, Scale
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.entries import Row
from reverie_eval.server.service.leaderboard import PAPER, Ranking
from reverie_eval.server.service.news import latest_news
from reverie_eval.server.state import ServerState

router = APIRouter()

MOST_LEADERS = 5
DATA = "https://github.com/YuankaiQi/REVERIE"
"""Where the dataset is, unless the settings have a link that is called ``Data``."""
PAPER_PAGE = "https://arxiv.org/abs/1904.10151"
"""Its paper, unless they have one that is called ``Paper``."""


@dataclass(frozen=True, slots=True)
class Leaders:
    """The first rows of a leaderboard."""

    board: Board
    ranking: Ranking
    schedule: Schedule
    rows: Sequence[Row]
    references: Mapping[str, Scores]
    """By agent, what it scores; empty if there are results, or the answers are private."""
    scale: Scale
    """Of the bars of intervals."""


@router.get("/")
def show_home(visitor: Visitor) -> Response:
    """Show the task by an example, the first of every leaderboard, and how to take part."""
    server = visitor.server
    links = {name.casefold(): str(url) for name, url in server.settings.links.items()}
    example_board, example = server.episodes.example
    # Drawings are safe HTML: all text in them was escaped when they were drawn.
    drawn = Markup(map_svg(EpisodeMap.of({"": example}).without_routes()))  # noqa: S704
    view = AnswerView.at_path_end(example)
    answer = None if view is None else Markup(answer_svg(view, 1))  # noqa: S704
    with visitor.snapshot() as snapshot:
        return page(
            visitor.request,
            "home.html",
            snapshot,
            leaders=_leaders(server, snapshot),
            now=snapshot.now,
            example=example,
            example_board=example_board,
            example_is_browsable=example_board.name in server.boards
            and not server.boards[example_board.name].is_private,
            picture=drawn,
            answer=answer,
            data=links.get("data", DATA),
            paper_page=links.get("paper", PAPER_PAGE),
            paper=PAPER,
            news=latest_news(snapshot.session, NEWS_SHOWN),
        )


def _leaders(server: ServerState, snapshot: Snapshot) -> Sequence[Leaders]:
    schedules = server.schedules.in_effect(snapshot.session)
    found = []
    for name, board in server.boards.items():
        ranking = server.ranking(snapshot.session, board)
        rows = ranking.rows[:MOST_LEADERS]
        has_results = any(row.entry.standing == "ranked" for row in ranking.rows)
        references = {} if has_results else server.episodes.references(board)
        scale = Scale.of(rows, board.primary.key)
        found.append(Leaders(board, ranking, schedules[name], rows, references, scale))
    return found
