"""``reverie-eval SUBMISSION --split SPLIT``: print the scores of a submission, or of many.

The words choose one of eight ways to score, each a function below; ``_way_of`` says which.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from reverie_eval import (
    Evaluator,
    GroundTruth,
    ScoredFiles,
    Scores,
    SubmissionError,
    diagnose,
    evaluate_protocols,
)
from reverie_eval.files import staged_file
from reverie_eval.logs import find_run
from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.scores import (
    ranking_printout,
    runs_printout,
    scores_printout,
    write_episodes,
)
from reverie_eval.reporting.tables import FORMATS, Printout, metric_cells
from reverie_eval.scoring import (
    DEFAULT_PROTOCOL,
    TABLE_KEYS,
    score_files,
    scored_metrics,
)
from reverie_eval.submissions import (
    find_files,
    find_runs,
    has_fields,
    is_pattern,
    submission_names,
    watch_files,
)
from reverie_eval.tasks import DEFAULT_TASK, find_task
from reverie_eval_cli import options
from reverie_eval_cli.output import (
    check_outputs,
    failure_line,
    naming,
    note,
    open_output,
    say,
    score_each,
    show_printout,
    with_progress,
)

if TYPE_CHECKING:
    from reverie_eval import Sweep

_REVERIE = find_task(DEFAULT_TASK)
# The metrics of formats that have more than the table has.
_KEYS = dict.fromkeys(("csv", "json"), frozenset(CATALOGUE))
# A file that has not changed for so long is taken to be complete.
_SECONDS_BETWEEN_LOOKS = 1.0
# Characters in a column, such as `RGSPL %` and `100.00`.
_WATCH_WIDTH = 7
# Files of which the best is rather a checkpoint than a method.
_MANY = 20
_INTERVALS = frozenset({"--ci", "--cluster", "--confidence"})
_PRINTING = frozenset({"--format", "--output"})


@dataclass(frozen=True)
class Wanted:
    """What the words after ``score`` say."""

    submissions: Sequence[str]
    scoring: options.ScoringOptions
    episodes_from: Path | None
    diagnosed: bool
    intervals: options.IntervalOptions
    select: str | None
    curve: str | None
    watch: bool
    jobs: int | None
    layout: str
    output: str | None
    episodes: str | None
    run: Path | None

    @property
    def given(self) -> Iterator[str]:
        """The given options that only some of the ways take."""
        values = {
            "--diagnose": self.diagnosed,
            "--ci": self.intervals.ci,
            "--cluster": self.intervals.cluster,
            "--confidence": self.intervals.confidence,
            "--episodes": self.episodes,
            "--format": self.layout != FORMATS[0],
            "--output": self.output,
            "--run": self.run,
            "--select": self.select,
            "--curve": self.curve,
            f"--protocol {options.ALL_PROTOCOLS}": self.scoring.protocol == options.ALL_PROTOCOLS,
        }
        return (option for option, value in values.items() if value)

    # Read once: ways that need both truth and evaluator share it.
    @cached_property
    def truth(self) -> GroundTruth:
        """The ground truth of the chosen episodes."""
        return self.scoring.find(self.episodes_from)

    @cached_property
    def evaluator(self) -> Evaluator:
        """What scores by the chosen protocol."""
        return self.scoring.evaluator(self.truth)

    @property
    def file(self) -> str | None:
        """The only file that is to be scored; None if there are several, or runs of a method."""
        # A folder or a pattern is a ranking even if it has one file, so that its output has one
        # form.
        first, *others = self.submissions
        is_one = not others and not find_runs(first) and find_files([first]) == [first]
        return first if is_one else None

    def show(self, printout: Printout) -> None:
        """Print a result in the chosen format."""
        show_printout(printout, self.layout, self.output)


@click.command()
@options.grouped(
    "wanted",
    Wanted,
    options.submissions,
    options.scoring_by(
        options.with_default(
            "--protocol",
            default=DEFAULT_PROTOCOL,
            metavar="NAME",
            shell_complete=options.complete_protocol,
            help=f"The rules to score by: {', '.join(each.name for each in _REVERIE.protocols)}; "
            f"{', '.join(f'{alias} (= {name})' for alias, name in _REVERIE.aliases.items())}; "
            f"or {options.ALL_PROTOCOLS} of them.",
        ),
        options.split_named("--split", "--report"),
    ),
    options.episodes_from,
    click.option(
        "--diagnose",
        "diagnosed",
        is_flag=True,
        help="Also show the scores if only the first viewpoint of each hop were read.",
    ),
    options.intervals("confidence intervals.", "the intervals"),
    click.option(
        "--select",
        metavar="SPLIT",
        help="Choose the best row of a sweep on SPLIT, and score that alone on --report.",
    ),
    click.option(
        "--curve",
        metavar="FILE",
        type=click.Path(),
        help="Also draw the rows of a sweep over their numbers, as FILE.pdf, .svg or .png.",
    ),
    click.option(
        "--watch",
        is_flag=True,
        help="Score files as they appear and change, a line each, until Ctrl-C.",
    ),
    options.jobs,
    options.layout(*FORMATS),
    options.output("the scores"),
    click.option(
        "--episodes",
        metavar="FILE",
        type=click.Path(),
        help="Also write the values, outcome and instruction of every episode to FILE, as CSV; "
        "with several protocols, the first's.",
    ),
    click.option(
        "--run",
        metavar="FOLDER",
        type=options.PATH,
        help="Also show what the run in FOLDER cost, as its episodes.jsonl says.  [default: the "
        "submission's folder, if `reverie-eval run` wrote it]",
    ),
)
def score(*, wanted: Wanted) -> int:
    """Score a submission, or many.

    SUBMISSION is a result file (.json or .jsonl, also .gz or .zip), the folder of a run, or - for
    standard input. Several files, a folder of them, or a pattern ('runs/*/val_unseen.json') give a
    ranking; several runs of a method (ours=seed1.json,seed2.json or ours='seed*.json') their mean;
    and a sweep ('runs/seed{seed}/{checkpoint}.json') a row for each checkpoint, the mean of its
    seeds. The word `score` may be left out.
    """
    inputs = [*wanted.submissions, wanted.scoring.ground_truth, wanted.episodes_from]
    check_outputs([wanted.output, wanted.episodes, wanted.curve], inputs)
    way = _way_of(wanted)
    # Refused rather than ignored: a score without the asked intervals looks like one that has none.
    refused = [option for option in wanted.given if option not in way.takes]
    if refused:
        raise click.UsageError(f"{', '.join(refused)} cannot be combined with {way.meaning}")
    return way.follow(wanted)


def _way_of(wanted: Wanted) -> "_Way":
    # First, because a folder that is watched may still be empty.
    if wanted.watch:
        return _WATCH
    if any(map(find_runs, wanted.submissions)):
        return _RUNS
    if any(map(has_fields, wanted.submissions)):
        return _SELECTION if wanted.select else _SWEEP
    if wanted.file is None:
        return _RANKING
    if wanted.diagnosed:
        return _DIAGNOSIS
    return _ALL_PROTOCOLS if wanted.scoring.protocol == options.ALL_PROTOCOLS else _FILE


# One file.


def score_file(wanted: Wanted) -> int:
    """Print the scores of a file."""
    return _print_scores(wanted, lambda file, _: [wanted.evaluator(file)])


def score_by_all_protocols(wanted: Wanted) -> int:
    """Print a file's scores by every protocol, those that differ from the first's marked."""
    return _print_scores(
        wanted,
        lambda file, truth: list(
            evaluate_protocols(
                file, split=truth.split, ground_truth=truth, track=wanted.scoring.track
            ).values()
        ),
    )


def diagnose_file(wanted: Wanted) -> int:
    """Print a file's scores, and those if only the first viewpoint of each hop were read."""
    if wanted.scoring.track != "full":
        raise click.UsageError("--diagnose needs the full track")
    return _print_scores(
        wanted,
        lambda file, truth: diagnose(
            file, split=truth.split, ground_truth=truth, protocol=wanted.scoring.protocol
        ),
    )


