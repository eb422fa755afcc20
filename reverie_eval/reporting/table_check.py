"""Whether the numbers of a printed table are those of result files, and whether bold is the best.

The mean in the file of a row is rounded to the digits that are printed, and compared. A number that
differs is compared with other ways to round, and with other protocols.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_DOWN, ROUND_HALF_UP, Decimal
from itertools import groupby
from typing import Literal, NamedTuple

from reverie_eval.analysis import Comparison, p_text
from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import Metric
from reverie_eval.reporting.printed import (
    Look,
    PrintedCell,
    PrintedTable,
    metric_in,
    number_in,
    split_in,
)
from reverie_eval.reporting.tables import Part, Printout, Table
from reverie_eval.scoring import Intervals, Scored
from reverie_eval.text import count_text

Verdict = Literal["agrees", "rounding", "protocol", "differs"]
Results = Mapping[str, Mapping[str, Mapping[str, Scored]]]
"""Scores by split, method and protocol."""

_VERDICTS: Mapping[Verdict, str] = {
    "agrees": "agree",
    "rounding": "rounded wrongly",
    "protocol": "under another protocol",
    "differs": "wrong",
}
# The ranks that types claim, from 0.
_RANKS: Mapping[Look, int] = {"bold": 0, "underlined": 1}
_RANK_NAMES = ("the best", "the second best")
# A value is within so many units of the last printed digit if it was only rounded otherwise.
_SLIP = Decimal("1.5")
# A mean of binary fractions is half a unit only up to its last bits.
_LAST_BITS = Decimal("1e-9")
# Without a label, a row is a file's if at least so many of its numbers agree, and half of them.
_FEWEST_AGREEING = 2


class CheckedNumber(NamedTuple):
    """A printed number, and what the file of its row has."""

    line: int
    row: str
    """The label of the row."""
    method: str
    split: str
    metric: str
    printed: str
    computed: str
    """By the file, with two more digits."""
    verdict: Verdict
    finding: str


class CheckedLook(NamedTuple):
    """A number in bold or underlined, and whether it should be."""

    line: int
    row: str
    split: str
    metric: str
    printed: str
    look: Look
    finding: str
    is_right: bool


@dataclass(frozen=True)
class TableCheck:
    """What was found in the tables of a file."""

    numbers: Sequence[CheckedNumber]
    looks: Sequence[CheckedLook]
    notes: Sequence[str]
    """How rows were matched to files, and what was not checked."""

    @property
    def is_right(self) -> bool:
        """Whether all numbers agree, and all that is bold or underlined should be."""
        agrees = all(each.verdict == "agrees" for each in self.numbers)
        return agrees and all(each.is_right for each in self.looks)

    @property
    def summary(self) -> str:
        """How many numbers were checked, and how many agree, in a line."""
        verdicts = Counter(each.verdict for each in self.numbers)
        wrong = Counter(each.look for each in self.looks if not each.is_right)
        told = [f"{verdicts[each]} {text}" for each, text in _VERDICTS.items() if verdicts[each]]
        told += [f"{wrong[look]} wrongly {look}" for look in _RANKS if wrong[look]]
        return f"{count_text(len(self.numbers), 'number')} checked: {', '.join(told)}"

    def printout(self) -> Printout:
        """Return what needs a look, in tables; as CSV, every number that was checked."""
        return Printout(self._parts, csv=lambda: _number_table(self.numbers).to_csv())

    def _parts(self) -> Sequence[Part]:
        wrong = [each for each in self.numbers if each.verdict != "agrees"]
        headings = ["line", "row", "split", "metric", "printed", "type", "finding"]
        looks = [[str(part) for part in each[:-1]] for each in self.looks]
        return [
            Part([_number_table(wrong)] if wrong else [], self.summary),
            *([Part([Table(headings, looks, frozenset({1, 2, 3, 5, 6}))])] if looks else []),
            *([Part(note="\n".join(self.notes))] if self.notes else []),
        ]


def _number_table(numbers: Iterable[CheckedNumber]) -> Table:
    return Table(
        ["line", "row", "file", "split", "metric", "printed", "computed", "verdict", "finding"],
        [[str(part) for part in each] for each in numbers],
        frozenset({1, 2, 3, 4, 7, 8}),
    )


def check_tables(tables: Sequence[PrintedTable], results: Results, protocol: str) -> TableCheck:
    """Check the tables of a file against the scores of result files.

    Parameters
    ----------
    tables : sequence of PrintedTable
    results : mapping
        Scores by split, method and protocol; each method has those of ``protocol``.
    protocol : str
        The rules by which the numbers should have been made.

    Raises
    ------
    ProtocolError
        If no column is headed by a metric of a split that was scored, no row is one of a file, or
        the files do not have the metrics of their rows.
    """
    checks = [_OneTable(table, results, protocol) for table in tables]
    checks = [each for each in checks if each.columns]
    if not checks:
        raise ProtocolError(
            f"no column is headed by a metric, such as SR or SPL, of {' or '.join(results)}"
        )
    numbers = [number for each in checks for number in each.numbers()]
    if not numbers and any(each.matches for each in checks):
        metrics = dict.fromkeys(it.label for each in checks for _, it in each.columns.values())
        raise ProtocolError(
            f"nothing to compare: the files have no scores of {', '.join(metrics)}, or their rows "
            "have no numbers in these columns"
        )
    if not numbers:
        labels = dict.fromkeys(row.label for each in checks for row in each.rows)
        names = dict.fromkeys(name for methods in results.values() for name in methods)
        raise ProtocolError(
            f"no row is one of {', '.join(names)}, by its label or its numbers; the rows are "
            f"{', '.join(labels)}. Name a file after its row: 'LABEL=FILE'"
        )
    return TableCheck(
        numbers,
        [look for each in checks for look in each.looks()],
        list(dict.fromkeys(note for each in checks for note in each.notes())),
    )


class _Row(NamedTuple):
    label: str
    cells: Sequence[PrintedCell]
    section: str
    """The text of the last row that had nothing else, such as a split."""
    block: int
    """The number of horizontal lines above the row."""


class _Compared(NamedTuple):
    """A printed number beside that of a file."""

    column: int
    printed: Decimal
    computed: Decimal
    agreeing: Sequence[str]
    """The protocols by which the file's number is printed so."""


