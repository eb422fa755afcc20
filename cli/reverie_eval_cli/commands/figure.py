"""``reverie-eval figure``: an episode as a figure for a paper, or as a walk that plays."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from reverie_eval.submissions import find_runs
from reverie_eval_cli import options
from reverie_eval_cli.commands.compare import find_methods
from reverie_eval_cli.options import ScoringOptions
from reverie_eval_cli.output import check_outputs, score_each, with_progress

if TYPE_CHECKING:
    from reverie_eval.reporting.episode_figure import Columns

_COLUMNS = "2"


@click.command()
@options.submissions
@click.argument("episode")
@options.new_path("FILE", "The figure: .svg, .pdf or .png; with --animate, .svg, .gif or .mp4.")
@options.scoring
@options.with_default(
    "--columns",
    type=options.Choice(["1", "2"]),
    default=_COLUMNS,
    help="Width of the figure, in columns of a page: 3.3 or 6.9 inches.",
)
@options.with_default("--legend/--no-legend", default=True, help="Explain the signs of the map.")
@click.option("--animate", is_flag=True, help="Let the walk play in its building, for 8 seconds.")
def figure(
    *,
    submissions: Sequence[str],
    episode: str,
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
    from reverie_eval.reporting.animations import check_animation_name, save_animation
    from reverie_eval.reporting.figures import check_figure_name

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
