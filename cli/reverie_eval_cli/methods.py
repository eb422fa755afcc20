"""What a participant says about a method, for the leaderboard."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from reverie_eval import ReverieEvalError
from reverie_eval.text import printable

if TYPE_CHECKING:
    from reverie_eval.schemas.service import Method

_TEXTS = {
    "name": ("--method", "NAME", "Name of the method.  [default: the file's name]"),
    "description": ("--description", "TEXT", "A description in a few sentences."),
    "paper": ("--paper", "URL", "Where the paper is."),
    "code": ("--code", "URL", "Where the code is."),
}
_FLAGS = {
    "extra_data": "It was trained on more than the benchmark's training split.",
    "pre_exploration": "It saw the test buildings before the instructions.",
    "ground_truth_objects": "It was given the annotated objects of a viewpoint.",
    "ensemble": "Several models decide together.",
}
_LONGEST_NAME = 100


@dataclass(frozen=True)
class MethodOptions:
    """The fields of a :class:`~reverie_eval.schemas.service.Method` that were given."""

    given: Mapping[str, Any]

    def method(self, submission: str) -> "Method":
        """Return the method; if it has no name, it gets the file's.

        Raises
        ------
        ReverieEvalError
            Naming each option that is wrong.
        """
        from pydantic import ValidationError

        from reverie_eval.schemas.service import Method

        try:
            return Method.model_validate({"name": _name_of(submission), **self.given})
        except ValidationError as error:
            wrong = [
                f"{_option(str(detail['loc'][0]))}: {detail['msg']}"
                for detail in error.errors(include_url=False)
            ]
            raise ReverieEvalError("; ".join(wrong)) from None

    def changes(self, before: "Method", submission: str) -> Mapping[str, Any]:
        """Return the fields that were given and differ from what the server has."""
        given = self.method(submission).model_dump(include=set(self.given))
        return {field: value for field, value in given.items() if value != getattr(before, field)}


def method_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option for each field of a method; the command gets them as ``method``."""

    @functools.wraps(command)
    def with_method(**values: Any) -> Any:
        fields = {field: values.pop(field) for field in (*_TEXTS, *_FLAGS)}
        given = {field: value for field, value in fields.items() if value is not None}
        return command(method=MethodOptions(given), **values)

    decorated: Callable[..., Any] = with_method
    for field, meaning in reversed(_FLAGS.items()):
        name = field.replace("_", "-")
        add = click.option(f"--{name}/--no-{name}", field, default=None, help=meaning)
        decorated = add(decorated)
    for field, (option, metavar, meaning) in reversed(_TEXTS.items()):
        decorated = click.option(option, field, metavar=metavar, help=meaning)(decorated)
    return decorated


def _option(field: str) -> str:
    return _TEXTS[field][0] if field in _TEXTS else f"--{field.replace('_', '-')}"


def _name_of(submission: str) -> str:
    """Return a file's name up to the first dot."""
    stem = "" if submission == "-" else Path(submission).name.partition(".")[0]
    return printable(stem)[:_LONGEST_NAME].strip() or "unnamed"
