"""Tables as papers print them, read from LaTeX, Markdown or CSV: texts, and what is bold."""

import csv
import html
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cache
from itertools import groupby
from typing import Any, Literal, TypeAlias

from reverie_eval.errors import naming_missing_parts
from reverie_eval.metrics import CATALOGUE, Metric

Look = Literal["bold", "underlined"]
_Looks: TypeAlias = frozenset[Look]

_CELL_MARKS = re.compile(r"</?(?:b|strong|u|ins|sup|sub|small|i|em)>|\*\*|__|`", re.IGNORECASE)
_MARKED: Mapping[Look, re.Pattern[str]] = {
    "bold": re.compile(r"\*\*|__|<(?:b|strong)>", re.IGNORECASE),
    "underlined": re.compile(r"<(?:u|ins)>", re.IGNORECASE),
}
_MARKDOWN_LINE = re.compile(r"\|?(\s*:?-+:?\s*\|)+\s*(:?-+:?)?\s*")
# Of LaTeX: what a macro adds to the looks of what it contains, or of what follows it.
_LOOKS: Mapping[str, Look] = {
    **dict.fromkeys(("textbf", "mathbf", "bm", "boldsymbol", "bf", "bfseries"), "bold"),
    **dict.fromkeys(("underline", "uline"), "underlined"),
}
_TABULARS = {
    "tabular": "[{",
    "array": "[{",
    "tabular*": "{[{",
    "tabularx": "{[{",
    "tabulary": "{{",
    "longtable": "[{",
    "NiceTabular": "[{",
}
# The last argument of these is what they print.
_MACROS = {
    "multicolumn": "{{{",
    "multirow": "[{[{[{",
    "makecell": "[{",
    "shortstack": "[{",
    "rlap": "{",
    "uline": "{",
    "bm": "{",
    "boldsymbol": "{",
    "textsuperscript": "{",
    "textsubscript": "{",
}
# These print nothing of a table, whatever their arguments are.
_SILENT = {
    **dict.fromkeys(("cite", "citep", "citet"), "*[[{"),
    **dict.fromkeys(("vspace", "hspace"), "*{"),
    **dict.fromkeys(("rowcolor", "cellcolor", "color", "footnote"), "[{"),
    **dict.fromkeys(("ref", "label"), "{"),
}
_SYMBOLS = {"pm": "±", "%": "%", "&": "&", "_": "_", "#": "#", "$": "$", "mp": "±", "times": "x"}
# The number that a cell begins with; an interval or a mark after it is not read.
_NUMBER = re.compile(r"-?(?:\d+(?:\.\d+)?|\.\d+)(?![\d.]*[A-Za-z])")
_IN_BRACKETS = re.compile(r"\([^)]*\)|\[[^]]*\]")
_FURTHER_SPELLINGS = {
    "succ": "success",
    "osucc": "oracle_success",
    "oraclesucc": "oracle_success",
    "oraclesr": "oracle_success",
    "length": "path_length",
    "pl": "path_length",
    "trajectorylength": "path_length",
}
# In a short heading, and in a longer text, where "seen" and "test" have other meanings too.
_SPLITS = {
    "test": (r"\btest\b", r"\btest[- _](?:un)?(?:seen|set|split)\b"),
    "train": (r"\btrain\b", r"\btrain(?:ing)?[- _](?:set|split)\b"),
    "val_unseen": (r"(?<!test )(?<!test-)\bunseen\b", r"\bval(?:idation)?[- _]unseen\b"),
    "val_seen": (r"(?<!test )(?<!test-)\bseen\b", r"\bval(?:idation)?[- _]seen\b"),
}
_LONGEST_HEADING = 5
_LINES = frozenset({"toprule", "midrule", "bottomrule", "hline", "Xhline", "specialrule"})
_PARTIAL_LINE = re.compile(
    r"\\(?:cmidrule|cline|addlinespace|arrayrulecolor)\s*(?:\[[^]\n]*\])?(?:\([^)\n]*\))?(?:\{[^}\n]*\})?"
)
_TABLE = re.compile(
    r"\\begin\{((?:sideways|wrap)?table\*?|longtable|tabular[xy*]?|NiceTabular)\}.*?\\end\{\1\}",
    re.DOTALL,
)
# A definition may use another one; in a circle, it would grow without end.
_MOST_EXPANSIONS = 5
_LONGEST_TEXT = 1_000_000


