"""``reverie-eval export FORMAT``: scores in the formats of other collections."""

import hashlib
import json
import re
import uuid
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timezone
from functools import wraps
from pathlib import Path
from typing import Any

import click

from reverie_eval import Scores
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.options import ScoringOptions
from reverie_eval_cli.output import check_outputs, naming, open_output, show


class _Repository(click.ParamType[tuple[str, str]]):
    """The name of something below its owner's: ``OWNER/NAME``."""

    name = "OWNER/NAME"
    _FORM = re.compile(r"([A-Za-z0-9][\w.-]*)/([A-Za-z0-9][\w.-]*)", re.ASCII)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str]:
        """Read both names."""
        found = self._FORM.fullmatch(value)
        if found is None:
            self.fail(
                f"{value!r} is not OWNER/NAME, with letters, digits, '.', '_' and '-': "
                "example-lab/walker",
                param,
                ctx,
            )
        return found[1], found[2]


def _scored(command: Callable[..., None]) -> Callable[..., None]:
    """Add what scores a submission; the command gets the scores, and the submission's path."""

    @options.submission
    @options.scoring
    @wraps(command)
    def with_scores(*, submission: str, scoring: ScoringOptions, **others: Any) -> None:
        truth = scoring.find()
        check_outputs([others["output"]], [submission, scoring.ground_truth])
        with naming(submission):
            scores = scoring.evaluator(truth)(submission)
        command(submission=submission, scores=scores, **others)

    return with_scores


@click.group(cls=Group)
def export() -> None:
    """Write scores in the format of another collection."""


@export.command("every-eval-ever")
@_scored
@click.option(
    "--model", type=_Repository(), required=True, help="What was evaluated: DEVELOPER/NAME."
)
@click.option(
    "--evaluator",
    metavar="NAME",
    help="The organisation that computed the scores.  [default: the developer]",
)
@click.option(
    "--instances", is_flag=True, help="Also write the values of each episode of an open split."
)
@options.new_path(
    "FOLDER", "The root of the collection; files go to data/DATASET/DEVELOPER/NAME/ in it."
)
def export_every_eval_ever(
    *,
    submission: str,
    scores: Scores,
    model: tuple[str, str],
    evaluator: str | None,
    instances: bool,
    output: Path,
) -> None:
    """Write a result for Every Eval Ever.

    SUBMISSION is a result file. Metrics are those of the score table that have a better direction,
    with 95 % confidence intervals.
    """
    from reverie_eval.exports import EvaluatedModel, collection, every_eval_ever

    developer, name = model
    # Most results are computed by those who made the model.
    evaluated = EvaluatedModel(developer, name, evaluator or developer)
    aggregate = every_eval_ever(scores.with_intervals(), evaluated, datetime.now(timezone.utc))
    folder = Path("data", collection(scores), developer, name)
    # A name that no other file of the collection has.
    stem = str(uuid.uuid4())
    (output / folder).mkdir(parents=True, exist_ok=True)
    written = [folder / f"{stem}.json"]
    if instances:
        written.append(folder / f"{stem}_samples.jsonl")
        details = _write_instances(submission, scores, aggregate, output, written[-1])
        aggregate = {**aggregate, "detailed_evaluation_results": details}
    with open_output(str(output / written[0])) as file:
        file.write(f"{json.dumps(aggregate, indent=2)}\n")
    for each in written:
        print(output / each)


def _write_instances(
    submission: str, scores: Scores, aggregate: Mapping[str, Any], root: Path, name: Path
) -> Mapping[str, Any]:
    """Write the values of all episodes, and return what the aggregate says of the file."""
    from reverie_eval.exports import instance_results
    from reverie_eval.submissions import convert

    truth = scores.ground_truth
    records = convert(submission, split=truth.split, ground_truth=truth).records
    digest, rows = hashlib.sha256(), 0
    # Line by line: a split has thousands of episodes, each with its trajectory.
    with open_output(str(root / name)) as file:
        for row in instance_results(scores, records, aggregate):
            line = f"{json.dumps(row)}\n"
            digest.update(line.encode())
            file.write(line)
            rows += 1
    return {
        "format": "jsonl",
        "file_path": name.as_posix(),
        "hash_algorithm": "sha256",
        "checksum": digest.hexdigest(),
        "total_rows": rows,
    }


@export.command("model-card")
@_scored
@click.option("--model", metavar="NAME", required=True, help="What was evaluated.")
@options.output("the metadata")
def export_model_card(*, submission: str, scores: Scores, model: str, output: str | None) -> None:  # noqa: ARG001
    """Print the metadata of a model card.

    It goes to the top of the model's README.md on Hugging Face. SUBMISSION is a result file.
    """
    from reverie_eval.exports import model_index

    show(lambda: f"---\n{_yaml(model_index(scores, model))}---", output)


@export.command("eval-results")
@_scored
@click.option(
    "--benchmark",
    type=_Repository(),
    required=True,
    help="The benchmark's dataset on Hugging Face: OWNER/NAME.",
)
@click.option(
    "--task-id", metavar="ID", required=True, help="The task as the benchmark's eval.yaml names it."
)
@options.output("the results")
def export_eval_results(
    *,
    submission: str,  # noqa: ARG001
    scores: Scores,
    benchmark: tuple[str, str],
    task_id: str,
    output: str | None,
) -> None:
    """Print a result for a Hugging Face benchmark.

    It goes to the folder .eval_results/ of the model. SUBMISSION is a result file; the value is
    that of the metric that ranks submissions.
    """
    from reverie_eval.exports import evaluation_results

    # When it was computed, which is now; a file has no trustworthy date.
    at = datetime.now(timezone.utc)
    results = evaluation_results(scores, "/".join(benchmark), task_id, at)
    show(lambda: _yaml(results).rstrip(), output)


def _yaml(document: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> str:
    import yaml

    text: str = yaml.safe_dump(document, sort_keys=False, allow_unicode=True)
    return text
