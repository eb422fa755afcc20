"""When splits accept submissions and show scores: by the settings, or as set at the desk.

Scores that are held back until a phase ends are computed and stored when a submission arrives, as
usual. Until they are released, nothing that leaves the server contains them, including the receipt,
which is signed without scores each time. If a phase is extended before it ends, scores are held
back until its new end.

A schedule that is set at the desk applies at once on all servers of the database, because each
request reads it from there. The latest schedule of a split applies. The earlier ones show what
applied when a submission arrived, and whether its scores have been shown since: scores that were
shown stay visible.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Any, NamedTuple, Self, TypeAlias, TypeVar
from urllib.parse import quote

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import NewSchedule, ScheduleReport
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import (
    BoardResult,
    Phase,
    Receipt,
    ReleaseScores,
    Schedule,
    ScoredSubmission,
    last_moment,
)
from reverie_eval.server.audit.signing import Signer, read_as
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import ConflictError, no_split
from reverie_eval.server.messages.queue import messages_of
from reverie_eval.server.settings import Channel, Split
from reverie_eval.server.state import Reading, ServerState
from reverie_eval.server.store.tables import Message, SetSchedule, Submission, read_stored

SCHEDULE_SET = "schedule set"
RECENT = timedelta(days=1)
"""How long after a phase a server that was off at its end still announces the end."""
_MOMENT = timedelta.resolution
Result = TypeVar("Result", BoardResult, ScoredSubmission)
_ROWS = "schedules"
"""Where a database session keeps the schedules that it has read."""


@dataclass(frozen=True, slots=True)
class Timetable:
    """All schedules that a split has had, the earliest first."""

    settings: Schedule
    """The schedule of the settings, which applied before any was set."""
    rows: Sequence[SetSchedule]

    def at(self, moment: datetime) -> Schedule:
        """Return the schedule that applied at a moment."""
        earlier = [row for row in self.rows if row.created_at <= moment]
        return self._of(earlier[-1]) if earlier else self.settings

    @property
    def latest(self) -> Schedule:
        """The schedule that applies now."""
        return self._of(self.rows[-1]) if self.rows else self.settings

    @property
    def desk(self) -> NewSchedule:
        """The schedule that was set at the desk."""
        return read_stored(NewSchedule, self.rows[-1]) if self.rows else NewSchedule()

    def held_until(
        self, received_at: datetime, scored_at: datetime, now: datetime
    ) -> datetime | None:
        """Return the last second in which scores of a submission are held back.

        None if they are shown, or have been at any time since it was scored. A file that came by
        e-mail may be scored long after it was received; until then, nobody could see its scores.
        """
        until = None
        for schedule, ends in self._periods(scored_at, now):
            until = schedule.held_until(received_at)
            if until is None or ends > last_moment(until):
                return None
        return until

    def _periods(self, since: datetime, now: datetime) -> Iterator[tuple[Schedule, datetime]]:
        """Yield each schedule that has applied since a moment, and when it ended."""
        changes = [row.created_at for row in self.rows if since < row.created_at <= now]
        for begins, ends in pairwise([since, *changes, now]):
            yield self.at(begins), ends

    def with_one_more(self, row: SetSchedule) -> "Timetable":
        """Return the timetable with one more schedule."""
        return Timetable(self.settings, [*self.rows, row])

    def report(self, split: str) -> ScheduleReport:
        """Report the schedules of the settings and of the desk, and the one in effect."""
        row = self.rows[-1] if self.rows else None
        return ScheduleReport(
            split=split,
            settings=self.settings,
            desk=None if self.desk == NewSchedule() else self.desk,
            in_effect=self.latest,
            set_at=row and row.created_at,
        )

    def _of(self, row: SetSchedule) -> Schedule:
        if row.phases is None:
            return self.settings.model_copy(update={"paused": row.paused})
        return read_stored(Schedule, row)


Change: TypeAlias = Callable[[Timetable, datetime], NewSchedule]
"""Returns what to set, given the schedules that a split has had and the time."""


class Effect(NamedTuple):
    """What a change of a split's schedule does."""

    new: NewSchedule
    before: Schedule
    """The schedule that applied before the change."""
    after: Schedule
    shown: int
    """The number of submissions whose scores were held back and are then shown."""


