"""``reverie-eval server phase|news|snapshot``: when splits are open, and what is announced."""

from datetime import datetime
from typing import TYPE_CHECKING, get_args

import click

from reverie_eval.schemas.organising import (
    NewNews,
    NewNotice,
    NewSchedule,
    NewSnapshot,
    NoticeReport,
)
from reverie_eval.schemas.service import ReleaseScores, Schedule
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, actor, minute, print_list, server_folder

if TYPE_CHECKING:
    from reverie_eval.server.boards.schedules import Change, Timetable


split = click.argument("split")


@click.group(cls=Group)
def phase() -> None:
    """Show and change phases, and pause splits.

    No restart is needed. Each change is in the audit log.
    """


@phase.command()
@server_folder
def show(*, folder: Folder) -> None:
    """Show what is in effect, and what set it.

    Phases, when scores are shown, pauses and the banner: as in the settings file, as set at the
    desk or by commands, and as they are in effect.
    """
    from reverie_eval.server.boards.schedules import Schedules
    from reverie_eval.server.messages.notices import current_notice

    with folder.reading() as session:
        reports = Schedules(folder.settings.splits).list_all(session)
        notice = current_notice(session)
    # Side by side, because what the desk has set overrides the file.
    rows = [
        (each.split, _text(each.settings), _text(each.desk), _text(each.in_effect))
        for each in reports
    ]
    text = _notice_text(notice)
    of_all = ("all splits", "-", text if notice.created_at else "-", text)
    print_list(("of", "settings file", "desk", "in effect"), [of_all, *rows])


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
    from reverie_eval.server.boards.schedules import with_phase

    # Applied within the transaction to what is there then: of two changes at once, none is lost.
    def change(timetable: "Timetable", _: datetime) -> NewSchedule:
        fields = with_phase(timetable.latest, name, opens, closes, release_scores)
        return options.checked(NewSchedule, **fields)

    _change_schedule(folder, split, change)


@phase.command()
@server_folder
@split
def close(*, folder: Folder, split: str) -> None:
    """End the open phases of a split now."""
    from reverie_eval.server.boards import schedules

    _change_schedule(folder, split, schedules.close)


@phase.command()
@server_folder
@split
def reset(*, folder: Folder, split: str) -> None:
    """Use the phases and `release_scores` of the settings file again."""
    from reverie_eval.server.boards import schedules

    _change_schedule(folder, split, schedules.reset)


@phase.command()
@server_folder
@click.argument("split", required=False)
def pause(*, folder: Folder, split: str | None) -> None:
    """Pause SPLIT, or all splits, whatever phases say.

    Uploads are refused with the banner as the reason; `server news banner` sets it.
    """
    from reverie_eval.server.boards import schedules

    if split:
        _change_schedule(folder, split, schedules.pause)
    else:
        _change_notice(folder, paused=True)


@phase.command()
@server_folder
@click.argument("split", required=False)
def resume(*, folder: Folder, split: str | None) -> None:
    """End a pause of SPLIT, or of all splits."""
    from reverie_eval.server.boards import schedules

    if split:
        _change_schedule(folder, split, schedules.resume)
    else:
        _change_notice(folder, paused=False)


def _change_schedule(folder: Folder, split: str, change: "Change") -> None:
    """Change the schedule of a split, and print what applies now."""
    from reverie_eval.server.boards.schedules import Schedules

    with folder.acting() as transaction:
        effect = Schedules(folder.settings.splits).change(transaction, split, change)
    print(f"{split}: {_text(effect.after)}")
    # What was shown cannot be held back again.
    if effect.shown:
        print(f"{split}: scores held back until now are shown: {effect.shown}")


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
    from reverie_eval.server.corrections.snapshots import Snapshots

    new = options.checked(NewSnapshot, split=split, title=title)
    # The whole server, not its database alone: a snapshot is signed with its key.
    with folder.open() as state, state.transactions.begin(actor()) as transaction:
        taken = state.get(Snapshots).take(transaction, new)
    print(f"{split}: snapshot {taken.number}, {taken.title}, as of {minute(taken.as_of)} UTC")
    print(f"it stays at /splits/{split}/snapshots/{taken.number}")


@click.group(cls=Group)
def news() -> None:
    """Post, list and remove news, and set the banner."""


@news.command()
@server_folder
@click.argument("text")
def add(*, folder: Folder, text: str) -> None:
    """Post an entry: TEXT is one line, public at once."""
    from reverie_eval.server.boards.news import add_news

    new = options.checked(NewNews, text=text)
    with folder.acting() as transaction:
        added = add_news(transaction, new)
    print(f"news entry {added.id} posted")


@news.command("list")
@server_folder
def list_entries(*, folder: Folder) -> None:
    """List the entries with their numbers, the latest first."""
    from reverie_eval.server.boards.news import list_news

    # Numbers are shown because `news remove` takes them.
    known = folder.all_of(list_news)
    rows = [(str(each.id), minute(each.created_at), each.text) for each in known]
    print_list(("number", "posted (UTC)", "text"), rows)


@news.command()
@server_folder
@click.argument("number", type=options.Number(1))
def remove(*, folder: Folder, number: int) -> None:
    """Remove an entry."""
    from reverie_eval.server.boards.news import remove_news

    with folder.acting() as transaction:
        remove_news(transaction, number)
    print(f"news entry {number} removed")


@news.command()
@server_folder
@click.argument("text")
def banner(*, folder: Folder, text: str) -> None:
    """Show a banner on all pages: TEXT is one line.

    An empty TEXT removes it.
    """
    # Checked first, as the pages check it: a banner has to fit on a line.
    _change_notice(folder, banner=options.checked(NewNotice, banner=text).banner)


def _change_notice(folder: Folder, **changes: object) -> None:
    """Change the notice, and print what applies now."""
    from reverie_eval.server.messages.notices import change_notice

    with folder.acting() as transaction:
        current = change_notice(transaction, **changes)
    print(_notice_text(current))


def _notice_text(current: NoticeReport) -> str:
    """Write a notice on one line."""
    banner = f"; banner: {current.banner}" if current.banner else ""
    return f"{'paused' if current.paused else 'not paused'}{banner}"
