"""What submissions add to the server."""

from collections.abc import Iterable, Mapping
from datetime import datetime
from functools import partial

from sqlalchemy.orm import Session

from reverie_eval.server.audit.log import SERVER
from reverie_eval.server.intake import desk, pages, routes
from reverie_eval.server.intake.retention import Retention
from reverie_eval.server.jobs import DAY, Job
from reverie_eval.server.rooms import Room, Tab
from reverie_eval.server.state import ServerState


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that deletes old uploads, if the settings limit their age."""
    retention = server.get(Retention)

    def waiting(session: Session, now: datetime) -> Mapping[str, int]:
        return {"files": retention.count_expired(session, now)}

    if server.settings.keep_uploads_days is not None:
        yield Job("tidying", partial(retention.tidy, SERVER), DAY, waiting)


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
