"""Scores as tables in each of the formats: of a file, of several files, of runs, of sweeps."""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TextIO, cast

import numpy as np

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.results import results_table
from reverie_eval.reporting.tables import (
    MARK,
    MISSING,
    Part,
    Printout,
    Table,
    cell_of,
    metric_cell,
    metric_cells,
)
from reverie_eval.scoring import Scored, ScoredFiles, Scores
from reverie_eval.submissions import submission_names

if TYPE_CHECKING:
    from reverie_eval.analysis import Runs, Sweep

_DUE_TO_RUNS = (
    "due to runs: the part of the mean's variance that more runs would reduce; the rest is due to "
    "the choice of episodes"
)
# A row's name, its value for a metric, and how the value is shown.
_Row = tuple[str, Callable[[Metric], float], Callable[[Metric, float], str]]


def scores_printout(results: Sequence[Scores]) -> Printout:
    """Return a submission's scores by one or several protocols in each format."""

    def as_json() -> str:
        reports = [scores.to_report().model_dump_json(indent=2) for scores in results]
        return reports[0] if len(reports) == 1 else "[\n" + ",\n".join(reports) + "\n]"

    def as_csv() -> str:
        keys = results[0].ground_truth.task.metrics
        bounds = [f"{key}_{end}" for key in keys for end in ("low", "high")]
        columns = [*keys, *bounds] if results[0].intervals else keys
        return _csv([], columns, (([], it.to_dict(), [it.signature]) for it in results))

    def table() -> Table:
        wide = score_table(results)
        return replace(wide, narrow=wide.stacked())

    return Printout.of_table(table, json=as_json, csv=as_csv)


def score_table(results: Sequence[Scores]) -> Table:
    """Return a submission's scores, a row per protocol, and two more for interval bounds.

    With more than one row, a first column names them, and values that differ from the first
    protocol's are marked. In a task of several languages, a single protocol's scores have a row
    for each of them below.
    """
    first = results[0]
    metrics = first.ground_truth.task.table_metrics(first.keys())
    has_several = len(results) > 1
    # Rows of languages and of protocols at once would be a table of tables.
    by_language = [] if has_several else list(_language_rows(first, metrics))
    has_names = has_several or first.intervals is not None or bool(by_language)
    named = [row for scores in results for row in _rows(scores, first, metrics)] + by_language
    # The mark is explained only where there is one.
    is_marked = any(cell.endswith(MARK) for _, *cells in named for cell in cells)
    return table_of_scores(
        first,
        ["protocol" if has_several else ""] if has_names else [],
        metrics,
        named if has_names else [cells for _, *cells in named],
        about=[
            *([f"{MARK} differs from {_name(first)}", ""] if is_marked else []),
            *(scores.signature for scores in results),
            *([] if first.intervals is None else [first.intervals.caption]),
        ],
        notes=[f"note: {note}" for note in _notes(results)],
    )


def ranking_printout(scored: ScoredFiles) -> Printout:
    """Return a ranking in each format: a row per file, best first."""

    def as_json() -> str:
        reports = [
            f"{json.dumps(file)}: {scores.to_report().model_dump_json(indent=2)}"
            for file, scores in scored.items()
        ]
        return "{\n" + ",\n".join(reports) + "\n}"

    def as_csv() -> str:
        rows = (
            ([file, scores.split, scores.protocol.name], scores, [scores.signature])
            for file, scores in scored.items()
        )
        keys = next(iter(scored.values())).ground_truth.task.metrics
        return _csv(["file", "split", "protocol"], keys, rows)

    return Printout.of_table(lambda: ranking_table(scored), json=as_json, csv=as_csv)


def ranking_table(scored: ScoredFiles) -> Table:
    """Return a row per file, best first, named by the part of its path that identifies it."""
    names = dict(zip(scored, submission_names(list(scored)), strict=True))
    return table_of_scores(
        next(iter(scored.values())),
        ["rank", "file"],
        scored.metrics,
        [
            [cell_of(rank), names[file], *metric_cells(scored.metrics, scored[file])]
            for file, rank in scored.ranks.items()
        ],
        notes=list(_notes_of_files(scored, names)),
    )


