"""The parts of a report in words and numbers, before a template lays them out."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import starmap
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from reverie_eval.analysis import GROUPINGS, Grouping
from reverie_eval.errors import GroundTruthError
from reverie_eval.metrics import CATALOGUE, PRIMARY_METRIC, Metric
from reverie_eval.scoring import OUTCOMES, Scores

if TYPE_CHECKING:
    import pandas as pd


_OWN_SECTION = "scan"
FEW = 10
"""Episodes; scans with fewer are not called the worst for what may be chance."""

FROM_THE_BEST: Mapping[str, str] = MappingProxyType(dict(reversed(list(OUTCOMES.items()))))
"""The outcomes with what they mean, in a report's order."""

Named = Mapping[str, Scores]
"""The submissions of a report by name, the one that it is about first."""


@dataclass(frozen=True, slots=True)
class ScoreCell:
    """A metric's mean, and its interval if there is one."""

    metric: Metric
    value: str
    interval: str
    is_primary: bool


@dataclass(frozen=True, slots=True)
class Bar:
    """A value as a length, in percent; with the ends of its interval where there are any."""

    percent: float
    low: float = math.nan
    high: float = math.nan

    @property
    def interval(self) -> str:
        """The interval in words; empty if there is none."""
        return "" if math.isnan(self.low) else f"{self.low:.1f} to {self.high:.1f}"


@dataclass(frozen=True, slots=True)
class Share:
    """So many episodes of all."""

    count: int
    of: int
    """All that could be: of the stage before, or of everything."""
    percent: float
    """Of all episodes."""

    @property
    def passed(self) -> str:
        """Which part of ``of`` it is, in percent, if there is any."""
        return f"{_percent(self.count, self.of)} %" if self.of else "-"

    @property
    def bar(self) -> Bar:
        """The same as a length."""
        return Bar(self.percent)


@dataclass(frozen=True, slots=True)
class Line:
    """A named row with something for each submission."""

    name: str
    meaning: str
    shares: Sequence[Share]


@dataclass(frozen=True, slots=True)
class PartRow:
    """A part of the episodes: its size, the first's success, everybody's primary metric.

    Of the others None where the part has no episode of theirs.
    """

    name: str
    episodes: int
    success: str
    bars: Sequence[Bar | None]


@dataclass(frozen=True, slots=True)
class SliceTable:
    """The parts that a slicing cuts the episodes into."""

    slicing: Grouping
    rows: Sequence[PartRow]


def score_rows(scores: Named) -> Mapping[str, Sequence[ScoreCell]]:
    """Word every submission's headline metrics."""
    return {name: list(_score_cells(each)) for name, each in scores.items()}


def _score_cells(scores: Scores) -> Iterator[ScoreCell]:
    for metric in scores.headline:
        interval = scores.intervals and scores.intervals.get(metric.key)
        bounds = [interval.low, interval.high] if interval else []
        yield ScoreCell(
            metric=metric,
            value=metric.display(scores[metric.key]),
            interval=" to ".join(map(metric.display, bounds)),
            is_primary=metric.key == PRIMARY_METRIC,
        )


def finding(scores: Scores) -> str:
    """Say in a sentence or two how far the agent comes, and where most is lost."""
    counts, total = scores.failure_modes.counts, len(scores.instr_ids)
    correct, wrong = counts["correct"], total - counts["correct"]
    share = f"{correct:,} of {total:,} episodes ({_percent(correct, total)} %)"
    whole = f"{share} {OUTCOMES['correct']}."
    if not wrong:
        return whole
    failures = {outcome: count for outcome, count in counts.items() if outcome != "correct"}
    worst = max(failures, key=lambda outcome: failures[outcome])
    most = f"{failures[worst]:,} of the other {wrong:,} ({_percent(failures[worst], wrong)} %)"
    return f"{whole} The most frequent failure: {most} {OUTCOMES[worst]}."


def funnel_lines(scores: Named) -> Sequence[Line]:
    """Say how many episodes came how far, and which part of the stage before that is."""
    funnels = [each.failure_modes.funnel for each in scores.values()]
    stages = list(funnels[0])
    before = dict(zip(stages, [stages[0], *stages], strict=False))
    return [
        Line(
            stage,
            "",
            [Share(each[stage], each[before[stage]], _share(each, stage)) for each in funnels],
        )
        for stage in stages
    ]


