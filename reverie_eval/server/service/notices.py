"""What the organiser tells everybody, and whether submissions are taken, without a restart.

The latest notice holds. Below it are the settings: their banner is shown where a notice has none,
and a server that is paused there stays paused, whatever a notice says.
"""

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.server.service.audit import record
from reverie_eval.server.service.lines import demand_line
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Notice


@dataclass(frozen=True, slots=True)
class Standing:
    """What holds now."""

    banner: str
    """Empty if there is nothing to say."""
    paused: bool


class Notices:
    """What is posted above what the settings say."""

    def __init__(self, database: Database, settled: Standing) -> None:
        self._database = database
        self.settled = settled
        """What the settings say; holds where the database cannot be asked."""

    def now(self) -> Standing:
        """Return what holds."""
        with self._database.reading() as session:
            return self.standing(session)

    def standing(self, session: Session) -> Standing:
        """Return what holds in a session."""
        posted = latest_notice(session)
        return self.settled if posted is None else self.above_settings(posted.banner, posted.paused)

    def above_settings(self, banner: str, paused: bool) -> Standing:  # noqa: FBT001  # as posted
        """Return what would hold if this were posted."""
        return Standing(banner or self.settled.banner, paused or self.settled.paused)


def post_notice(
    session: Session, banner: str, *, paused: bool, now: datetime, actor: str
) -> Notice:
    """Say something to everybody, or nothing; pause submissions, or take them again.

    Raises
    ------
    MalformedError
        If the banner is no line.
    """
    refusal = "a banner is one line of up to 500 letters that can be seen"
    posted = Notice(
        banner=demand_line(banner, refusal) if banner.strip() else "",
        paused=paused,
        posted_by=actor,
        created_at=now,
    )
    session.add(posted)
    session.flush()
    record(session, now, actor, "notice posted", "server", banner=posted.banner, paused=paused)
    return posted


def latest_notice(session: Session) -> Notice | None:
    """Return the notice that holds, if any was posted."""
    return session.scalars(select(Notice).order_by(Notice.id.desc()).limit(1)).first()
