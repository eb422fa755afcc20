"""``reverie-eval compare``, ``report`` and ``plan``: submissions beside each other."""

import re
import sys
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path

import click

from reverie_eval import Evaluator
from reverie_eval.analysis import BEST, Runs
from reverie_eval.metrics import CATALOGUE, printed_value
from reverie_eval.reporting.tables import FORMATS
from reverie_eval.scoring import Clustering, Intervals, Scored
from reverie_eval.submissions import find_files, find_runs, submission_names
from reverie_eval.text import did_you_mean
from reverie_eval_cli import options
from reverie_eval_cli.options import ScoringOptions, TruthOptions
from reverie_eval_cli.output import (
    check_outputs,
    open_output,
    score_each,
    show,
    show_printout,
    write_text,
)

# Percent, as tables show rates; arithmetic takes fractions.
_PERCENT = options.Decimal(0, 100, min_open=True)
# A published mean: RGS=41.2.
_MEAN = re.compile(r"[A-Za-z_]+(=[0-9.]+%?)(,[A-Za-z_]+=[0-9.]+%?)*")


@click.command()
@options.submissions
@click.option(
    "--baseline",
    metavar="FILE|best",
    help="What the others are compared with.  [default: the first file; of a folder or a pattern, "
    "the best]",
)
@options.scoring
@options.episodes_from
@options.cluster
@options.confidence("Confidence of the intervals, and of a significant difference.")
@options.layout(
    *FORMATS,
    explained=" csv has a row per submission and metric; markdown and latex show the scores as "
    "papers do.",
)
@options.output("the comparison")
@click.option(
    "--against",
    multiple=True,
    metavar="METRIC=VALUE|METHOD",
    help="Compare one submission with published means instead: numbers in percent or metres, such "
    "as SR=46.9 RGS=32.1, or those of a known method, such as FAST-Short.",
)
@click.option(
    "--n",
    "n_published",
    metavar="N",
    type=options.Number(min=1),
    help="The number of episodes that the published means are over.  [default: all of the split]",
)
@click.option(
    "--episodes",
    metavar="FILE",
    type=click.Path(),
    help="Also write the episodes that some submissions got right and others wrong to FILE, as "
    "CSV: by RGS or, if that is not scored, by SR.",
)
def compare(
    *,
    submissions: Sequence[str],
    baseline: str | None,
    scoring: ScoringOptions,
    episodes_from: Path | None,
    cluster: Clustering,
    confidence: float | None,
    layout: str,
    output: str | None,
    against: Sequence[str],
    n_published: int | None,
    episodes: str | None,
) -> None:
    """Compare submissions: differences, intervals, significance.

    Each SUBMISSION is compared with the first, or with the baseline. It is a result file (.json,
    .json.gz or .zip), - for standard input, a folder, a pattern ('runs/*/val_unseen.json'), or
    several runs of a method: ours=seed1.json,seed2.json or ours='seed*.json'.
    """
    from reverie_eval import Comparison
    from reverie_eval.analysis import against as compare_with
    from reverie_eval.reporting.comparisons import against_printout, comparison_printout

    if against:
        # Written as `--against SR=46.9 RGS=32.1`, all but the first arrive among the submissions.
        words = [word for word in submissions if _MEAN.fullmatch(word) and not Path(word).exists()]
        submissions = [word for word in submissions if word not in words]
        against = [part for word in (*against, *words) for part in word.split(",")]
    elif n_published is not None:
        raise click.UsageError("--n is the number of episodes of --against, which is missing")
    methods = find_methods(submissions)
    if against and (len(methods) != 1 or baseline or episodes):
        raise click.UsageError(
            "--against compares one submission, or the runs of one method, with published means; "
            "leave out --baseline, --episodes and other files"
        )
    files = [file for runs in methods.values() for file in runs]
    check_outputs([output, episodes], [*files, scoring.ground_truth, episodes_from])
    # Somebody who names a folder has not chosen a first file.
    if baseline is None and len(methods) > len(submissions):
        baseline = BEST
    # A baseline is given as its file, and compared under its name.
    name_of = {runs[0]: name for name, runs in methods.items() if len(runs) == 1}
    scores = score_methods(
        methods, scoring.evaluator(scoring.find(episodes_from)), cluster, confidence
    )
    if against:
        ((name, scored_one),) = scores.items()
        published = _published(against)
        compared = compare_with(scored_one, published, n_published, cluster, confidence=confidence)
        show_printout(against_printout(compared, name), layout, output)
        return
    comparison = Comparison.of(
        scores,
        cluster,
        confidence=confidence,
        baseline=name_of.get(str(baseline), baseline),
    )
    if episodes:
        with open_output(episodes) as file:
            comparison.episodes().to_csv(file)
    show_printout(comparison_printout(comparison), layout, output)


