"""What exploring episodes adds to the server, and to its first page."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

from markupsafe import Markup

from reverie_eval.analysis import Episode
from reverie_eval.reporting.answer_svg import answer_svg
from reverie_eval.reporting.answers import AnswerView
from reverie_eval.reporting.building_svg import BuildingPicture
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.server.explore import compare_page, method_page, pages, play_page
from reverie_eval.server.explore.episodes import EpisodeService, Reference
from reverie_eval.server.http.rendering import drawn
from reverie_eval.server.jobs import Job
from reverie_eval.server.rooms import Room
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.state import ServerState


@dataclass(frozen=True, slots=True)
class Example:
    """An episode of the first task, as drawings."""

    board: Board
    episode: Episode
    is_browsable: bool
    """Whether the server has a page for it."""
    picture: Markup
    answer: Markup | None


class Showcase:
    """What the first page shows of episodes."""

    def __init__(self, episodes: EpisodeService) -> None:
        self._episodes = episodes
        # Drawn once for the same signatures: it takes longer than the rest of the page.
        self._drawn = lru_cache(1)(lambda _: self._draw())

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return what a server shows."""
        return cls(server.get(EpisodeService))

    def example(self) -> Example | None:
        """Return an episode of the first task; None if there is no open split."""
        return self._drawn(self._episodes.signatures)

    def references(self, board: Board) -> Sequence[Reference]:
        """Return the reference agents' scores on a split, the best first; none on a private one."""
        return self._episodes.references(board)

    def _draw(self) -> Example | None:
        if self._episodes.example is None:
            return None
        board, episode = self._episodes.example
        view = AnswerView.at_path_end(episode)
        walk = EpisodeMap.of({"": episode}).along_path()
        building = BuildingPicture(walk, episode.target_object)
        return Example(
            board=board,
            episode=episode,
            is_browsable=board in self._episodes.boards,
            picture=drawn(building.svg(plays=True)),
            answer=None if view is None else drawn(answer_svg(view, 1)),
        )


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that scores the methods whose episodes everyone may look at."""
    episodes = server.get(EpisodeService)

    def compare() -> None:
        with server.database.reading() as session:
            shown = [(board, episodes.shown_methods(session, board)) for board in episodes.boards]
        for board, methods in shown:
            episodes.comparing.compare(board, methods)

    yield Job("methods", compare, None)


ROOM = Room(
    pages=[pages.router, method_page.router, compare_page.router, play_page.router],
    showcase=Showcase,
    jobs=jobs,
)
"""Open splits, episode by episode: the walks, methods side by side, and playing oneself."""
