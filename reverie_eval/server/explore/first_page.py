"""An episode, and the reference agents, as the first page shows them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

from markupsafe import Markup

from reverie_eval.analysis import Episode
from reverie_eval.reporting.answer_svg import answer_svg
from reverie_eval.reporting.answers import AnswerView
from reverie_eval.reporting.building_svg import BuildingPicture
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.server.explore.episodes import EpisodeService, Reference
from reverie_eval.server.http.rendering import drawn
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
