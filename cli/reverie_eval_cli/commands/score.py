"""``reverie-eval SUBMISSION --split SPLIT``: print the score table of a submission."""

import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from glob import has_magic
from pathlib import Path

import click

from reverie_eval import (
    Evaluator,
    GroundTruth,
    Runs,
    ScoredFiles,
    Scores,
    SubmissionError,
    diagnose,
    evaluate,
    evaluate_protocols,
)
from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.scores import (
    FORMATS,
    RANKING_FORMATS,
    RUNS_FORMATS,
    ranking_table,
    runs_table,
    score_table,
    watch_heading,
    watch_line,
    write_episodes,
)
from reverie_eval.scoring import (
    DEFAULT_PROTOCOL,
    TABLE_KEYS,
    Clustering,
    Failure,
    Track,
    score_files,
)
from reverie_eval.submissions import find_files, find_runs, submission_names, watch_files
from reverie_eval.tasks import DEFAULT_TASK, find_task
from reverie_eval_cli import options
from reverie_eval_cli.options import ScoringOptions
from reverie_eval_cli.output import (
    check_outputs,
    naming,
    open_output,
    score_each,
    show,
    show_table,
    with_progress,
)

_ALL = "all"
_REVERIE = find_task(DEFAULT_TASK)
_KEYS = dict.fromkeys(("csv", "json"), frozenset(CATALOGUE))
"""The metrics of formats that have more than the table has."""
_SECONDS_BETWEEN_LOOKS = 1.0
"""A file that has not changed for so long is taken to be complete."""


@click.command()
@options.submissions
@options.grouped(
    "scoring",
    ScoringOptions,
    options.split,
    options.ground_truth,
    options.task,
    options.with_default(
        "--protocol",
        default=DEFAULT_PROTOCOL,
        metavar="NAME",
        shell_complete=options.complete_protocol,
        help=f"The rules to score by: {', '.join(each.name for each in _REVERIE.protocols)}; "
        f"{', '.join(f'{alias} (= {name})' for alias, name in _REVERIE.aliases.items())}; "
        f"or {_ALL} of them.",
    ),
    options.track,
)
@options.episodes_from
@click.option(
    "--diagnose",
    "diagnosed",
    is_flag=True,
    help="Also show the scores if only the first viewpoint of each hop were read.",
)
@click.option("--ci", is_flag=True, help="Also show confidence intervals.")
@click.option(
    "--cluster",
    type=options.Choice(["target", "scan"]),
    help="What to resample for intervals; implies --ci.  [default: target]",
)
@click.option(
    "--confidence",
    metavar="SHARE",
    type=options.CONFIDENCE,
    help="Confidence of the intervals; implies --ci.  [default: 0.95]",
)
@click.option(
    "--watch",
    is_flag=True,
    help="Score files as they appear and change, a line each, until Ctrl-C.",
)
@options.jobs
@options.layout(*FORMATS)
@options.output("the scores")
@click.option(
    "--episodes",
    metavar="FILE",
    type=click.Path(),
    help="Also write the values, outcome and instruction of every episode to FILE, as CSV; with "
    "several protocols, the first's.",
)
def score(
    *,
    submissions: Sequence[str],
    scoring: ScoringOptions,
    episodes_from: Path | None,
    diagnosed: bool,
    ci: bool,
    cluster: Clustering | None,
    confidence: float | None,
    watch: bool,
    jobs: int | None,
    layout: str,
    output: str | None,
    episodes: str | None,
) -> int:
    """Score a submission, or many.

    SUBMISSION is a result file (.json, .json.gz or .zip), or - for standard input. Several files, a
    folder of them, or a pattern ('runs/*/val_unseen.json') give a ranking; several runs of a method
    (ours=seed1.json,seed2.json or ours='seed*.json') their mean. The word `score` may be left out.
    """
    check_outputs([output, episodes], [*submissions, scoring.ground_truth, episodes_from])
    if diagnosed and (scoring.protocol == _ALL or scoring.track != "full"):
        raise click.UsageError("--diagnose needs a single protocol and the full track")
    has_intervals = bool(ci or cluster or confidence)
    truth = scoring.find(episodes_from)
    submission = None if watch else _only_file(submissions)
    if submission is None:
        is_interval_lost = has_intervals and not any(map(find_runs, submissions))
        if diagnosed or is_interval_lost or episodes or scoring.protocol == _ALL:
            raise click.UsageError(
                "--diagnose, --ci, --cluster, --confidence, --episodes and --protocol all need a "
                "single file; `reverie-eval compare` compares several with intervals"
            )
        evaluator = scoring.evaluator(truth)
        if watch:
            return _watch(submissions, evaluator, layout, output)
        if any(map(find_runs, submissions)):
            by = cluster or "target"
            return _score_runs(submissions, evaluator, by, confidence, layout=layout, output=output)
        return _rank(find_files(submissions), evaluator, jobs, layout, output)
    results: Sequence[Scores]
    with naming(submission):
        if diagnosed:
            protocol = scoring.protocol
            results = diagnose(submission, split=truth.split, ground_truth=truth, protocol=protocol)
        else:
            results = _score_one(submission, truth, scoring.protocol, scoring.track)
    if has_intervals:
        results = [
            scores.with_intervals(cluster or "target", confidence=confidence) for scores in results
        ]
    if episodes:
        with open_output(episodes) as file:
            write_episodes(results[0], file)
    if layout == "table":
        table = score_table(results)
        show_table(table, table.stacked(), output=output)
    else:
        show(partial(FORMATS[layout], results), output)
    return 0


