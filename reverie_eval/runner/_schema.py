"""The JSON Schemas of a run's files."""

import ast
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import msgspec

from reverie_eval import logs
from reverie_eval.logs import Attempt, Step
from reverie_eval.runner import _records
from reverie_eval.runner._records import RunCard

RUN_SCHEMAS: Mapping[str, type[msgspec.Struct]] = MappingProxyType(
    {"run-card": RunCard, "run-episode": Attempt, "run-step": Step}
)
"""The records of a run's files by the names of their schemas."""


def run_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of ``run.json``, or of a line of another file, by its name.

    Fields are described by their docstrings, which msgspec does not read.
    """
    schema = msgspec.json.schema(RUN_SCHEMAS[name])
    for title, definition in schema["$defs"].items():
        about = dict(_field_docstrings({**vars(logs), **vars(_records)}[title]))
        for field, details in definition["properties"].items():
            details["description"] = about[field]
    return schema


def _field_docstrings(record: type) -> Iterator[tuple[str, str]]:
    """Yield the fields of a class, each with the text below it."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(record)))
    (definition,) = tree.body
    for field, below in pairwise(getattr(definition, "body", ())):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(ast.Constant(str(text))):
                yield name, " ".join(text.split())
            case _:
                pass
