"""``reverie-eval table``, ``check-table`` and ``figure``: the tables and pictures of a paper."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from glob import glob
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from reverie_eval import ReverieEvalError, Scores, evaluate_protocols
from reverie_eval.analysis import SPLIT_FIELD, Runs
from reverie_eval.reporting.tables import Printout
from reverie_eval.scoring import Scored
from reverie_eval.submissions import find_fields, find_runs
from reverie_eval.tasks import PublishedResult, published_on
from reverie_eval.text import did_you_mean
from reverie_eval_cli import options
from reverie_eval_cli.commands.compare import find_methods, score_methods
from reverie_eval_cli.options import IntervalOptions, ScoringOptions
from reverie_eval_cli.output import (
    check_outputs,
    note,
    score_each,
    score_each_by,
    show_printout,
    with_progress,
)

if TYPE_CHECKING:
    from reverie_eval.reporting.episode_figure import Columns

# How wide a figure is, if it is not said.
_COLUMNS = "2"

_methods = click.argument("methods", metavar="[NAME=]FILE...", nargs=-1, required=True)
_scoring_of_splits = options.scoring_by(
    options.protocol,
    click.option(
        "--split",
        required=True,
        metavar="NAME[,NAME]",
        shell_complete=options.complete_split,
        help="The split, or several: val_seen,val_unseen.",
    ),
)
"""What scores submissions to one or several splits, which :func:`_each_split` tells apart."""


@click.command()
@_methods
@_scoring_of_splits
@click.option(
    "--baseline",
    "baselines",
    metavar="NAME",
    multiple=True,
    help="Mark what differs significantly from this method; may be repeated.",
)
@click.option(
    "--published",
    metavar="METHOD|FILE",
    multiple=True,
    help="Rows above the others: a method that is known here, such as FAST-Short, or all of a TOML "
    "file; may be repeated.",
)
@options.intervals(
    "confidence intervals; means of runs have them.", "the intervals and of the tests"
)
@options.layout("table", "latex", "markdown", "csv", "html")
@options.output("the table")
def table(
    *,
    methods: Sequence[str],
    scoring: ScoringOptions,
    baselines: Sequence[str],
    published: Sequence[str],
    intervals: IntervalOptions,
    layout: str,
    output: str | None,
) -> None:
    """Write the results table of a paper.

    \b
      reverie-eval table HAMT=hamt/{split}.json DUET=duet/{split}.json \\
          ours='ours/seed*/{split}.json' --split val_seen,val_unseen \\
          --baseline DUET --published FAST-Short --format latex

    A row is a file, or the mean of several runs; {split} stands for each split's name. Bold is the
    best of a column if it is significantly better than all others, underlined the second best. The
    caption says by which test, and has protocol and data. LaTeX needs the package booktabs.
    """  # noqa: D301  # click keeps the lines of a paragraph that begins with it
    from reverie_eval.reporting import results_table

    results: dict[str, list[Scored]] = {}
    for split, files in _files_of_splits(methods, scoring, output).items():
        how = _each_split(scoring)[split]
        scores = score_methods(
            files, how.evaluator(how.find()), intervals.over, intervals.confidence
        )
        for name, each in scores.items():
            results.setdefault(name, []).append(
                intervals.added_to(each) if isinstance(each, Scores) else each
            )
    above = _published(published, next(iter(results.values()))[0], scoring)
    laid_out = results_table(results, baselines=baselines, published=above)
    show_printout(
        Printout.of_table(lambda: laid_out, csv=laid_out.to_csv, papers={"html": lambda: laid_out}),
        layout,
        output,
    )


@click.command("check-table")
@click.argument("paper", metavar="TABLE", type=options.PATH)
@_methods
@_scoring_of_splits
@options.layout("table", "csv", explained=" csv has every number that was checked.")
@options.output("what was found")
def check_table(
    *,
    paper: Path,
    methods: Sequence[str],
    scoring: ScoringOptions,
    layout: str,
    output: str | None,
) -> int:
    """Check the numbers of a paper's table.

    \b
      reverie-eval check-table paper.tex ours=ours/{split}.json \\
          DUET=duet/{split}.json --split val_seen,val_unseen

    TABLE is LaTeX (.tex), Markdown (.md) or CSV, with **bold** marked as in Markdown. Each number
    that a file has is compared with it: whether it agrees, was rounded wrongly, or agrees under
    another protocol. Rows are matched to files by label, or else by their numbers. For what is bold
    it says whether it is the best, and significantly so. Exit status 1 if something is wrong.
    """  # noqa: D301  # click keeps the lines of a paragraph that begins with it
    from reverie_eval.reporting.printed import read_tables
    from reverie_eval.reporting.table_check import check_tables

    if paper.suffix.casefold() == ".pdf":
        raise click.UsageError(
            f"{paper}: tables are not read from PDF; give LaTeX, or copy the table to a CSV file"
        )
    check_outputs([output], [paper])
    tables = read_tables(paper.read_text("utf-8", errors="replace"), paper.name.casefold())
    if not any(table.rows for table in tables):
        raise ReverieEvalError(
            f"{paper}: no table found; in LaTeX (.tex), environments such as tabular, tabularx and "
            "longtable are read, but not files that it inputs; in Markdown (.md), lines that begin "
            "with |; any other file is read as CSV"
        )
    results = {
        split: _by_protocol(files, _each_split(scoring)[split])
        for split, files in _files_of_splits(methods, scoring, output).items()
    }
    by_method = next(iter(results.values()))
    # The first, whatever alias it was given by.
    protocol = next(iter(next(iter(by_method.values()))))
    check = check_tables(tables, results, protocol)
    show_printout(check.printout(), layout, output)
    return 0 if check.is_right else 1


def _by_protocol(
    methods: Mapping[str, Sequence[str]], how: ScoringOptions
) -> Mapping[str, Mapping[str, Scored]]:
    """Return the scores of each method under each protocol, the wanted one first."""
    truth = how.find()
    wanted = how.evaluator(truth).protocol.name
    score = partial(evaluate_protocols, split=how.split, ground_truth=truth, track=how.track)
    # In one go, so that the problems of all files are listed together.
    scored = iter(score_each_by(score, [file for files in methods.values() for file in files]))
    results: dict[str, Mapping[str, Scored]] = {}
    for method, files in methods.items():
        runs = dict(zip(files, islice(scored, len(files)), strict=True))
        first, *others = runs.values()
        results[method] = {
            name: Runs.of({file: run[name] for file, run in runs.items()})
            if others
            else first[name]
            for name in sorted(first, key=lambda name: name != wanted)
        }
    return results


def _each_split(how: ScoringOptions) -> Mapping[str, ScoringOptions]:
    """Return the options for each of the splits that ``--split`` names, by split."""
    names = [name.strip() for name in how.split.split(",")]
    if "" in names:
        raise click.UsageError(f"--split {how.split}: a comma has no split before or after it")
    return {name: replace(how, split=name) for name in names}


def _files_of_splits(
    words: Sequence[str], scoring: ScoringOptions, output: str | None
) -> Mapping[str, Mapping[str, Sequence[str]]]:
    """Return the files of each method by its name, for each split."""
    splits = list(_each_split(scoring))
    if len(splits) > 1:
        fixed = [word for word in words if SPLIT_FIELD not in word]
        if fixed:
            raise click.UsageError(
                f"{', '.join(fixed)}: of which split? Write {SPLIT_FIELD} where its name stands, "
                f"as in ours=runs/{SPLIT_FIELD}.json"
            )
    found: dict[str, Mapping[str, Sequence[str]]] = {}
    for split in splits:
        named = {word: word.replace(SPLIT_FIELD, split) for word in words}
        missing = [it for word, it in named.items() if word != it and not _has_file(it)]
        if len(missing) == len(named):
            raise click.UsageError(f"{split}: no file {', '.join(missing)}")
        for each in missing:
            note(f"no result on {split}: there is no file {each}")
        found[split] = find_methods([it for it in named.values() if it not in missing], split)
    check_outputs(
        [output],
        [
            scoring.ground_truth,
            *(file for each in found.values() for runs in each.values() for file in runs),
        ],
    )
    return found


def _has_file(word: str) -> bool:
    named = word.partition("=")[2]
    names = (named or word).split(",")
    return Path(word).exists() or any(glob(each) or find_fields(each) for each in names)  # noqa: PTH207


def _published(
    words: Sequence[str], first: Scored, scoring: ScoringOptions
) -> Sequence[PublishedResult]:
    """Return the published results that words name, on the splits that are shown."""
    found: list[PublishedResult] = []
    for word in words:
        file = word if Path(word).exists() else None
        of_splits = [
            published_on(first.ground_truth.task.name, split, scoring.track, file)
            for split in _each_split(scoring)
        ]
        several = [
            each
            for by_method in of_splits
            for method, each in by_method.items()
            if file or method.casefold() == word.casefold()
        ]
        if not several:
            known = {method for by_method in of_splits for method in by_method}
            raise ReverieEvalError(
                f"--published {word}: nothing on {scoring.split} is known here"
                f"{did_you_mean(word, sorted(known))}; or give a file of the form of published.toml"
            )
        found += several
    return found


@click.command()
@click.argument(
    "words",
    metavar="SUBMISSION... EPISODE",
    nargs=-1,
    required=True,
    type=click.Path(allow_dash=True),
)
@options.new_path("FILE", "The figure: .svg, .pdf or .png; with --animate, .svg, .gif or .mp4.")
@options.scoring
@options.with_default(
    "--columns",
    type=options.Choice(["1", "2"]),
    default=_COLUMNS,
    help="Width of the figure, in columns of a page: 3.3 or 6.9 inches.",
)
@options.with_default("--legend/--no-legend", default=True, help="Explain the symbols of the map.")
@click.option("--animate", is_flag=True, help="Animate the walk in its building, over 8 seconds.")
def figure(
    *,
    words: Sequence[str],
    output: Path,
    scoring: ScoringOptions,
    columns: str,
    legend: bool,
    animate: bool,
) -> None:
    """Draw an episode for a paper: its map, and what the agent saw where it answered.

    EPISODE is an instr_id. A second SUBMISSION is drawn on the same map. NAME=FILE names a method.
    """
    from reverie_eval.reporting import save_figure
    from reverie_eval.reporting.episode_figure import check_animation_name, save_animation
    from reverie_eval.reporting.figures import check_figure_name

    *submissions, episode = words
    if not submissions:
        raise click.UsageError(f"name a submission and an episode of it, got {episode} alone")
    if animate and (columns != _COLUMNS or not legend):
        raise click.UsageError("--columns and --no-legend cannot be combined with --animate")
    is_named = [find_runs(word) is not None for word in submissions]
    if any(is_named) and not all(is_named):
        raise click.UsageError("one file has a name and another has none; write NAME=FILE for both")
    methods = find_methods(submissions)
    for name, runs in methods.items():
        if len(runs) > 1:
            raise click.UsageError(
                f"{name}: a figure shows one file of each method, got {len(runs)}"
            )
    files = [file for (file,) in methods.values()]
    # A single method needs a name only if it is given one.
    names = list(methods) if any(is_named) or len(files) > 1 else [""]
    (check_animation_name if animate else check_figure_name)(output)
    check_outputs([output], [*files, scoring.ground_truth])
    scored = score_each(files, scoring.evaluator(scoring.find()))
    episodes = {name: each.episode(episode) for name, each in zip(names, scored, strict=True)}
    if animate:
        save_animation(episodes, output, with_progress)
        return
    save_figure(episodes, output, cast("Columns", int(columns)), legend=legend)
