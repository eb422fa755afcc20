"""``reverie-eval compile``, ``lint`` and ``describe``: work on a dataset's published files."""

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from reverie_eval import DatasetError, ReverieEvalError
from reverie_eval.ground_truth import Bundle, bundle_folder, bundle_name
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.output import check_outputs, note, show, with_progress

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from reverie_eval.dataset import DatasetDescription, LintReport


@click.command("compile")
@options.dataset_files
@options.object_positions
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
@click.option("--public", is_flag=True, help="Leave out the answers: a bundle to validate with.")
def compile_bundle(
    *, split: str, output: str, public: bool, task: str, **paths: Path | None
) -> None:
    """Compile a split's files into a ground-truth bundle.

    DATASET is a clone of the REVERIE dataset repository, or of another task's. Name files that are
    elsewhere with the options.
    """
    from reverie_eval.dataset import DatasetFiles, compile_split, origin_notes

    if not re.fullmatch(r"\w+", split):
        raise click.UsageError(f"{split!r} is not a split's name; use letters, digits and _")
    files = DatasetFiles.find(split=split, task=task, **paths)
    bundle = compile_split(files, split, progress=with_progress)
    notes = list(origin_notes(bundle.header))
    if public:
        bundle = bundle.public()
    place = _bundle_path(output, bundle)
    check_outputs([place], [*files.annotations.values(), files.boxes, files.object_positions])
    bundle.save(place)
    parts = {"episode": "instr_id", "scan": "scan_id", "viewpoint": "viewpoint_id"}
    counts = [count_text(len(bundle.arrays[array]), noun) for noun, array in parts.items()]
    print(f"{place}: {bundle.header.dataset} {split}, {', '.join(counts)}")
    if bundle.is_public:
        print("no answers included: it can validate submissions, not score them")
    print(f"fingerprint {bundle.header.fingerprint}")
    for remark in notes:
        note(remark)


def _bundle_path(output: str, bundle: Bundle) -> Path:
    """Return the file to write; a folder that is named with a slash is made."""
    path = Path(output)
    if output.endswith(os.sep):
        path.mkdir(parents=True, exist_ok=True)
    if path.is_dir():
        path = bundle_folder(path, bundle.header.task)
        path.mkdir(exist_ok=True)
        path /= bundle_name(bundle.header.split, public=bundle.is_public)
    if path.exists() and not path.is_file():
        raise ReverieEvalError(f"{path} is not a regular file, and is not replaced")
    return path


@click.command()
@options.dataset_files
@options.object_positions
@options.dataset_task
@options.layout("text", "json", explained=" json has more percentiles and examples.")
@options.output("the report")
def lint(*, task: str, layout: str, output: str | None, **paths: Path | None) -> int:
    """Check all files of a dataset.

    DATASET is a clone of the REVERIE dataset repository, or of another task's.

    Exit status: 0 no errors, 1 errors found, 2 usage or system error.
    """
    from reverie_eval.dataset import DatasetFiles, lint_dataset
    from reverie_eval.reporting._lint import lint_text, print_lint

    check_outputs([output], paths.values())
    try:
        files = DatasetFiles.find(split=None, task=task, **paths)
    except DatasetError as error:  # no dataset to check is a usage error, not a finding
        raise ReverieEvalError(str(error)) from error
    report = lint_dataset(files, progress=with_progress)
    if layout == "json":
        show(lambda: _as_json(report), output)
    else:
        show(lambda: lint_text(report), output, lambda console: print_lint(console, report))
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
    from reverie_eval.reporting._description import description_text, print_description

    check_outputs([output], paths.values())
    write_figures = _figure_writer() if figures else None
    files = DatasetFiles.find(split=None, task=task, **paths)
    description = describe_dataset(files, progress=with_progress)
    if write_figures and figures:
        write_figures(description, figures)
    if layout == "json":
        show(lambda: _as_json(description), output)
    else:
        show(
            lambda: description_text(description),
            output,
            lambda console: print_description(console, description),
        )


def _as_json(report: "DatasetDescription | LintReport") -> str:
    from pydantic import TypeAdapter

    adapter: TypeAdapter[Any] = TypeAdapter(type(report))
    return adapter.dump_json(report, indent=2).decode()


def _figure_writer() -> "Callable[[DatasetDescription, Path], Sequence[Path]]":
    """Return what draws, before any time is spent on a dataset that could not be drawn."""
    try:
        from reverie_eval.reporting._dataset_figures import write_figures
    except ModuleNotFoundError as error:
        raise ReverieEvalError(
            "--figures needs matplotlib; install it with: pip install 'reverie-eval[figures]'"
        ) from error
    return write_figures
