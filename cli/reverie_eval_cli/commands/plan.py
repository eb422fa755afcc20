"""``reverie-eval plan``: which differences a split can show, and what it takes to show others."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval.scoring import Clustering, clusters_of
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.options import TruthOptions
from reverie_eval_cli.output import show

if TYPE_CHECKING:
    from reverie_eval.metrics.power import Design

# Percent, as tables show rates; arithmetic takes fractions.
_PERCENT = options.Decimal(0, 100, min_open=True)


@click.command()
@options.truth
@options.episodes_from
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
    episodes_from: Path | None,
    effect: float,
    discordance: float,
    correlation: float,
    run_deviation: float | None,
    runs: int | None,
    cluster: Clustering,
    output: str | None,
) -> None:
    """Plan a comparison: what a split can show.

    Prints the smallest difference in SR or RGS that is found significant (5 %) with a probability
    of 80 %, how likely the effect is to be found, and how many episodes and runs it takes. The
    default discordance is that of unrelated methods; similar ones have less. `reverie-eval compare`
    counts it: won plus lost. With fewer than 400 targets, comparisons are simulated, which takes
    seconds.
    """
    from reverie_eval.metrics.power import Design

    # Design refuses this too, in fractions and without the options' names.
    if effect > discordance:
        raise click.UsageError(
            f"the effect ({effect:g} points) is larger than the discordance ({discordance:g} %); "
            "methods cannot differ by more than the episodes in which they differ"
        )
    if runs and run_deviation is None:
        raise click.UsageError("--runs needs --run-deviation: how much do runs of a method differ?")
    truth = truth_options.find(episodes_from)
    design = Design.of(clusters_of(truth, cluster), discordance / 100, correlation)
    if run_deviation is not None:
        # Options are in points and percent, as papers write rates; arithmetic is in fractions.
        design = replace(design, n_runs=runs or 1, run_deviation=run_deviation / 100)
    clusters = count_text(design.n_clusters, cluster)
    assumed = f"discordance {discordance:g} %, correlation {correlation:g}"
    if runs:
        assumed += f"; {count_text(runs, 'run')} each, deviation {run_deviation:g} points"
    first = f"{truth.split}: {design.n_episodes:,} episodes, {clusters}; {assumed}"
    show(lambda: "\n".join([first, *_rows(design, effect)]), output)


def _rows(design: "Design", effect: float) -> list[str]:
    smallest = design.smallest_effect()
    needed = design.episodes_needed(effect / 100)
    shown = "none" if smallest is None else f"{100 * smallest:.2f} points"
    rows = {
        "smallest difference at 80 % power": shown,
        f"power for {effect:g} points": f"{100 * design.power(effect / 100):.0f} %",
        f"episodes for {effect:g} points": "over 10,000,000" if needed is None else f"{needed:,}",
    }
    if design.run_deviation:
        runs = design.runs_needed(effect / 100)
        rows[f"runs of each method for {effect:g} points"] = (
            "no number of runs: there are too few episodes" if runs is None else f"{runs:,}"
        )
    width = max(map(len, rows))
    return [f"{name:{width}}  {value}" for name, value in rows.items()]
