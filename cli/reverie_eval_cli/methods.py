"""What a participant says of a method: options, and what is made of them."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reverie_eval import ReverieEvalError

if TYPE_CHECKING:
    from reverie_eval.schemas.service import Method

_FLAGS = {
    "extra_data": "the method was trained on more than the benchmark's training split",
    "pre_exploration": "it saw the test buildings before the instructions",
    "ground_truth_objects": "it was given the annotated objects of a viewpoint",
    "ensemble": "several models decide together",
}
_OPTIONS = {"name": "method"}
"""Fields whose option is called otherwise."""
_LONGEST_NAME = 100


def add_method(parser: argparse.ArgumentParser) -> None:
    """Add what a leaderboard says of the method."""
    about = parser.add_argument_group("what the leaderboard says of the method")
    about.add_argument("--method", metavar="NAME", help="its name (default: the file's)")
    about.add_argument("--description", metavar="TEXT", help="in a few sentences")
    about.add_argument("--paper", metavar="URL", help="https://...")
    about.add_argument("--code", metavar="URL", help="https://...")
    for name, meaning in _FLAGS.items():
        about.add_argument(
            f"--{name.replace('_', '-')}", action=argparse.BooleanOptionalAction, help=meaning
        )


def method_of(arguments: argparse.Namespace) -> "Method":
    """Return what is said of the method; without a name, it has the file's.

    Raises
    ------
    ReverieEvalError
        Naming each option that is wrong.
    """
    from pydantic import ValidationError

    from reverie_eval.schemas.service import Method

    try:
        return Method.model_validate({"name": _stem(arguments.submission)} | _given(arguments))
    except ValidationError as error:
        wrong = [
            f"--{_option(str(detail['loc'][0]))}: {detail['msg']}"
            for detail in error.errors(include_url=False)
        ]
        raise ReverieEvalError("; ".join(wrong)) from None


def amendments(method: "Method", arguments: argparse.Namespace) -> Mapping[str, Any]:
    """Return what is said now that was not said of a method before."""
    said = method_of(arguments).model_dump(include=set(_given(arguments)))
    return {field: value for field, value in said.items() if value != getattr(method, field)}


def _given(arguments: argparse.Namespace) -> dict[str, Any]:
    fields = ("name", "description", "paper", "code", *_FLAGS)
    said = {field: getattr(arguments, _OPTIONS.get(field, field)) for field in fields}
    return {field: value for field, value in said.items() if value is not None}


def _option(field: str) -> str:
    return _OPTIONS.get(field, field).replace("_", "-")


def _stem(submission: str) -> str:
    """Return a file's name up to the first dot."""
    from reverie_eval.text import printable

    stem = "" if submission == "-" else Path(submission).name.partition(".")[0]
    return printable(stem)[:_LONGEST_NAME].strip() or "unnamed"
