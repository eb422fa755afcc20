"""The results of several methods as papers show them, the best of each column in bold."""

from collections.abc import Mapping, Sequence

from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.tables import (
    MISSING,
    Bold,
    Table,
    metric_cell,
)
from reverie_eval.scoring import Scored

_COLUMNS = ("success", "oracle_success", "spl", "path_length", "rgs", "rgspl")


def results_table(results: Mapping[str, Scored | Sequence[Scored]]) -> Table:
    r"""Return the results of several methods as a table, the best of each column in bold.

    Parameters
    ----------
    results : mapping of Scores or Runs, or of several
        By the name of the method; a method may have scores for several splits. Means over runs
        are shown with their intervals.

    Returns
    -------
    Table
        A notebook shows it; ``to_latex()``, ``to_markdown()``, ``to_html()``, ``to_csv()`` and
        ``to_text()`` return it for other places.

    Raises
    ------
    ProtocolError
        If there are no scores, or they are not comparable.

    Examples
    --------
    >>> from reverie_eval import evaluate
    >>> samples = {"first": "mediocre", "second": "good"}
    >>> results = {
    ...     name: evaluate(f"demo/{sample}.json", split="val_unseen")
    ...     for name, sample in samples.items()
    ... }
    >>> print("\n".join(results_table(results).to_markdown().splitlines()[:4]))
    | Method | SR | OSR | SPL | TL | RGS | RGSPL |
    | :--- | ---: | ---: | ---: | ---: | ---: | ---: |
    | first | 41.67 | 55.95 | 35.89 | 8.72 | 40.48 | 34.52 |
    | second | **80.95** | **88.10** | **72.88** | 9.84 | **65.48** | **57.22** |
    """
    by_method = {name: _by_split(name, scores) for name, scores in results.items()}
    every = [scores for by_split in by_method.values() for scores in by_split.values()]
    _check_comparable(every)
    splits = list(dict.fromkeys(scores.split for scores in every))
    metrics = [CATALOGUE[key] for key in _COLUMNS if any(key in scores for scores in every)]
    return methods_table(
        {
            name: [by_split.get(split, {}) for split in splits]
            for name, by_split in by_method.items()
        },
        [split.replace("_", " ").capitalize() for split in splits],
        metrics,
        _caption(every, metrics),
    )


def methods_table(
    methods: Mapping[str, Sequence[Mapping[str, float]]],
    groups: Sequence[str],
    metrics: Sequence[Metric],
    caption: str,
) -> Table:
    """Return a table with a row per method and the same metrics for each group of columns.

    ``methods`` has, by the name of the method, for each group its values by metric key; the caption
    says what the numbers depend on, so that a reader can reproduce them.
    """
    columns = [
        _column(metric, [groups_of_one[number] for groups_of_one in methods.values()])
        for number in range(len(groups))
        for metric in metrics
    ]
    return Table(
        headings=["Method", *[metric.label for metric in metrics] * len(groups)],
        rows=[list(row) for row in zip(methods, *columns, strict=True)],
        text_columns=frozenset({0}),
        groups=groups,
        caption=caption,
    )


def _column(metric: Metric, values: Sequence[Mapping[str, float]]) -> Sequence[str]:
    """Return the cells of a column, the best in bold, means over runs with their intervals.

    Digits that are not shown do not count: of equal best cells, all are bold.
    """
    intervals = [_interval(metric, it) for it in values]
    return [
        Bold(cell + interval) if isinstance(cell, Bold) else cell + interval
        for cell, interval in zip(_means(metric, values), intervals, strict=True)
    ]


def _interval(metric: Metric, values: Mapping[str, float]) -> str:
    """Return a mean's interval over runs, as it is shown after the mean.

    By its ends: it need not be symmetric, and papers write a standard deviation after ±.
    """
    from reverie_eval.analysis import Runs  # not imported for scores alone

    if not isinstance(values, Runs) or metric.key not in values:
        return ""
    interval = values.intervals[metric.key]
    return f" ({metric.display(interval.low)} to {metric.display(interval.high)})"


def _means(metric: Metric, values: Sequence[Mapping[str, float]]) -> Sequence[str]:
    cells = [metric_cell(metric, it) for it in values]
    shown = [float(cell) for cell in cells if cell != MISSING]
    # One method is not the best of one.
    if metric.better == "neither" or len(shown) < 2:
        return cells
    best = max(shown) if metric.better == "higher" else min(shown)
    return [Bold(cell) if cell != MISSING and float(cell) == best else cell for cell in cells]


def _by_split(name: str, scores: Scored | Sequence[Scored]) -> Mapping[str, Scored]:
    several = [scores] if isinstance(scores, Scored) else scores
    by_split = {each.split: each for each in several}
    if len(by_split) < len(several):
        raise ProtocolError(f"{name} has two scores of the same split; give each a name of its own")
    return by_split


def _check_comparable(every: Sequence[Scored]) -> None:
    if not every:
        raise ProtocolError("a results table needs the scores of at least one method")
    scored_under = {
        (each.protocol.name, each.qualifier, each.ground_truth.header.dataset) for each in every
    }
    signatures = sorted({each.signature for each in every})
    # Two splits have two signatures, but not more.
    if len(scored_under) > 1 or len(signatures) > len({each.split for each in every}):
        raise ProtocolError(f"these scores are not comparable: {', '.join(signatures)}")


def _caption(every: Sequence[Scored], metrics: Sequence[Metric]) -> str:
    from reverie_eval.analysis import Runs

    truth = every[0].ground_truth
    world = "the synthetic demo world" if truth.is_demo else truth.header.dataset
    # A caption stands alone: it says the units, because the headings have none.
    lengths = [metric.label for metric in metrics if metric.unit == "metres"]
    unit = f"{lengths[0]} in metres, all else in percent" if lengths else "In percent"
    parts = [dict(part.split(":", 1) for part in each.signature.split("|")) for each in every]
    data = {
        it["split"]: f"{it['split']} {it['data']} ({it['n']} episodes"
        + (f" of subset {it['subset']})" if "subset" in it else ")")
        for it in parts
    }
    protocol = " ".join(filter(None, (parts[0]["protocol"], every[0].qualifier)))
    captions = dict.fromkeys(each.intervals.caption for each in every if isinstance(each, Runs))
    spread = "".join(f" In parentheses: {each}." for each in captions)
    return (
        f"Results on {world}. {unit}; the best of each column in bold.{spread} Scored by "
        f"reverie-eval {parts[0]['version']}, protocol {protocol}; "
        f"data: {', '.join(data.values())}."
    )
