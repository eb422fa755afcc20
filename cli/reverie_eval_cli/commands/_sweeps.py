"""The ways of ``reverie-eval score`` with a sweep: all rows of a split, or the best on another."""

import sys
from dataclasses import replace
from pathlib import Path

import click

from reverie_eval import ScoredFiles, Sweep
from reverie_eval.analysis import SPLIT_FIELD, check_curve, sweep_files
from reverie_eval.files import staged_file
from reverie_eval.reporting.figures import check_figure_name, check_matplotlib
from reverie_eval.reporting.sweeps import selection_printout, sweep_printout
from reverie_eval.scoring import score_files
from reverie_eval_cli.commands._wanted import Wanted
from reverie_eval_cli.options import ScoringOptions
from reverie_eval_cli.output import failure_line, note, with_progress


def print_sweep(wanted: Wanted) -> int:
    """Print a row for each checkpoint or setting, and the best; return the exit status."""
    sweep = _score_and_draw(wanted, _pattern(wanted), wanted.scoring)
    if sweep:
        wanted.show(sweep_printout(sweep))
    return 1 if sweep.failures else 0


def select_and_report(wanted: Wanted) -> int:
    """Print the rows of the split to select on, and the best of them on the other."""
    pattern, select = _pattern(wanted), str(wanted.select)
    if f"{{{SPLIT_FIELD}}}" not in pattern:
        raise click.UsageError(
            "--select needs {split} in the pattern, as in 'runs/{checkpoint}_{split}.json'"
        )
    if select == wanted.scoring.split:
        raise click.UsageError(f"--select and --report are both {select}; report another split")
    if wanted.episodes_from:
        raise click.UsageError("--episodes-from cannot be combined with --select")
    sweep = _score_and_draw(wanted, pattern, replace(wanted.scoring, split=select))
    best = _score(wanted, sweep.best_pattern, wanted.scoring)
    # A single row, or none if no file of it could be scored.
    for name, runs in best.rows.items():
        for seed in sweep.rows[sweep.best]:
            if seed not in runs:
                note(f"{sweep.best} has no score of seed {seed} on {wanted.scoring.split}")
        reported = best.with_intervals(
            name, wanted.cluster or "target", confidence=wanted.confidence
        )
        wanted.show(selection_printout(sweep, reported))
    return 1 if sweep.failures or best.failures else 0


def _pattern(wanted: Wanted) -> str:
    pattern, *others = wanted.submissions
    if others:
        raise click.UsageError("give the pattern of a sweep alone, in quotes")
    return pattern


def _score_and_draw(wanted: Wanted, pattern: str, scoring: ScoringOptions) -> Sweep:
    """Score the files of a pattern, and draw the curve if one is wanted."""
    if wanted.curve:  # before any time is spent on files that cannot be drawn
        check_figure_name(wanted.curve)
        check_matplotlib()
        check_curve(pattern, scoring.split)
    sweep = _score(wanted, pattern, scoring)
    if wanted.curve and sweep:
        file = Path(wanted.curve)
        with staged_file(file) as staged:
            sweep.plot().figure.canvas.print_figure(
                staged, format=file.suffix[1:], bbox_inches="tight"
            )
    return sweep


def _score(wanted: Wanted, pattern: str, scoring: ScoringOptions) -> Sweep:
    """Score the files of a pattern, and say why others have no scores."""
    files = sweep_files(pattern, scoring.split)
    evaluator = scoring.evaluator(scoring.find(wanted.episodes_from))
    results = score_files(files, evaluator, jobs=wanted.jobs)
    scored = ScoredFiles.of(with_progress(results, f"Scoring {scoring.split}", len(files)))
    for file, error in scored.failures.items():
        print(failure_line(file, error), file=sys.stderr)
    return Sweep.of(pattern, scored, scoring.split)
