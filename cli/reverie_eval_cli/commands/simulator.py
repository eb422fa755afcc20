"""``reverie-eval simulator``: hand out ``MatterSim.py``."""

from pathlib import Path

import click

from reverie_eval import ReverieEvalError


@click.command()
@click.option("--path", is_flag=True, help="Print the folder that PYTHONPATH needs.")
@click.option(
    "--copy",
    "folder",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Write MatterSim.py to DIR, such as the folder of a project.",
)
def simulator(*, path: bool, folder: Path | None) -> None:
    """Let code that says `import MatterSim` run without the C++ simulator.

    \b
      export PYTHONPATH=$(reverie-eval simulator --path)
      reverie-eval simulator --copy my-project

    MatterSim.py is one file that needs numpy alone, and Pillow for pictures. It computes the states
    of the Matterport3D simulator from connectivity files, number for number. `pip install
    mattersim` is something else, a model of materials.
    """  # noqa: D301  # click keeps the lines of a paragraph that begins with it
    from reverie_eval.simulator import FOLDER

    # Both or neither.
    if path == (folder is not None):
        raise click.UsageError("give either --path or --copy DIR")
    if folder is None:
        click.echo(FOLDER)
        return
    content, copy = (FOLDER / "MatterSim.py").read_bytes(), folder / "MatterSim.py"
    if not folder.is_dir():
        raise ReverieEvalError(f"{folder} is not a folder; name the one of your project")
    # A changed copy may be somebody's work.
    if copy.exists() and copy.read_bytes() != content:
        raise ReverieEvalError(f"{copy} exists and is another file; remove it first")
    copy.write_bytes(content)
    click.echo(copy)
