"""``reverie-eval train NAME``: how the paper's agents learn."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from reverie_eval_cli import options
from reverie_eval_cli.output import note

if TYPE_CHECKING:
    from reverie_eval.agents.trained import Epoch


@click.command()
@click.argument("name")
@click.option(
    "--data", "root", metavar="FOLDER", type=options.PATH, help="A clone of the dataset repository."
)
@options.dataset_parts
@options.dataset_task
@options.with_default("--split", default="train", metavar="NAME", help="The split to train on.")
@options.new_path("FOLDER", "The model's folder: a new one, or one to go on with.")
@options.with_default(
    "--seed",
    metavar="N",
    # What numpy and torch can be seeded with.
    type=options.Number(min=0, max=2**63 - 1),
    default=0,
    help="Seed of all random choices.",
)
@options.agent_option
@click.option(
    "--pointer",
    metavar="FOLDER",
    type=options.PATH,
    help="A trained pointer, which answers where a navigator stops.",
)
def train(
    *,
    name: str,
    split: str,
    output: Path,
    seed: int,
    option: Mapping[str, Any],
    pointer: Path | None,
    task: str,
    **paths: Path | None,
) -> None:
    """Train one of the paper's agents, on names instead of pictures.

    NAME is a navigator (r2r-tf, r2r-sf, rcm, self-monitor, fast-short, fast-lan-only or
    interactive) or a pointer (name-rnn, mattnet or cm-erase). `reverie-eval run FOLDER` runs it.

    The same command goes on with a training that was interrupted. FOLDER gets model.safetensors and
    card.json, and a copy of the pointer. Needs PyTorch: pip install 'reverie-eval[agents]'.
    """
    from reverie_eval.agents import trained
    from reverie_eval.dataset import DatasetFiles

    trained.find_recipe(name, option)  # before the files, whose faults would hide a wrong name
    plan = trained.TrainingPlan(
        name=name,
        files=DatasetFiles.find(split=split, task=task, **paths),
        split=split,
        options=option,
        seed=seed,
        pointer=pointer,
    )

    def show(number: int, epoch: "Epoch") -> None:
        note(
            f"epoch {number}: loss {epoch.loss:.3f}; of what is held back, {epoch.seen:.1%} in "
            f"seen and {epoch.unseen:.1%} in unseen buildings"
        )

    card = trained.train(plan, output, show)
    print(f"{output / trained.MODEL}: {card.name}, epoch {card.best} of {len(card.curve)}")
    print(f"reads: {', '.join(card.input_class)}")
    if card.left_out:
        note(f"left out {card.left_out} items, whose target is not visible at their goal")
