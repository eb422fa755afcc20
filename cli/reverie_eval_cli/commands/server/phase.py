"""``reverie-eval server phase set|close|reset|pause|resume``, ``diff`` and ``snapshot``."""

from datetime import datetime
from typing import TYPE_CHECKING, get_args

import click

from reverie_eval.schemas.organising import NewSchedule, NewSnapshot, NoticeReport
from reverie_eval.schemas.service import ReleaseScores, Schedule
from reverie_eval_cli import options
from reverie_eval_cli.commands.server.announcements import notice_text
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, actor, minute, print_list, server_folder

if TYPE_CHECKING:
    from reverie_eval.server.service.schedules import Change, Timetable

split = click.argument("split")


@click.group(cls=Group)
def phase() -> None:
    """Open, close and extend phases, and pause splits, without a restart.

    `server diff` shows what applies. Each change is in the audit log.
    """


@phase.command("set")
@server_folder
@split
@click.argument("name")
@click.option(
    "--opens",
    type=options.DayOrTime(),
    help="Its first second: 2027-01-01T00:00:00Z, or a day in UTC.",
)
@click.option(
    "--closes",
    type=options.DayOrTime(),
    help="Its last second: 2027-06-01T23:59:59Z, or a date in UTC, which means the whole day.",
)
@click.option(
    "--release-scores",
    type=options.Choice(get_args(ReleaseScores)),
    help="When scores of the split are shown. Those that are shown already stay visible.",
)
def set_phase(
    *,
    folder: Folder,
    split: str,
    name: str,
    opens: str | None,
    closes: str | None,
    release_scores: ReleaseScores | None,
) -> None:
    """Add a phase, or open or extend the phase of that NAME.

    Options that you omit leave the phase as it is. From then on, the phases of SPLIT in the
    settings file do not apply, until `server phase reset`.
    """
    from reverie_eval.server.service.schedules import with_phase

    def change(timetable: "Timetable", _: datetime) -> NewSchedule:
        fields = with_phase(timetable.latest, name, opens, closes, release_scores)
        return options.checked(NewSchedule, **fields)

    _change(folder, split, change)


@phase.command()
@server_folder
@split
def close(*, folder: Folder, split: str) -> None:
    """End the open phases of a split now."""
    from reverie_eval.server.service import schedules

    _change(folder, split, schedules.close)


@phase.command()
@server_folder
@split
def reset(*, folder: Folder, split: str) -> None:
    """Use the phases and `release_scores` of the settings file again."""
    from reverie_eval.server.service import schedules

    _change(folder, split, schedules.reset)


@phase.command()
@server_folder
@split
def pause(*, folder: Folder, split: str) -> None:
    """Accept no submissions to a split, whatever its phases say."""
    from reverie_eval.server.service import schedules

    _change(folder, split, schedules.pause)


@phase.command()
@server_folder
@split
def resume(*, folder: Folder, split: str) -> None:
    """Accept submissions to a split again."""
    from reverie_eval.server.service import schedules

    _change(folder, split, schedules.resume)


def _change(folder: Folder, split: str, change: "Change") -> None:
    """Change the schedule of a split, and print what applies now."""
    from reverie_eval.server.service.schedules import Schedules

    with folder.acting() as transaction:
        effect = Schedules(folder.settings.splits).change(transaction, split, change)
    print(f"{split}: {_text(effect.after)}")
    if effect.shown:
        print(f"{split}: scores held back until now are shown: {effect.shown}")


@click.command()
@server_folder
def diff(*, folder: Folder) -> None:
    """Compare the settings file with what the desk has set.

    Shows phases, the release of scores and pauses, and what is in effect.
    """
    from reverie_eval.server.service.notices import Notices
    from reverie_eval.server.service.schedules import Schedules

    settings = folder.settings
    notices = Notices(settings.banner, paused=settings.paused)
    with folder.reading() as session:
        reports = Schedules(settings.splits).list_all(session)
        notice = notices.current(session)
    rows = [
        (each.split, _text(each.settings), _text(each.desk), _text(each.in_effect))
        for each in reports
    ]
    posted = notice if notice.created_at else None
    standing = [_of_server(each) for each in (notices.of_settings, posted, notice)]
    print_list(("of", "settings file", "desk", "in effect"), [("all splits", *standing), *rows])


def _of_server(notice: NoticeReport | None) -> str:
    return "-" if notice is None else notice_text(notice)


def _text(schedule: "Schedule | NewSchedule | None") -> str:
    """Write a schedule on one line."""
    if schedule is None:
        return "-"
    words = [f"{each.name} {each.period}".rstrip() for each in schedule.phases or ()]
    if schedule.release_scores == "phase-end":
        words.append("scores shown when the phase ends")
    if schedule.paused:
        words.append("paused")
    return ", ".join(words)


@click.command()
@server_folder
@split
@click.option("--title", required=True, metavar="TEXT", help="Shown on the leaderboard.")
def snapshot(*, folder: Folder, split: str, title: str) -> None:
    """Take a signed snapshot of a leaderboard.

    It is public at once and never changes: reviews in it keep the organiser's name that the
    settings have now (`organiser`). When a phase has ended, the server takes one automatically.
    """
    new = options.checked(NewSnapshot, split=split, title=title)
    with folder.open() as state, state.transactions.begin(actor()) as transaction:
        taken = state.snapshots.take(transaction, new)
    print(f"{split}: snapshot {taken.number}, {taken.title}, as of {minute(taken.as_of)} UTC")
    print(f"it stays at /boards/{split}/snapshots/{taken.number}")
