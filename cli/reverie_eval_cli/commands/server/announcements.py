"""``reverie-eval server news|notice COMMAND FOLDER``: what the organiser tells everyone."""

import click

from reverie_eval.schemas.organising import NewNews, NewNotice, NoticeReport
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, minute, print_list, server_folder
from reverie_eval_cli.output import note


@click.group(cls=Group)
def news() -> None:
    """Post, list and remove news, which the leaderboards show."""


@news.command()
@server_folder
@click.argument("text")
def add(*, folder: Folder, text: str) -> None:
    """Post an entry: TEXT is one line, public at once."""
    from reverie_eval.server.service.news import add_news

    new = options.checked(NewNews, text=text)
    with folder.acting() as transaction:
        added = add_news(transaction, new)
    print(f"news entry {added.id} posted")


@news.command("list")
@server_folder
def list_entries(*, folder: Folder) -> None:
    """List the entries with their numbers, the latest first."""
    from reverie_eval.server.service.news import list_news

    known = folder.all_of(list_news)
    rows = [(str(each.id), minute(each.created_at), each.text) for each in known]
    print_list(("number", "posted (UTC)", "text"), rows)


@news.command()
@server_folder
@click.argument("number", type=options.Number(1))
def remove(*, folder: Folder, number: int) -> None:
    """Remove an entry."""
    from reverie_eval.server.service.news import remove_news

    with folder.acting() as transaction:
        remove_news(transaction, number)
    print(f"news entry {number} removed")


@click.group(cls=Group)
def notice() -> None:
    """Post a banner, and pause submissions to all splits, without a restart.

    Each change is in the audit log. `server phase pause` pauses one split.
    """


@notice.command()
@server_folder
def show(*, folder: Folder) -> None:
    """Show the banner, and whether submissions are paused."""
    from reverie_eval.server.service.notices import Notices

    settings = folder.settings
    with folder.reading() as session:
        current = Notices(settings.banner, paused=settings.paused).current(session)
    print(notice_text(current))
    if current.created_at:
        print(f"posted {minute(current.created_at)} UTC")


@notice.command("set")
@server_folder
@click.argument("text")
def set_banner(*, folder: Folder, text: str) -> None:
    """Show a banner on all pages: TEXT is one line. A pause stays."""
    _change(folder, banner=options.checked(NewNotice, banner=text).banner)


@notice.command()
@server_folder
def clear(*, folder: Folder) -> None:
    """Remove the banner; that of the settings file is shown again. A pause stays."""
    _change(folder, banner="")


@notice.command()
@server_folder
def pause(*, folder: Folder) -> None:
    """Accept no submissions to any split. The banner stays, and is given as the reason."""
    _change(folder, paused=True)


@notice.command()
@server_folder
def resume(*, folder: Folder) -> None:
    """Accept submissions again, as phases allow. The banner stays."""
    if _change(folder, paused=False).paused:
        note("the settings file still pauses submissions: `paused = true`")


def _change(folder: Folder, **changes: object) -> NoticeReport:
    """Change the notice, print what applies now, and return it."""
    from reverie_eval.server.service.notices import Notices

    settings = folder.settings
    with folder.acting() as transaction:
        notices = Notices(settings.banner, paused=settings.paused)
        current = notices.change(transaction, **changes)
    print(notice_text(current))
    return current


def notice_text(current: NoticeReport) -> str:
    """Write a notice on one line."""
    banner = f"; banner: {current.banner}" if current.banner else ""
    return f"{'paused' if current.paused else 'not paused'}{banner}"
