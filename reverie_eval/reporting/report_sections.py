"""The sections of a report as words, numbers and charts; a template lays them out."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from reverie_eval.analysis import GROUPINGS, Comparison, Grouping, logged
from reverie_eval.errors import ProtocolError
from reverie_eval.logs import cost_name
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.charts import Histogram, WalkLengths, budget_chart
from reverie_eval.reporting.comparisons import cost_notes, cost_table
from reverie_eval.reporting.resources import as_markup
from reverie_eval.reporting.tables import metric_cell
from reverie_eval.scoring import OUTCOMES, Clustering, FailureModes, Scores, shared_keys
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from markupsafe import Markup

BEST_OUTCOME_FIRST: Mapping[str, str] = MappingProxyType(dict(reversed(list(OUTCOMES.items()))))
"""The outcomes with their meanings, in the order of a report."""
FEW_EPISODES = 10
"""Scans with fewer episodes are listed last: a low score may be chance."""

Submissions = Mapping[str, Scores]
"""The submissions of a report by name; the report is about the first."""


@dataclass(frozen=True, slots=True)
class ScoreCell:
    """A metric's mean, with its interval if there is one."""

    metric: Metric
    value: str
    interval: str
    is_primary: bool


@dataclass(frozen=True, slots=True)
class Bar:
    """A value as it is shown, with the ends of its interval; NaN where there is none."""

    value: float
    low: float = math.nan
    high: float = math.nan
    full: float = 100.0
    """The value of a bar of full length."""

    def percent(self, value: float) -> float:
        """Return where a value is on the bar, in percent of its full length."""
        # The end of an interval may be beyond the longest bar.
        return min(max(100 * value / self.full, 0.0), 100.0)

    @property
    def interval(self) -> str:
        """The interval in words; empty if there is none."""
        return "" if math.isnan(self.low) else f"{self.low:.1f} to {self.high:.1f}"


@dataclass(frozen=True, slots=True)
class Share:
    """A number of episodes."""

    count: int
    percent: float
    """Percent of all episodes."""
    of_previous: str = ""
    """Percent of the funnel's previous stage, as text."""

    @property
    def bar(self) -> Bar:
        """The share as a bar."""
        return Bar(self.percent)


@dataclass(frozen=True, slots=True)
class CountRow:
    """The episodes of a stage or an outcome."""

    name: str
    meaning: str
    shares: Sequence[Share]
    """The shares by submission."""


@dataclass(frozen=True, slots=True)
class GroupRow:
    """A group of episodes: its size, the first submission's success, and each primary metric.

    Success is missing if the track does not score it.
    """

    name: str
    episodes: int
    success: str | None
    bars: Sequence[Bar | None]
    """The primary metric by submission; None if the submission has no episode in the group."""


@dataclass(frozen=True, slots=True)
class Breakdown:
    """The scores of all groups of a grouping."""

    grouping: Grouping
    rows: Sequence[GroupRow]


@dataclass(frozen=True)
class CaptionedChart:
    """A distribution with its caption."""

    picture: "Markup"
    title: str
    caption: str


def score_rows(scores: Submissions) -> Mapping[str, Sequence[ScoreCell]]:
    """Return the headline metrics of every submission."""
    # The second submission may have metrics that the first lacks.
    metrics = list(dict.fromkeys(metric for each in scores.values() for metric in each.headline))
    return {
        name: [_score_cell(metric, each) for metric in metrics] for name, each in scores.items()
    }


def _score_cell(metric: Metric, scores: Scores) -> ScoreCell:
    interval = scores.intervals and scores.intervals.get(metric.key)
    ends = [interval.low, interval.high] if interval else []
    between = " to ".join(map(metric.display, ends))
    is_primary = metric == scores.ground_truth.task.primary_metric(scores.keys())
    return ScoreCell(metric, metric_cell(metric, scores), between, is_primary)


def shared_primary(scores: Submissions) -> Metric:
    """Return the metric to rank submissions by, among those that all of them have."""
    task = next(iter(scores.values())).ground_truth.task
    return task.primary_metric(shared_keys(scores.values()))


def has_walks(scores: Submissions) -> bool:
    """Whether navigation is scored, as it is on the full track."""
    return all("success" in each for each in scores.values())


def has_outcomes(scores: Submissions) -> bool:
    """Whether episodes have outcomes, which need both navigation and an answer."""
    return has_walks(scores) and all("rgs" in each for each in scores.values())