@dataclass(frozen=True, slots=True)
class PrintedCell:
    """A cell of a printed table, in plain text."""

    text: str
    line: int
    """The line of the file, from 1."""
    looks: _Looks = frozenset()
    columns: int = 1
    rows: int = 1


@dataclass(frozen=True, slots=True)
class PrintedTable:
    """A printed table; a cell over several columns or rows stands in each of them."""

    rows: Sequence[Sequence[PrintedCell]]
    blocks: Sequence[int] = ()
    """For each row, the number of horizontal lines above it."""
    caption: str = ""

    @classmethod
    def of(
        cls, rows: Sequence[Sequence[PrintedCell]], blocks: Sequence[int], caption: str = ""
    ) -> "PrintedTable":
        """Return a table of which every cell is repeated as often as it is wide and high."""
        above: dict[int, PrintedCell] = {}
        laid_out = []
        for row in rows:
            wide = [cell for cell in row for _ in range(cell.columns)]
            for column, cell in enumerate(wide):
                if not cell.text and column in above:
                    wide[column] = above[column]
            above = {
                column: replace(cell, rows=cell.rows - 1)
                for column, cell in enumerate(wide)
                if cell.rows > 1
            }
            laid_out.append(wide)
        return cls(laid_out, blocks, caption)


def read_tables(text: str, name: str) -> Sequence[PrintedTable]:
    """Read the tables of a file, whose ending says what it is: ``.tex``, ``.md``, or else CSV.

    Raises
    ------
    MissingPartError
        If it is LaTeX, and pylatexenc is not installed.
    """
    if name.endswith(".tex"):
        return list(_LatexReader.of(text).tables())
    if name.endswith((".md", ".markdown")):
        return list(_markdown_tables(text))
    lines = text.splitlines()
    first = lines[0] if lines else ""
    # As reviewers type them, or copy them from a page.
    delimiter = max(",;\t", key=first.count)
    rows = [
        [_marked(cell, number) for cell in row]
        for number, row in enumerate(csv.reader(lines, delimiter=delimiter), 1)
    ]
    return [PrintedTable.of(rows, [0] * len(rows))]


def _marked(text: str, line: int) -> PrintedCell:
    """Return a cell of Markdown, or of a CSV file that marks bold cells in the same way."""
    looks = frozenset(look for look, mark in _MARKED.items() if mark.search(text))
    bare = re.sub(r"\\([\\`*_\[\]~$|#+-])", r"\1", _CELL_MARKS.sub("", text))
    return PrintedCell(html.unescape(bare).strip(), line, looks)


def _markdown_tables(text: str) -> Iterator[PrintedTable]:
    numbered = enumerate(text.splitlines(), 1)
    for is_table, lines in groupby(numbered, lambda each: each[1].lstrip().startswith("|")):
        if is_table:
            rows = [
                [_marked(cell, number) for cell in re.split(r"(?<!\\)\|", line.strip().strip("|"))]
                for number, line in lines
                if not _MARKDOWN_LINE.fullmatch(line.strip())
            ]
            yield PrintedTable.of(rows, [0] * len(rows))


