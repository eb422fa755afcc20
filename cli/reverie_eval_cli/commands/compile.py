"""``reverie-eval compile DATASET --split SPLIT -o FILE``: make a split's ground-truth bundle."""

import argparse
import os
import re
from pathlib import Path

from reverie_eval import ReverieEvalError
from reverie_eval.ground_truth import Bundle, bundle_name
from reverie_eval.text import count_text
from reverie_eval_cli.arguments import add_dataset, add_object_positions, add_split
from reverie_eval_cli.outputs import check_outputs
from reverie_eval_cli.progress import with_progress

SUMMARY = "compile the published dataset files of a split into a ground-truth bundle"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_dataset(parser)
    add_object_positions(parser)
    add_split(parser)
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FILE",
        help="the bundle to write, or a folder (an existing one, or with / at the end) to write "
        "SPLIT.npz into",
    )
    parser.add_argument(
        "--public", action="store_true", help="leave the answers out: a bundle to validate with"
    )


def run(arguments: argparse.Namespace) -> int:
    """Compile the split, write its bundle and say what it holds."""
    from reverie_eval.dataset import DatasetFiles, compile_split

    if not re.fullmatch(r"\w+", arguments.split):
        raise ReverieEvalError(f"{arguments.split!r} is no name of a split; use letters and _")
    files = DatasetFiles.find(
        arguments.dataset,
        split=arguments.split,
        annotations=arguments.annotations,
        boxes=arguments.boxes,
        connectivity=arguments.connectivity,
        object_positions=arguments.object_positions,
    )
    bundle = compile_split(files, arguments.split, progress=with_progress)
    if arguments.public:
        bundle = bundle.public()
    output = _output(arguments, bundle)
    check_outputs([output], [*files.annotations.values(), files.boxes, files.object_positions])
    bundle.save(output)
    parts = {"episode": "instr_id", "scan": "scan_id", "viewpoint": "viewpoint_id"}
    counts = [count_text(len(bundle.arrays[array]), noun) for noun, array in parts.items()]
    print(f"{output}: {bundle.header.dataset} {arguments.split}, {', '.join(counts)}")
    if bundle.is_public:
        print("it holds no answers: it checks submissions (`reverie-eval validate`)")
    print(f"fingerprint {bundle.header.fingerprint}")
    return 0


def _output(arguments: argparse.Namespace, bundle: Bundle) -> Path:
    """Return the file to write; a folder that is named with a slash is made."""
    output = Path(arguments.output)
    if arguments.output.endswith(os.sep):
        output.mkdir(parents=True, exist_ok=True)
    if output.is_dir():
        output /= bundle_name(arguments.split, public=bundle.is_public)
    if output.exists() and not output.is_file():
        raise ReverieEvalError(f"{output} is no file that could be replaced")
    return output
