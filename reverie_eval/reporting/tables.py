"""One table, and its formats: text, terminals, Markdown, LaTeX, CSV and HTML.

No table library is used: scoring a file must not import one, and none escapes LaTeX and marks
values as papers need it.
"""

import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import accumulate, chain, groupby, pairwise
from types import MappingProxyType
from typing import Literal, NamedTuple, TypeVar

from typing_extensions import Self

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.tasks import DEFAULT_TASK, Task, find_task

T = TypeVar("T")

MISSING = "-"
"""Shown in place of a missing value."""
MARK = "*"
"""Follows a value that a note below the table explains."""

_REVERIE = find_task(DEFAULT_TASK)


Style = Literal["plain", "bold", "underlined"]


class Number(str):
    """A number as papers set it; as text, it is followed by its marks and its interval."""

    __slots__ = ("interval", "marks", "style", "value")

    value: str
    style: Style
    """The type, in the layouts that have it."""
    marks: str
    """Set above the line, and explained in the caption."""
    interval: tuple[str, str] | None
    """The low and the high end of the value's interval, in LaTeX and HTML below it."""

    def __new__(
        cls,
        value: str,
        style: Style = "plain",
        marks: str = "",
        interval: tuple[str, str] | None = None,
    ) -> Self:
        """Return a number with its looks."""
        ends = f" ({interval[0]} to {interval[1]})" if interval else ""
        self = super().__new__(cls, value + marks + ends)
        self.value, self.style, self.marks, self.interval = value, style, marks, interval
        return self


class Group(NamedTuple):
    """A heading above several columns."""

    heading: str
    columns: int