@dataclass(frozen=True)
class _LatexReader:
    """Reads the tables of a LaTeX file."""

    text: str
    nodes: Sequence[Any]

    @classmethod
    def of(cls, text: str) -> "_LatexReader":
        """Parse a file; its own macros are replaced by what they stand for."""
        with naming_missing_parts():
            from pylatexenc.latexwalker import LatexWalker, get_default_latex_context_db
            from pylatexenc.macrospec import EnvironmentSpec, MacroSpec

        known = get_default_latex_context_db()
        known.add_context_category(
            "tables",
            prepend=True,
            macros=[MacroSpec(name, spec) for name, spec in (_MACROS | _SILENT).items()],
            environments=[EnvironmentSpec(name, spec) for name, spec in _TABULARS.items()],
        )

        def parse(text: str) -> Sequence[Any]:
            walker = LatexWalker(text, latex_context=known, tolerant_parsing=True)
            nodes: Sequence[Any] = walker.get_latex_nodes()[0]
            return nodes

        text = _PARTIAL_LINE.sub("", _only_tables(text))
        definitions = _definitions(parse(text))
        for _ in range(_MOST_EXPANSIONS):
            for name, body in definitions.items():
                text = _expand(text, name, body) if len(text) < _LONGEST_TEXT else text
        return cls(text, parse(text))

    def tables(self) -> Iterator[PrintedTable]:
        """Yield the tables in the order of the file."""
        yield from self._tables(self.nodes, "")

    def _tables(self, nodes: Sequence[Any], caption: str) -> Iterator[PrintedTable]:
        caption = _caption(nodes) or caption
        for node in nodes:
            if getattr(node, "environmentname", None) in _TABULARS:
                yield self._table(node.nodelist, caption)
            else:
                inner = [*(getattr(node, "nodelist", None) or ()), *filter(None, _arguments(node))]
                yield from self._tables(inner, caption)

    def _table(self, nodes: Sequence[Any], caption: str) -> PrintedTable:
        rows: list[Sequence[PrintedCell]] = []
        blocks: list[int] = []
        n_lines = 0
        cells: list[list[Any]] = [[]]
        for node in [*nodes, None]:
            name = getattr(node, "macroname", None)
            if node is None or name in ("\\", "tabularnewline"):
                row = [self._cell(cell) for cell in cells]
                if any(cell.text for cell in row):
                    rows.append(row)
                    blocks.append(n_lines)
                cells = [[]]
            elif name in _LINES:
                n_lines += 1
            elif getattr(node, "specials_chars", None) == "&":
                cells.append([])
            else:
                cells[-1].append(node)
        return PrintedTable.of(rows, blocks, caption)

    def _cell(self, nodes: Sequence[Any]) -> PrintedCell:
        pieces = list(_pieces(nodes))
        # Blanks and comments before it do not say where a cell is.
        shown = next(
            (it for it in nodes if "".join(text for text, _ in _pieces([it])).strip()), None
        )
        position = 0 if shown is None else shown.pos
        blank = re.match(r"\s*", getattr(shown, "chars", ""))
        return PrintedCell(
            text=" ".join("".join(text for text, _ in pieces).split()),
            line=1 + self.text.count("\n", 0, position + len(blank[0] if blank else "")),
            looks=next((looks for text, looks in pieces if re.search(r"\d", text)), frozenset()),
            columns=next((_number(it[0]) for it in _uses(nodes, "multicolumn")), 1),
            rows=next((_number(it[1]) for it in _uses(nodes, "multirow")), 1),
        )


def _uses(nodes: Iterable[Any], macro: str) -> Iterator[Sequence[Any]]:
    """Yield the arguments of each use of a macro, if it has them."""
    for node in filter(None, nodes):
        if getattr(node, "macroname", None) == macro and _arguments(node):
            yield _arguments(node)
        yield from _uses([*_arguments(node), *(getattr(node, "nodelist", None) or ())], macro)


def _only_tables(text: str) -> str:
    """Return a file with empty lines for all but tables and definitions: papers are long."""

    def definitions(between: str) -> str:
        return "\n".join(line if "command" in line else "" for line in between.split("\n"))

    # After an odd number of backslashes, a percent sign is one.
    text = re.sub(r"(?<!\\)((?:\\\\)*)%[^\n]*", r"\1", text)
    end, kept = 0, []
    for found in _TABLE.finditer(text):
        kept += [definitions(text[end : found.start()]), found[0]]
        end = found.end()
    return "".join([*kept, definitions(text[end:])])


def _number(node: Any) -> int:
    found = re.search(r"\d+", node.latex_verbatim())
    return int(found[0]) if found else 1


def _arguments(node: Any) -> Sequence[Any]:
    parsed = getattr(node, "nodeargd", None)
    return (parsed.argnlist or ()) if parsed else ()


