"""The history of a leaderboard as SVG: results over the years, and a rank over time.

Places across are percentages, so that a picture is as wide as its page and its text as large as
the page's. Colours come from ``charts.css``.
"""

import math
from bisect import bisect_left, insort
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain, groupby, pairwise
from operator import attrgetter
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from reverie_eval.metrics import Metric
from reverie_eval.reporting.charts import MOST_SERIES, round_numbers
from reverie_eval.reporting.drawing import (
    element,
    line_across,
    steps,
    stretched_paths,
    text_across,
    wide_svg,
)

_TOP, _LINE = 18, 16
_FIRST, _LAST = 7.0, 97.0
_WEEK = 7 / 365
# Names are placed for this width in pixels; narrower pages show those of the best alone.
_WIDTH, _PHONE, _LETTER = 640.0, 320.0, 6.6
_TICK = 3 * _LETTER  # of a value at the left, at most 100
_LONGEST_NAME = 24
# Pixels.
_RANK_HEIGHT = 150
_MOST_MARKS = 500
"""Methods that were not the best so far; more are drawn as dots, as circles hide each other."""


ResultKind: TypeAlias = Literal["method", "human", "reference"]


class PastResult(NamedTuple):
    """A result on a timeline."""

    name: str
    date: str
    """A day, a month or a year: ``2021-06-01``, ``2021-06`` or ``2021``; empty if not known."""
    value: float
    """In the metric's own unit."""
    version: str
    """The version of the dataset, or other rules: results of one version can be compared."""
    kind: ResultKind = "method"

    @property
    def years(self) -> float:
        """When it was published, in years; the middle of a month or a year."""
        return years_of(self.date)


@lru_cache(4096)  # the results of a leaderboard share their days
def years_of(date: str) -> float:
    """Return a day, or the middle of a month or a year, in years.

    >>> years_of("2021-01-01"), years_of("2021-07"), years_of("2021")
    (2021.0, 2021.5416666666667, 2021.5)
    """
    year, *month_and_day = map(int, date.split("-"))
    if not month_and_day:
        return year + 0.5
    month, *day = month_and_day
    return year + (month - 1 + ((day[0] - 1) / 31 if day else 0.5)) / 12


