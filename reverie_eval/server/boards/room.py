"""What leaderboards add to the server."""

from collections.abc import Iterable, Mapping
from datetime import datetime

from sqlalchemy.orm import Session

from reverie_eval.server.boards import desk, pages
from reverie_eval.server.boards.schedules import Schedules, notify_of_ends, untold_ends
from reverie_eval.server.jobs import SOON, Job
from reverie_eval.server.rooms import Room, Tab
from reverie_eval.server.state import ServerState


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that announces ends of phases, if the settings have a channel for messages."""
    schedules, channels = server.get(Schedules), server.settings.channels

    def waiting(session: Session, now: datetime) -> Mapping[str, int]:
        return {"ends": len(untold_ends(session, schedules, channels, now))}

    def work() -> None:
        with server.database.reading() as session:
            if not untold_ends(session, schedules, channels, server.clock()):
                return
        with server.database.writing() as session:
            notify_of_ends(session, schedules, channels, server.clock())

    if channels:
        yield Job("phase ends", work, SOON, waiting)


ROOM = Room(
    routes=[pages.routes, pages.news_routes, desk.routes],
    pages=[pages.router, desk.pages],
    jobs=jobs,
    desk=[
        Tab("Results", 1, "Reviews", "/desk/reviews"),
        Tab("Results", 4, "Reported results", "/desk/reported"),
        Tab("In public", 1, "Phases", "/desk/phases"),
        Tab("In public", 2, "News", "/desk/news"),
        Tab("In public", 3, "Notice", "/desk/notice"),
    ],
)
