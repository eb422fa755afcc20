"""``reverie-eval boxes HOUSES CONNECTIVITY -o FOLDER``: build boxes from Matterport's files."""

import argparse
import math
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import get_args

from reverie_eval.dataset._object_boxes import EXCLUDED_NAMES, MAX_DISTANCE, BoxRules, Occlusion
from reverie_eval.text import count_text
from reverie_eval_cli.arguments import positive_number
from reverie_eval_cli.progress import with_progress

SUMMARY = "build boxes in the published layout from Matterport's .house files"

_CAVEAT = (
    "these are projections of oriented boxes; the released v1 files are not exactly such: 4.9 % of "
    "their boxes miss their object's centre (docs/boxes-from-houses.md)"
)
"""The share is what ``benchmarks/released_boxes.py`` measures."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.add_argument(
        "houses", type=Path, help="the folder with Matterport's SCAN.house files, at any depth"
    )
    parser.add_argument(
        "connectivity", type=Path, help="the folder with SCAN_connectivity.json files"
    )
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FOLDER",
        type=Path,
        help="where to write SCAN_VIEWPOINT.json files; a new or an empty folder",
    )
    parser.add_argument(
        "--max-distance",
        metavar="METRES",
        type=_metres,
        default=MAX_DISTANCE,
        help="list objects whose centre is nearer to the camera (default: %(default)s; the "
        "released files list up to 2.0)",
    )
    parser.add_argument(
        "--occlusion",
        choices=get_args(Occlusion),
        default=BoxRules().occlusion,
        help="paper: take away boxes within the box of a nearer object (default: %(default)s)",
    )
    left_out = parser.add_mutually_exclusive_group()
    left_out.add_argument(
        "--exclude",
        action="append",
        metavar="NAME",
        help="a raw category name to leave out; as often as there are such names, instead of wall, "
        "door, ceiling, floor and the others that the released files never list",
    )
    left_out.add_argument(
        "--exclude-nothing",
        action="store_const",
        const=[],
        dest="exclude",
        help="leave no name out",
    )
    parser.add_argument(
        "--scans", nargs="+", metavar="SCAN", help="build these (default: all that have both files)"
    )
    parser.add_argument(
        "--jobs",
        metavar="N",
        type=positive_number,
        help="processes to share the work (default: cores)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Build the boxes and say how many."""
    from reverie_eval.dataset import build_boxes, find_scans

    found = find_scans(arguments.houses, arguments.connectivity, arguments.scans)
    for note in found.notes():
        print(f"note: {note}", file=sys.stderr)
    excluded = EXCLUDED_NAMES if arguments.exclude is None else frozenset(arguments.exclude)
    with _ended_as_by_ctrl_c():
        built = build_boxes(
            found.complete,
            arguments.output,
            BoxRules(arguments.max_distance, arguments.occlusion, excluded),
            jobs=arguments.jobs or os.cpu_count() or 1,
            progress=lambda outcomes, total: with_progress(outcomes, "boxes", total),
        )
    counts = [
        count_text(len(found.complete), "scan"),
        count_text(built.viewpoints, "viewpoint"),
        count_text(built.listed, "listed object"),
        f"{built.boxes:,} boxes",
    ]
    print(f"{arguments.output}: {', '.join(counts)}")
    print(_CAVEAT)
    return 0


@contextmanager
def _ended_as_by_ctrl_c() -> Iterator[None]:
    """Let SIGTERM end the work as Ctrl-C does, so that nothing of it stays behind."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _metres(text: str) -> float:
    try:
        metres = float(text)
    except ValueError:
        metres = math.nan
    if not 0 < metres < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is no distance; give metres, more than 0")
    return metres
