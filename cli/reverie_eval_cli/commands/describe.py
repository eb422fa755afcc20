"""``reverie-eval describe DATASET``: what a dataset is made of, beside the paper's numbers."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from reverie_eval import ReverieEvalError
from reverie_eval_cli.arguments import add_dataset
from reverie_eval_cli.progress import with_progress

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from reverie_eval.dataset import DatasetDescription

SUMMARY = "describe a dataset in numbers and figures, beside those of the REVERIE paper"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_dataset(parser)
    parser.add_argument(
        "--format", choices=("table", "json"), default="table", help="(default: %(default)s)"
    )
    parser.add_argument(
        "--figures",
        metavar="FOLDER",
        type=Path,
        help="also draw figures into FOLDER, as SVG and PNG; needs matplotlib",
    )


def run(arguments: argparse.Namespace) -> int:
    """Describe the splits that are there, and draw what was asked for."""
    from reverie_eval.dataset import DatasetFiles, describe_dataset

    write_figures = _figure_writer() if arguments.figures else None
    files = DatasetFiles.find(
        arguments.dataset,
        annotations=arguments.annotations,
        boxes=arguments.boxes,
        connectivity=arguments.connectivity,
    )
    description = describe_dataset(files, progress=with_progress)
    if write_figures:
        write_figures(description, arguments.figures)
    _show(description, arguments.format)
    return 0


def _figure_writer() -> "Callable[[DatasetDescription, Path], Sequence[Path]]":
    """Return what draws, before any time is spent on a dataset that could not be drawn."""
    try:
        from reverie_eval.reporting._dataset_figures import write_figures
    except ModuleNotFoundError as error:
        raise ReverieEvalError(
            "--figures needs matplotlib; install it with: pip install 'reverie-eval[figures]'"
        ) from error
    return write_figures


def _show(description: "DatasetDescription", form: str) -> None:
    from reverie_eval.reporting._description import FORMATS, show

    if form == "table" and sys.stdout.isatty():
        from rich.console import Console

        show(description, Console())
    else:
        print(FORMATS[form](description))