def _pieces(nodes: Iterable[Any], looks: _Looks = frozenset()) -> Iterator[tuple[str, _Looks]]:
    """Yield the texts of nodes, each with its looks; a declaration holds until its group ends."""
    for node in nodes:
        if node is None or getattr(node, "comment", None) is not None:
            continue
        name: str = getattr(node, "macroname", "")
        if name in _SILENT:
            continue
        added = looks | ({_LOOKS[name]} if name in _LOOKS else set())
        arguments = [each for each in _arguments(node) if each is not None]
        if name and arguments:
            yield from _pieces(arguments[-1:], added)
        elif name:
            looks = added
            yield _SYMBOLS.get(name, " "), looks
        elif hasattr(node, "chars"):
            yield node.chars, looks
        elif hasattr(node, "specials_chars"):
            yield (node.specials_chars if node.specials_chars.startswith("-") else " "), looks
        else:
            yield from _pieces(node.nodelist or (), looks)


def _caption(nodes: Sequence[Any]) -> str:
    """Return the caption that stands among nodes: the group behind the macro."""
    for position, node in enumerate(nodes):
        if getattr(node, "macroname", None) == "caption":
            return "".join(text for text, _ in _pieces(nodes[position + 1 : position + 2]))
    return ""


def _definitions(nodes: Sequence[Any]) -> Mapping[str, str]:
    """Return the bodies of macros that a file defines."""
    found = {}
    for node in nodes:
        name_of_macro, arguments = getattr(node, "macroname", ""), _arguments(node)
        # Without arguments, if the file is broken there.
        if arguments and name_of_macro in ("newcommand", "renewcommand", "providecommand"):
            _, name, _, _, body = arguments
            # An expansion must not move what follows to another line.
            found[name.latex_verbatim().strip("{}\\ ")] = body.latex_verbatim()[1:-1].replace(
                "\n", " "
            )
    return found


def _expand(text: str, name: str, body: str) -> str:
    """Replace a macro by its body, except where it is defined."""
    has_argument = "#1" in body
    use = re.compile(
        rf"(?<!newcommand)(?<!newcommand\*)(?<!command\{{)\\{re.escape(name)}(?![A-Za-z])"
        + r"\s*\{([^{}]*)\}" * has_argument
    )
    return use.sub(lambda it: body.replace("#1", it[1]) if has_argument else body, text)


def number_in(text: str) -> Decimal | None:
    """Return the number that a cell begins with, with its decimals; None if there is none.

    >>> number_in("52.50 (50.1 to 54.9)"), number_in("R2R")
    (Decimal('52.50'), None)
    """
    found = _NUMBER.match(text.replace("\N{MINUS SIGN}", "-"))
    return Decimal(found[0]) if found else None


def metric_in(headings: Sequence[str]) -> Metric | None:
    """Return the metric that a column's headings name, the lowest of them first.

    >>> metric_in(["Val Seen", "Oracle Succ. (%)"]).label
    'OSR'
    """
    for heading in reversed(headings):
        words = _IN_BRACKETS.sub(" ", heading).split()
        # The longest ending first: "Oracle SR" is not SR.
        for start in range(len(words)):
            key = _spellings().get(_spelling("".join(words[start:])))
            if key:
                return CATALOGUE[key]
    return None


@cache
def _spellings() -> Mapping[str, str]:
    known = {
        _spelling(text): metric.key
        for metric in CATALOGUE.values()
        for text in (metric.key, metric.name, metric.label)
    }
    return known | _FURTHER_SPELLINGS


def _spelling(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.casefold())


def split_in(text: str) -> str | None:
    """Return the split that a heading or a caption names; None if it does not name just one.

    >>> split_in("Validation Unseen"), split_in("Test (Unseen)"), split_in("Seen from afar, a test")
    ('val_unseen', 'test', None)
    """
    heading = " ".join(re.sub(r"[()_]", " ", text.casefold()).split())
    is_long = len(heading.split()) > _LONGEST_HEADING
    named = [split for split, patterns in _SPLITS.items() if re.search(patterns[is_long], heading)]
    return named[0] if len(named) == 1 else None