def runs_printout(name: str, runs: "Runs") -> Printout:
    """Return the runs of a method, and their mean, in each format."""

    def as_csv() -> str:
        keys = runs.ground_truth.task.metrics
        summary = [
            (label, {key: value(CATALOGUE[key]) for key in keys if key in runs})
            for label, value, _ in _rows_below(runs)
        ]
        named: list[tuple[str, Mapping[str, float]]] = [*runs.runs.items(), *summary]
        about = [runs.signature, runs.intervals.caution]
        rows = (([label], values, about) for label, values in named)
        return _csv(["run"], keys, rows, ["signature", "caution"])

    return Printout.of_table(
        lambda: runs_table(runs),
        json=lambda: runs.to_report().model_dump_json(indent=2),
        csv=as_csv,
        papers={"latex": lambda: results_table({name: runs})},
    )


def runs_table(runs: "Runs") -> Table:
    """Return a row per run, and below them the mean, its interval and its variance."""
    metrics = runs.ground_truth.task.table_metrics(runs.keys())
    shown = [m for m in metrics if m.key in runs]
    each_run = [[name, *metric_cells(shown, scores)] for name, scores in runs.runs.items()]
    summary = [
        [name, *(text(m, value(m)) for m in shown)] for name, value, text in _rows_below(runs)
    ]
    return table_of_scores(
        runs,
        [""],
        shown,
        [*each_run, [""] * (1 + len(shown)), *summary],
        about=[runs.signature, runs.intervals.caption, _DUE_TO_RUNS],
        notes=[f"note on {note}" for note in runs.notes],
    )


def table_of_scores(
    first: Scored,
    names: Sequence[str],
    metrics: Sequence[Metric],
    rows: Sequence[Sequence[str]],
    *,
    further: Sequence[str] = (),
    about: Sequence[str] | None = None,
    notes: Sequence[str] = (),
    findings: Sequence[str] = (),
) -> Table:
    """Return a table of scores with a column per metric, and below it what they depend on.

    Parameters
    ----------
    first : Scores or Runs
        The scores whose ground truth all rows share.
    names, further : sequences of str
        Headings of the columns before and after those of the metrics. The last one of ``names`` is
        aligned to the left.
    about : sequence of str, optional
        Notes above the one on the ground truth; the signature if not given.
    notes, findings : sequences of str
        Notes below the one on the ground truth, and :attr:`Table.findings`.
    """
    truth = first.ground_truth
    return Table(
        headings=[*names, *(metric.heading for metric in metrics), *further],
        rows=rows,
        text_columns=frozenset({len(names) - 1} if names else ()),
        findings=findings,
        notes=[
            *([first.signature] if about is None else about),
            f"ground truth: {truth.provenance}",
            *notes,
        ],
        task=truth.task,
    )


def _csv(
    names: Sequence[str],
    keys: Iterable[str],
    rows: Iterable[tuple[Sequence[str], Mapping[str, float], Sequence[str]]],
    further: Sequence[str] = ("signature",),
) -> str:
    """Return unrounded values by the keys of their metrics, between columns of text.

    A cell is empty where a value is missing.
    """
    # They are gone through once for each row.
    keys = list(keys)
    cells = [
        [*before, *(str(values.get(key, "")) for key in keys), *after]
        for before, values, after in rows
    ]
    return Table([*names, *keys, *further], cells).to_csv()


def _rows_below(runs: "Runs") -> Iterator[_Row]:
    """Yield the rows below those of the runs."""
    intervals, display = runs.intervals, Metric.display
    yield "mean", lambda metric: runs[metric.key], display
    yield f"{intervals.label} low", lambda metric: intervals[metric.key].low, display
    yield f"{intervals.label} high", lambda metric: intervals[metric.key].high, display
    yield "standard deviation", lambda metric: runs.deviation(metric.key), display
    yield "due to runs", lambda metric: intervals.run_shares[metric.key], _percent


def _percent(_: Metric, share: float) -> str:
    return f"{100 * share:.0f} %"