@dataclass(frozen=True, slots=True, repr=False)
class Table:
    """A table of formatted cells; a notebook shows it as Markdown.

    An empty row separates the rows above it from those below.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    text_columns: frozenset[int] = frozenset()
    """Columns aligned to the left; the others hold numbers and are aligned to the right."""
    groups: Sequence[Sequence["Group"]] = ()
    """Rows of headings above the headings, the widest first, over the columns after the first."""
    caption: str = ""
    """The caption, as in a paper; with a caption, LaTeX gets a floating ``table``."""
    findings: Sequence[str] = ()
    """Sentences on what the table shows, before the notes; in bold on a terminal."""
    notes: Sequence[str] = ()
    """Lines below the table, the signature first; in LaTeX, comments above it."""
    task: Task = _REVERIE
    """The task of the metrics in the headings."""
    narrow: "Table | None" = None
    """The table for a narrow terminal, if there is another."""

    def __repr__(self) -> str:
        return self.to_markdown()

    def _repr_markdown_(self) -> str:
        """Show the table in a notebook."""
        return self.to_markdown()

    def to_text(self) -> str:
        """Align the columns with spaces, for a pipe or a file.

        >>> rows = [["scans", "7"], ["edges", "321"]]
        >>> print(Table(["", "number"], rows, text_columns=frozenset({0})).to_text())
               number
        scans       7
        edges     321
        """
        columns = zip(self.flat_headings, *self.rows, strict=True)
        aligned = [
            _aligned(column, is_text=number in self.text_columns)
            for number, column in enumerate(columns)
        ]
        lines = ["  ".join(row).rstrip() for row in zip(*aligned, strict=True)]
        return "\n".join([*lines, "", *self.lines_below] if self.lines_below else lines)

    def to_markdown(self) -> str:
        """Return a GitHub-flavoured table with the lines below it as paragraphs."""
        rule = [":---" if n in self.text_columns else "---:" for n in range(len(self.headings))]
        rows = [
            list(map(_markdown_cell, self.flat_headings)),
            rule,
            *(map(_markdown_number, row) for row in self.rows),
        ]
        table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
        below = [markdown_text(line) for line in self.lines_below if line]
        return "\n\n".join([table, *below])

    def to_latex(self) -> str:
        r"""Return a ``tabular`` for the booktabs package, in a ``table`` if there is a caption."""
        columns = "".join("l" if n in self.text_columns else "r" for n in range(len(self.headings)))
        tabular = [
            rf"\begin{{tabular}}{{{columns}}}",
            r"\toprule",
            *self._latex_groups(),
            _latex_row(map(latex_text, self.headings)),
            r"\midrule",
            *(
                _latex_row(map(_latex_number, row)) if any(row) else r"\midrule"
                for row in self.rows
            ),
            r"\bottomrule",
            r"\end{tabular}",
        ]
        if self.caption:
            # Several groups, or intervals, are wider than one of a page's two columns.
            cells = chain.from_iterable(self.rows)
            has_intervals = any(isinstance(cell, Number) and cell.interval for cell in cells)
            name = "table*" if self._is_wide or has_intervals else "table"
            caption = rf"\caption{{{latex_text(self.caption)}}}"
            begin, end = rf"\begin{{{name}}}", rf"\end{{{name}}}"
            # Twelve columns fit a page, and six one of its columns, if little is between them.
            narrow = [r"\setlength{\tabcolsep}{3pt}"] if self.groups else []
            tabular = [begin, r"\centering", caption, *narrow, *tabular, end]
        return "\n".join([*latex_comments([*self.findings, *self.notes]), *tabular])

    def to_csv(self) -> str:
        """Return the headings and the rows as CSV, without empty rows and the lines below."""
        import csv

        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(
            [self.flat_headings, *filter(any, self.rows)]
        )
        return text.getvalue().rstrip("\n")

    def to_html(self) -> str:
        """Return the table as HTML, everything escaped, the signature as code.

        A metric's heading explains the metric as its tooltip. Findings are a paragraph above.
        """
        meanings = _meanings(self.task)
        headings = [_html_heading(each, meanings.get(each)) for each in self.headings]
        bodies = [
            "".join(self._html_row(row) for row in rows)
            for is_filled, rows in groupby(self.rows, any)
            if is_filled
        ]
        lines = "<br>".join(map(_html_text, self.findings))
        findings = f"<p><strong>{lines}</strong></p>" if lines else ""
        return (
            f"{findings}<table>{self._html_caption()}<thead>{''.join(self._html_groups())}"
            f"<tr>{''.join(headings)}</tr></thead>"
            f"<tbody>{'</tbody><tbody>'.join(bodies)}</tbody></table>"
        )

    def stacked(self) -> "Table":
        """Return two columns, heading and value, with the rows below each other.

        Fits where the table is too wide. Empty cells are left out.
        """
        blocks = [
            [[heading, cell] for heading, cell in zip(self.flat_headings, row, strict=True) if cell]
            for row in filter(any, self.rows)
        ]
        # An empty row between blocks, but none before the first.
        rows = [line for block in blocks for line in (["", ""], *block)][1:]
        has_text = any(column > 0 for column in self.text_columns)
        return Table(["", ""], rows, frozenset({0, 1} if has_text else {0}))

    @property
    def flat_headings(self) -> Sequence[str]:
        """The headings in one row, each with its widest group if there are several."""
        if not self._is_wide:
            return self.headings
        first, *others = self.headings
        names = [group.heading for group in self.groups[0] for _ in range(group.columns)]
        return [first, *(f"{name} {it}" for name, it in zip(names, others, strict=True))]

    @property
    def _is_wide(self) -> bool:
        return any(len(row) > 1 for row in self.groups[:1])

    @property
    def lines_below(self) -> Sequence[str]:
        """The caption, the findings and the notes, as far as there are any."""
        caption = [self.caption] if self.caption else []
        return [*caption, *self.findings, *([""] if self.findings else []), *self.notes]

    def _latex_groups(self) -> Iterator[str]:
        for row in self.groups:
            ends = list(accumulate((group.columns for group in row), initial=1))
            names = (rf"\multicolumn{{{n}}}{{c}}{{{latex_text(name)}}}" for name, n in row)
            yield _latex_row(["", *names])
            yield " ".join(rf"\cmidrule(lr){{{end + 1}-{last}}}" for end, last in pairwise(ends))

    def _html_groups(self) -> Iterator[str]:
        for row in self.groups:
            names = (f'<th colspan="{n}">{_html_text(name)}</th>' for name, n in row)
            yield f"<tr><th></th>{''.join(names)}</tr>"

    def _html_caption(self) -> str:
        lines = [_html_text(line) for line in (self.caption, *self.notes) if line]
        if not lines:
            return ""
        if not self.caption:
            lines[0] = f"<code>{lines[0]}</code>"
        text = "<br>".join(lines)
        return f'<caption style="caption-side: bottom; text-align: left">{text}</caption>'

    def _html_row(self, row: Sequence[str]) -> str:
        cells = (
            f'<th scope="row" style="text-align: left">{text}</th>'
            if column in self.text_columns
            else f"<td>{text}</td>"
            for column, text in enumerate(map(_html_number, row))
        )
        return f"<tr>{''.join(cells)}</tr>"


@dataclass(frozen=True, slots=True)
class Part:
    """A part of what is printed: a title, tables and a note, each if there is one."""

    tables: Sequence[Table] = ()
    title: str = ""
    note: str = ""
    style: str = "dim"
    """How a terminal shows the note."""

    def to_text(self) -> str:
        """Return the lines of the part in aligned columns, for a pipe or a file."""
        tables = (table.to_text() for table in self.tables)
        return "\n".join(filter(None, [self.title, *tables, self.note]))


FORMATS = ("table", "json", "csv", "markdown", "latex")
"""What ``--format`` offers for scores."""


@dataclass(frozen=True)
class Printout:
    """A result in each of its formats; those that are not asked for are not written."""

    parts: Callable[[], Sequence[Part]]
    """The result for people."""
    json: Callable[[], str] = str
    csv: Callable[[], str] = str
    papers: Mapping[str, Callable[[], Table]] = field(default_factory=dict)
    """The table as papers show it, by the formats that have another one than people."""

    @classmethod
    def of_table(
        cls,
        table: Callable[[], Table],
        *,
        json: Callable[[], str] = str,
        csv: Callable[[], str] = str,
        papers: Mapping[str, Callable[[], Table]] = MappingProxyType({}),
    ) -> Self:
        """Return a result that is one table, which papers show as it is, too."""
        every = dict.fromkeys(("markdown", "latex"), table) | dict(papers)
        return cls(lambda: [Part([table()])], json, csv, every)

    def text(self, layout: str) -> str:
        """Return the result in one of the formats."""
        match layout:
            case "json":
                return self.json()
            case "csv":
                return self.csv()
            case "markdown":
                return self.papers[layout]().to_markdown()
            case "latex":
                return self.papers[layout]().to_latex()
            case "html":
                return self.papers[layout]().to_html()
            case _:
                return "\n\n".join(part.to_text() for part in self.parts())


def _aligned(column: Sequence[str], *, is_text: bool) -> Sequence[str]:
    """Pad a heading and its cells to one width; decimal points stay in line despite marks."""
    heading, *cells = column
    # A mark takes a column of its own, or the points of the numbers beside it would be out of line.
    is_marked = not is_text and any(cell.endswith(MARK) for cell in cells)
    if is_marked:
        cells = [cell if cell.endswith(MARK) else f"{cell} " for cell in cells]
    width = max(map(len, [heading, *cells]))
    if is_text:
        return [cell.ljust(width) for cell in column]
    if is_marked and len(heading) < width:
        heading = f"{heading} "
    return [cell.rjust(width) for cell in [heading, *cells]]


# Markdown.

_MARKDOWN = re.compile(
    r"""
    [\\`*\[\]~$]                           # code, emphasis, links, strikethrough, formulas
    | (?<![A-Za-z0-9])_ | _(?![A-Za-z0-9])  # emphasis; inside a word, _ is itself
    | & | <(?![ ]) | (?<![ ])>(?!=)         # HTML; "p < 0.001" and ">=" are no tags
    | ^[#+-](?=[ ])                         # headings and lists, at the beginning of a line
    """,
    re.VERBOSE,
)
_ENTITIES = {"&": "&amp;", "<": "&lt;", ">": "&gt;"}


def markdown_text(text: str) -> str:
    r"""Escape a line of text for Markdown, which may also contain HTML.

    >>> print(markdown_text("<b>DUET*</b> & `ours`: p < 0.001, val_unseen"))
    &lt;b&gt;DUET\*&lt;/b&gt; &amp; \`ours\`: p < 0.001, val_unseen
    """
    line = " ".join(text.splitlines())
    return _MARKDOWN.sub(lambda found: _ENTITIES.get(found[0]) or rf"\{found[0]}", line)


def _markdown_cell(text: str) -> str:
    # Only in a table does | end a cell.
    return markdown_text(text).replace("|", r"\|")


_MARKDOWN_STYLES = {"plain": "{}", "bold": "**{}**", "underlined": "<ins>{}</ins>"}


def _markdown_number(cell: str) -> str:
    if not isinstance(cell, Number):
        return _markdown_cell(cell)
    value = _MARKDOWN_STYLES[cell.style].format(_markdown_cell(cell.value))
    return value + _markdown_cell(cell[len(cell.value) :])


# LaTeX.

_NAMED = {
    "~": "asciitilde",
    "^": "asciicircum",
    "\\": "backslash",
    "<": "less",
    ">": "greater",
    "|": "bar",
    "±": "pm",
    "†": "dagger",
    "‡": "daggerdbl",
    "§": "section",
    "¶": "paragraph",
}
# Escapes of characters that LaTeX, or its default font encoding, takes for something else.
_SPECIAL = str.maketrans(
    {letter: f"\\{letter}" for letter in "&%$#_{}"}
    | {letter: f"{{{letter}}}" for letter in "[]*"}  # options of the \\ that ends a row
    | {letter: rf"\text{name}{{}}" for letter, name in _NAMED.items()}
    | dict.fromkeys("\n\r", " ")  # two of them would end a paragraph
)


def latex_text(text: str) -> str:
    r"""Escape a text for LaTeX.

    Letters beyond the Latin ones stay: they need xelatex or lualatex, and a font that has them.
    Quotation marks, and hyphens in a row, come out as LaTeX sets them.

    >>> print(latex_text("DUET_{ours} & 100% ~ a|b"))
    DUET\_\{ours\} \& 100\% \textasciitilde{} a\textbar{}b
    """
    return text.translate(_SPECIAL)


def latex_comments(lines: Iterable[str]) -> Sequence[str]:
    r"""Return lines as LaTeX comments.

    >>> latex_comments(["95 % intervals", "", "of a\nb.npz"])
    ['% 95 % intervals', '%', '% of a b.npz']
    """
    return [f"% {' '.join(line.splitlines())}".rstrip() for line in lines]


_LATEX_STYLES = {"plain": "{}", "bold": r"\textbf{{{}}}", "underlined": r"\underline{{{}}}"}


def _latex_number(cell: str) -> str:
    if not isinstance(cell, Number):
        return latex_text(cell)
    value = _LATEX_STYLES[cell.style].format(latex_text(cell.value))
    if cell.marks:
        # Without a width, so that the decimal points above and below stay in line.
        value += rf"\rlap{{\textsuperscript{{{latex_text(cell.marks)}}}}}"
    if cell.interval is None:
        return value
    # Beside the value, or on one line below it, twelve intervals would be wider than a page.
    low, high = map(latex_text, cell.interval)
    lines = rf"{value}\\ \scriptsize ({low},\\ \scriptsize {high})"
    return rf"\begin{{tabular}}[t]{{@{{}}r@{{}}}}{lines}\end{{tabular}}"


def _latex_row(cells: Iterable[str]) -> str:
    return " & ".join(cells) + r" \\"


# HTML.


def _html_text(text: str) -> str:
    from html import escape

    return escape(text)


_HTML_STYLES = {"plain": "{}", "bold": "<strong>{}</strong>", "underlined": "<u>{}</u>"}


def _html_number(cell: str) -> str:
    if not isinstance(cell, Number):
        return _html_text(cell)
    value = _HTML_STYLES[cell.style].format(_html_text(cell.value))
    marks = f"<sup>{_html_text(cell.marks)}</sup>" if cell.marks else ""
    interval = " to ".join(map(_html_text, cell.interval or ()))
    return value + marks + (f"<br><small>({interval})</small>" if interval else "")


@cache
def _meanings(task: Task) -> Mapping[str, str]:
    """Return what the headings of metrics mean in a task."""
    metrics = map(task.metric, CATALOGUE)
    return {metric.heading: f"{metric.name}: {metric.definition}" for metric in metrics}


def _html_heading(heading: str, meaning: str | None) -> str:
    title = f' title="{_html_text(meaning)}"' if meaning else ""
    return f"<th{title}>{_html_text(heading)}</th>"


# Cells.


def cell_of(value: T | None, text: Callable[[T], str] = str) -> str:
    """Return a value that may be missing as a cell."""
    return MISSING if value is None else text(value)


def metric_cell(metric: Metric, values: Mapping[str, float]) -> str:
    """Return a metric's value as a cell, given the values by the keys of their metrics."""
    return cell_of(values.get(metric.key), metric.display)


def metric_cells(metrics: Iterable[Metric], values: Mapping[str, float]) -> Sequence[str]:
    """Return the cells of several metrics."""
    return [metric_cell(metric, values) for metric in metrics]
