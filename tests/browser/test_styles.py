"""The style sheets: a browser understands every declaration, and every rule is of use."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
import tinycss2
from playwright.sync_api import Browser

from tests.conftest import REPOSITORY
from tests.support.browser import new_page

PACKAGE = REPOSITORY / "reverie_eval"
SHEETS = sorted(PACKAGE.rglob("*.css"))
UNKNOWN = "each => each.filter(([name, value]) => !CSS.supports(name, value))"

every_sheet = pytest.mark.parametrize("sheet", SHEETS, ids=[sheet.name for sheet in SHEETS])


class Rule(NamedTuple):
    """A style rule, or an at-rule with declarations of its own."""

    selector: str
    declarations: dict[str, str]


def rules(sheet: Path) -> list[Rule]:
    """Read a style sheet, and accept no error in it."""
    return list(_rules(parsed(sheet)))


def parsed(sheet: Path) -> list[tinycss2.ast.Node]:
    nodes: list[tinycss2.ast.Node] = tinycss2.parse_stylesheet(
        sheet.read_text(), skip_comments=True, skip_whitespace=True
    )
    return nodes


def _rules(nodes: list[tinycss2.ast.Node]) -> Iterator[Rule]:
    for node in nodes:
        assert node.type in ("qualified-rule", "at-rule"), f"line {node.source_line}: {node}"
        inside = tinycss2.parse_blocks_contents(
            node.content or [], skip_comments=True, skip_whitespace=True
        )
        declared = [each for each in inside if each.type == "declaration"]
        names = [each.lower_name for each in declared]
        assert len(names) == len(set(names)), f"line {node.source_line}: declared twice"
        if declared:
            values = {each.name: tinycss2.serialize(each.value).strip() for each in declared}
            yield Rule(tinycss2.serialize(node.prelude), values)
        yield from _rules([each for each in inside if each.type != "declaration"])


@every_sheet
def test_a_browser_understands_every_declaration(sheet: Path, browser: Browser) -> None:
    declarations = [each for rule in rules(sheet) for each in rule.declarations.items()]
    assert len(declarations) > 10
    page = new_page(browser)
    assert page.evaluate(UNKNOWN, declarations) == []
    page.close()


def test_no_colour_of_the_server_depends_on_the_width_of_the_screen() -> None:
    """So ``barriers`` looks at the light ones on a desktop and at the dark ones on a phone."""
    of_widths = [
        node
        for sheet in SHEETS
        if "server" in sheet.parts
        for node in parsed(sheet)
        if node.type == "at-rule" and "width" in tinycss2.serialize(node.prelude)
    ]
    assert len(of_widths) > 3
    declared = {name for rule in _rules(of_widths) for name in rule.declarations}
    assert not declared & {"color", "background", "background-color", "fill", "opacity"}


def test_every_custom_property_is_defined_and_used() -> None:
    declarations = [
        each for sheet in SHEETS for rule in rules(sheet) for each in rule.declarations.items()
    ]
    defined = {name for name, _ in declarations if name.startswith("--")}
    used = {name for _, value in declarations for name in re.findall(r"var\((--[\w-]+)", value)}
    assert used - defined == set()
    assert defined - used <= words("js")


def test_every_class_that_is_styled_is_in_a_page() -> None:
    selectors = " ".join(rule.selector for sheet in SHEETS for rule in rules(sheet))
    styled = set(re.findall(r"\.([A-Za-z][\w-]*?)\d*(?![\w-])", selectors))  # route-1: route-
    assert styled - words("html", "jinja", "js", "py") == set()


def words(*endings: str) -> set[str]:
    """Return all words of the package's files with these endings."""
    files = [file for ending in endings for file in PACKAGE.rglob(f"*.{ending}")]
    return {
        word for file in files for word in re.findall(r"-{0,2}[A-Za-z][\w-]*", file.read_text())
    }
