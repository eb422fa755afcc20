"""What exploring episodes adds to the server, and to its first page."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from markupsafe import Markup

from reverie_eval.analysis import Episode
from reverie_eval.ground_truth import DEMO_BUNDLES, bundle_folder
from reverie_eval.reporting.answer_svg import answer_svg
from reverie_eval.reporting.answers import AnswerView
from reverie_eval.reporting.building_svg import BuildingPicture
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.server.explore import pages, play_page, results_page
from reverie_eval.server.explore.episodes import Annotations, EpisodeService, Reference
from reverie_eval.server.http.rendering import drawn
from reverie_eval.server.jobs import Job
from reverie_eval.server.rooms import Room
from reverie_eval.server.scoring.boards import Board, load_board
from reverie_eval.server.settings import Split
from reverie_eval.server.state import ServerState
from reverie_eval.tasks import Task, name_on_server


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

    def __init__(self, episodes: EpisodeService, first_task: Task) -> None:
        self._episodes, self._first_task = episodes, first_task
        # Drawn once for the same signatures: it takes longer than the rest of the page.
        self._drawn = lru_cache(1)(lambda _signatures: self._draw())

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return what a server shows."""
        return cls(server.get(EpisodeService), server.tasks[0])

    def example(self) -> Example | None:
        """Return an episode of the first task; None if there is no open split.

        Its shortest length is the median of all episodes.
        """
        return self._drawn(tuple(board.signature for board in self._episodes.boards))

    def references(self, board: Board) -> Sequence[Reference]:
        """Return the reference agents' scores on a split, the best first; none on a private one."""
        return self._episodes.references(board)

    def _draw(self) -> Example | None:
        board = self._board()
        if board is None:
            return None
        scores = Annotations.of(board).scores
        by_length = np.argsort(scores.episodes["shortest_length"], kind="stable")
        shown = scores.episode(scores.instr_ids[by_length[len(by_length) // 2]])
        view = AnswerView.at_path_end(shown)
        walk = EpisodeMap.of({"": shown}).along_path()
        building = BuildingPicture(walk, shown.target_object)
        return Example(
            board=board,
            episode=shown,
            is_browsable=board in self._episodes.boards,
            picture=drawn(building.svg(plays=True)),
            answer=None if view is None else drawn(answer_svg(view, 1)),
        )

    def _board(self) -> Board | None:
        """Return an open split of the first task: the server's own, or that of the demo world.

        Tasks of other packages have no demo world.
        """
        own = [board for board in self._episodes.boards if board.task is self._first_task]
        if own:
            return min(own, key=lambda board: board.truth.split != "val_unseen")
        bundle = bundle_folder(DEMO_BUNDLES, self._first_task.name) / "val_unseen.npz"
        if not bundle.is_file():
            return None
        split = Split(bundle=bundle, visibility="open", task=self._first_task.name)
        return load_board(name_on_server(split.task, "val_unseen"), split, bundle)


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
    pages=[pages.router, results_page.router, play_page.router],
    showcase=Showcase,
    jobs=jobs,
)
"""Open splits, episode by episode: the walks, methods side by side, and playing oneself."""
