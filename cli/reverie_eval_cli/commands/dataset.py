"""``reverie-eval compile``, ``lint``, ``describe`` and ``boxes``: work on a dataset's files."""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import click

from reverie_eval import DatasetError, GroundTruth, ReverieEvalError
from reverie_eval.dataset import MAX_DISTANCE, BoxSettings, Occlusion
from reverie_eval.ground_truth import Bundle, bundle_folder, bundle_name
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.output import check_outputs, note, show_printout, with_progress

# The share is what `benchmarks/released_boxes.py` measures.
_CAVEAT = (
    "these are exact projections of oriented boxes, unlike the released v1 files: 4.9 % of the "
    "boxes there do not contain their object's centre (documentation: Build boxes from "
    "Matterport's files)"
)

_object_positions = click.option(
    "--object-positions",
    metavar="FILE",
    type=options.PATH,
    help="objpos.json, the centres of all objects: needed for the protocol challenge-2022, and by "
    "lint to check distances.",
)


@click.command("compile")
@options.dataset_files
@_object_positions
@options.dataset_task
@options.split
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FILE",
    help="The bundle to write; or a folder, existing or ending in /, for SPLIT.npz or "
    "SPLIT.public.npz, in it or in its folder of the task's name.",
)
@options.episodes_listed(
    "Declare a sample: the bundle scores only the episodes whose instr_ids FILE lists, one a "
    "line or as JSON."
)
@click.option("--public", is_flag=True, help="Leave out the solution: a bundle to validate with.")
def compile_bundle(
    *,
    split: str,
    output: str,
    episodes_from: Path | None,
    public: bool,
    task: str,
    **paths: Path | None,
) -> None:
    """Compile a split's files into a ground-truth bundle.

    DATASET is a clone of the REVERIE dataset repository, or of another task's. Name files that are
    elsewhere with the options.
    """
    from reverie_eval.dataset import DatasetFiles, compile_split, origin_notes

    # It becomes the name of a file.
    if not re.fullmatch(r"\w+", split):
        raise click.UsageError(f"{split!r} is not a split's name; use letters, digits and _")
    files = DatasetFiles.find(split=split, task=task, **paths)
    bundle = compile_split(files, split, progress=with_progress)
    # Before --public, which drops the digests that the notes are about.
    notes = list(origin_notes(bundle.header))
    if public:
        bundle = bundle.public()
    if episodes_from is not None:
        truth = options.sample_of(GroundTruth.from_bundle(bundle), episodes_from)
        bundle = bundle.of_sample(truth.episodes.instr_ids)
    file = _bundle_file(output, bundle)
    sources = [*files.annotations.values(), files.boxes, files.object_positions]
    check_outputs([file], [episodes_from, *sources])
    bundle.save(file)
    parts = {"episode": "instr_id", "scan": "scan_id", "viewpoint": "viewpoint_id"}
    counts = [count_text(len(bundle.arrays[array]), noun) for noun, array in parts.items()]
    print(f"{file}: {bundle.header.dataset} {split}, {', '.join(counts)}")
    if bundle.header.episodes:
        print(f"scores a sample of {count_text(len(bundle.header.episodes), 'episode')}")
    if bundle.is_public:
        print("no solution included: it can validate submissions, not score them")
    print(f"fingerprint {bundle.header.fingerprint}")
    for each in notes:
        note(each)


def _bundle_file(output: str, bundle: Bundle) -> Path:
    """Return the file to write; a folder that is named with a slash is made."""
    path = Path(output)
    # As with cp: a slash at the end says that a folder is meant, there or not.
    if output.endswith(os.sep) or path.is_dir():
        if bundle.header.episodes:
            raise ReverieEvalError(f"{path} is a folder; name the file, as the split has another")
        path = bundle_folder(path, bundle.header.task)
        path.mkdir(parents=True, exist_ok=True)
        path /= bundle_name(bundle.header.split, public=bundle.is_public)
    if path.exists() and not path.is_file():
        raise ReverieEvalError(f"{path} is not a regular file, and is not replaced")
    return path


