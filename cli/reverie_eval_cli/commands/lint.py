"""``reverie-eval lint DATASET``: check the published files, all splits and scans of them.

Exit status: 0 sound, 1 errors were found, 2 it could not be tried.
"""

import argparse
import sys
from typing import TYPE_CHECKING

from reverie_eval import DatasetError, ReverieEvalError
from reverie_eval_cli.arguments import add_dataset, add_object_positions
from reverie_eval_cli.progress import with_progress

if TYPE_CHECKING:
    from reverie_eval.dataset import LintReport

SUMMARY = "check all published files of a dataset: what is in them, and what is wrong"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_dataset(parser)
    add_object_positions(parser)
    parser.add_argument(
        "--format",
        choices=("text", "json"),
        default="text",
        help="of the report; json holds more percentiles and examples",
    )


def run(arguments: argparse.Namespace) -> int:
    """Look through the files and say what is in them."""
    from reverie_eval.dataset import DatasetFiles, lint_dataset

    try:
        files = DatasetFiles.find(
            arguments.dataset,
            annotations=arguments.annotations,
            boxes=arguments.boxes,
            connectivity=arguments.connectivity,
            object_positions=arguments.object_positions,
        )
    except DatasetError as error:
        raise ReverieEvalError(str(error)) from error
    report = lint_dataset(files, progress=with_progress)
    _show(report, arguments.format)
    return 0 if report.sound else 1


def _show(report: "LintReport", form: str) -> None:
    from reverie_eval.reporting._lint import lint_text, show_lint

    if form == "json":
        from pydantic import TypeAdapter

        from reverie_eval.dataset import LintReport

        print(TypeAdapter(LintReport).dump_json(report, indent=2).decode())
    elif sys.stdout.isatty():
        from rich.console import Console

        show_lint(report, Console())
    else:
        print(lint_text(report))
