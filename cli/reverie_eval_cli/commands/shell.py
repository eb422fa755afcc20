"""``reverie-eval schema``, ``completion`` and ``simulator``: what programs and shells need."""

import json
from pathlib import Path
from typing import Any

import click

from reverie_eval import ReverieEvalError
from reverie_eval.files import staged_file
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


@click.command()
@click.option("--path", is_flag=True, help="Print the folder that PYTHONPATH needs.")
@click.option(
    "--copy",
    "folder",
    metavar="DIR",
    type=options.PATH,
    help="Write MatterSim.py to DIR, such as the folder of a project.",
)
def simulator(*, path: bool, folder: Path | None) -> None:
    """Let code that says `import MatterSim` run without the C++ simulator.

    \b
      export PYTHONPATH=$(reverie-eval simulator --path)
      reverie-eval simulator --copy my-project

    MatterSim.py is one file that needs numpy alone, and Pillow for pictures. It computes the states
    of the Matterport3D simulator from connectivity files, number for number. `pip install
    mattersim` is something else, a model of materials.
    """  # noqa: D301  # click keeps the lines of a paragraph that begins with it
    from reverie_eval.simulator import FOLDER

    # Both or neither.
    if path == (folder is not None):
        raise click.UsageError("give either --path or --copy DIR")
    if folder is None:
        click.echo(FOLDER)
        return
    content, copy = (FOLDER / "MatterSim.py").read_bytes(), folder / "MatterSim.py"
    if not folder.is_dir():
        raise ReverieEvalError(f"{folder} is not a folder; name the one of your project")
    # A changed copy may be somebody's work.
    if copy.exists() and copy.read_bytes() != content:
        raise ReverieEvalError(f"{copy} exists and is another file; remove it first")
    with staged_file(copy) as file:
        file.write(content)
    click.echo(copy)
