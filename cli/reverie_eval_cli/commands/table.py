"""``reverie-eval table`` and ``check-table``: the table of a paper, and whether it is right."""

from collections.abc import Mapping, Sequence
from glob import glob
from pathlib import Path

import click

from reverie_eval import ReverieEvalError, Scores
from reverie_eval.reporting.tables import Printout
from reverie_eval.scoring import Clustering, Scored
from reverie_eval.submissions import find_fields
from reverie_eval.tasks import PublishedResult, published_on
from reverie_eval.text import did_you_mean
from reverie_eval_cli import options
from reverie_eval_cli.commands.compare import find_methods, score_methods
from reverie_eval_cli.options import ScoringOptions, each_split
from reverie_eval_cli.output import check_outputs, note, show_printout

_SPLIT = "{split}"

_methods = click.argument("methods", metavar="[NAME=]FILE...", nargs=-1, required=True)


@click.command()
@_methods
@options.scoring_of_splits
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
@click.option("--ci", is_flag=True, help="Also show confidence intervals; means of runs have them.")
@click.option(
    "--cluster",
    type=options.Choice(["target", "scan"]),
    help="What to resample for intervals; implies --ci.  [default: target]",
)
@options.confidence("Confidence of the intervals and of the tests; implies --ci.")
@options.layout("table", "latex", "markdown", "csv", "html")
@options.output("the table")
def table(
    *,
    methods: Sequence[str],
    scoring: ScoringOptions,
    baselines: Sequence[str],
    published: Sequence[str],
    ci: bool,
    cluster: Clustering | None,
    confidence: float | None,
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
    has_intervals = bool(ci or cluster or confidence)
    over = cluster or "target"
    for split, files in _files_of_splits(methods, scoring, output).items():
        how = each_split(scoring)[split]
        scores = score_methods(files, how.evaluator(how.find()), over, confidence)
        for name, each in scores.items():
            results.setdefault(name, []).append(
                each.with_intervals(over, confidence=confidence)
                if has_intervals and isinstance(each, Scores)
                else each
            )
    above = _published(published, next(iter(results.values()))[0], scoring)
    laid_out = results_table(results, baselines=baselines, published=above)
    show_printout(
        Printout.of_table(
            lambda: laid_out, json=str, csv=laid_out.to_csv, papers={"html": lambda: laid_out}
        ),
        layout,
        output,
    )


def _files_of_splits(
    words: Sequence[str], scoring: ScoringOptions, output: str | None
) -> Mapping[str, Mapping[str, Sequence[str]]]:
    """Return the files of each method by its name, for each split."""
    splits = list(each_split(scoring))
    if len(splits) > 1:
        fixed = [word for word in words if _SPLIT not in word]
        if fixed:
            raise click.UsageError(
                f"{', '.join(fixed)}: of which split? Write {_SPLIT} where its name stands, as in "
                f"ours=runs/{_SPLIT}.json"
            )
    found: dict[str, Mapping[str, Sequence[str]]] = {}
    for split in splits:
        named = {word: word.replace(_SPLIT, split) for word in words}
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
            for split in each_split(scoring)
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
