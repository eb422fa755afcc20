"""``reverie-eval plan``: which differences a split can show, and what it takes to show others."""

from pathlib import Path

import click

from reverie_eval.scoring import Clustering
from reverie_eval_cli import options
from reverie_eval_cli.options import TruthOptions
from reverie_eval_cli.output import show

# Percent, as tables show rates; arithmetic takes fractions.
_PERCENT = options.Decimal(0, 100, min_open=True)


@click.command()
@options.truth
@click.option(
    "--n",
    metavar="N",
    type=options.Number(min=1),
    help="Plan a sample of N episodes, as `reverie-eval subset --n N` draws it.",
)
@click.option(
    "--episodes-from",
    metavar="FILE",
    type=options.PATH,
    help="Plan the episodes whose instr_ids FILE lists.",
)
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
