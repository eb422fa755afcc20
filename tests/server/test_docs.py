"""The organiser's guide is true: every command in it runs, every setting is in its reference."""

import re
import runpy
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import click
import pytest

from tests.conftest import COMMAND, REPOSITORY
from tests.support.processes import Laptop
from tests.support.sharing import shared_folder

DOCS = REPOSITORY / "docs"
TUTORIAL = DOCS / "tutorials" / "server.md"
REFERENCE = (DOCS / "reference" / "server-settings.md").read_text()
YEAR = DOCS / "how-to" / "organising" / "index.md"
TASKS = [page for page in sorted(YEAR.parent.glob("*.md")) if page != YEAR]
GENERATED = runpy.run_path(str(DOCS / "extensions" / "generated.py"))["GENERATED"]
GUIDE = "".join(page.read_text() for page in [TUTORIAL, *TASKS]) + REFERENCE
PACKAGE_MANAGERS = ("pip",)
SHELL = re.compile(r"[|&;<>$`*?~]")
"""What only a shell understands."""


class Reader:
    """Someone who types what a page says."""

    def __init__(self, folder: Path, elsewhere: Callable[[str], str]) -> None:
        self._laptop = Laptop(folder)
        self._elsewhere = elsewhere
        """What to set a variable to that a page exports."""
        self._variables = {"PATH": f"{COMMAND.parent}:/usr/bin:/bin"}

    def types(self, command: str) -> None:
        """Run a command, which must succeed; a server must answer."""
        program, *words = shlex.split(command)
        if program in PACKAGE_MANAGERS:
            return
        if program == "export":
            name = words[0].partition("=")[0]
            self._variables[name] = self._elsewhere(name)
        elif words[0] == "serve":
            with self._laptop.serving(*words[1:], variables=self._variables) as server:
                assert server.get("/splits").status_code == 200
        elif program == COMMAND.name and not SHELL.search(command):
            self._laptop.run(*words, variables=self._variables)
        else:
            self._laptop.shell(command, variables=self._variables)


def commands(page: Path) -> list[str]:
    """List the commands of a page."""
    return "".join(re.findall(r"```sh\n(.*?)```", page.read_text(), re.DOTALL)).splitlines()


@pytest.fixture(scope="session")
def after_tutorial(tmp_path_factory: pytest.TempPathFactory, demo_world: Path) -> Path:
    """Follow the tutorial, and return the folder that it was followed in."""

    def follow(folder: Path) -> None:
        (folder / "REVERIE").symlink_to(demo_world)
        (folder / "private").symlink_to(demo_world / "private")
        reader = Reader(folder, str)
        for command in commands(TUTORIAL):
            reader.types(command)

    return shared_folder(tmp_path_factory, "tutorial", follow)


def test_the_tutorial_leads_to_a_checked_server(after_tutorial: Path) -> None:
    assert (after_tutorial / "lab-backup.tar.gz").is_file()


@pytest.mark.parametrize("page", [p for p in TASKS if commands(p)], ids=lambda page: page.stem)
def test_a_task_can_be_done_after_the_tutorial(
    page: Path, after_tutorial: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    def elsewhere(name: str) -> str:
        if name == "REVERIE_EVAL_DATABASE":
            database: Callable[[], str] = request.getfixturevalue("postgresql")
            return database()
        return f"s3://{request.getfixturevalue('bucket')}/u"

    folder = Path(shutil.copytree(after_tutorial, tmp_path / "followed", symlinks=True))
    reader = Reader(folder, elsewhere)
    for command in commands(page):
        reader.types(command)


def test_the_year_leads_to_every_task() -> None:
    linked = re.findall(r"\]\(([\w-]+)\.md\)", YEAR.read_text())
    assert sorted(linked) == [page.stem for page in TASKS]


def test_every_command_of_an_organiser_is_in_the_guide() -> None:
    from reverie_eval_cli.commands.server import server

    context = click.Context(server)
    for name in server.list_commands(context):
        group = server.get_command(context, name)
        for command in group.list_commands(context) if isinstance(group, click.Group) else [""]:
            assert f"{name} {command}".strip() in GUIDE


def test_a_server_is_stopped_before_it_is_upgraded() -> None:
    upgrading = (YEAR.parent / "handing-over.md").read_text().partition("## Upgrading")[2]
    assert upgrading.index("Stop the server first") < upgrading.index("server backup")


def test_every_setting_has_a_meaning() -> None:
    table = GENERATED["settings"]("")
    assert table in REFERENCE, f"renew the table in docs/reference/server-settings.md:\n{table}"
    assert [row for row in table.splitlines() if re.search(r"\|\s*\|\s*$", row)] == []


def test_everything_the_doctor_checks_is_in_the_guide() -> None:
    source = [
        (REPOSITORY / "reverie_eval" / "server" / "operations" / f"{name}.py").read_text()
        for name in ("checks", "doctor")
    ]
    checks = set(re.findall(r'(?:Finding|_guarded)\(\s*"([a-z ]+)"', "".join(source)))
    checks |= {f"{kind}s" for kind in re.findall(r'_Envelopes\("([a-z]+)"', "".join(source))}
    table = REFERENCE.partition("| check |")[2].partition("\n\n")[0]
    assert checks - {"stored data"} == set(re.findall(r"^\| ([a-z ]+?) \|", table, re.MULTILINE))


def test_each_operation_of_the_reference_has_an_example() -> None:
    reference = GENERATED["http_operations"]("")
    assert '"team": "Blue"' in reference
    assert "```json\nnull\n" not in reference