def _rows(scores: Scores, first: Scores, metrics: Sequence[Metric]) -> Iterator[Sequence[str]]:
    """Yield the named row of the means and, if there are intervals, those of their bounds."""
    yield [_name(scores), *(_mean(metric, scores, first) for metric in metrics)]
    if scores.intervals is None:
        return
    for end in ("low", "high"):
        bounds = [getattr(scores.intervals.get(metric.key), end, None) for metric in metrics]
        cells = (cell_of(bound, it.display) for it, bound in zip(metrics, bounds, strict=True))
        yield [f"{scores.intervals.label} {end}", *cells]


def _language_rows(scores: Scores, metrics: Sequence[Metric]) -> Iterator[Sequence[str]]:
    """Yield an empty row and the means over the instructions of each language, if it has some."""
    if not scores.ground_truth.episodes.languages:
        return
    from reverie_eval.analysis import GROUPINGS

    grouping = GROUPINGS["language"]
    slices = [{group, *grouping.wider(group)} for group in grouping.groups(scores)]
    _, *languages = grouping.order  # all of them are the rows above
    yield [""] * (1 + len(metrics))
    for language in languages:
        is_in = np.array([language in each for each in slices])
        if is_in.any():
            values = (metric.mean(scores.episodes[metric.key][is_in]) for metric in metrics)
            shown = (it.display(value) for it, value in zip(metrics, values, strict=True))
            yield [language, *shown]


def _mean(metric: Metric, scores: Scores, first: Scores) -> str:
    value = metric_cell(metric, scores)
    # As shown, not as computed: digits that nobody sees make no difference.
    return value if value in (MISSING, metric_cell(metric, first)) else value + MARK


def _notes(results: Sequence[Scores]) -> Iterable[str]:
    """Return each note once; notes on other readings than the first result's would be ambiguous."""
    alike = (scores for scores in results if scores.qualifier == results[0].qualifier)
    return dict.fromkeys(note for scores in alike for note in scores.notes)


def _notes_of_files(scored: ScoredFiles, names: Mapping[str, str]) -> Iterator[str]:
    """Yield each note once, with the file that has it, or the number of files."""
    files: dict[str, list[str]] = {}
    for file, scores in scored.items():
        for note in scores.notes:
            files.setdefault(note, []).append(names[file])
    for note, noted in files.items():
        whose = noted[0] if len(noted) == 1 else f"{len(noted):,} files"
        yield f"note on {whose}: {note}"


def _name(scores: Scores) -> str:
    return " ".join(filter(None, (scores.protocol.name, scores.qualifier)))


# A row for each episode.


def write_episodes(scores: Scores, file: TextIO) -> None:
    """Write a row per episode as CSV: metrics and costs, unrounded, outcome, scan and instruction.

    Columns are those of ``scores.to_pandas()``.
    """
    import csv

    columns = {**_columns(scores), **scores.texts}
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["instr_id", *columns])
    writer.writerows(zip(scores.instr_ids, *columns.values(), strict=True))


def episode_table(scores: Scores) -> Table:
    """Return the score table's metrics for every episode, a row each."""
    metrics = scores.ground_truth.task.table_metrics(scores.keys())
    metrics = [metric for metric in metrics if metric.key in scores]
    columns = [map(metric.display, scores.episodes[metric.key].tolist()) for metric in metrics]
    return Table(
        headings=["instr_id", *(metric.heading for metric in metrics)],
        rows=list(zip(scores.instr_ids, *columns, strict=True)),
        text_columns=frozenset({0}),
        notes=[scores.signature],
    )


def episodes_json(scores: Scores) -> str:
    """Return every metric of every episode as JSON, unrounded, with the signature."""
    columns = _columns(scores)
    episodes = [
        dict(zip(("instr_id", *columns), row, strict=True))
        for row in zip(scores.instr_ids, *columns.values(), strict=True)
    ]
    return json.dumps({"signature": scores.signature, "episodes": episodes}, indent=1)


def _columns(scores: Scores) -> dict[str, Sequence[Any]]:
    """Return the values of every episode by metric and cost; None where an episode has none."""
    return {
        key: [None if math.isnan(value) else value for value in column.tolist()]
        for key, column in {**scores.episodes, **scores.costs}.items()
    }


# Sweeps.