def _only_file(submissions: Sequence[str]) -> str | None:
    """Return the only file that is to be scored; None if there are several, or runs of a method."""
    (first, *others) = submissions
    return first if not others and not find_runs(first) and find_files([first]) == [first] else None


def _score_one(
    submission: str, truth: GroundTruth, protocol: str, track: Track
) -> Sequence[Scores]:
    """Score a file by a protocol, or by all."""
    if protocol == _ALL:
        tables = evaluate_protocols(submission, split=truth.split, ground_truth=truth, track=track)
        return list(tables.values())
    return [
        evaluate(submission, split=truth.split, ground_truth=truth, protocol=protocol, track=track)
    ]


def _rank(
    files: Sequence[str], evaluator: Evaluator, jobs: int | None, layout: str, output: str | None
) -> int:
    """Print a ranking of files, and why others are not in it; return the exit status."""
    results = score_files(files, evaluator, jobs=jobs, keys=_KEYS.get(layout, TABLE_KEYS))
    scored = ScoredFiles.of(with_progress(results, "Scoring", len(files)))
    if scored:
        if layout == "table":
            show_table(ranking_table(scored), output=output)
        else:
            show(partial(RANKING_FORMATS[layout], scored), output)
    for file, error in scored.failures.items():
        print(_failure(file, error), file=sys.stderr)
    return 1 if scored.failures else 0


def _score_runs(
    words: Sequence[str],
    evaluator: Evaluator,
    cluster: Clustering,
    confidence: float | None,
    *,
    layout: str,
    output: str | None,
) -> int:
    """Print the mean of several runs of a method, with its interval."""
    (first, *others) = words
    found = find_runs(first)
    if found is None or others:
        raise click.UsageError(
            "give NAME=FILES alone; `reverie-eval compare` takes several methods and their runs"
        )
    name, files = found
    check_outputs([output], files)
    names = submission_names(files)
    scores = dict(zip(names, score_each(files, evaluator), strict=True))
    runs = Runs.of(scores, cluster, confidence=confidence)
    if layout == "table":
        show_table(runs_table(runs), output=output)
    else:
        show(partial(RUNS_FORMATS[layout], name, runs), output)
    return 0


def _watch(names: Sequence[str], evaluator: Evaluator, layout: str, output: str | None) -> int:
    """Print a line for each file that comes or changes, until the user interrupts."""
    if output or layout != "table":
        raise click.UsageError("--watch prints lines; omit --output and --format")
    for name in names:
        if not (has_magic(name) or Path(name).exists()):
            raise click.UsageError(f"{name}: there is no such file or folder to watch")
    print(watch_heading(evaluator), flush=True)
    with suppress(KeyboardInterrupt):
        for file in watch_files(names, partial(time.sleep, _SECONDS_BETWEEN_LOOKS)):
            try:
                print(watch_line(file, evaluator(file), evaluator), flush=True)
            except (SubmissionError, OSError) as error:
                print(_failure(file, error), file=sys.stderr)
    return 0


def _failure(file: str, error: Failure) -> str:
    """Say in a line why a file has no scores."""
    if isinstance(error, OSError):
        return f"{file}: {error.strerror}"
    first, *others = error.problems
    more = f" (`reverie-eval validate` lists {len(others):,} more)" if others else ""
    return f"{file}: submission rejected: {first}{more}"
