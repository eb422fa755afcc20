"""``reverie-eval compare A B ...``: say whether one submission is better than another."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from reverie_eval_cli.arguments import add_clustering, add_ground_truth, add_split
from reverie_eval_cli.outputs import check_outputs
from reverie_eval_cli.scoring import add_protocol, evaluate_each

if TYPE_CHECKING:
    from reverie_eval import Comparison

SUMMARY = "compare submissions with the first: differences, intervals, tests, and where they differ"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.add_argument("first", help="what the others are compared with")
    parser.add_argument("others", nargs="+", metavar="other", help="result files as for scoring")
    add_split(parser)
    add_ground_truth(parser)
    add_protocol(parser)
    add_clustering(parser)
    parser.add_argument(
        "--format",
        choices=("table", "json", "csv", "markdown", "latex"),
        default="table",
        help="of the comparison; csv has a row per submission and metric, markdown and latex show "
        "the scores as papers do (default: %(default)s)",
    )
    parser.add_argument(
        "--episodes",
        metavar="FILE",
        help="also write the episodes that not all have right, or not all wrong, to FILE, as CSV: "
        "by RGS, and where that is not scored by SR",
    )


def run(arguments: argparse.Namespace) -> int:
    """Score all, compare, and say it."""
    from reverie_eval import Comparison

    submissions = [arguments.first, *arguments.others]
    check_outputs([arguments.episodes], [*submissions, arguments.ground_truth])
    scores = evaluate_each(submissions, arguments)
    if scores is None:
        return 1
    comparison = Comparison.of(scores, arguments.cluster)
    if arguments.episodes:
        comparison.episodes().to_csv(Path(arguments.episodes))
    _show(comparison, arguments.format)
    return 0


def _show(comparison: "Comparison", form: str) -> None:
    from reverie_eval.reporting._comparison import (
        comparison_latex,
        comparison_markdown,
        comparison_text,
        show_comparison,
    )

    if form == "json":
        print(comparison.to_report().model_dump_json(indent=2))
    elif form == "csv":
        print(comparison.to_pandas().to_csv(), end="")
    elif form == "markdown":
        print(comparison_markdown(comparison))
    elif form == "latex":
        print(comparison_latex(comparison))
    elif sys.stdout.isatty():
        from rich.console import Console

        show_comparison(comparison, Console())
    else:
        print(comparison_text(comparison))
