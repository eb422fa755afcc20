"""``reverie-eval boxes HOUSES CONNECTIVITY -o FOLDER``: build boxes from Matterport's files."""

import math
import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import get_args

import click

from reverie_eval.dataset._object_boxes import EXCLUDED_NAMES, MAX_DISTANCE, BoxRules, Occlusion
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.output import note, with_progress

_CAVEAT = (
    "these are exact projections of oriented boxes, unlike the released v1 files: 4.9 % of the "
    "boxes there do not contain their object's centre (documentation: Build boxes from "
    "Matterport's files)"
)
"""The share is what ``benchmarks/released_boxes.py`` measures."""


def _finite(context: click.Context, parameter: click.Parameter, metres: float) -> float:
    """Refuse what a range of floats lets through: infinity and NaN."""
    if not math.isfinite(metres):
        raise click.BadParameter(f"{metres} is not a distance in metres", context, parameter)
    return metres


@click.command()
@click.argument("houses", type=options.PATH)
@click.argument("connectivity", type=options.PATH)
@options.new_path("FOLDER", "Where to write SCAN_VIEWPOINT.json files; a new or an empty folder.")
@options.with_default(
    "--max-distance",
    metavar="METRES",
    type=options.Decimal(min=0, min_open=True),
    default=MAX_DISTANCE,
    callback=_finite,
    help="List objects whose centre is nearer to the camera; the released files list up to 2.0.",
)
@options.with_default(
    "--occlusion",
    type=options.Choice(get_args(Occlusion)),
    default=BoxRules().occlusion,
    help="paper: remove boxes inside the box of a nearer object.",
)
@click.option(
    "--exclude",
    metavar="NAME",
    multiple=True,
    help="A raw category name to leave out, as often as needed.  [default: wall, door, ceiling, "
    "floor and the others that the released files never list]",
)
@click.option("--exclude-nothing", is_flag=True, help="Leave out no name.")
@click.option(
    "--scan",
    "scans",
    metavar="SCAN",
    multiple=True,
    help="A scan to build, as often as needed.  [default: all that have both files]",
)
@options.jobs
def boxes(
    *,
    houses: Path,
    connectivity: Path,
    output: Path,
    max_distance: float,
    occlusion: Occlusion,
    exclude: Sequence[str],
    exclude_nothing: bool,
    scans: Sequence[str],
    jobs: int | None,
) -> None:
    """Build boxes from Matterport3D's .house files.

    HOUSES is a folder with SCAN.house files, at any depth; CONNECTIVITY one with
    SCAN_connectivity.json files.
    """
    from reverie_eval.dataset import build_boxes, find_scans

    if exclude and exclude_nothing:
        raise click.UsageError("give --exclude or --exclude-nothing, not both")
    excluded = frozenset(exclude) if exclude or exclude_nothing else EXCLUDED_NAMES
    found = find_scans(houses, connectivity, list(scans) or None)
    for each in found.notes():
        note(each)
    with _terminated_as_by_ctrl_c():
        built = build_boxes(
            found.complete,
            output,
            BoxRules(max_distance, occlusion, excluded),
            jobs=jobs or os.cpu_count() or 1,
            progress=lambda outcomes, total: with_progress(outcomes, "boxes", total),
        )
    counts = [
        count_text(len(found.complete), "scan"),
        count_text(built.viewpoints, "viewpoint"),
        count_text(built.listed, "listed object"),
        f"{built.boxes:,} boxes",
    ]
    print(f"{output}: {', '.join(counts)}")
    print(_CAVEAT)


@contextmanager
def _terminated_as_by_ctrl_c() -> Iterator[None]:
    """Let SIGTERM stop the work as Ctrl-C does, so that no draft and no worker is left behind."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