def main_finding(scores: Scores) -> str:
    """Say in a sentence or two how often the agent succeeds, and how it mostly fails."""
    total = len(scores.instr_ids)
    if "success" not in scores:
        correct = int(scores.episodes["rgs"].sum())
        share = f"{correct:,} of {total:,} answers from the goal ({_percent(correct, total)} %)"
        return f"{share} are correct."
    if "rgs" not in scores:
        reached = int(scores.episodes["success"].sum())
        share = f"{reached:,} of {total:,} episodes ({_percent(reached, total)} %)"
        answers = "; answers are not scored" if scores.ground_truth.task.has_targets else ""
        return f"{share} stopped at the goal{answers}."
    counts = scores.failure_modes.counts
    correct, wrong = counts["correct"], total - counts["correct"]
    share = f"{correct:,} of {total:,} episodes ({_percent(correct, total)} %)"
    success = f"{share} {OUTCOMES['correct']}."
    if not wrong:
        return success
    failures = {outcome: count for outcome, count in counts.items() if outcome != "correct"}
    worst = max(failures, key=lambda outcome: failures[outcome])
    most = f"{failures[worst]:,} of the other {wrong:,} ({_percent(failures[worst], wrong)} %)"
    return f"{success} Most common failure: {most} {OUTCOMES[worst]}."


def funnel_rows(modes: Sequence[FailureModes]) -> Sequence[CountRow]:
    """Count the episodes of every stage of the progress funnel, by submission."""
    funnels = [each.funnel for each in modes]
    stages = list(funnels[0])
    first, rows = stages[0], []
    # The first stage is all episodes, and compared with itself.
    for stage, previous in zip(stages, [first, *stages], strict=False):
        shares = []
        for funnel in funnels:
            count, before = funnel[stage], funnel[previous]
            of_previous = f"{_percent(count, before)} %" if before else "-"
            shares.append(Share(count, 100 * count / max(funnel[first], 1), of_previous))
        rows.append(CountRow(stage, "", shares))
    return rows


def outcome_rows(modes: Sequence[FailureModes]) -> Sequence[CountRow]:
    """Count the episodes of every outcome by submission, the best outcome first."""
    totals = [max(sum(each.counts.values()), 1) for each in modes]
    rows = []
    for outcome, meaning in BEST_OUTCOME_FIRST.items():
        counts = [each.counts[outcome] for each in modes]
        shares = [Share(it, 100 * it / total) for it, total in zip(counts, totals, strict=True)]
        rows.append(CountRow(outcome, meaning, shares))
    return rows


def outcome_changes(first: Scores, other: Scores) -> Sequence[Sequence[int]]:
    """Count the episodes by their outcomes for the first (rows) and the other (columns)."""
    index = {outcome: row for row, outcome in enumerate(BEST_OUTCOME_FIRST)}
    table = np.zeros((len(index), len(index)), dtype=np.int64)
    rows = [index[outcome] for outcome in first.outcomes]
    # `table[rows, columns] += 1` would count a pair that occurs several times once.
    np.add.at(table, (rows, [index[outcome] for outcome in other.outcomes]), 1)
    counts: list[list[int]] = table.tolist()
    return counts


def goal_reached_notes(scores: Submissions) -> Sequence[str]:
    """Say how many wrong stops came after the goal had been reached, which OSR counts."""
    notes = []
    for name, each in scores.items():
        wrong_stops = each.failure_modes.counts["correct object at the wrong stop"]
        reached = each.failure_modes.wrong_stops_after_reaching
        if reached:
            notes.append(
                f"{reached:,} of the {wrong_stops:,} episodes{_of(name, scores)} with the correct "
                "object at the wrong stop had reached the goal before."
            )
    return notes


def breakdowns(scores: Submissions) -> tuple[Sequence[Breakdown], Sequence[str]]:
    """Score groups of episodes by every grouping but the scan.

    Groupings with a single group are left out; for any other that is missing, a note says why.
    """
    tables, notes = [], []
    for grouping in GROUPINGS.values():
        if grouping.key == "scan":  # has a section of its own
            continue
        try:
            table = breakdown_by(scores, grouping)
        except ProtocolError as error:
            notes.append(f"No breakdown by {grouping.key}: {error}.")
        else:
            tables += [table] if len(table.rows) > 1 else []
    return tables, notes


def breakdown_by(scores: Submissions, grouping: Grouping) -> Breakdown:
    """Score the groups of a grouping, with intervals where the scores have them."""
    frames = [
        each.breakdown(
            grouping.key,
            intervals=each.intervals is not None,
            confidence=None if each.intervals is None else each.intervals.confidence,
        )
        for each in scores.values()
    ]
    primary = shared_primary(scores)
    columns = [primary.key, f"{primary.key}_low", f"{primary.key}_high"]
    # `reindex` adds columns of NaN where the scores have no intervals.
    tables = [(primary.scale * frame.reindex(columns=columns)).to_numpy() for frame in frames]
    # Lengths have no natural end: the longest bar is full. At least 1, which 0 can be divided by.
    full = (
        100.0 if primary.unit == "fraction" else max(float(np.nanmax(np.concatenate(tables))), 1.0)
    )
    bars: list[Mapping[str, Bar]] = [
        {
            str(group): Bar(value, low, high, full)
            for group, (value, low, high) in zip(frame.index, table.tolist(), strict=True)
        }
        for frame, table in zip(frames, tables, strict=True)
    ]
    first = frames[0]
    rows = [
        GroupRow(
            name=name,
            episodes=int(row["episodes"]),
            success=CATALOGUE["success"].display(row["success"]) if "success" in row else None,
            bars=[by_group.get(name) for by_group in bars],
        )
        for name, row in zip(bars[0], first.to_dict("records"), strict=True)
    ]
    return Breakdown(grouping, rows)