def _print_scores(wanted: Wanted, score_by: Callable[[str, GroundTruth], Sequence[Scores]]) -> int:
    """Print the scores of a file, with intervals if they are wanted."""
    (file,), truth = wanted.submissions, wanted.truth
    with naming(file):
        results = score_by(file, truth)
    results = list(map(wanted.intervals.added_to, results))
    if run := wanted.run or find_run(file):
        results = [scores.with_run(run) for scores in results]
    if wanted.episodes:
        with open_output(wanted.episodes) as opened:
            write_episodes(results[0], opened)
    wanted.show(scores_printout(results))
    return 0


# Many files.


def rank_files(wanted: Wanted) -> int:
    """Print a ranking of files, and why others are not in it; return the exit status."""
    files, evaluator = find_files(wanted.submissions), wanted.evaluator
    # Only the columns that are printed are computed in the processes and sent back.
    keys = _KEYS.get(wanted.layout, TABLE_KEYS)
    results = score_files(files, evaluator, jobs=wanted.jobs, keys=keys)
    scored = ScoredFiles.of(with_progress(results, "Scoring", len(files)))
    if scored:
        wanted.show(ranking_printout(scored))
    if len(scored) > _MANY:
        note(
            f"the best of {len(scored)} is partly luck; if these are seeds and checkpoints of a "
            "method, 'runs/seed{seed}/{checkpoint}.json' averages seeds and says how much"
        )
    for file, error in scored.failures.items():
        say(failure_line(file, error))
    return 1 if scored.failures else 0


