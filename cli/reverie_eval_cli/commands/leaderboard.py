"""``reverie-eval leaderboard --server URL``: what teams have published."""

import argparse
import sys
from typing import TYPE_CHECKING

from reverie_eval import CATALOGUE, ReverieEvalError
from reverie_eval.metrics import PRIMARY_METRIC
from reverie_eval_cli.servers import add_server, connect, tell_banner

if TYPE_CHECKING:
    from reverie_eval.client import Client
    from reverie_eval.schemas.service import Leaderboard

SUMMARY = "show what is published on an evaluation server"

_RANKED = [key for key, metric in CATALOGUE.items() if metric.better != "neither"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server(parser)
    parser.add_argument("--split", help="whose board (default: the first that the server has)")
    parser.add_argument(
        "--metric",
        choices=_RANKED,
        default=PRIMARY_METRIC,
        metavar="KEY",
        help=f"to rank by: {', '.join(_RANKED)} (default: %(default)s)",
    )
    parser.add_argument(
        "--format", choices=("table", "json", "csv"), default="table", help="(default: %(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the leaderboard."""
    from reverie_eval.text import printable

    with connect(arguments) as client:
        tell_banner(client)
        split = arguments.split or _first_split(client)
        if arguments.format == "csv":
            lines = client.leaderboard_csv(split, arguments.metric).splitlines()
            print(*map(printable, lines), sep="\n")
            return 0
        board = client.leaderboard(split, arguments.metric)
    if arguments.format == "json":
        print(board.model_dump_json(indent=2, ensure_ascii=True))
    else:
        _show(board)
    return 0


def _first_split(client: "Client") -> str:
    splits = client.splits()
    if not splits:
        raise ReverieEvalError(f"{client.url} takes submissions for no split")
    return splits[0].name


def _show(board: "Leaderboard") -> None:
    from reverie_eval.reporting._grids import aligned
    from reverie_eval.reporting._leaderboards import (
        leaderboard_captions,
        leaderboard_grid,
        show_leaderboard,
    )

    if (board.rows or board.apart) and sys.stdout.isatty():
        from rich.console import Console

        show_leaderboard(board, Console())
    elif board.rows or board.apart:
        print(aligned(leaderboard_grid(board)) + "\n")
    print(*leaderboard_captions(board), sep="\n")
