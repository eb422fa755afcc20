"""``reverie-eval leaderboard --server URL``: what teams have published."""

import click

from reverie_eval import ReverieEvalError
from reverie_eval.metrics import CATALOGUE
from reverie_eval.tasks import name_on_server
from reverie_eval_cli import options
from reverie_eval_cli.output import show
from reverie_eval_cli.servers import ServerOptions, print_banner, server_options

_RANKED = [key for key, metric in CATALOGUE.items() if metric.better != "neither"]


@click.command()
@server_options
@click.option("--split", help="Whose leaderboard.  [default: the server's first split]")
@options.server_task
@click.option("--board", default="", metavar="NAME", help="A further leaderboard of the split.")
@click.option(
    "--metric",
    type=options.Choice(_RANKED),
    metavar="KEY",
    help=f"Rank by this metric: {', '.join(_RANKED)}.  [default: the leaderboard's primary one]",
)
@options.layout("table", "json", "csv")
@options.output("the leaderboard")
def leaderboard(
    *,
    server: ServerOptions,
    split: str | None,
    task: str,
    board: str,
    metric: str | None,
    layout: str,
    output: str | None,
) -> None:
    """Show a server's leaderboard."""
    from reverie_eval.reporting.service import leaderboard_text, print_leaderboard
    from reverie_eval.text import printable

    with server.connect() as client:
        print_banner(client)
        if not split:
            splits = client.splits()
            if not splits:
                raise ReverieEvalError(f"{client.url} has no split that accepts submissions")
            name = splits[0].name
        else:
            name = name_on_server(task, split)
        if layout == "csv":
            lines = client.leaderboard_csv(name, metric, board=board).splitlines()
            show(lambda: "\n".join(map(printable, lines)), output)
            return
        found = client.leaderboard(name, metric, board=board)
    if layout == "json":
        show(lambda: found.model_dump_json(indent=2, ensure_ascii=True), output)
    else:
        show(
            lambda: leaderboard_text(found),
            output,
            lambda console: print_leaderboard(console, found),
        )
