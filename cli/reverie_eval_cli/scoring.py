"""Several submissions, scored alike."""

import argparse
import sys
from collections.abc import Mapping, Sequence

from reverie_eval import PROTOCOLS, Scores, SubmissionError, evaluate
from reverie_eval.ground_truth import find_ground_truth
from reverie_eval.scoring import ALIASES, DEFAULT_PROTOCOL
from reverie_eval_cli.submissions import rejection


def add_protocol(parser: argparse.ArgumentParser) -> None:
    """Add the one protocol that all are scored by."""
    parser.add_argument(
        "--protocol",
        choices=[*PROTOCOLS, *ALIASES],
        default=DEFAULT_PROTOCOL,
        metavar="NAME",
        help="the rules to score by (default: %(default)s)",
    )


def evaluate_each(
    submissions: Sequence[str], arguments: argparse.Namespace
) -> Mapping[str, Scores] | None:
    """Score all by their names; if some are rejected, say what is wrong with each of them."""
    from reverie_eval.submissions import submission_names

    truth = find_ground_truth(arguments.ground_truth, arguments.split)
    where = {"split": arguments.split, "ground_truth": truth, "protocol": arguments.protocol}
    scores = []
    for submission in submissions:
        try:
            scores.append(evaluate(submission, **where))
        except SubmissionError as error:
            print(rejection(submission, error), file=sys.stderr)
    if len(scores) < len(submissions):
        return None
    return dict(zip(submission_names(submissions), scores, strict=True))