class _Match(NamedTuple):
    """A row, by its number, and the method whose file it is compared with."""

    number: int
    method: str
    compared: Sequence[_Compared]
    is_labelled: bool
    """Whether the row's label names the method; if not, its numbers are the file's."""


class _OneTable:
    """A printed table beside the results: what its columns and rows are."""

    def __init__(self, table: PrintedTable, results: Results, protocol: str) -> None:
        self._results, self._protocol, self._caption = results, protocol, table.caption
        self._comparisons: dict[tuple[str, str], Comparison] = {}
        has_numbers = [any(number_in(it.text) is not None for it in row[1:]) for row in table.rows]
        n_heads = has_numbers.index(True) if True in has_numbers else len(table.rows)
        # A row with one text is a heading among the rows, even if it is above all of them.
        while n_heads > 1 and len({cell.text for cell in table.rows[n_heads - 1]} - {""}) == 1:
            n_heads -= 1
        heads, body = table.rows[:n_heads], table.rows[n_heads:]
        self._stacks = [
            [row[column].text for row in heads if column < len(row)]
            for column in range(max(map(len, table.rows), default=0))
        ]
        found = {column: metric_in(stack) for column, stack in enumerate(self._stacks)}
        self._metrics = {column: metric for column, metric in found.items() if metric}
        self.rows = list(self._rows(body, table.blocks[n_heads:]))
        self.columns = {
            (section, column): (split, metric)
            for section in dict.fromkeys(row.section for row in self.rows)
            for column, metric in self._metrics.items()
            if (split := self._split_of(section, column)) in results
        }
        rates = [
            number
            for row in self.rows
            for column, metric in self._metrics.items()
            if metric.unit == "fraction" and (number := _number(row, column)) is not None
        ]
        self._whole = 1 if rates and max(rates) <= 1 else 100
        self.matches = sorted(self._find_matches(), key=lambda match: match.number)
        self._method_of = {match.number: match.method for match in self.matches}

    def _rows(self, body: Sequence[Sequence[PrintedCell]], blocks: Sequence[int]) -> Iterator[_Row]:
        first, section = min(self._metrics, default=0), ""
        for cells, block in zip(body, blocks, strict=True):
            texts = list(dict.fromkeys(cell.text for cell in cells if cell.text))
            if len(texts) == 1 and number_in(texts[0]) is None:
                section = texts[0]
            elif len(cells) > first:
                label = " ".join(dict.fromkeys(it.text for it in cells[:first] if it.text))
                yield _Row(label, cells, section, block)

    def _split_of(self, section: str, column: int) -> str:
        """Return the split of a column, by the heading nearest to it."""
        for text in (" ".join(self._stacks[column]), section, self._caption):
            if named := split_in(text):
                return named
        # Nothing says which it is, and there may be but one that it can be.
        return next(iter(self._results)) if len(self._results) == 1 else ""

    # Rows and files.

    def _find_matches(self) -> Iterator[_Match]:
        """Yield the rows that are those of files, each section's on their own."""
        names = list(dict.fromkeys(name for methods in self._results.values() for name in methods))
        for _, several in groupby(enumerate(self.rows), lambda each: each[1].section):
            rows = dict(several)
            labelled = _by_label({number: row.label for number, row in rows.items()}, names)
            for number, name in labelled.items():
                compared = list(self._compare(rows[number], name))
                yield _Match(number, name, compared, is_labelled=True)
            free = set(names) - set(labelled.values())
            counts = {
                (number, name): self._agreement(row, name)
                for number, row in rows.items()
                for name in names
                if number not in labelled and name in free
            }
            # The row that has most of a file's numbers is the file's.
            for (number, name), count in sorted(counts.items(), key=lambda each: -each[1]):
                if count and name in free and number in rows:
                    free.remove(name)
                    compared = list(self._compare(rows.pop(number), name))
                    yield _Match(number, name, compared, is_labelled=False)

    def _agreement(self, row: _Row, name: str) -> int:
        """Return how many numbers of a row are a file's under one protocol; 0 if too few are."""
        compared = list(self._compare(row, name))
        most = max(_counts(compared).values(), default=0)
        return most if most >= max(_FEWEST_AGREEING, len(compared) / 2) else 0

    def _compare(self, row: _Row, name: str) -> Iterator[_Compared]:
        """Yield the numbers of a row that a file has too."""
        for (section, column), (split, metric) in self.columns.items():
            by_protocol = self._results[split].get(name, {})
            printed = _number(row, column)
            if (
                section != row.section
                or printed is None
                or metric.key not in by_protocol.get(self._protocol, {})
            ):
                continue
            scale = self._whole if metric.unit == "fraction" else 1
            values = {
                protocol: Decimal(scores[metric.key]) * scale
                for protocol, scores in by_protocol.items()
                if metric.key in scores
            }
            agreeing = [each for each, value in values.items() if _agrees(printed, value)]
            yield _Compared(column, printed, values[self._protocol], agreeing)

    # Findings.

    def numbers(self) -> Iterator[CheckedNumber]:
        """Yield every number that a file has."""
        for match in self.matches:
            row = self.rows[match.number]
            for column, printed, computed, agreeing in match.compared:
                split, metric = self.columns[row.section, column]
                yield CheckedNumber(
                    row.cells[column].line,
                    row.label,
                    match.method,
                    split,
                    metric.label,
                    str(printed),
                    f"{computed:.{_decimals(printed) + 2}f}",
                    *_judge(printed, computed, agreeing, self._protocol),
                )

    def looks(self) -> Iterator[CheckedLook]:
        """Yield what is bold or underlined, and whether it is the best or the second best."""
        for (section, column), (split, metric) in self.columns.items():
            if metric.better == "neither":
                continue
            values = {
                number: value
                for number, row in enumerate(self.rows)
                if row.section == section and (value := _number(row, column)) is not None
            }
            for number, value in values.items():
                row = self.rows[number]
                for look in filter(row.cells[column].looks.__contains__, _RANKS):
                    wrong = self._wrong_rank(values, number, metric, _RANKS[look])
                    right = f"is {_RANK_NAMES[_RANKS[look]]}"
                    if look == "bold" and not wrong:
                        right += f"; {self._certainty(values, number, split, metric)}"
                    yield CheckedLook(
                        row.cells[column].line,
                        row.label,
                        split,
                        metric.label,
                        str(value),
                        look,
                        wrong or right,
                        not wrong,
                    )

    def _wrong_rank(
        self, values: Mapping[int, Decimal], number: int, metric: Metric, rank: int
    ) -> str:
        """Say why a number does not have a rank; empty if it does, in its column or block."""
        block = [it for it in values if self.rows[it].block == self.rows[number].block]
        better: Mapping[Decimal, int] = {}
        for rows in (block, values):
            better = {
                values[it]: it
                for it in rows
                if metric.is_better(float(values[it]), float(values[number]))
            }
            if len(better) == rank:
                return ""
        if not better:
            return "is the best, not the second best"
        best = max(better, key=lambda value: abs(value - values[number]))
        return f"is not {_RANK_NAMES[rank]}: {self.rows[better[best]].label} has {best}"

    def _certainty(
        self, values: Mapping[int, Decimal], number: int, split: str, metric: Metric
    ) -> str:
        """Say whether a bold number is significantly better than the best of the others."""
        own = float(values[number])
        # Without those that are better, on the other side of a rule.
        others = {
            it: float(value)
            for it, value in values.items()
            if it != number and not metric.is_better(float(value), own)
        }
        if not others:
            return "there is no other"
        runner_up = min(others, key=lambda it: abs(others[it] - own))
        name, other = self._method_of.get(number), self._method_of.get(runner_up)
        label = self.rows[runner_up].label
        if name is None or other is None or name == other:
            return f"not tested: {label if name else 'it'} has no file"
        truth = self._results[split][name][self._protocol].ground_truth
        if reason := Intervals.why_not(truth, "target"):
            return f"not tested: {reason}"
        comparison = self._comparison(split, name)
        if metric.key not in comparison.get(other, {}):
            return f"not tested: the file of {label} has no {metric.label} on {split}"
        found = comparison[other][metric.key]
        size = metric.display(abs(found.mean))
        # A difference is the other's minus that of the bold number, of which either can be wrong.
        if metric.is_better(found.mean, 0.0):
            return f"but by their files, {label} is better by {size}, {p_text(found.p_value)}"
        is_sure = comparison.is_significant(other, metric.key)
        return (
            f"{'' if is_sure else 'not '}significantly better than {label}, by {size}, "
            f"{p_text(found.p_value)}"
        )

    def _comparison(self, split: str, name: str) -> Comparison:
        """Compare a method with all others, in the metrics of the table."""
        if (split, name) not in self._comparisons:
            keys = {metric.key for _, metric in self.columns.values()}
            scores = {
                each: replace(it, episodes={key: it.episodes[key] for key in it if key in keys})
                for each, by_protocol in self._results[split].items()
                for it in [by_protocol[self._protocol]]
            }
            self._comparisons[split, name] = Comparison.of(scores, baseline=name, all_pairs=True)
        return self._comparisons[split, name]

    def notes(self) -> Iterator[str]:
        """Say how rows were matched to files, and what was not checked."""
        for match in self.matches:
            label, total = self.rows[match.number].label, len(match.compared)
            counts = _counts(match.compared)
            most = max(counts.values(), default=0)
            if not match.is_labelled:
                yield (
                    f"{label or 'a row without a label'} is taken for {match.method}, because "
                    f"{most} of {total} numbers agree; no label says so"
                )
            if most > counts[self._protocol]:
                best = ", ".join(each for each in counts if counts[each] == most)
                yield (
                    f"{label}: of {count_text(total, 'number')}, {counts[self._protocol]} agree "
                    f"under {self._protocol}, {most} under {best}"
                )
        unmatched = [
            row.label
            for number, row in enumerate(self.rows)
            if number not in self._method_of
            and any(_number(row, column) is not None for column in self._metrics)
        ]
        if unmatched:
            yield f"not checked, without a file: {', '.join(dict.fromkeys(unmatched))}"
        of_columns = (self._split_of(row.section, it) for row in self.rows for it in self._metrics)
        skipped = dict.fromkeys(split for split in of_columns if split not in self._results)
        if skipped:
            unknown = "columns whose split no heading names"
            yield f"not checked: {', '.join(split or unknown for split in skipped)}"
        headings = [*map(" ".join, self._stacks), *(row.section for row in self.rows)]
        if not any(map(split_in, [*headings, self._caption])):
            yield f"no heading names a split: taken for {next(iter(self._results))}"