@dataclass(frozen=True)
class Timeline:
    """Results over the years; each version of the dataset has its own best-so-far line.

    Lines are of methods alone: a human or a reference result is a mark of its own.
    """

    metric: Metric
    results: Sequence[PastResult]
    """At least one with a date; of the others, people are drawn as a line."""
    until: str
    """The day up to which the lines go on."""
    height: int = 300
    """Pixels."""

    @cached_property
    def dated(self) -> Sequence[PastResult]:
        """The results that have a date."""
        return [each for each in self.results if each.date]

    @cached_property
    def versions(self) -> Mapping[str, str]:
        """The class of each version's marks, the version with the latest results first."""
        by_version: dict[str, float] = {}
        for each in sorted(self.dated, key=attrgetter("years"), reverse=True):
            by_version.setdefault(each.version, each.years)
        return {
            version: f"series-{number % MOST_SERIES + 1}"
            for number, version in enumerate(by_version)
        }

    @cached_property
    def best_so_far(self) -> Mapping[str, Sequence[PastResult]]:
        """The methods of each version that were better than all before, by date.

        Of methods of the same date, the best counts.
        """
        best: dict[str, list[PastResult]] = {version: [] for version in self.versions}
        methods = [each for each in self.dated if each.kind == "method"]
        for each in sorted(methods, key=lambda it: (it.years, self._cost(it.value))):
            before = best[each.version]
            if not before or self._cost(each.value) < self._cost(before[-1].value):
                before.append(each)
        return best

    @cached_property
    def svg(self) -> str:
        """The timeline, drawn."""
        shapes = [
            *self._axis.labels(self.height - 4),
            *self._values(),
            *self._human(),
            *self._steps(),
            *self._marks(),
            *self._names(),
        ]
        number = len(self.dated)
        title = f"{number} results by {self.metric.name}, {self._axis.first} to {self._axis.last}"
        return wide_svg(title, self.height, shapes)

    @cached_property
    def _axis(self) -> "Years":
        dates = [each.years for each in self.dated]
        end = max(years_of(self.until), *dates)
        return Years(min(math.floor(min(dates)), end - 0.5), end)

    @cached_property
    def _ticks(self) -> Sequence[float]:
        # With nothing but zeros, the axis is that of all values there may be.
        most = max(self._shown(each.value) for each in self.results) or self._shown(1.0)
        step = next(each for each in round_numbers() if most / each <= 5)
        return np.arange(0, most + step, step).tolist()

    def _y(self, value: float) -> float:
        inside = self.height - _TOP - 2 * _LINE
        return _TOP + inside * (1 - self._shown(value) / self._ticks[-1])

    def _shown(self, value: float) -> float:
        return self.metric.scale * value

    def _cost(self, value: float) -> float:
        return -value if self.metric.better == "higher" else value

    def _values(self) -> Iterator[str]:
        for tick in self._ticks:
            yield line_across(self._y(tick / self._shown(1.0)), f"{tick:g}")

    def _human(self) -> Iterator[str]:
        """Draw a line across at each version's best human result."""
        people = [each for each in self.results if each.kind == "human"]
        people.sort(key=attrgetter("version"))
        for version, its in groupby(people, attrgetter("version")):
            best = min(its, key=lambda each: self._cost(each.value))
            y = f"{self._y(best.value):.1f}"
            line = f'class="human" x1="{_FIRST}%" x2="100%" y1="{y}" y2="{y}"'
            yield element("line", line, f"{best.name}, {version}")
            told = f"{best.name} {self.metric.display(best.value)}"
            yield text_across(100, float(y) - 4, told, "end")

    def _steps(self) -> Iterator[str]:
        lines = []
        for version, kind in self.versions.items():
            best = self.best_so_far[version]
            points = [(self._axis.across(each.years), self._y(each.value)) for each in best]
            if points:
                lines.append((f"curve {kind}", steps(points, self._axis.across(self._axis.end))))
        yield stretched_paths(self.height, lines)

    def _marks(self) -> Iterator[str]:
        """Draw a circle for each result, those that were the best on top, or dots for a crowd."""
        leaders = [*chain.from_iterable(self.best_so_far.values())]
        best = set(leaders)
        others = [each for each in self.dated if each not in best]
        crowd = [each for each in others if each.kind == "method"]
        if len(crowd) > _MOST_MARKS:
            yield stretched_paths(self.height, self._dots(crowd))
            others = [each for each in others if each.kind != "method"]
        groups: dict[str, list[str]] = {}
        for each in (*others, *leaders):  # a set's order would be another in each process
            kind: str = "best" if each in best else each.kind
            position = f'cx="{self._axis.across(each.years):.1f}%" cy="{self._y(each.value):.0f}"'
            told = f"{each.name}: {self.metric.display(each.value)}, {each.date}"
            if len(self.versions) > 1:
                told += f", {each.version}"
            marks = groups.setdefault(f"{kind} {self.versions[each.version]}", [])
            marks.append(element("circle", position, told))
        for kind, marks in groups.items():
            yield f'<g class="{kind}">{"".join(marks)}</g>'

    def _dots(self, crowd: Iterable[PastResult]) -> Iterator[tuple[str, str]]:
        """Draw results as dots, equal ones once: a path for each version."""
        dots: dict[str, dict[str, None]] = {}
        for each in crowd:
            dot = f"M{self._axis.across(each.years):.1f} {self._y(each.value):.0f}h0"
            dots.setdefault(self.versions[each.version], {})[dot] = None
        for version, lines in dots.items():
            yield f"crowd {version}", "".join(lines)  # of length 0, with round ends

    def _names(self) -> Iterator[str]:
        """Name those that were the best, the latest first, where there is room to their left."""
        taken: list[tuple[float, float, float]] = []
        best = [*chain.from_iterable(self.best_so_far.values())]
        leader = min(best, key=lambda it: self._cost(it.value), default=None)
        for each in sorted(best, key=lambda it: (self._cost(it.value), it.years)):
            name = _short(each.name)
            across, width = self._axis.across(each.years), _LETTER * len(name)
            # On a phone, too, the leader's name is there: at the right, if it must be.
            to_left = each is not leader or across / 100 * _PHONE > width + _TICK
            right = across / 100 * _WIDTH + (-7 if to_left else width)
            left, y = right - width, self._y(each.value) - 6
            overlaps = any(
                left < its_right and its_left < right and abs(y - its_y) < _LINE
                for its_left, its_right, its_y in taken
            )
            if left >= _TICK and not overlaps:
                taken.append((left, right, y))
                kind = "leader" if each is leader else "was-best"
                yield text_across(across, y, name, "end" if to_left else "start", kind)


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"


