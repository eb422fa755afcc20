"""Work on submissions without scoring them: check them, convert them, have an agent write one."""

from collections.abc import Sequence
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval import Problem, SubmissionError, Validation, validate
from reverie_eval.submissions import source_name, submission_text
from reverie_eval_cli import options
from reverie_eval_cli.options import TruthOptions
from reverie_eval_cli.output import (
    RejectedSubmission,
    check_outputs,
    naming,
    rejection,
    say,
    show,
    write_text,
)

if TYPE_CHECKING:
    from reverie_eval.scoring import Track


@click.command("validate")
@options.submission
@options.truth
@options.track
@options.episodes_from
@options.layout("text", "json", explained=" json lists all problems, text the first 20.")
@options.output("the outcome")
def validate_submission(
    *,
    submission: str,
    truth_options: TruthOptions,
    track: "Track",
    episodes_from: Path | None,
    layout: str,
    output: str | None,
) -> int:
    """Check a submission without scoring it.

    SUBMISSION is a result file, or - for standard input. A public bundle, without the solution, is
    enough.
    """
    check_outputs([output], [submission, truth_options.ground_truth, episodes_from])
    truth = truth_options.find(episodes_from)
    try:
        checked = validate(submission, split=truth.split, ground_truth=truth, track=track)
    except SubmissionError as error:
        if layout == "text":
            # Text is for people, and goes to standard error; JSON is the result that was asked for.
            raise RejectedSubmission(rejection(submission, error)) from None
        write_text(validation_json(truth.split, error.problems) + "\n", output)
        return 1
    if layout == "json":
        show(lambda: validation_json(truth.split, notes=checked.notes), output)
    else:
        show(lambda: _as_text(checked, submission), output)
    return 0


def _as_text(checked: Validation, submission: str) -> str:
    truth = checked.ground_truth
    count = len(truth.episodes.instr_ids)
    chosen = "chosen " if truth.subset_digest else ""
    verdict = (
        f"valid, with a prediction for each of the {count:,} {chosen}episodes of {truth.split}"
    )
    notes = [f"note: {note}" for note in checked.notes]
    first = f"{source_name(submission)}: {verdict}"
    return "\n".join([first, f"ground truth: {truth.provenance}", *notes])


def validation_json(split: str, problems: Sequence[Problem] = (), notes: Sequence[str] = ()) -> str:
    """Return the outcome of checking a submission as a validation report."""
    from reverie_eval.schemas.report import ProblemReport, ValidationReport

    report = ValidationReport(
        split=split,
        valid=not problems,
        problems=[ProblemReport.model_validate(problem) for problem in problems],
        notes=list(notes),
    )
    return report.model_dump_json(indent=2)


@click.command("convert")
@options.submission
@click.option(
    "--split",
    metavar="NAME",
    help="Also fix ids that this split does not have: prefixes, spaces, instructions counted "
    "from 1; and leave out records of other splits.",
)
@options.ground_truth
@options.task
@options.output("the submission")
def convert_submission(
    *,
    submission: str,
    split: str | None,
    ground_truth: str | None,
    task: str | None,
    output: str | None,
) -> None:
    """Convert a submission to the official form.

    SUBMISSION is a result file, or - for standard input. Mistakes whose meaning is clear, such as
    misspelt fields or object ids written as decimals, are fixed. Standard error reports what was
    fixed, what was read differently from the official form, and what was dropped.
    """
    from reverie_eval.submissions import convert

    check_outputs([output], [submission, ground_truth])
    with naming(submission):
        conversion = convert(submission, split=split, ground_truth=ground_truth, task=task)
    write_text(submission_text(conversion.records), output)
    for each in conversion.notes:
        say(f"{source_name(submission)}: {each}")


@click.command("subset")
@options.truth
@click.option(
    "--n", "number", metavar="N", type=int, required=True, help="Number of episodes to draw."
)
@click.option(
    "--stratify",
    type=options.Choice(["scan"]),
    help="Draw from each scan in proportion to its episodes.",
)
@options.with_default("--seed", type=int, default=0, help="Other seeds draw others.")
@options.output("the list")
def draw_episodes(
    *,
    truth_options: TruthOptions,
    number: int,
    stratify: str | None,
    seed: int,
    output: str | None,
) -> None:
    """Draw some episodes of a split at random.

    Prints their instr_ids, one a line, for `--episodes-from`. The same options always draw the same
    episodes. Standard error shows the name of this subset in signatures.
    """
    from reverie_eval.ground_truth import draw_subset

    check_outputs([output], [truth_options.ground_truth])
    truth = truth_options.find()
    scans = map(truth.graph.scan_of, truth.episodes.start.tolist())
    # One stratum for all, unless scans are to be in proportion.
    strata = dict(zip(truth.episodes.instr_ids, scans if stratify else repeat(""), strict=False))
    chosen = draw_subset(strata, number, seed, truth.split)
    write_text("".join(f"{instr_id}\n" for instr_id in chosen), output)
    # As signatures name it, to be quoted with scores; not part of the list.
    say(f"subset:{truth.subset(chosen).subset_digest}|n:{number}")


@click.command("demo")
@click.argument("folder", type=options.PATH, default=Path("demo"))
def write_samples(*, folder: Path) -> None:
    """Write sample submissions for the demo world.

    FOLDER is a new or an empty folder; without it, `demo`. The samples are for val_unseen: a good
    one, a mediocre one, one that answers by boxes (drawn), one with every kind of mistake (broken),
    and one for each further task. `fast-short` is a trained agent, for `reverie-eval run`.
    """
    from shutil import copyfile
    from zipfile import ZipFile

    from reverie_eval.agents import DEMO_AGENT
    from reverie_eval.files import staged_folder
    from reverie_eval.ground_truth import DEMO_SAMPLES

    if folder.exists() and any(folder.iterdir()):
        raise click.UsageError(f"{folder} is not empty; name a new folder")
    with staged_folder(folder) as aside, ZipFile(DEMO_SAMPLES) as samples:
        # Beside the folder first, which appears complete or not at all.
        samples.extractall(aside)
        (aside / DEMO_AGENT.name).mkdir()
        for file in DEMO_AGENT.iterdir():
            copyfile(file, aside / DEMO_AGENT.name / file.name)
        names = [*samples.namelist(), f"{DEMO_AGENT.name}/"]
    print(f"{folder}: {', '.join(names)}")
    print(f"try: reverie-eval {folder / 'good.json'} --split val_unseen")
