"""Sweeps in each of the formats: a row per checkpoint or setting, and which was chosen."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

from reverie_eval.analysis import Runs, Sweep
from reverie_eval.reporting.results import results_table
from reverie_eval.reporting.scores import runs_table, score_table, table_of_scores
from reverie_eval.reporting.tables import MARK, Part, Printout, Table
from reverie_eval.scoring import Scored, Scores


def sweep_printout(sweep: Sweep) -> Printout:
    """Return the rows of a sweep in each format."""
    return Printout.of_table(
        lambda: sweep_table(sweep),
        json=lambda: json.dumps(_as_json(sweep), indent=2),
        csv=lambda: _csv_table(sweep).to_csv(),
    )


def selection_printout(sweep: Sweep, reported: Scored) -> Printout:
    """Return the rows that were chosen from on one split, and the best of them on another."""

    def parts() -> Sequence[Part]:
        chosen_from = replace(sweep_table(sweep), findings=[])
        table = (
            runs_table(reported)
            if isinstance(reported, Runs)
            else score_table([cast("Scores", reported)])
        )
        findings = [_answer(sweep, reported), *_cautions(sweep, f"report {reported.split} alone")]
        files = f"files: {sweep.best_pattern.replace('{split}', reported.split)}"
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
    return Printout(parts, as_json, lambda: _csv_table(sweep).to_csv(), papers)


def sweep_table(sweep: Sweep) -> Table:
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


def _answer(sweep: Sweep, reported: Scored) -> str:
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


def _cautions(sweep: Sweep, remedy: str) -> Sequence[str]:
    return [f"caution: {sweep.caution}; {remedy}"] if sweep.caution else []


def _as_json(sweep: Sweep) -> Mapping[str, Any]:
    keys = [metric.key for metric in sweep.metrics]
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
                "scores": {key: sweep.mean(name, key) for key in keys},
            }
            for name, runs in sweep.rows.items()
        ],
    }


def _csv_table(sweep: Sweep) -> Table:
    """Return unrounded means by the keys of their metrics."""
    names, *_ = sweep.fields.values()
    keys = [metric.key for metric in sweep.metrics]
    return Table(
        [*names, "runs", *keys, "signature"],
        [
            [
                *sweep.fields[name].values(),
                str(len(runs)),
                *(str(sweep.mean(name, key)) for key in keys),
                sweep.first.signature,
            ]
            for name, runs in sweep.rows.items()
        ],
    )