def sweep_printout(sweep: "Sweep") -> Printout:
    """Return the rows of a sweep in each format."""
    return Printout.of_table(
        lambda: sweep_table(sweep),
        json=lambda: json.dumps(_as_json(sweep), indent=2),
        csv=lambda: _sweep_csv(sweep),
    )


def selection_printout(sweep: "Sweep", reported: Scored) -> Printout:
    """Return the rows that were chosen from on one split, and the best of them on another."""
    from reverie_eval.analysis import SPLIT_FIELD, Runs  # not imported for files alone

    def parts() -> Sequence[Part]:
        chosen_from = replace(sweep_table(sweep), findings=[])
        table = (
            runs_table(reported)
            if isinstance(reported, Runs)
            else score_table([cast("Scores", reported)])
        )
        findings = [_selected(sweep, reported), *_cautions(sweep, f"report {reported.split} alone")]
        files = f"files: {sweep.best_pattern.replace(SPLIT_FIELD, reported.split)}"
        told = replace(table, findings=findings, notes=[*table.notes, files])
        return [
            Part([chosen_from], f"Selection on {sweep.split}"),
            Part([told], f"Report on {reported.split}"),
        ]

    def as_json() -> str:
        report = reported.to_report().model_dump(mode="json")
        return json.dumps({"selection": _as_json(sweep), "report": report}, indent=2)

    def paper_table() -> Table:
        return results_table({sweep.best: reported})

    papers = dict.fromkeys(("markdown", "latex"), paper_table)
    return Printout(parts, as_json, lambda: _sweep_csv(sweep), papers)


def sweep_table(sweep: "Sweep") -> Table:
    """Return a row per checkpoint or setting with its means over seeds, the best marked."""
    names, *_ = sweep.fields.values()
    return table_of_scores(
        sweep.first,
        [*names, "runs"],
        sweep.metrics,
        [
            [
                *sweep.fields[name].values(),
                str(len(runs)),
                *(
                    metric.display(sweep.mean(name, metric.key))
                    + MARK * (name == sweep.best and metric is sweep.primary)
                    for metric in sweep.metrics
                ),
            ]
            for name, runs in sweep.rows.items()
        ],
        findings=[sweep.sentence, *_cautions(sweep, "report another split")],
        notes=[f"note: {note}" for note in sweep.notes],
    )


def _selected(sweep: "Sweep", reported: Scored) -> str:
    from reverie_eval.analysis import Runs

    metric = sweep.primary
    value = metric.display(reported[metric.key])
    runs = f", the mean of {len(reported.runs)} runs" if isinstance(reported, Runs) else ""
    told = (
        f"{sweep.best}, chosen on {sweep.split}: {metric.label} {value} on {reported.split}{runs}"
    )
    if reported.intervals is None:
        return told
    ends = reported.intervals[metric.key]
    low, high = metric.display(ends.low), metric.display(ends.high)
    return f"{told}, {reported.intervals.label} interval {low} to {high}"


def _cautions(sweep: "Sweep", remedy: str) -> Sequence[str]:
    return [f"caution: {sweep.caution}; {remedy}"] if sweep.caution else []


def _as_json(sweep: "Sweep") -> Mapping[str, Any]:
    return {
        "signature": sweep.first.signature,
        "metric": sweep.primary.key,
        "best": sweep.best,
        "pattern": sweep.best_pattern,
        "candidates": len(sweep.candidates),
        "excess": sweep.excess,
        "rows": [
            {
                "name": name,
                "fields": sweep.fields[name],
                "runs": list(runs),
                "scores": _means(sweep, name),
            }
            for name, runs in sweep.rows.items()
        ],
    }


def _sweep_csv(sweep: "Sweep") -> str:
    """Return unrounded means by the keys of their metrics."""
    names, *_ = sweep.fields.values()
    rows = (
        (
            [*sweep.fields[name].values(), str(len(runs))],
            _means(sweep, name),
            [sweep.first.signature],
        )
        for name, runs in sweep.rows.items()
    )
    return _csv([*names, "runs"], [metric.key for metric in sweep.metrics], rows)


def _means(sweep: "Sweep", name: str) -> Mapping[str, float]:
    """Return the means of a row, unrounded, by the keys of their metrics."""
    return {metric.key: sweep.mean(name, metric.key) for metric in sweep.metrics}
