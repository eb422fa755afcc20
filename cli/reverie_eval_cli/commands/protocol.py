"""``reverie-eval protocol``: by which protocol a public codebase's numbers are reproduced."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from reverie_eval_cli import options
from reverie_eval_cli.output import show

if TYPE_CHECKING:
    from reverie_eval.tasks import Codebase, CodebaseEvaluator


@options.completing
def _complete_codebase(_: click.Context) -> list[str]:
    from reverie_eval.tasks import codebases

    return [each.name for each in codebases()]


@click.command()
@click.argument("codebase", required=False, shell_complete=_complete_codebase)
@options.output("what it prints")
def protocol(*, codebase: str | None, output: str | None) -> None:
    """Tell which protocol reproduces a codebase's numbers.

    CODEBASE is a method or a repository: DUET, cshizhe/VLN-DUET. Prints the protocol for each task,
    what its evaluator does otherwise, the form of its result files, and on which commit and date
    each of them was executed. Without CODEBASE, lists all.
    """
    from reverie_eval.tasks import find_codebase

    # A reader who does not know the name yet wants the whole list.
    if codebase is None:
        show(lambda: "\n".join(_overview()), output)
        return
    found = find_codebase(codebase)
    show(lambda: "\n".join(_lines(found)), output)


def _overview() -> Iterator[str]:
    from reverie_eval.tasks import codebases

    width = max(len(each.name) for each in codebases())
    for each in codebases():
        scored = ", ".join(f"{it.task} {it.protocol}" for it in each.evaluator)
        yield f"{each.name:{width}}  {scored}"


def _lines(codebase: "Codebase") -> Iterator[str]:
    yield f"{codebase.name}: github.com/{codebase.repository} at {codebase.commit}"
    for each in codebase.evaluator:
        yield ""
        yield f"{each.task}: {_options(each)}"
        yield f"  evaluator  {each.source} ({each.standing})"
        if each.differs:
            yield f"  differs    {each.differs}"
    for form in codebase.file:
        yield ""
        yield f"file: {form.name or 'any name'}"
        yield f"  form       {form.form} ({form.standing})"
        if form.example:
            yield f"  example    {form.example}"


def _options(evaluator: "CodebaseEvaluator") -> str:
    from reverie_eval.tasks import DEFAULT_TASK

    task = "" if evaluator.task == DEFAULT_TASK else f"--task {evaluator.task} "
    return f"{task}--protocol {evaluator.protocol}"
