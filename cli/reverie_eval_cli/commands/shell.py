"""``reverie-eval schema`` and ``completion``: what programs and shells need."""

import json
from typing import Any

import click

from reverie_eval_cli import options
from reverie_eval_cli.output import show

SCHEMAS = (
    "submission",
    "score-report",
    "runs-report",
    "validation-report",
    "comparison-report",
    "against-report",
    "lint-report",
    "dataset-description",
    "run-card",
    "run-episode",
    "run-step",
)


@click.command()
@click.argument("name", type=options.Choice(SCHEMAS))
@options.output("the schema")
def schema(*, name: str, output: str | None) -> None:
    """Print the JSON Schema of a submission, a report, or a line in a run's folder."""
    show(lambda: json.dumps(_schema(name), indent=2), output)


def _schema(name: str) -> dict[str, Any]:
    from pydantic import TypeAdapter

    from reverie_eval.dataset import DatasetDescription, LintReport
    from reverie_eval.reporting.comparisons import AgainstReport, ComparisonReport
    from reverie_eval.runner import RUN_SCHEMAS, run_schema
    from reverie_eval.schemas.report import RunsReport, ScoreReport, ValidationReport
    from reverie_eval.submissions import submission_schema

    if name == "submission":
        return submission_schema()
    if name in RUN_SCHEMAS:
        return run_schema(name)
    adapters: dict[str, TypeAdapter[Any]] = {
        "score-report": TypeAdapter(ScoreReport),
        "runs-report": TypeAdapter(RunsReport),
        "validation-report": TypeAdapter(ValidationReport),
        "comparison-report": TypeAdapter(ComparisonReport),
        "against-report": TypeAdapter(AgainstReport),
        "lint-report": TypeAdapter(LintReport),
        "dataset-description": TypeAdapter(DatasetDescription),
    }
    return adapters[name].json_schema(mode="serialization")


@click.command()
@click.argument("shell", type=options.Choice(["bash", "zsh", "fish", "powershell"]))
def completion(*, shell: str) -> int:
    """Print a script for completion in a shell.

    \b
      bash:  eval "$(reverie-eval completion bash)"
      zsh:   eval "$(reverie-eval completion zsh)"
      fish:  reverie-eval completion fish | source
    """  # noqa: D301  # click keeps the lines of a paragraph that begins with it
    from click.shell_completion import shell_complete

    from reverie_eval_cli.main import COMPLETION_VARIABLE, PROGRAM, program

    return shell_complete(program, {}, PROGRAM, COMPLETION_VARIABLE, f"{shell}_source")
