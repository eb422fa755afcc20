"""The organiser's guide is true: every command in it runs, every setting is in it."""

import re
import shlex
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, get_args

import click
import pytest
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from reverie_eval.server.settings import Settings
from tests.conftest import REPOSITORY
from tests.support.processes import COMMAND, Laptop

PAGE = (REPOSITORY / "docs" / "server.md").read_text()
COMMANDS = "".join(re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)).splitlines()
PACKAGE_MANAGERS = ("pip",)
SHELL = re.compile(r"[|&;<>$`*?~]")
"""What only a shell understands."""


def test_every_command_of_the_guide_runs_in_its_order(
    tmp_path: Path, demo_world: Path, postgresql: Callable[[], str], bucket: str
) -> None:
    (tmp_path / "REVERIE").symlink_to(demo_world)
    (tmp_path / "private").symlink_to(demo_world / "private")
    laptop, variables = Laptop(tmp_path), {"PATH": f"{COMMAND.parent}:/usr/bin:/bin"}
    elsewhere = {"REVERIE_EVAL_DATABASE": postgresql(), "REVERIE_EVAL_UPLOADS": f"s3://{bucket}/u"}
    ran = []
    with ExitStack() as running:
        for command in COMMANDS:
            program, *words = shlex.split(command)
            if program in PACKAGE_MANAGERS:
                continue
            ran.append(command)
            if program == "export":
                name = words[0].partition("=")[0]
                variables[name] = elsewhere[name]
            elif words[0] == "serve":
                server = running.enter_context(laptop.serving(*words[1:], variables=variables))
                assert server.get("/splits").status_code == 200
            elif program == COMMAND.name and not SHELL.search(command):
                laptop.run(*words, variables=variables)
            else:
                laptop.shell(command, variables=variables)
    assert len(ran) > 20


def test_every_command_of_an_organiser_is_in_the_guide() -> None:
    from reverie_eval_cli.commands.server import server

    context = click.Context(server)
    for name in server.list_commands(context):
        group = server.get_command(context, name)
        for command in group.list_commands(context) if isinstance(group, click.Group) else [""]:
            assert f"{name} {command}".strip() in PAGE


def settings_of(model: type[BaseModel], above: str = "") -> Iterator[tuple[str, object]]:
    """List every setting by its place, with its default."""
    for name, field in model.model_fields.items():
        place = f"{above}{name}"
        section = section_of(field.annotation)
        if section is None:
            yield place, field.default
        else:
            entry = ".NAME." if name == "splits" else "."
            yield from settings_of(section, place + entry)


def section_of(annotation: Any) -> type[BaseModel] | None:
    """Return the settings within a setting, if it has any."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(section_of, get_args(annotation))), None)


def as_written(default: object) -> str:
    """Write a default as the settings file has it."""
    if default is PydanticUndefined:
        return "required"
    if default is None:
        return "none"
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    if isinstance(default, (str, Path)):
        return f'`"{default}"`'
    return "`[]`" if default == () else f"`{default}`"


SETTINGS = dict(settings_of(Settings))


@pytest.mark.parametrize("name", SETTINGS)
def test_every_setting_is_in_the_guide_with_its_default(name: str) -> None:
    assert re.search(
        rf"^\| `{name}` \| {re.escape(as_written(SETTINGS[name]))} \| \S", PAGE, re.MULTILINE
    )


def test_there_is_no_other_setting_in_the_guide() -> None:
    table = PAGE.partition("| setting |")[2].partition("\n\n")[0]
    assert set(re.findall(r"^\| `([\w.]+)`", table, re.MULTILINE)) == set(SETTINGS)


def test_everything_the_doctor_checks_is_in_the_guide() -> None:
    source = [
        (REPOSITORY / "reverie_eval" / "server" / "operations" / f"{name}.py").read_text()
        for name in ("checks", "doctor")
    ]
    checks = set(re.findall(r'(?:Finding|_guarded)\(\s*"([a-z ]+)"', "".join(source)))
    table = PAGE.partition("| check |")[2].partition("\n\n")[0]
    assert checks - {"stored data"} == set(re.findall(r"^\| ([a-z ]+?) \|", table, re.MULTILINE))
