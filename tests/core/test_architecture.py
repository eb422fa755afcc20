"""The page about the architecture names what exists."""

import pkgutil
import re
import tomllib

import pytest

from tests.conftest import REPOSITORY

PAGE = (REPOSITORY / "docs" / "architecture.md").read_text()
NAMES = re.findall(r"`((?:\w+\.)+\w+)`", PAGE.partition("## The walk")[2].partition("## A new")[0])


def test_the_picture_shows_the_rooms_of_the_contract() -> None:
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    (contract,) = [
        each for each in settings["tool"]["importlinter"]["contracts"] if "layers" in each
    ]
    picture = PAGE.partition("```")[2].partition("```")[0].splitlines()
    for layer in contract["layers"]:
        rooms = [room for room in layer.split(" | ") if room != "__main__"]
        if rooms:
            assert any(set(rooms) <= set(line.split()) for line in picture)


@pytest.mark.parametrize(
    "name", [name for name in NAMES if not name.endswith((".py", ".md", ".json"))]
)
def test_a_function_that_is_named_exists(name: str) -> None:
    full = name if name.startswith("reverie_eval") else f"reverie_eval.{name}"
    assert callable(pkgutil.resolve_name(full))