def average_runs(wanted: Wanted) -> int:
    """Print the mean of several runs of a method, with its interval."""
    (first, *others) = wanted.submissions
    found = find_runs(first)
    if found is None or others:
        raise click.UsageError(
            "give NAME=FILES alone; `reverie-eval compare` takes several methods and their runs"
        )
    name, files = found
    check_outputs([wanted.output], files)
    scores = score_each(files, wanted.evaluator)
    named = dict(zip(submission_names(files), scores, strict=True))
    from reverie_eval.analysis import Runs  # not imported for files alone

    runs = Runs.of(named, wanted.intervals.over, confidence=wanted.intervals.confidence)
    wanted.show(runs_printout(name, runs))
    return 0


def watch_for_files(wanted: Wanted) -> int:
    """Print a line for each file that comes or changes, until the user interrupts."""
    evaluator = wanted.evaluator
    for name in wanted.submissions:
        if not (is_pattern(name) or Path(name).exists()):
            raise click.UsageError(f"{name}: there is no such file or folder to watch")
    task = evaluator.ground_truth.task
    metrics = task.table_metrics(scored_metrics(evaluator.protocol, evaluator.track))
    _print_line([metric.heading for metric in metrics], "file")
    with suppress(KeyboardInterrupt):
        for file in watch_files(wanted.submissions, partial(time.sleep, _SECONDS_BETWEEN_LOOKS)):
            try:
                scores = evaluator(file)
            except (SubmissionError, OSError) as error:
                say(failure_line(file, error))
                continue
            _print_line(metric_cells(metrics, scores), file)
    return 0


def _print_line(cells: Sequence[str], file: str) -> None:
    """Print the cells of a file, its path last so that the columns stay in line."""
    # Flushed line by line, for a log or a pipe that someone follows.
    print("  ".join([*(cell.rjust(_WATCH_WIDTH) for cell in cells), file]), flush=True)


# Sweeps.


def print_sweep(wanted: Wanted) -> int:
    """Print a row for each checkpoint or setting, and the best; return the exit status."""
    from reverie_eval.reporting.scores import sweep_printout  # imports what takes long, too

    sweep = _score_and_draw(wanted, _pattern(wanted), wanted.scoring)
    if sweep:
        wanted.show(sweep_printout(sweep))
    return 1 if sweep.failures else 0


