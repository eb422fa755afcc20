"""``reverie-eval compare`` and ``report``: several submissions side by side, and as a page."""

import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click

from reverie_eval import Scores
from reverie_eval.analysis import BEST, ComparedSubmissionsError, score_all
from reverie_eval.scoring import Intervals
from reverie_eval.submissions import find_files, submission_names
from reverie_eval_cli import options
from reverie_eval_cli.output import (
    RejectedSubmission,
    check_outputs,
    open_output,
    rejection,
    show,
    write_text,
)

if TYPE_CHECKING:
    from reverie_eval.scoring import Clustering, Track


@click.command()
@click.argument(
    "submissions",
    metavar="SUBMISSION...",
    nargs=-1,
    required=True,
    type=click.Path(allow_dash=True),
)
@click.option(
    "--baseline",
    metavar="FILE|best",
    help="What the others are compared with.  [default: the first file; of a folder or a pattern, "
    "the best]",
)
@options.split
@options.ground_truth
@options.protocol
@options.track
@options.cluster
@options.layout(
    "table",
    "json",
    "csv",
    "markdown",
    "latex",
    explained=" csv has a row per submission and metric; markdown and latex show the scores as "
    "papers do.",
)
@options.output("the comparison")
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
    split: str,
    ground_truth: str | None,
    protocol: str,
    track: "Track",
    cluster: "Clustering",
    layout: str,
    output: str | None,
    episodes: str | None,
) -> None:
    """Compare submissions: differences, intervals, significance.

    Each SUBMISSION is compared with the first, or with the baseline. It is a result file (.json,
    .json.gz or .zip), - for standard input, a folder, or a pattern ('runs/*/val_unseen.json').
    """
    from reverie_eval import Comparison
    from reverie_eval.reporting._comparison import (
        comparison_latex,
        comparison_markdown,
        comparison_text,
        print_comparison,
    )

    files = [file for each in submissions for file in find_files([each])]
    check_outputs([output, episodes], [*files, ground_truth])
    if baseline is None and files != list(submissions):
        baseline = BEST
    names = dict(zip(files, submission_names(files), strict=True))
    scores = _score(files, split, ground_truth, protocol, track)
    comparison = Comparison.of(scores, cluster, baseline=names.get(str(baseline), baseline))
    if episodes:
        with open_output(episodes) as file:
            comparison.episodes().to_csv(file)
    texts = {
        "table": lambda: comparison_text(comparison),
        "json": lambda: comparison.to_report().model_dump_json(indent=2),
        "csv": lambda: comparison.to_pandas().to_csv().removesuffix("\n"),
        "markdown": lambda: comparison_markdown(comparison),
        "latex": lambda: comparison_latex(comparison),
    }
    if layout == "table":
        show(texts[layout], output, lambda console: print_comparison(console, comparison))
    else:
        show(texts[layout], output)


@click.command()
@options.submission
@click.argument("other", required=False, type=click.Path(allow_dash=True))
@options.split
@options.ground_truth
@options.protocol
@options.track
@options.cluster
@options.output("the report")
def report(
    *,
    submission: str,
    other: str | None,
    split: str,
    ground_truth: str | None,
    protocol: str,
    track: "Track",
    cluster: "Clustering",
    output: str | None,
) -> None:
    """Write an HTML report with scores, outcomes and maps.

    With OTHER, a second result file, the report also compares the two.
    """
    from reverie_eval.reporting import report_html

    submissions = [submission, *filter(None, [other])]
    check_outputs([output], [*submissions, ground_truth])
    if output is None and sys.stdout.isatty():
        raise click.UsageError("a report is a page for a browser; name its file: -o report.html")
    scores = _score(submissions, split, ground_truth, protocol, track)
    # With too few clusters there are no intervals, and the report says so.
    page = {
        name: it if Intervals.why_not(it.ground_truth, cluster) else it.with_intervals(cluster)
        for name, it in scores.items()
    }
    write_text(report_html(page, cluster), output)


def _score(
    submissions: Sequence[str],
    split: str,
    ground_truth: str | None,
    protocol: str,
    track: "Track",
) -> Mapping[str, Scores]:
    """Score all; if some are rejected, list the problems of each of them."""
    named = dict(zip(submission_names(submissions), submissions, strict=True))
    try:
        return score_all(
            named, split=split, ground_truth=ground_truth, protocol=protocol, track=track
        )
    except ComparedSubmissionsError as error:
        lines = [rejection(named[name], each) for name, each in error.errors.items()]
        raise RejectedSubmission("\n".join(lines)) from None