def _share(funnel: Mapping[str, int], stage: str) -> float:
    return 100 * funnel[stage] / funnel[next(iter(funnel))]


def outcome_lines(scores: Named) -> Sequence[Line]:
    """Count what became of the episodes, the best first."""
    counts = [each.failure_modes.counts for each in scores.values()]
    totals = [len(each.instr_ids) for each in scores.values()]
    return [
        Line(
            outcome,
            meaning,
            [
                Share(count[outcome], total, 100 * count[outcome] / total)
                for count, total in zip(counts, totals, strict=True)
            ],
        )
        for outcome, meaning in FROM_THE_BEST.items()
    ]


def outcome_changes(first: Scores, other: Scores) -> Sequence[Sequence[int]]:
    """Count the episodes by outcome of the first (rows) and of the other, both from the best."""
    number = {outcome: row for row, outcome in enumerate(FROM_THE_BEST)}
    table = np.zeros((len(number), len(number)), dtype=np.int64)
    rows = [number[outcome] for outcome in first.outcomes]
    np.add.at(table, (rows, [number[outcome] for outcome in other.outcomes]), 1)
    counts: list[list[int]] = table.tolist()
    return counts


def slice_tables(scores: Named) -> tuple[Sequence[SliceTable], Sequence[str]]:
    """Score parts of the episodes; cuts that make one part are left out.

    Returns
    -------
    tables, notes
        And a note on every cut that the ground truth does not serve.
    """
    tables, notes = [], []
    for slicing in GROUPINGS.values():
        if slicing.key == _OWN_SECTION:
            continue
        try:
            table = slice_table(scores, slicing)
        except GroundTruthError as error:
            notes.append(f"Not cut by {slicing.key}: {error}.")
        else:
            tables += [table] if len(table.rows) > 1 else []
    return tables, notes


def slice_table(scores: Named, slicing: Grouping) -> SliceTable:
    """Score the parts of one cut, with intervals where the scores have them."""
    first, *others = [
        each.breakdown(slicing.key, intervals=each.intervals is not None)
        for each in scores.values()
    ]
    bars = [_bars(table) for table in (first, *others)]
    rows = [
        PartRow(
            name=name,
            episodes=int(episodes),
            success=CATALOGUE["success"].display(success),
            bars=[by_part.get(name) for by_part in bars],
        )
        for name, episodes, success in zip(
            bars[0], first["episodes"], first["success"], strict=True
        )
    ]
    return SliceTable(slicing, rows)


def _bars(table: "pd.DataFrame") -> Mapping[str, Bar]:
    """Take the primary metric from a breakdown, by part."""
    columns = [PRIMARY_METRIC, f"{PRIMARY_METRIC}_low", f"{PRIMARY_METRIC}_high"]
    shown = 100 * table.reindex(columns=columns)
    return dict(zip(map(str, table.index), starmap(Bar, shown.to_numpy().tolist()), strict=True))


def scans_from_the_worst(scores: Named) -> SliceTable:
    """Score the scans, those with the lowest primary metric first; small ones come last."""
    table = slice_table(scores, GROUPINGS[_OWN_SECTION])
    return SliceTable(table.slicing, sorted(table.rows, key=_from_the_worst))


def _from_the_worst(row: PartRow) -> tuple[bool, float, str]:
    bar = row.bars[0]
    return row.episodes < FEW, bar.percent if bar else 0.0, row.name


def passing_notes(scores: Named) -> Sequence[str]:
    """Say how many wrong stops came after the goal had been reached, which OSR counts."""
    notes = []
    for name, each in scores.items():
        wrong_stops = each.failure_modes.counts["correct object at the wrong stop"]
        reached = each.failure_modes.wrong_stops_after_reaching
        if reached:
            of = f" of {name}" if len(scores) > 1 else ""
            notes.append(
                f"{reached:,} of the {wrong_stops:,} episodes{of} with the correct object at the "
                "wrong stop had reached the goal before."
            )
    return notes


def _percent(count: int, of: int) -> str:
    return f"{100 * count / of:.1f}"
