"""``reverie-eval server news add|list|remove FOLDER``."""

import click

from reverie_eval.schemas.organising import NewNews
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, minute, print_list, server_folder


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
