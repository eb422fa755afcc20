"""``reverie-eval SUBMISSION --split SPLIT``: print the score table of a submission."""

from functools import partial
from typing import TYPE_CHECKING

import click

from reverie_eval import PROTOCOLS, Scores, diagnose, evaluate, evaluate_protocols
from reverie_eval.ground_truth import find_ground_truth
from reverie_eval.reporting._scores import FORMATS, print_scores, write_episodes
from reverie_eval.scoring import ALIASES, DEFAULT_PROTOCOL
from reverie_eval_cli import options
from reverie_eval_cli.output import check_outputs, naming, open_output, show

if TYPE_CHECKING:
    from collections.abc import Sequence

    from reverie_eval.scoring import Clustering, Track

_ALL = "all"


@click.command()
@options.submission
@options.split
@options.ground_truth
@click.option(
    "--protocol",
    type=options.Choice([*PROTOCOLS, *ALIASES, _ALL]),
    default=DEFAULT_PROTOCOL,
    show_default=True,
    metavar="NAME",
    help=f"The rules to score by: {', '.join(PROTOCOLS)}; "
    f"{', '.join(f'{alias} (= {name})' for alias, name in ALIASES.items())}; or {_ALL} of them.",
)
@options.track
@click.option(
    "--diagnose",
    "diagnosed",
    is_flag=True,
    help="Also show the scores if only the first viewpoint of each hop were read.",
)
@click.option("--ci", is_flag=True, help="Also show 95 % confidence intervals.")
@click.option(
    "--cluster",
    type=options.Choice(["target", "scan"]),
    help="What to resample for intervals; implies --ci.  [default: target]",
)
@options.layout(*FORMATS)
@options.output("the scores")
@click.option(
    "--episodes",
    metavar="FILE",
    type=click.Path(),
    help="Also write every episode's values to FILE, as CSV; with several protocols, the first's.",
)
def score(
    *,
    submission: str,
    split: str,
    ground_truth: str | None,
    protocol: str,
    track: "Track",
    diagnosed: bool,
    ci: bool,
    cluster: "Clustering | None",
    layout: str,
    output: str | None,
    episodes: str | None,
) -> None:
    """Score a submission.

    SUBMISSION is a result file (.json, .json.gz or .zip), or - for standard input. The word `score`
    may be left out.
    """
    check_outputs([output, episodes], [submission, ground_truth])
    if diagnosed and (protocol == _ALL or track != "full"):
        raise click.UsageError("--diagnose goes with one protocol, on the full track")
    truth = find_ground_truth(ground_truth, split)
    results: Sequence[Scores]
    with naming(submission):
        if diagnosed:
            results = diagnose(submission, split=split, ground_truth=truth, protocol=protocol)
        elif protocol == _ALL:
            tables = evaluate_protocols(submission, split=split, ground_truth=truth, track=track)
            results = list(tables.values())
        else:
            results = [
                evaluate(
                    submission, split=split, ground_truth=truth, protocol=protocol, track=track
                )
            ]
    if ci or cluster:
        results = [scores.with_intervals(cluster or "target") for scores in results]
    if episodes:
        with open_output(episodes) as file:
            write_episodes(results[0], file)
    text = partial(FORMATS[layout], results)
    if layout == "table":
        show(text, output, lambda console: print_scores(console, results))
    else:
        show(text, output)
