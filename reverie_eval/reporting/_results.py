"""Results of several methods side by side, as a paper shows them: LaTeX, and Markdown.

A row per method, and for each split the columns of the REVERIE paper's results table (Qi et al.,
CVPR 2020) and RGSPL, by which the benchmark has ranked since.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting._latex import escaped, table_row
from reverie_eval.reporting._tables import NOT_SCORED
from reverie_eval.scoring import Scores

_COLUMNS = ("success", "oracle_success", "spl", "path_length", "rgs", "rgspl")


@dataclass(frozen=True, slots=True)
class Cell:
    """A value in words."""

    text: str
    is_best: bool = False
    """Whether no other method shows a better value in this column, though one may show the same."""


@dataclass(frozen=True, slots=True, repr=False)
class ResultsTable:
    """A table of results; a notebook shows it as it is."""

    splits: Sequence[str]
    """Each heads the same metrics."""
    metrics: Sequence[Metric]
    rows: Mapping[str, Sequence[Cell]]
    """By method; split after split, metric after metric."""
    caption: str
    """What the numbers depend on, so that a reader can repeat them."""

    def latex(self) -> str:
        r"""Return a ``table`` for LaTeX's booktabs package, a ``table*`` for several splits."""
        n_columns = len(self.metrics)
        starts = [2 + n_columns * number for number in range(len(self.splits))]
        heads = [rf"\multicolumn{{{n_columns}}}{{c}}{{{escaped(it)}}}" for it in self.splits]
        rules = [rf"\cmidrule(lr){{{start}-{start + n_columns - 1}}}" for start in starts]
        labels = [escaped(metric.label) for metric in self.metrics] * len(self.splits)
        wide = "*" if len(self.splits) > 1 else ""
        return "\n".join(
            [
                rf"\begin{{table{wide}}}",
                r"\centering",
                rf"\caption{{{escaped(self.caption)}}}",
                rf"\begin{{tabular}}{{l{'r' * len(labels)}}}",
                r"\toprule",
                table_row(["", *heads]),
                " ".join(rules),
                table_row(["Method", *labels]),
                r"\midrule",
                *(_latex_row(name, cells) for name, cells in self.rows.items()),
                r"\bottomrule",
                r"\end{tabular}",
                rf"\end{{table{wide}}}",
            ]
        )

    def markdown(self) -> str:
        """Return a GitHub-flavoured table, with the caption below."""
        several = len(self.splits) > 1
        labels = [
            f"{split} {metric.label}" if several else metric.label
            for split in self.splits
            for metric in self.metrics
        ]
        rows = [
            [name.replace("|", r"\|"), *(f"**{it.text}**" if it.is_best else it.text for it in row)]
            for name, row in self.rows.items()
        ]
        lines = [["method", *labels], [":---", *["---:"] * len(labels)], *rows]
        table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        return f"{table}\n\n{self.caption}"

    def __repr__(self) -> str:
        return self.markdown()

    def _repr_markdown_(self) -> str:
        """Show the table in a notebook."""
        return self.markdown()


def results_table(results: Mapping[str, Scores | Sequence[Scores]]) -> ResultsTable:
    r"""Lay out the results of methods, the best of each column in bold.

    Parameters
    ----------
    results : mapping of Scores, or of several
        By the name of the method; a method may have scores for several splits.

    Raises
    ------
    ProtocolError
        If there are none, or they do not compare.

    Examples
    --------
    >>> from reverie_eval import evaluate
    >>> samples = {"first": "mediocre", "second": "good"}
    >>> results = {
    ...     name: evaluate(f"fixtures/submissions/{sample}.json", split="val_unseen")
    ...     for name, sample in samples.items()
    ... }
    >>> print("\n".join(results_table(results).markdown().splitlines()[:4]))
    | method | SR | OSR | SPL | TL | RGS | RGSPL |
    | :--- | ---: | ---: | ---: | ---: | ---: | ---: |
    | first | 41.67 | 55.95 | 35.89 | 8.72 | 40.48 | 34.52 |
    | second | **80.95** | **88.10** | **72.88** | 9.84 | **65.48** | **57.22** |
    """
    by_method = {name: _by_split(name, scores) for name, scores in results.items()}
    every = [scores for by_split in by_method.values() for scores in by_split.values()]
    _demand_comparable(every)
    splits = list(dict.fromkeys(scores.split for scores in every))
    metrics = [CATALOGUE[key] for key in _COLUMNS if any(key in scores for scores in every)]
    columns = [
        column(metric, [by_split.get(split, {}) for by_split in by_method.values()])
        for split in splits
        for metric in metrics
    ]
    rows = dict(zip(by_method, zip(*columns, strict=True), strict=True))
    return ResultsTable(
        [_title(split) for split in splits], metrics, rows, _caption(every, metrics)
    )


def _latex_row(name: str, cells: Sequence[Cell]) -> str:
    return table_row([escaped(name), *map(_latex_cell, cells)])


def _latex_cell(cell: Cell) -> str:
    text = escaped(cell.text)
    return rf"\textbf{{{text}}}" if cell.is_best else text


def _by_split(name: str, scores: Scores | Sequence[Scores]) -> Mapping[str, Scores]:
    several = [scores] if isinstance(scores, Scores) else scores
    by_split = {each.split: each for each in several}
    if len(by_split) < len(several):
        raise ProtocolError(f"{name} has two scores of the same split; give each a name of its own")
    return by_split


def _demand_comparable(every: Sequence[Scores]) -> None:
    if not every:
        raise ProtocolError("a table of results needs the scores of one method or more")
    rules = {
        (each.protocol.name, each.qualifier, each.ground_truth.header.dataset) for each in every
    }
    signatures = sorted({each.signature for each in every})
    if len(rules) > 1 or len(signatures) > len({each.split for each in every}):
        raise ProtocolError(f"these scores do not compare: {', '.join(signatures)}")


def column(metric: Metric, values: Sequence[Mapping[str, float]]) -> Sequence[Cell]:
    """Word a column, and mark the best of what it shows: digits that nobody sees decide nothing."""
    texts = [metric.display(it[metric.key]) if metric.key in it else NOT_SCORED for it in values]
    best = _best(metric, [float(text) for text in texts if text != NOT_SCORED])
    return [Cell(text, text != NOT_SCORED and float(text) == best) for text in texts]


def _best(metric: Metric, shown: Sequence[float]) -> float | None:
    """Return the best of several values, if one is better than another at all."""
    if metric.better == "neither" or len(shown) == 1:
        return None
    return max(shown) if metric.better == "higher" else min(shown)


def _title(split: str) -> str:
    return split.replace("_", " ").capitalize()


def _caption(every: Sequence[Scores], metrics: Sequence[Metric]) -> str:
    truth = every[0].ground_truth
    world = "the synthetic demo world" if truth.is_demo else truth.header.dataset
    lengths = [metric.label for metric in metrics if metric.unit == "metres"]
    unit = f"{lengths[0]} in metres, all else in percent" if lengths else "In percent"
    said = [dict(part.split(":", 1) for part in each.signature.split("|")) for each in every]
    data = {it["split"]: f"{it['split']} {it['data']} ({it['n']} episodes)" for it in said}
    rules = " ".join(filter(None, (said[0]["protocol"], every[0].qualifier)))
    return (
        f"Results on {world}. {unit}; the best of each column in bold. Scored by reverie-eval "
        f"{said[0]['version']}, protocol {rules}; data: {', '.join(data.values())}."
    )
