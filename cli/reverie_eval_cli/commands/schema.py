"""``reverie-eval schema NAME``: print the JSON Schema of a file or a reply."""

import argparse
import json
from typing import Any

SUMMARY = "print the JSON Schema of submissions or of reports"
NAMES = (
    "submission",
    "score-report",
    "validation-report",
    "comparison-report",
    "lint-report",
    "dataset-description",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.add_argument("name", choices=NAMES)


def run(arguments: argparse.Namespace) -> int:
    """Print the schema."""
    print(schema_text(arguments.name))
    return 0


def schema_text(name: str) -> str:
    """Return a schema as indented JSON."""
    from pydantic import TypeAdapter

    from reverie_eval.dataset import DatasetDescription, LintReport
    from reverie_eval.reporting._comparison import ComparisonReport
    from reverie_eval.schemas.report import ScoreReport, ValidationReport
    from reverie_eval.submissions import submission_schema

    adapters: dict[str, TypeAdapter[Any]] = {
        "score-report": TypeAdapter(ScoreReport),
        "validation-report": TypeAdapter(ValidationReport),
        "comparison-report": TypeAdapter(ComparisonReport),
        "lint-report": TypeAdapter(LintReport),
        "dataset-description": TypeAdapter(DatasetDescription),
    }
    if name == "submission":
        return json.dumps(submission_schema(), indent=2)
    return json.dumps(adapters[name].json_schema(mode="serialization"), indent=2)
