"""What watching over itself adds to the server."""

from collections.abc import Iterable

from reverie_eval.server.jobs import MINUTE, SECOND, Job
from reverie_eval.server.operations import desk
from reverie_eval.server.rooms import Room, Tab
from reverie_eval.server.state import ServerState


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the jobs that follow corrected ground truth and look for damage."""

    def follow_rules() -> None:  # uploads and leaderboards do not wait for this
        with server.database.reading() as session:
            server.rules.follow(session)

    def search_for_damage() -> None:
        server.database_watch.search()
        server.uploads_watch.search()

    yield Job("ground-truth", follow_rules, SECOND)
    yield Job("damage", search_for_damage, MINUTE)


ROOM = Room(
    pages=[desk.router],
    jobs=jobs,
    desk=[
        Tab("Today", 1, "Overview", "/desk"),
    ],
)
