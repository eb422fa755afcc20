"""Arguments that several commands take, worded once."""

import argparse


def add_submission(parser: argparse.ArgumentParser) -> argparse.Action:
    """Add the file that is scored or checked."""
    return parser.add_argument(
        "submission", help="the result file, .json or .json.gz; - reads standard input"
    )


def add_split(parser: argparse.ArgumentParser) -> None:
    """Add the split."""
    parser.add_argument("--split", required=True, help="train, val_seen, val_unseen or test")


def add_ground_truth(parser: argparse.ArgumentParser) -> None:
    """Add the place of the ground truth."""
    parser.add_argument(
        "--ground-truth",
        metavar="PATH",
        help="a bundle or a folder of bundles (default: $REVERIE_EVAL_GROUND_TRUTH, then the "
        "demo world that ships with the package)",
    )


def add_output(parser: argparse.ArgumentParser) -> None:
    """Add the file that a submission is written to."""
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="where to write it (default: standard output)"
    )
