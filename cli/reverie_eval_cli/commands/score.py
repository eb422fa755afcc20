"""``reverie-eval SUBMISSION --split SPLIT``: print the score table of a submission."""

import argparse
import sys
from pathlib import Path

from reverie_eval import PROTOCOLS, Scores, evaluate
from reverie_eval.protocol import DEFAULT_PROTOCOL
from reverie_eval.reporting.tables import FORMATS, write_episodes
from reverie_eval_cli.arguments import add_ground_truth, add_split, add_submission


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_submission(parser)
    add_split(parser)
    add_ground_truth(parser)
    parser.add_argument(
        "--protocol",
        choices=PROTOCOLS,
        default=DEFAULT_PROTOCOL,
        help="the rules to score by (default: %(default)s)",
    )
    parser.add_argument(
        "--format", choices=FORMATS, default="table", help="of the scores (default: %(default)s)"
    )
    parser.add_argument("--output", metavar="FILE", help="write the scores to FILE")
    parser.add_argument(
        "--episodes", metavar="FILE", help="also write the value of every episode to FILE, as CSV"
    )


def run(arguments: argparse.Namespace) -> int:
    """Score the submission and put the scores where they were asked for."""
    scores = evaluate(
        arguments.submission,
        split=arguments.split,
        ground_truth=arguments.ground_truth,
        protocol=arguments.protocol,
    )
    if arguments.episodes:
        with Path(arguments.episodes).open("w", encoding="utf-8", newline="") as file:
            write_episodes(scores, file)
    if arguments.output:
        text = FORMATS[arguments.format](scores)
        Path(arguments.output).write_text(text + "\n", encoding="utf-8")
    elif arguments.format == "table" and sys.stdout.isatty():
        _show_on_terminal(scores)
    else:
        print(FORMATS[arguments.format](scores))
    return 0


def _show_on_terminal(scores: Scores) -> None:
    from rich.console import Console

    from reverie_eval.reporting.terminal import show

    show(scores, Console())