def select_and_report(wanted: Wanted) -> int:
    """Print the rows of the split to select on, and the best of them on the other."""
    from reverie_eval.analysis import SPLIT_FIELD
    from reverie_eval.reporting.scores import selection_printout

    pattern, select = _pattern(wanted), str(wanted.select)
    if SPLIT_FIELD not in pattern:
        raise click.UsageError(
            f"--select needs {SPLIT_FIELD} in the pattern, as in "
            f"'runs/{{checkpoint}}_{SPLIT_FIELD}.json'"
        )
    if select == wanted.scoring.split:
        raise click.UsageError(f"--select and --report are both {select}; report another split")
    if wanted.episodes_from:
        raise click.UsageError("--episodes-from cannot be combined with --select")
    sweep = _score_and_draw(wanted, pattern, replace(wanted.scoring, split=select))
    best = _score_rows(wanted, sweep.best_pattern, wanted.scoring)
    # A single row, or none if no file of it could be scored.
    for name, runs in best.rows.items():
        for seed in sweep.rows[sweep.best]:
            if seed not in runs:
                note(f"{sweep.best} has no score of seed {seed} on {wanted.scoring.split}")
        reported = best.with_intervals(
            name, wanted.intervals.over, confidence=wanted.intervals.confidence
        )
        wanted.show(selection_printout(sweep, reported))
    return 1 if sweep.failures or best.failures else 0


def _pattern(wanted: Wanted) -> str:
    pattern, *others = wanted.submissions
    if others:
        raise click.UsageError("give the pattern of a sweep alone, in quotes")
    return pattern


def _score_and_draw(wanted: Wanted, pattern: str, scoring: options.ScoringOptions) -> "Sweep":
    """Score the files of a pattern, and draw the curve if one is wanted."""
    from reverie_eval.analysis import check_curve
    from reverie_eval.reporting.figures import check_figure_name, check_matplotlib

    if wanted.curve:  # before any time is spent on files that cannot be drawn
        check_figure_name(wanted.curve)
        check_matplotlib()
        check_curve(pattern, scoring.split)
    sweep = _score_rows(wanted, pattern, scoring)
    if wanted.curve and sweep:
        file = Path(wanted.curve)
        with staged_file(file) as staged:
            sweep.plot().figure.canvas.print_figure(
                staged, format=file.suffix[1:], bbox_inches="tight"
            )
    return sweep


def _score_rows(wanted: Wanted, pattern: str, scoring: options.ScoringOptions) -> "Sweep":
    """Score the files of a pattern, and say why others have no scores."""
    from reverie_eval import Sweep
    from reverie_eval.analysis import sweep_files

    files = sweep_files(pattern, scoring.split)
    evaluator = scoring.evaluator(scoring.find(wanted.episodes_from))
    results = score_files(files, evaluator, jobs=wanted.jobs)
    scored = ScoredFiles.of(with_progress(results, f"Scoring {scoring.split}", len(files)))
    for file, error in scored.failures.items():
        say(failure_line(file, error))
    return Sweep.of(pattern, scored, scoring.split)


class _Way(NamedTuple):
    """A way to score."""

    meaning: str
    """What chooses it, as an error names it."""
    follow: Callable[[Wanted], int]
    takes: frozenset[str]
    """The options that it takes, of those that not all ways take."""


_OF_A_FILE = _INTERVALS | _PRINTING | {"--episodes", "--run"}
_ALL = f"--protocol {options.ALL_PROTOCOLS}"
_FILE = _Way("a single file", score_file, _OF_A_FILE)
_ALL_PROTOCOLS = _Way(_ALL, score_by_all_protocols, _OF_A_FILE | {_ALL})
_DIAGNOSIS = _Way("--diagnose", diagnose_file, _OF_A_FILE | {"--diagnose"})
_RANKING = _Way(
    "several files; `reverie-eval compare` compares them with intervals", rank_files, _PRINTING
)
_RUNS = _Way("runs of a method", average_runs, _INTERVALS | _PRINTING)
_SWEEP = _Way("a sweep without --select", print_sweep, _PRINTING | {"--curve"})
_SELECTION = _Way("--select", select_and_report, _INTERVALS | _PRINTING | {"--curve", "--select"})
_WATCH = _Way("--watch", watch_for_files, frozenset())
