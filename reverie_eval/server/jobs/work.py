"""The jobs of a server."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime
from functools import partial

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from reverie_eval.server.errors import BusyError, RequestError
from reverie_eval.server.jobs.delivery import deliver
from reverie_eval.server.jobs.runner import Job, Jobs
from reverie_eval.server.service.audit import SERVER
from reverie_eval.server.service.outbox import (
    announce_ends,
    announce_fault,
    backlog_of,
    untold_ends,
)
from reverie_eval.server.state import ServerState

_SECOND, _SOON, _MINUTE, _DAY = 1, 10, 60, 24 * 60 * 60
"""Seconds between two runs."""


def jobs_of(server: ServerState, warm_up: Callable[[], object]) -> Jobs:
    """Return the jobs of a server.

    ``warm_up`` computes what pages keep, so that their first readers need not wait for it.
    """
    jobs = [*_jobs(server, warm_up)]
    return Jobs(jobs, server.database, server.clock, partial(tell_fault, server))


def tell_fault(server: ServerState, text: str) -> None:
    """Notify the organiser of a fault, unless the fault prevents it, or no channel is set up."""
    if not server.settings.channels:
        return
    with (
        suppress(SQLAlchemyError, RequestError),
        server.transactions.begin(SERVER) as transaction,
    ):
        announce_fault(transaction, text)


def _jobs(server: ServerState, warm_up: Callable[[], object]) -> Iterator[Job]:
    snapshots, retention, settings = server.snapshots, server.retention, server.settings

    def snapshots_due(session: Session, now: datetime) -> Mapping[str, int]:
        return {"due": len(snapshots.due(session, now))}

    def uploads_to_delete(session: Session, now: datetime) -> Mapping[str, int]:
        return {"files": retention.count_expired(session, now)}

    def ends_to_announce(session: Session, now: datetime) -> Mapping[str, int]:
        return {"ends": len(untold_ends(session, server.schedules, settings.channels, now))}

    def search_for_damage() -> None:
        server.database_watch.search()
        server.uploads_watch.search()

    def warm_up_once() -> None:
        try:
            warm_up()
        except BusyError:  # a scoring process was killed; another has taken its place
            warm_up()
        finally:
            server.warming.clear()

    yield Job("warm-up", warm_up_once, None)
    yield Job("ground-truth", partial(_follow_rules, server), _SECOND)
    yield Job("damage", search_for_damage, _MINUTE)
    yield Job(
        "snapshots", partial(snapshots.take_if_due, server.transactions), _MINUTE, snapshots_due
    )
    if settings.keep_uploads_days is not None:
        yield Job("tidying", partial(retention.tidy, SERVER), _DAY, uploads_to_delete)
    if settings.channels:
        yield Job("phase ends", partial(_announce_ends, server), _SOON, ends_to_announce)
    for channel in settings.channels:
        yield Job(
            channel,
            partial(deliver, server.database, settings, channel, server.clock),
            _SOON,
            partial(backlog_of, channel),
        )


def _announce_ends(server: ServerState) -> None:
    schedules, channels = server.schedules, server.settings.channels
    with server.database.reading() as session:
        if not untold_ends(session, schedules, channels, server.clock()):
            return
    with server.database.writing() as session:
        announce_ends(session, schedules, channels, server.clock())


def _follow_rules(server: ServerState) -> None:
    """Use corrected ground truth; uploads and leaderboards do not wait for this."""
    with server.database.reading() as session:
        server.rules.follow(session)