class Schedules:
    """The schedules of all splits."""

    def __init__(self, splits: Mapping[str, Split]) -> None:
        self._splits = splits

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return the schedules of a server."""
        return cls(server.settings.splits)

    def read(self, session: Session) -> Mapping[str, Timetable]:
        """Return the timetable of every split."""
        rows = _rows(session)
        return {
            name: Timetable(
                # Not validated again: the settings are.
                Schedule.model_construct(
                    phases=split.phases, release_scores=split.release_scores, paused=False
                ),
                rows.get(name, ()),
            )
            for name, split in self._splits.items()
        }

    def in_effect(self, session: Session) -> Mapping[str, Schedule]:
        """Return the schedule of every split that applies now."""
        return {name: timetable.latest for name, timetable in self.read(session).items()}

    def list_all(self, session: Session) -> list[ScheduleReport]:
        """Report the schedules of the settings, of the desk, and in effect, for every split."""
        return [timetable.report(name) for name, timetable in self.read(session).items()]

    def of_split(self, session: Session, split: str) -> Timetable:
        """Return the timetable of a split. Raises NotFoundError if the server has no such split."""
        timetable = self.read(session).get(split)
        if timetable is None:
            raise no_split(split, self._splits)
        return timetable

    def set(self, transaction: Transaction, split: str, new: NewSchedule) -> ScheduleReport:
        """Set when a split accepts submissions and shows scores, or return to the settings.

        Raises
        ------
        NotFoundError
            If the server has no such split.
        ConflictError
            If phases overlap, or scores would be held back for ever, or on a split whose solution
            are public.
        """
        timetable = self.of_split(transaction.session, split)
        row = self._row(timetable, split, new, transaction.now)
        del transaction.session.info[_ROWS]
        transaction.record(SCHEDULE_SET, row, split, **new.model_dump(mode="json"))
        return timetable.with_one_more(row).report(split)

    def change(self, transaction: Transaction, split: str, change: Change) -> Effect:
        """Set what a change makes of the latest schedule; raises the errors of :meth:`set`."""
        effect = self.if_changed(transaction.session, split, change, transaction.now)
        self.set(transaction, split, effect.new)
        return effect

    def if_changed(self, session: Session, split: str, change: Change, now: datetime) -> Effect:
        """Return what a change would do. Raises the errors of :meth:`set`."""
        timetable = self.of_split(session, split)
        new = change(timetable, now)
        changed = timetable.with_one_more(self._row(timetable, split, new, now))
        times = select(Submission.received_at, Submission.scored_at)
        shown = [
            timetable.held_until(received, scored, now) is not None
            and changed.held_until(received, scored, now) is None
            for received, scored in session.execute(times.where(Submission.split == split))
        ]
        return Effect(new, timetable.latest, changed.latest, sum(shown))

    def _row(
        self, timetable: Timetable, split: str, new: NewSchedule, now: datetime
    ) -> SetSchedule:
        known = timetable.latest
        is_changed = (new.phases, new.release_scores) != (known.phases, known.release_scores)
        # A pause is possible whatever the phases are: an earlier version accepted more of them.
        if is_changed and new.phases is not None and new.release_scores is not None:
            self._check(split, new.phases, new.release_scores)
        fields = new.model_dump(mode="json")
        return SetSchedule(split=split, **fields, created_at=now)

    def _check(self, split: str, phases: Sequence[Phase], release_scores: ReleaseScores) -> None:
        try:
            self._splits[split].check_phases(phases, release_scores)
        except ValueError as error:
            remedy = "change it at /desk/phases or with `reverie-eval server phase set`"
            raise ConflictError(f"{error}; {remedy}") from None


def _rows(session: Session) -> Mapping[str, Sequence[SetSchedule]]:
    """Return the schedules of each split, the earliest first; read once in a transaction."""
    if _ROWS not in session.info:
        rows = defaultdict(list)
        for row in session.scalars(select(SetSchedule).order_by(SetSchedule.id)):
            rows[row.split].append(row)
        session.info[_ROWS] = rows
    return session.info[_ROWS]  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class View:
    """What may be seen of submissions at a moment: no scores that are held back."""

    timetables: Mapping[str, Timetable]
    signer: Signer
    now: datetime

    @classmethod
    def of(cls, reading: Reading) -> Self:
        """Return what may be seen in a reading of the database."""
        server = reading.server
        timetables = server.get(Schedules).read(reading.session)
        return cls(timetables, server.signer, reading.now)

    def held_until(self, row: Submission) -> datetime | None:
        """Return the last second in which a submission's scores are held back, if they are now."""
        timetable = self.timetables.get(row.split)
        if timetable is None:
            return None
        return timetable.held_until(row.received_at, row.scored_at, self.now)

    def score_report(self, row: Submission) -> ScoreReport:
        """Return a submission's report, with its scores unless they are held back."""
        known = read_stored(ScoreReport, row.report)
        return known if self.held_until(row) is None else without_scores(known)

    def report(self, row: Submission) -> ScoredSubmission:
        """Return a submission as its team may see it."""
        known, until = row.as_scored(), self.held_until(row)
        if until is None:
            return known
        held = {"boards": self.boards(row), "scores_held_until": until}
        return self._withheld(known).model_copy(update=held)

    def boards(self, row: Submission) -> Mapping[str, BoardResult]:
        """Return a submission's results on other leaderboards, unless scores are held back."""
        known = {name: result for name, result in row.results.items() if name}
        if self.held_until(row) is None:
            return known
        return {name: self._withheld(result) for name, result in known.items()}

    def _withheld(self, result: Result) -> Result:
        """Return a result, or a submission with its own result, without scores."""
        known = read_as(Receipt, result.receipt)
        receipt = self.signer.sign(known.model_copy(update={"scores": {}}))
        held = {"report": without_scores(result.report), "receipt": receipt, "earlier": []}
        return result.model_copy(update=held)


