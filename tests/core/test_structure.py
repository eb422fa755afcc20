"""`scripts/structure` counts what its rows say."""

import importlib.util
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "structure"
MODULE = '''"""A module."""

import os
from pathlib import (
    Path,
    PurePath,
)

NAMES = [  # one
    Path(os.sep),
]
"""What a list has."""


def first() -> PurePath:
    """Return the first of them."""
    import sys

    return NAMES[0] / sys.platform  # and more
'''


@pytest.fixture(scope="module")
def structure() -> ModuleType:
    loader = SourceFileLoader("structure", str(SCRIPT))
    spec = importlib.util.spec_from_loader("structure", loader)
    assert spec
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def test_imports_and_comments_are_shares_of_the_lines_of_code(structure: ModuleType) -> None:
    # Five and one lines of imports, three of the list, two of the function.
    assert structure.code_lines(MODULE) == 11
    assert structure.import_share({"module": MODULE}) == pytest.approx(100 * 6 / 11)
    assert structure.comment_share({"module": MODULE}) == pytest.approx(100 * 2 / 11)
