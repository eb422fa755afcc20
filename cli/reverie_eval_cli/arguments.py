"""Arguments that several commands take, worded once."""

import argparse
from pathlib import Path

_MOST_DAYS = 100 * 365


def add_submission(parser: argparse.ArgumentParser) -> argparse.Action:
    """Add the file that is scored or checked."""
    return parser.add_argument(
        "submission", help="the result file, .json, .json.gz or .zip; - reads standard input"
    )


def add_split(parser: argparse.ArgumentParser) -> None:
    """Add the split."""
    parser.add_argument("--split", required=True, help="train, val_seen, val_unseen or test")


def add_dataset(parser: argparse.ArgumentParser) -> None:
    """Add the published files: a clone's root, and where they are if not in it."""
    parser.add_argument(
        "dataset", nargs="?", type=Path, help="a clone of the REVERIE dataset repository"
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


def add_object_positions(parser: argparse.ArgumentParser) -> None:
    """Add the file that a clone does not hold."""
    parser.add_argument(
        "--object-positions",
        metavar="FILE",
        type=Path,
        help="objpos.json, the centres of all objects; the protocol challenge-2022 needs it, and "
        "`lint` to measure distances",
    )


def add_ground_truth(parser: argparse.ArgumentParser) -> None:
    """Add the place of the ground truth."""
    parser.add_argument(
        "--ground-truth",
        metavar="PATH",
        help="a bundle or a folder of bundles (default: $REVERIE_EVAL_GROUND_TRUTH, then the "
        "demo world that ships with the package)",
    )


def add_clustering(parser: argparse.ArgumentParser, default: str | None = "target") -> None:
    """Add what episodes have in common that are not independent."""
    parser.add_argument(
        "--cluster",
        choices=("target", "scan"),
        default=default,
        help="what is resampled together for intervals: the episodes of a target object, or of a "
        "scan (default: target)",
    )


def add_server_folder(parser: argparse.ArgumentParser) -> None:
    """Add the folder of an evaluation server."""
    parser.add_argument("folder", type=Path, help="the server's folder, with reverie-eval.toml")


def add_expiry(parser: argparse.ArgumentParser, default: int | None) -> None:
    """Add when a token ends."""
    ends = "never" if default is None else f"{default}"
    parser.add_argument(
        "--expires-days",
        metavar="N",
        type=days,
        default=default,
        help=f"days until it is worth nothing (default: {ends})",
    )


def days(text: str) -> int:
    """Read a number of days, after which there still is a date."""
    number = positive_number(text)
    if number > _MOST_DAYS:
        raise argparse.ArgumentTypeError(f"{text!r} days are more than a hundred years")
    return number


def positive_number(text: str) -> int:
    """Read a whole number of 1 or more."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of 1 or more")
    return int(text)


def add_output(parser: argparse.ArgumentParser) -> None:
    """Add the file that a submission is written to."""
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="where to write it (default: standard output)"
    )
