"""``reverie-eval report SUBMISSION [OTHER] --split SPLIT -o FILE``: write the HTML report."""

import argparse
import sys
from pathlib import Path

from reverie_eval import ReverieEvalError, Scores
from reverie_eval.scoring import Clustering, Intervals
from reverie_eval_cli.arguments import (
    add_clustering,
    add_ground_truth,
    add_output,
    add_split,
    add_submission,
)
from reverie_eval_cli.outputs import check_outputs
from reverie_eval_cli.scoring import add_protocol, evaluate_each

SUMMARY = "write an HTML report: what became of the episodes, where and why, with maps"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_submission(parser)
    parser.add_argument("other", nargs="?", help="a second result file, compared with the first")
    add_split(parser)
    add_ground_truth(parser)
    add_protocol(parser)
    add_clustering(parser)
    add_output(parser)


def run(arguments: argparse.Namespace) -> int:
    """Score what was given, and write a report on it."""
    from reverie_eval.reporting._report import report_html

    submissions = [arguments.submission, *([arguments.other] if arguments.other else [])]
    check_outputs([arguments.output], [*submissions, arguments.ground_truth])
    if not arguments.output and sys.stdout.isatty():
        raise ReverieEvalError("a report is a page for a browser; name its file: -o report.html")
    scores = evaluate_each(submissions, arguments)
    if scores is None:
        return 1
    by = arguments.cluster
    report = report_html({name: _with_intervals(each, by) for name, each in scores.items()}, by)
    if arguments.output:
        Path(arguments.output).write_text(report, encoding="utf-8")
    else:
        sys.stdout.write(report)
    return 0


def _with_intervals(scores: Scores, by: Clustering) -> Scores:
    """Draw intervals, unless there is nothing to draw from, which the report then says."""
    return scores if Intervals.why_not(scores.ground_truth, by) else scores.with_intervals(by)