def _by_label(labels: Mapping[int, str], names: Iterable[str]) -> Mapping[int, str]:
    """Return the names of rows: a label is the name or, if none is, alone contains it."""

    def simple(text: str) -> str:
        # Without the numbers of citations.
        return re.sub(r"[\W_]", "", re.sub(r"\[[^]]*\]", "", text).casefold())

    simple_labels = {number: simple(label) for number, label in labels.items()}
    found = {
        number: name
        for name in names
        for number, label in simple_labels.items()
        if label == simple(name)
    }
    for name in names:
        parts = [
            number
            for number, label in simple_labels.items()
            if number not in found and simple(name) and simple(name) in label
        ]
        if name not in found.values() and len(parts) == 1:
            found[parts[0]] = name
    return found


def _counts(compared: Iterable[_Compared]) -> Counter[str]:
    return Counter(protocol for each in compared for protocol in each.agreeing)


def _number(row: _Row, column: int) -> Decimal | None:
    return number_in(row.cells[column].text) if column < len(row.cells) else None


def _decimals(number: Decimal) -> int:
    return max(0, -int(number.as_tuple().exponent))


def _unit(number: Decimal) -> Decimal:
    """Return the value of a one in the last printed digit."""
    return Decimal(1).scaleb(-_decimals(number))


def _agrees(printed: Decimal, value: Decimal) -> bool:
    """Whether a printed number is a value, rounded; a half may be rounded up or down."""
    return abs(printed - value) <= _unit(printed) / 2 + _LAST_BITS


def _judge(
    printed: Decimal, value: Decimal, agreeing: Sequence[str], protocol: str
) -> tuple[Verdict, str]:
    """Say whether a number agrees or, if not, how else it may have come about."""
    if protocol in agreeing:
        return "agrees", f"rounded to {count_text(_decimals(printed), 'decimal')}"
    others = f"agrees under {', '.join(agreeing)}" if agreeing else ""
    unit = _unit(printed)
    if value.quantize(unit, ROUND_DOWN) == printed:
        slip = "cut off, not rounded"
    elif value.quantize(unit / 10, ROUND_HALF_UP).quantize(unit, ROUND_HALF_UP) == printed:
        slip = "rounded twice"
    elif abs(printed - value) < _SLIP * unit:
        slip = "off by one in the last digit"
    else:
        return ("protocol", others) if others else ("differs", "agrees under no protocol")
    return "rounding", f"{slip}; or it {others}" if others else slip
