"""``reverie-eval compile DATASET --split SPLIT -o FILE``: make a split's ground-truth bundle."""

import argparse
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from reverie_eval.ground_truth import bundle_name
from reverie_eval.wording import counted

SUMMARY = "compile the published dataset files of a split into a ground-truth bundle"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.add_argument(
        "dataset", nargs="?", type=Path, help="a clone of the REVERIE dataset repository"
    )
    parser.add_argument("--split", required=True, help="train, val_seen, val_unseen or test")
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FILE",
        type=Path,
        help="the bundle to write, or a folder to write SPLIT.npz into",
    )
    parser.add_argument(
        "--public", action="store_true", help="leave the answers out: a bundle to validate with"
    )
    elsewhere = parser.add_argument_group("where the files are, if not in DATASET")
    elsewhere.add_argument(
        "--annotations",
        metavar="PATH",
        type=Path,
        help="REVERIE_SPLIT.json, or its folder; a private file with objId and full path too",
    )
    elsewhere.add_argument(
        "--boxes", metavar="PATH", type=Path, help="the BBox folder, or one BBoxes.json"
    )
    elsewhere.add_argument(
        "--connectivity", metavar="PATH", type=Path, help="the folder of connectivity files"
    )


def run(arguments: argparse.Namespace) -> int:
    """Compile the split, write its bundle and say what it holds."""
    from reverie_eval.ground_truth.compile import compile_split
    from reverie_eval.ground_truth.dataset import DatasetFiles

    files = DatasetFiles.find(
        arguments.split,
        arguments.dataset,
        annotations=arguments.annotations,
        boxes=arguments.boxes,
        connectivity=arguments.connectivity,
    )
    bundle = compile_split(files, arguments.split, track=_with_progress)
    if arguments.public:
        bundle = bundle.public()
    output = arguments.output
    if output.is_dir():
        output /= bundle_name(arguments.split, public=bundle.is_public)
    bundle.save(output)
    parts = {"episode": "instr_id", "scan": "scan_id", "viewpoint": "viewpoint_id"}
    counts = [counted(len(bundle.arrays[array]), noun) for noun, array in parts.items()]
    print(f"{output}: {bundle.header.dataset} {arguments.split}, {', '.join(counts)}")
    if bundle.is_public:
        print("it holds no answers: it checks submissions (`reverie-eval validate`)")
    print(f"fingerprint {bundle.header.fingerprint}")
    return 0


def _with_progress(files: Sequence[Path], description: str) -> Iterable[Path]:
    """Show a progress bar while the files are read, on a terminal only."""
    if not sys.stderr.isatty():
        return files
    from rich.console import Console
    from rich.progress import track

    return track(files, description=description, console=Console(stderr=True), transient=True)
