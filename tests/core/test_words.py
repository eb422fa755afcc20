"""Names in the code are words of the glossary, and none that style.md rules out.

A name is defined by a function, a class, a parameter, a field or an assignment. Names of other
packages, of published files and of the original simulator are only used, or are left out here.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
STYLE = ROOT / "docs" / "project" / "style.md"
CODE = {"cli": ROOT / "cli" / "reverie_eval_cli", "core": ROOT / "reverie_eval"}
GIVEN = {
    "simulator/on_path": "the names of the original simulator",
    "tasks/ndh.py": "the fields of NDH's files",
}
"""Files below the core whose names were not ours to choose, with the reason."""


class Name(NamedTuple):
    """A name that a file defines, with its type as text if it is given one."""

    file: str
    line: int
    name: str
    type: str

    @property
    def words(self) -> frozenset[str]:
        """The words of the name, in lower case: of ``_ItemFacts``, item and facts."""
        return frozenset(word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", self.name))

    @property
    def package(self) -> str:
        """The subpackage, the module beside the subpackages, or ``cli``."""
        return self.file.split("/")[0].removesuffix(".py")


class Rule(NamedTuple):
    """A row of the table in style.md: in these packages, a name has none of these words."""

    packages: frozenset[str]
    words: frozenset[str]


@cache
def rules() -> tuple[Rule, ...]:
    """Read the table of words that are not used."""
    _, _, below = STYLE.read_text("utf-8").partition("| in | not | but |")
    table, _, _ = below.partition("\n\n")
    rows = [row.strip("|").split("|") for row in table.splitlines() if row.startswith("| ")]
    quoted = re.compile(r"`([^`]+)`")
    return tuple(
        Rule(frozenset(quoted.findall(where)), frozenset(quoted.findall(words)))
        for where, words, _ in rows
    )


@cache
def names() -> tuple[Name, ...]:
    """Return the names that the package and the command line define."""
    return tuple(
        Name(file, *found)
        for folder, root in CODE.items()
        for path in sorted(root.rglob("*.py"))
        if (file := path.relative_to(root).as_posix() if folder == "core" else f"cli/{path.name}")
        if not file.startswith(tuple(GIVEN))
        for found in defined_in(ast.parse(path.read_bytes()))
    )


def defined_in(tree: ast.AST) -> Iterator[tuple[int, str, str]]:
    """Yield the line, name and type of everything that a syntax tree defines."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                yield node.lineno, name, ""
            case ast.arg(arg=name, annotation=given):
                yield node.lineno, name, ast.unparse(given) if given else ""
            case ast.AnnAssign(target=ast.Name(id=name), annotation=given):
                yield node.lineno, name, ast.unparse(given)
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield node.lineno, name, ""
            case _:
                pass


@pytest.mark.parametrize("rule", rules(), ids=lambda rule: ", ".join(sorted(rule.words)))
def test_no_name_has_a_word_that_the_glossary_replaces(rule: Rule) -> None:
    found = [
        f"{each.file}:{each.line} {each.name}"
        for each in names()
        if each.words & rule.words
        and (each.package in rule.packages if rule.packages else each.package != "server")
    ]
    assert found == []


@pytest.mark.parametrize(
    ("name", "other_thing"),
    [
        pytest.param("path", r"\bstr\b(?!\])|PathLike", id="a path is annotated, or pathlib's"),
        pytest.param("paths", r"\[str\b(?!,)|PathLike", id="and so are several"),
        pytest.param("task", r"Array|tuple", id="a task is a benchmark, not an index or a job"),
        pytest.param("item", r"\bstr\b", id="an item is a record or its index"),
        pytest.param("items", r"\[(?:T|Item)\]", id="items are records, not whatever there is"),
        pytest.param("rules", r"^(?!.*\bRule\[).", id="rules are those of lint"),
        pytest.param("solution", r"Ground", id="a solution is a part of a ground truth"),
        pytest.param("method", r"Scores|Runs", id="a method is what a team names"),
    ],
)
def test_a_name_means_one_thing(name: str, other_thing: str) -> None:
    found = [each for each in names() if each.name == name and re.search(other_thing, each.type)]
    assert [each for each in found if each.package != "server"] == []


def test_a_bare_protocol_is_one_to_score_by() -> None:
    """The other kind, of types, is ``typing.Protocol``."""
    files = [file for root in CODE.values() for file in root.rglob("*.py")]
    found = [
        f"{file.relative_to(ROOT)}:{node.lineno}"
        for file in files
        if not file.is_relative_to(CODE["core"] / "server")
        for node in ast.walk(ast.parse(file.read_bytes()))
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").startswith("typing")
        and "Protocol" in {each.name for each in node.names}
    ]
    assert found == []


TWO_THINGS = {"Episode": "what an agent is told of an episode, and what became of it"}
"""Names that two packages export, each for a thing of its own: no code uses both."""


def exported_from(package: Path) -> Iterator[tuple[str, str]]:
    """Yield the names that a package exports, each with the module that it comes from."""
    for node in ast.parse((package / "__init__.py").read_bytes()).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            for each in node.names:
                yield each.name, node.module


def test_an_exported_name_is_that_of_one_thing() -> None:
    packages = [
        file.parent
        for file in CODE["core"].rglob("*/__init__.py")
        if not file.is_relative_to(CODE["core"] / "server")
    ]
    public = {f"reverie_eval.{it.relative_to(CODE['core']).as_posix()}" for it in packages}
    modules: dict[str, set[str]] = {}
    for package in packages:
        for name, module in exported_from(package):
            # What comes from another package is the same thing, exported twice.
            if module.replace(".", "/").replace("/", ".", 1) not in public:
                modules.setdefault(name, set()).add(module)
    several = {name: its for name, its in modules.items() if len(its) > 1}
    assert {name: its for name, its in several.items() if name not in TWO_THINGS} == {}
    assert TWO_THINGS.keys() <= several.keys()


def docstrings(path: Path) -> Iterator[str]:
    """Yield where each docstring of a file is, with its text: those of fields, too."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                yield f"{path.relative_to(ROOT)}:{node.lineno} {text}"
            case _:
                pass


def test_a_docstring_does_not_need_the_line_above_it() -> None:
    """A test's may begin "It ...", below a name that says of what."""
    folders = ("benchmarks", "cli", "docs", "fixtures", "reverie_eval", "scripts", "tests")
    of_product = re.compile(r"^(?:cli|reverie_eval)/.*:\d+ (?:As (?:in|it|for)|It|Its|They)\b")
    anywhere = re.compile(r":\d+ (?:Of|The same|What (?:it|they|these)|Those)\b")
    texts = [
        text
        for folder in folders
        for path in (ROOT / folder).rglob("*.py")
        for text in docstrings(path)
    ]
    begin = [text.split("\n")[0] for text in texts]
    assert [each for each in begin if of_product.search(each) or anywhere.search(each)] == []


def test_the_table_is_read() -> None:
    """An empty table would let every name pass."""
    assert frozenset({"place", "places"}) in {rule.words for rule in rules()}
    assert len(rules()) > 5
    assert len(names()) > 5_000