@click.command()
@options.submissions
@options.scoring
@options.episodes_from
@options.cluster
@options.output("the report")
def report(
    *,
    submissions: Sequence[str],
    scoring: ScoringOptions,
    episodes_from: Path | None,
    cluster: Clustering,
    output: str | None,
) -> None:
    """Write an HTML report with scores, outcomes and maps.

    The report is about the first SUBMISSION. A second one is compared with it throughout; further
    ones are in the scores, the comparison and the costs.
    """
    from reverie_eval.reporting import report_html

    submissions = find_files(submissions)
    check_outputs([output], [*submissions, scoring.ground_truth, episodes_from])
    # A page of HTML would flood the terminal.
    if output is None and sys.stdout.isatty():
        raise click.UsageError("a report is a page for a browser; name its file: -o report.html")
    if output is not None and Path(output).suffix not in ("", ".html", ".htm"):
        raise click.UsageError(
            f"{output}: expected a name that ends in .html; a browser prints the page as PDF"
        )
    evaluator = scoring.evaluator(scoring.find(episodes_from))
    scored = score_each(submissions, evaluator)
    scores = dict(zip(submission_names(submissions), scored, strict=True))
    # With too few clusters there are no intervals, and the report says so.
    page = {
        name: it if Intervals.why_not(it.ground_truth, cluster) else it.with_intervals(cluster)
        for name, it in scores.items()
    }
    write_text(report_html(page, cluster), output)


@click.command()
@options.truth
@click.option(
    "--n",
    metavar="N",
    type=options.Number(min=1),
    help="Plan a sample of N episodes, as `reverie-eval subset --n N` draws it.",
)
@options.episodes_listed("Plan the episodes whose instr_ids FILE lists.")
@click.option(
    "--against",
    metavar="PERCENT",
    type=options.Decimal(0, 100),
    help="Plan a comparison with a published rate over the whole split, without its results.",
)
@options.with_default(
    "--effect",
    metavar="POINTS",
    type=_PERCENT,
    default=2.0,
    help="The true difference in SR or RGS.",
)
@options.with_default(
    "--discordance",
    metavar="PERCENT",
    type=_PERCENT,
    default=50.0,
    help="Episodes that one method gets right and the other wrong.",
)
@click.option(
    "--correlation",
    metavar="R",
    type=options.Decimal(0, 1),
    help="Correlation of the differences of episodes with the same target or, with --against, of "
    "their results.  [default: 0; with --against, 0.3]",
)
@click.option(
    "--run-deviation",
    metavar="POINTS",
    type=_PERCENT,
    help="Standard deviation between runs of a method, to plan several runs.",
)
@click.option(
    "--runs",
    metavar="N",
    type=options.Number(min=1),
    help="Runs of each method, whose means are compared.  [default: 1]",
)
@options.cluster
@options.output("the plan")
def plan(
    *,
    truth_options: TruthOptions,
    n: int | None,
    episodes_from: Path | None,
    against: float | None,
    effect: float,
    discordance: float,
    correlation: float | None,
    run_deviation: float | None,
    runs: int | None,
    cluster: Clustering,
    output: str | None,
) -> None:
    """Plan a comparison: what a split can show.

    Prints whether the effect, a true difference in SR or RGS, can be shown: found significant (5 %)
    with a probability of 80 %. Then the smallest difference that can, and how many episodes and
    runs the effect takes. The default discordance is that of unrelated methods; similar ones have
    less. `reverie-eval compare` counts it: won plus lost. With fewer than 400 targets, comparisons
    are simulated, which takes seconds.
    """
    from reverie_eval.analysis import plan as plan_comparison

    # Design refuses this too, in fractions and without the options' names.
    if against is None and effect > discordance:
        raise click.UsageError(
            f"the effect ({effect:g} points) is larger than the discordance ({discordance:g} %); "
            "methods cannot differ by more than the episodes in which they differ"
        )
    if against is not None and not effect <= 100 - against:
        raise click.UsageError(f"no rate is {effect:g} points higher than {against:g} %")
    if runs and run_deviation is None:
        raise click.UsageError("--runs needs --run-deviation: how much do runs of a method differ?")
    if n and episodes_from:
        raise click.UsageError("--n and --episodes-from both choose episodes; give one of them")
    if against is not None and run_deviation is not None:
        raise click.UsageError("--run-deviation cannot be combined with --against")
    # Options are in points and percent, as papers write rates; arithmetic is in fractions.
    planned = plan_comparison(
        split=truth_options.split,
        ground_truth=truth_options.find(episodes_from),
        n=n,
        effect=effect / 100,
        against=None if against is None else against / 100,
        discordance=discordance / 100,
        correlation=correlation,
        runs=runs or 1,
        run_deviation=(run_deviation or 0) / 100,
        cluster=cluster,
    )
    show(lambda: str(planned), output)


