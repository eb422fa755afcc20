"""What exploring episodes adds to the server."""

from collections.abc import Iterable

from reverie_eval.server.explore import compare_page, method_page, pages, play_page
from reverie_eval.server.explore.episodes import EpisodeService
from reverie_eval.server.explore.first_page import Showcase
from reverie_eval.server.jobs import Job
from reverie_eval.server.rooms import Room
from reverie_eval.server.state import ServerState


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that scores the methods whose episodes everyone may look at."""
    episodes = server.get(EpisodeService)

    def compare() -> None:
        with server.database.reading() as session:
            shown = [(board, episodes.shown_methods(session, board)) for board in episodes.boards]
        for board, methods in shown:
            episodes.comparing.score(board, methods)

    yield Job("methods", compare, None)


ROOM = Room(
    pages=[pages.router, method_page.router, compare_page.router, play_page.router],
    showcase=Showcase,
    jobs=jobs,
)
"""Open splits, episode by episode: the walks, methods side by side, and playing oneself."""
