"""What the first page and the guide add to the server."""

from collections.abc import Iterable

from reverie_eval.server.errors import BusyError
from reverie_eval.server.home import guide_page, pages
from reverie_eval.server.jobs import Job
from reverie_eval.server.rooms import Room
from reverie_eval.server.state import ServerState


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that fills the caches of pages, so that their first readers need not wait."""

    def warm_up() -> None:
        try:
            pages.warm_up(server)
        except BusyError:  # a scoring process was killed; another has taken its place
            pages.warm_up(server)
        finally:
            server.warming.clear()

    yield Job("warm-up", warm_up, None)


ROOM = Room(pages=[pages.router, guide_page.router], jobs=jobs)