def scans_worst_first(scores: Submissions) -> Breakdown:
    """Score the scans, the lowest primary metric first; those with few episodes come last."""

    def order(row: GroupRow) -> tuple[bool, float, str]:
        bar = row.bars[0]
        return row.episodes < FEW_EPISODES, bar.value if bar else 0.0, row.name

    scans = breakdown_by(scores, GROUPINGS["scan"])
    return Breakdown(scans.grouping, sorted(scans.rows, key=order))


@dataclass(frozen=True)
class Costs:
    """What an episode cost in the runs that have a log, and what a budget buys."""

    names: Sequence[str]
    table: "Markup"
    chart: CaptionedChart | None
    notes: Sequence[str]


def costs(scores: Submissions, comparison: Comparison | None, cluster: Clustering) -> Costs | None:
    """Return the costs of runs; None if no submission has the log of one."""
    runs = logged(scores)
    if not runs:
        return None
    table = as_markup(cost_table(runs).to_html())
    notes = [] if comparison is None else list(cost_notes(comparison))
    try:
        curves = {name: each.success_within(cluster=cluster) for name, each in runs.items()}
    except ProtocolError as error:
        return Costs(list(runs), table, None, [*notes, f"no success within a budget: {error}"])
    first = next(iter(curves.values()))
    chart = CaptionedChart(
        as_markup(budget_chart(curves).svg()),
        f"{first.metric.label} within a budget",
        f"Share of all episodes that were solved ({first.metric.name}) at a cost of at most the "
        f"budget, in {cost_name(first.cost)}. {first.label} intervals, each of its budget alone.",
    )
    return Costs(list(runs), table, chart, notes)


def charts(scores: Submissions) -> Iterator[CaptionedChart]:
    """Draw lengths and distances of walks, and overlaps of boxes, if they are scored."""
    if has_walks(scores):
        yield from _walk_charts(scores)
    yield from _box_charts(scores)


def _walk_charts(scores: Submissions) -> Iterator[CaptionedChart]:
    (name, first), *_ = scores.items()
    # The first submission alone: dots of two would cover each other.
    walks = WalkLengths.of(first)
    hidden = int((~walks.is_shown).sum())
    longer = f" Not shown: {count_text(hidden, 'longer walk')}." if hidden else ""
    yield CaptionedChart(
        as_markup(walks.chart(walks.longest_shown).svg()),
        f"Walked and shortest length{_of(name, scores)}",
        "A dot for each episode, blue where the agent stopped at the goal. On the dashed line it "
        f"walked the shortest length; {_percent(walks.is_detour.sum(), len(walks.walked))} % are "
        f"above it.{longer}",
    )
    stops = Histogram.of(scores, "navigation_error")
    at_end = (first.episodes["navigation_error"] == 0).sum()
    yield CaptionedChart(
        as_markup(stops.chart(list(scores)).svg()),
        "Distance at stop",
        f"Metres from the stop to the end of the annotated path: {_medians(stops, scores)}. "
        f"{_percent(at_end, len(first.instr_ids))} % of episodes{_of(name, scores)} stop exactly "
        "there.",
    )


def _box_charts(scores: Submissions) -> Iterator[CaptionedChart]:
    boxes = {name: each.boxes for name, each in scores.items() if each.boxes is not None}
    if boxes:
        overlaps = Histogram.of({name: scores[name] for name in boxes}, "iou")
        correct = [
            f"{_percent(each.is_correct.sum(), len(each))} % of {len(each):,} boxes"
            f"{_of(name, scores)}"
            for name, each in boxes.items()
        ]
        yield CaptionedChart(
            as_markup(overlaps.chart(list(scores)).svg()),
            "Overlap of boxes",
            f"IoU of predicted boxes with the target's box: {_medians(overlaps, scores)}. "
            f"{' and '.join(correct)} reach 50 % and are correct.",
        )


def _medians(histogram: Histogram, scores: Submissions) -> str:
    metric = histogram.metric
    unit = f" {metric.suffix}".rstrip()
    return ", ".join(
        f"median{_of(name, scores)} {metric.display(float(np.median(values)))}{unit}"
        for name, values in histogram.values.items()
    )


def _of(name: str, scores: Submissions) -> str:
    """Name the submission if there are two."""
    return f" of {name}" if len(scores) > 1 else ""


def _percent(count: int, of: int) -> str:
    return f"{100 * count / of:.1f}"
