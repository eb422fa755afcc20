"""``reverie-eval plan``: which differences a split can show, and what it takes to show others."""

from typing import TYPE_CHECKING

import click

from reverie_eval.scoring import Clustering, clusters_of
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.options import TruthOptions
from reverie_eval_cli.output import show

if TYPE_CHECKING:
    from reverie_eval.metrics.power import Design

_PERCENT = options.Decimal(0, 100, min_open=True)


@click.command()
@options.truth
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
@options.with_default(
    "--correlation",
    metavar="R",
    type=options.Decimal(0, 1),
    default=0.0,
    help="Correlation of the differences of episodes with the same target.",
)
@click.option(
    "--run-deviation",
    metavar="POINTS",
    type=_PERCENT,
    help="Standard deviation between runs of a method, to plan several runs.",
)
@options.cluster
@options.output("the plan")
def plan(
    *,
    truth_options: TruthOptions,
    effect: float,
    discordance: float,
    correlation: float,
    run_deviation: float | None,
    cluster: Clustering,
    output: str | None,
) -> None:
    """Plan a comparison: what a split can show.

    Prints the smallest difference in SR or RGS that is found significant (5 %) with a probability
    of 80 %, how likely the effect is to be found, and how many episodes and runs it takes. The
    default discordance is that of unrelated methods; similar ones have less. `reverie-eval compare`
    counts it: won plus lost.
    """
    from reverie_eval.metrics.power import Design

    if effect > discordance:
        raise click.UsageError(
            f"the effect ({effect:g} points) is larger than the discordance ({discordance:g} %); "
            "methods cannot differ by more than the episodes in which they differ"
        )
    truth = truth_options.find()
    design = Design.of(clusters_of(truth, cluster), discordance / 100, correlation)
    clusters = count_text(int(design.n_clusters), cluster)
    assumed = f"discordance {discordance:g} %, correlation {correlation:g}"
    first = f"{truth.split}: {design.n_episodes:,} episodes, {clusters}; {assumed}"
    show(lambda: "\n".join([first, *_rows(design, effect, run_deviation)]), output)


def _rows(design: "Design", effect: float, run_deviation: float | None) -> list[str]:
    from dataclasses import replace

    smallest = design.smallest_effect()
    needed = design.episodes_needed(effect / 100)
    shown = "none" if smallest is None else f"{100 * smallest:.2f} points"
    rows = {
        "smallest difference at 80 % power": shown,
        f"power for {effect:g} points": f"{100 * design.power(effect / 100):.0f} %",
        f"episodes for {effect:g} points": "over 10,000,000" if needed is None else f"{needed:,}",
    }
    if run_deviation is not None:
        runs = replace(design, run_deviation=run_deviation / 100).runs_needed(effect / 100)
        rows[f"runs of each method for {effect:g} points"] = (
            "no number of runs: there are too few episodes" if runs is None else f"{runs:,}"
        )
    width = max(map(len, rows))
    return [f"{name:{width}}  {value}" for name, value in rows.items()]