@click.command()
@options.dataset_files
@_object_positions
@options.dataset_task
@options.layout("text", "json", explained=" json has more percentiles and examples.")
@options.output("the report")
def lint(*, task: str, layout: str, output: str | None, **paths: Path | None) -> int:
    """Check all files of a dataset.

    DATASET is a clone of the REVERIE dataset repository, or of another task's.

    Exit status: 0 no errors, 1 errors found, 2 usage or system error.
    """
    from reverie_eval.dataset import DatasetFiles, lint_dataset
    from reverie_eval.reporting.datasets import lint_printout

    check_outputs([output], paths.values())
    try:
        files = DatasetFiles.find(split=None, task=task, **paths)
    except DatasetError as error:  # no dataset to check is a usage error, not a finding
        raise ReverieEvalError(str(error)) from error
    report = lint_dataset(files, progress=with_progress)
    show_printout(lint_printout(report), layout, output)
    return 0 if report.sound else 1


@click.command()
@options.dataset_files
@options.dataset_task
@options.layout("table", "json")
@options.output("the description")
@click.option(
    "--figures",
    metavar="FOLDER",
    type=options.PATH,
    help="Also draw figures into FOLDER, as SVG and PNG; needs matplotlib.",
)
def describe(
    *, task: str, layout: str, output: str | None, figures: Path | None, **paths: Path | None
) -> None:
    """Describe a dataset, for REVERIE beside the paper's numbers.

    DATASET is a clone of the REVERIE dataset repository, or of another task's.
    """
    from reverie_eval.dataset import DatasetFiles, describe_dataset
    from reverie_eval.reporting.datasets import (
        description_printout,
        write_figures,
    )
    from reverie_eval.reporting.figures import check_matplotlib

    check_outputs([output], paths.values())
    if figures:  # before any time is spent on a dataset that could not be drawn
        check_matplotlib()
    files = DatasetFiles.find(split=None, task=task, **paths)
    description = describe_dataset(files, progress=with_progress)
    if figures:
        write_figures(description, figures)
    show_printout(description_printout(description), layout, output)


@click.command()
@click.argument("houses", type=options.PATH)
@click.argument("connectivity", type=options.PATH)
@options.new_path("FOLDER", "Where to write SCAN_VIEWPOINT.json files; a new or an empty folder.")
@options.with_default(
    "--max-distance",
    metavar="METRES",
    type=options.Decimal(min=0, min_open=True),
    default=MAX_DISTANCE,
    help="List objects whose centre is nearer to the camera; the released files list up to 2.0.",
)
@options.with_default(
    "--occlusion",
    type=options.Choice(get_args(Occlusion)),
    default=BoxSettings().occlusion,
    help="paper: remove boxes inside the box of a nearer object.",
)
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
    scans: Sequence[str],
    jobs: int | None,
) -> None:
    """Build boxes from Matterport3D's .house files.

    HOUSES is a folder with SCAN.house files, at any depth; CONNECTIVITY one with
    SCAN_connectivity.json files.
    """
    from reverie_eval.dataset import build_boxes, find_scans

    found = find_scans(houses, connectivity, list(scans) or None)
    for each in found.notes():
        note(each)
    built = build_boxes(
        found.complete,
        output,
        BoxSettings(max_distance, occlusion),
        jobs=jobs or os.cpu_count() or 1,
        progress=with_progress,
    )
    counts = [
        count_text(len(found.complete), "scan"),
        count_text(built.viewpoints, "viewpoint"),
        count_text(built.listed, "listed object"),
        f"{built.boxes:,} boxes",
    ]
    print(f"{output}: {', '.join(counts)}")
    # Each time: a score on such boxes must not pass for one on the released ones.
    print(_CAVEAT)
