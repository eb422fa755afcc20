"""What messages to the organiser add to the server."""

from collections.abc import Iterable
from functools import partial

from reverie_eval.server.jobs import SOON, Job
from reverie_eval.server.messages.queue import backlog_of
from reverie_eval.server.rooms import Room
from reverie_eval.server.state import ServerState


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield a job for each channel, which delivers its messages."""
    database, settings = server.database, server.settings
    if not settings.channels:
        return
    from reverie_eval.server.messages.delivery import deliver  # clients of SMTP and HTTP

    for channel in settings.channels:
        work = partial(deliver, database, settings, channel, server.clock)
        yield Job(channel, work, SOON, partial(backlog_of, channel))


ROOM = Room(jobs=jobs)