def without_scores(report: ScoreReport) -> ScoreReport:
    """Return a private split's report without its scores."""
    return report.model_copy(update={"scores": {}})


def with_phase(
    schedule: Schedule,
    name: str,
    opens: str | None,
    closes: str | None,
    release_scores: ReleaseScores | None,
) -> Mapping[str, Any]:
    """Return the fields of a schedule with a phase added, or changed if there is one of this name.

    What is None stays as it was.
    """
    phases = {phase.name: phase.model_dump() for phase in schedule.phases}
    given = {"opens": opens, "closes": closes}
    phases[name] = {
        **phases.get(name, {"name": name}),
        **{side: moment for side, moment in given.items() if moment is not None},
    }
    return {
        "phases": list(phases.values()),
        "release_scores": release_scores or schedule.release_scores,
        "paused": schedule.paused,
    }


def pause(timetable: Timetable, _: datetime) -> NewSchedule:
    """Accept no submissions, whatever the phases say."""
    return timetable.desk.model_copy(update={"paused": True})


def resume(timetable: Timetable, _: datetime) -> NewSchedule:
    """Accept submissions again."""
    return timetable.desk.model_copy(update={"paused": False})


def reset(timetable: Timetable, _: datetime) -> NewSchedule:
    """Use the phases and the release of scores of the settings again."""
    return timetable.desk.model_copy(update={"phases": None, "release_scores": None})


def close(timetable: Timetable, now: datetime) -> NewSchedule:
    """End the open phases now: what arrives from this moment on is too late.

    Raises ConflictError if none is open.
    """
    schedule = timetable.latest
    if not schedule.is_open(now):
        raise ConflictError("no phase is open")
    end = now - _MOMENT
    if not end.microsecond:  # it would stand for the whole second
        end -= _MOMENT
    phases = [
        phase.model_copy(update={"closes": max(end, _earliest_end(phase))})
        if phase.is_open(now)
        else phase
        for phase in schedule.phases
    ]
    return NewSchedule(
        phases=tuple(phases), release_scores=schedule.release_scores, paused=schedule.paused
    )


def _earliest_end(phase: Phase) -> datetime:
    """Return the earliest end that a phase may have."""
    return datetime.min.replace(tzinfo=UTC) if phase.opens is None else phase.opens + _MOMENT


def untold_ends(
    session: Session, schedules: Schedules, channels: Mapping[str, Channel], now: datetime
) -> Mapping[str, str]:
    """Return the messages about phases that ended in the last day, each with its split.

    No transaction announces the end of a phase, because nothing is written when it passes.
    """
    if not any(channel.wants("phase-end") for channel in channels.values()):
        return {}
    ends = {
        f"the phase {phase.name} of {split} ended at {phase.closes:%Y-%m-%d %H:%M} UTC": split
        for split, schedule in schedules.in_effect(session).items()
        for phase in schedule.phases
        if phase.closes is not None and last_moment(phase.closes) < now
        if now - phase.closes < RECENT
    }
    told = select(Message.text).where(Message.event == "phase-end", Message.text.in_(ends))
    known = set(session.scalars(told))
    return {text: split for text, split in ends.items() if text not in known}


def notify_of_ends(
    session: Session, schedules: Schedules, channels: Mapping[str, Channel], now: datetime
) -> None:
    """Notify the organiser of phases that have ended."""
    for text, split in untold_ends(session, schedules, channels, now).items():
        path = f"/splits/{quote(split)}"
        session.add_all(messages_of(channels, now, "phase-end", text, path))
    session.flush()
