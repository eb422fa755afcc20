"""``reverie-eval validate SUBMISSION --split SPLIT``: run every check, look at no answer."""

import argparse

from reverie_eval import SubmissionError, Validation, validate
from reverie_eval.submissions import source_name
from reverie_eval_cli.arguments import add_ground_truth, add_split, add_submission

SUMMARY = "check a submission without scoring it; a public bundle is enough"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_submission(parser)
    add_split(parser)
    add_ground_truth(parser)
    parser.add_argument(
        "--format",
        choices=("text", "json"),
        default="text",
        help="of the outcome; json lists every problem however many there are",
    )


def run(arguments: argparse.Namespace) -> int:
    """Check the submission and say that it is sound."""
    try:
        checked = validate(
            arguments.submission, split=arguments.split, ground_truth=arguments.ground_truth
        )
    except SubmissionError as error:
        if arguments.format == "text":
            raise
        print(problems_as_json(arguments.split, error))
        return 1
    print(_as_json(checked) if arguments.format == "json" else _as_text(checked, arguments))
    return 0


def _as_text(checked: Validation, arguments: argparse.Namespace) -> str:
    truth = checked.ground_truth
    count = len(truth.episodes.instr_ids)
    verdict = f"valid, with a prediction for each of the {count:,} episodes of {truth.split}"
    notes = [f"note: {note}" for note in checked.notes]
    return "\n".join(
        [
            f"{source_name(arguments.submission)}: {verdict}",
            f"ground truth: {truth.provenance}",
            *notes,
        ]
    )


def _as_json(checked: Validation) -> str:
    from reverie_eval.schemas.report import ValidationReport

    report = ValidationReport(
        split=checked.ground_truth.split, valid=True, notes=list(checked.notes)
    )
    return report.model_dump_json(indent=2)


def problems_as_json(split: str, error: SubmissionError) -> str:
    """Write what is wrong with a submission as a validation report."""
    from reverie_eval.schemas.report import ProblemReport, ValidationReport

    problems = [ProblemReport.model_validate(problem) for problem in error.problems]
    report = ValidationReport(split=split, valid=False, problems=problems)
    return report.model_dump_json(indent=2)
