"""What submissions add to the server."""

from collections.abc import Iterable, Mapping
from datetime import datetime, timedelta
from functools import partial

from sqlalchemy.orm import Session

from reverie_eval.server.intake import desk, pages, routes
from reverie_eval.server.intake.retention import expired, tidy
from reverie_eval.server.jobs import DAY, Job
from reverie_eval.server.rooms import Room, Tab
from reverie_eval.server.state import ServerState


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that deletes old uploads, if the settings limit their age."""
    days = server.settings.keep_uploads_days
    if days is None:
        return

    def waiting(session: Session, now: datetime) -> Mapping[str, int]:
        return {"files": len(expired(session, now - timedelta(days=days)))}

    yield Job("tidying", partial(tidy, server, days), DAY, waiting)


ROOM = Room(
    routes=[routes.splits, routes.router, desk.routes],
    pages=[pages.router, desk.pages],
    jobs=jobs,
    desk=[
        Tab("Today", 2, "Upload attempts", "/desk/attempts"),
        Tab("Results", 5, "E-mailed files", "/desk/emailed-files"),
        Tab("Participants", 2, "Quotas", "/desk/quotas"),
    ],
)