def _published(words: Sequence[str]) -> Mapping[str, float] | str:
    """Return the means that words give, by metric, or the name of a published method."""
    by_label = {each.label.casefold(): each for each in CATALOGUE.values()} | dict(CATALOGUE)
    if len(words) == 1 and "=" not in words[0]:
        return words[0]
    means: dict[str, float] = {}
    for word in words:
        label, _, value = word.partition("=")
        metric = by_label.get(label.casefold())
        if metric is None:
            known = [each.label for each in CATALOGUE.values()]
            raise click.UsageError(f"--against: no metric {label!r}{did_you_mean(label, known)}")
        if metric.key in means:
            raise click.UsageError(f"--against: {metric.label} is given twice")
        try:
            means[metric.key] = printed_value(metric, value)
        except ValueError as error:
            raise click.UsageError(f"--against: {error}") from None
    return means


def find_methods(words: Sequence[str], split: str = "") -> Mapping[str, Sequence[str]]:
    """Return the files of each method by its name; without a name, a file is one method.

    A method's name leaves out the name of the split, if one is given.
    """
    named = [find_runs(word) for word in words]
    single = [[] if runs else find_files([word]) for word, runs in zip(words, named, strict=True)]
    files = [file for several in single for file in several]
    bare = submission_names([it.replace(split, "") for it in files] if split else files)
    # It also leaves out what joined the two, as in `val_unseen.ours`.
    names = iter([name.strip("._-") or name for name in bare] if split else bare)
    methods: dict[str, Sequence[str]] = {}
    for runs, several in zip(named, single, strict=True):
        for name, each in [runs] if runs else [(next(names), [file]) for file in several]:
            if name in methods:
                raise click.UsageError(f"two methods are named {name}; give each a name of its own")
            methods[name] = each
    return methods


def score_methods(
    methods: Mapping[str, Sequence[str]],
    evaluator: Evaluator,
    cluster: Clustering,
    confidence: float | None,
) -> Mapping[str, Scored]:
    """Return the scores of each method, of a single file or of several runs together."""
    # Scored in one go, so that the problems of all files are listed together, then dealt out to
    # their methods in order.
    scored = iter(score_each([file for files in methods.values() for file in files], evaluator))
    scores: dict[str, Scored] = {}
    for name, files in methods.items():
        runs = dict(zip(submission_names(files), islice(scored, len(files)), strict=True))
        first, *others = runs.values()
        scores[name] = Runs.of(runs, cluster, confidence=confidence) if others else first
    return scores
