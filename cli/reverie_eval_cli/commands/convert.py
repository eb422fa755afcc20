"""``reverie-eval convert SUBMISSION -o FILE``: write any readable form in the official one."""

import argparse
import sys

from reverie_eval.submissions import source_name
from reverie_eval_cli.arguments import add_output, add_submission
from reverie_eval_cli.outputs import check_outputs
from reverie_eval_cli.submissions import write_submission

SUMMARY = "convert a submission from any readable form to the official one"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_submission(parser)
    add_output(parser)


def run(arguments: argparse.Namespace) -> int:
    """Convert the submission and say what was read differently, and what was dropped."""
    from reverie_eval.submissions import convert

    check_outputs([arguments.output], [arguments.submission])
    conversion = convert(arguments.submission)
    write_submission(conversion.records, arguments.output)
    for note in conversion.notes:
        print(f"{source_name(arguments.submission)}: {note}", file=sys.stderr)
    return 0
