"""The documentation says what the code does."""

import re
import runpy
import shlex
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import click
import pytest

from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._faults import Fault
from reverie_eval.submissions._problems import Template
from reverie_eval_cli.commands.shell import SCHEMAS
from reverie_eval_cli.main import main, program
from tests.conftest import REPOSITORY
from tests.support.flat_world import Run

DOCS = REPOSITORY / "docs"
README = REPOSITORY / "README.md"
GENERATED = runpy.run_path(str(DOCS / "extensions" / "generated.py"))["GENERATED"]


def codes_documented(page: str) -> set[str]:
    """Collect the codes that a page's table explains."""
    table = (DOCS / page).read_text().partition("| code |")[2]
    return set(re.findall(r"^\| `([a-z-]+)` \|", table, re.MULTILINE))


def command_above(page: str, begins: str) -> tuple[list[str], str]:
    """Return the first command of a page that begins so, and the page's text below it."""
    _, begin, rest = page.partition(begins)
    line, _, below = rest.partition("\n")
    return shlex.split(begin + line, comments=True), below


def test_the_picture_of_the_views_is_what_its_script_draws() -> None:
    pictures = DOCS / "pictures"
    drawn = runpy.run_path(str(pictures / "view_grid.py"))["picture"]()
    assert (pictures / "view-grid.svg").read_text() == drawn


@pytest.fixture
def at_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    """Work where the documentation's commands are given."""
    monkeypatch.chdir(REPOSITORY)


@pytest.mark.usefixtures("at_the_root")
def test_readme_shows_the_score_table_as_it_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    (_, *words), below = command_above(README.read_text(), "reverie-eval fixtures/")
    assert main(words) == 0
    assert below.startswith(f"```\n\n```\n{capsys.readouterr().out}```\n")


@pytest.mark.usefixtures("at_the_root", "printed_protocols")
def test_readme_shows_protocols_as_they_are_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, begin, section = README.read_text().partition("## Why it exists")
    (_, *words), below = command_above(begin + section, "reverie-eval fixtures/")
    assert main(words) == 0
    table, _, _ = capsys.readouterr().out.partition("\n\nsplit:")
    assert below.startswith(f"```\n\n```\n{table}\n```\n")


@pytest.mark.usefixtures("at_the_root")
def test_the_sample_with_boxes_scores_what_its_page_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = (DOCS / "explanation" / "boxes.md").read_text()
    (_, _, *words), below = command_above(page, "$ reverie-eval fixtures/submissions/drawn.json")
    assert main(words) == 0
    assert below.startswith(f"{capsys.readouterr().out}```\n")


@pytest.mark.usefixtures("at_the_root", "printed_protocols")
def test_the_table_of_protocols_is_what_the_command_above_it_prints(
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = (DOCS / "explanation" / "why-numbers-differ.md").read_text()
    (_, *words), below = command_above(page, "reverie-eval fixtures/")
    assert main(words) == 0
    table, _, _ = capsys.readouterr().out.partition("\n\n")
    assert below.startswith(f"```\n\n{table}\n\n")


@pytest.mark.parametrize("name", SCHEMAS)
def test_schemas_are_those_that_the_command_prints(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["schema", name]) == 0
    assert (
        DOCS / "reference" / "schemas" / f"{name}.schema.json"
    ).read_text() == capsys.readouterr().out


def options_of(command: click.Command) -> Iterator[str]:
    """Collect the options of a command and of all commands below it, each by its last name.

    A switch that can be turned off is listed by what turns it on; help and version are left out.
    """
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from options_of(below)
    else:
        options = [each for each in command.params if isinstance(each, click.Option)]
        yield from (option.opts[-1] for option in options)


def test_every_command_and_option_is_in_the_reference() -> None:
    page = GENERATED["commands"]("")
    names = program.list_commands(click.Context(program))
    assert [name for name in names if f"\n## reverie-eval {name}\n" not in f"\n{page}"] == []
    options = set(options_of(program))
    assert [each for each in sorted(options) if not re.search(rf"`[^`\n]*{each}\b", page)] == []


def test_every_problem_of_a_submission_is_documented() -> None:
    tables = [*vars(problems).values(), *vars(faults).values()]
    codes = {each.code for each in tables if isinstance(each, Template | Fault)}
    of_one_field = (
        faults.misspelt("path", "trajectory"),
        faults.records_of_other_splits([], 1, 2, ""),
    )
    assert codes | {fault.code for fault in of_one_field} == codes_documented(
        "reference/submission-format.md"
    )


PAGES = [*sorted(DOCS.rglob("*.md")), *sorted(REPOSITORY.glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text())
    assert [target for target in targets if not (page.parent / target).exists()] == []


def test_the_first_page_shows_what_is_printed(run: Run, beside_the_demo: Path) -> None:
    page = (DOCS / "index.md").read_text()
    (_, *words), below = command_above(page, "reverie-eval demo/")
    with chdir(beside_the_demo):
        assert below.startswith(f"```\n\n```\n{run(*words).out}```\n")


def commands_of(page: str) -> Iterator[list[str]]:
    """Return the words of every command of ours in a page's shell blocks, without redirections."""
    blocks = re.findall(r"^ *```(?:sh|bash|console)\n(.*?)^ *```", page, re.DOTALL | re.MULTILINE)
    for line in "\n".join(blocks).replace("\\\n", " ").splitlines():
        for part in re.findall(r"(?<![\w/-])reverie-eval (.*)", line):
            words = shlex.split(re.split(r" (?:[|>]|&&|<\() ?|\)\"", part)[0], comments=True)
            yield [re.sub(r"^\$.*", "1", word) for word in words]


RUN_ELSEWHERE = {DOCS / "tutorials", DOCS / "how-to" / "organising"}
"""Folders whose commands are run in a row, by tests/server/test_docs.py and test_tutorials.py."""


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if page.parent not in RUN_ELSEWHERE],
    ids=lambda page: str(page.relative_to(REPOSITORY)),
)
def test_every_command_is_one_that_we_have(page: Path) -> None:
    """Most are also run, by the tests of what they are about."""
    for words in commands_of(page.read_text()):
        context = program.make_context("reverie-eval", words)
        command: click.Command = program
        while isinstance(command, click.Group):
            name, found, rest = command.resolve_command(
                context,
                [*context._protected_args, *context.args],  # noqa: SLF001  # as click itself goes on
            )
            assert found is not None
            context = found.make_context(name, rest, parent=context)
            command = found


def test_decisions_are_numbered_without_gaps_and_all_are_listed() -> None:
    pages = sorted(path.name for path in (DOCS / "decisions").glob("[0-9]*.md"))
    assert [name[:4] for name in pages] == [f"{1 + row:04}" for row in range(len(pages))]
    listed = re.findall(
        r"^\* \[(\d{4})\]\((.+?)\)", (DOCS / "decisions" / "README.md").read_text(), re.MULTILINE
    )
    assert listed == [(name[:4], name) for name in pages]
    titles = [(DOCS / "decisions" / name).read_text()[:6] for name in pages]
    assert titles == [f"# {name[:4]}" for name in pages]