class RankAt(NamedTuple):
    """A rank from a moment on."""

    years: float
    rank: int
    results: int
    """The number of results then."""


def rank_over_time(
    results: Iterable[tuple[float, float]], own: Iterable[tuple[float, float]]
) -> Sequence[RankAt]:
    """Return the best rank of some results whenever it or the number of results changed.

    Parameters
    ----------
    results : iterable of (float, float)
        When each was published, in years, and its cost, lower being better; ``own`` among them.
    own : iterable of (float, float)
        Those whose best rank it is.

    Examples
    --------
    >>> [tuple(each) for each in rank_over_time([(1, 5.0), (2, 4.0), (3, 9.0)], [(1, 5.0)])]
    [(1, 1, 1), (2, 2, 2), (3, 2, 3)]
    """
    mine = sorted(own)
    if not mine:
        return []
    found: list[RankAt] = []
    costs: list[float] = []
    best = math.inf
    for years, cost in sorted(results):
        insort(costs, cost)
        while mine and mine[0][0] <= years:
            best = min(best, mine.pop(0)[1])
        if best < math.inf:
            rank = RankAt(years, 1 + bisect_left(costs, best), len(costs))
            # The last of the results of a moment has counted all of them.
            if found and found[-1].years == years:
                found[-1] = rank
            else:
                found.append(rank)
    return found


def rank_svg(ranks: Sequence[RankAt], until: float, title: str) -> str:
    """Draw a rank over time, the first at the top, above the number of results.

    ``ranks`` are at least one, and ``until`` is when the lines end, in years.
    """
    axis = Years(ranks[0].years - _WEEK, max(until, ranks[0].years) + _WEEK)
    last = ranks[-1]
    most = max(each.results for each in ranks)
    inside = _RANK_HEIGHT - _TOP - 2 * _LINE

    def y(rank: int) -> float:
        return _TOP + inside * (rank - 1) / max(most - 1, 1)

    def line(rank: Callable[[RankAt], int]) -> str:
        points = [(axis.across(each.years), y(rank(each))) for each in ranks]
        return steps(points, end)

    end, told = axis.across(max(until, last.years)), f"{last.rank} of {last.results}"
    # Above the end of the line, unless the line comes down there on a phone.
    begin = end - 100 * _LETTER * len(told) / _PHONE
    falls = any(
        each.rank < last.rank for each, after in pairwise(ranks) if axis.across(after.years) > begin
    )
    told_at = y(last.rank) + (_LINE - 3 if falls else -5)
    own, count = line(attrgetter("rank")), line(attrgetter("results"))
    shapes = [
        *axis.labels(_RANK_HEIGHT - 4),
        *(line_across(y(rank), f"{rank}") for rank in sorted({1, most})),
        stretched_paths(_RANK_HEIGHT, [("count", count), ("curve series-1", own)]),
        text_across(end, told_at, told, "end", "leader"),
    ]
    return wide_svg(title, _RANK_HEIGHT, shapes)


class Years(NamedTuple):
    """An axis of time."""

    start: float
    end: float

    @property
    def first(self) -> int:
        """The year of the start."""
        return math.floor(self.start)

    @property
    def last(self) -> int:
        """The year of the end."""
        return math.floor(self.end)

    def across(self, years: float) -> float:
        """Return where a moment is, in percent of the width."""
        return _FIRST + (_LAST - _FIRST) * (years - self.start) / (self.end - self.start)

    def labels(self, y: float) -> Iterator[str]:
        """Write the years, or the months of a short period, below a picture."""
        months = 12 if self.end - self.start > 1.5 else 1 if self.end - self.start < 0.5 else 3
        first = math.ceil(round(12 * self.start, 6) / months)
        for number in range(first, math.floor(12 * self.end / months) + 1):
            month = number * months
            name = f"{month // 12}" if months == 12 else f"{month // 12}-{month % 12 + 1:02d}"
            yield text_across(self.across(month / 12), y, name, "middle")
