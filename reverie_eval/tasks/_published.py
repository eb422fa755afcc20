"""Results that papers report, with the split, the protocol and the source of each.

They stand in ``published.toml``, and nowhere else.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Literal

import msgspec
from msgspec import Struct

from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import parse_toml
from reverie_eval.metrics import CATALOGUE, printed_value

_FILE = Path(__file__).with_name("published.toml")


class PublishedResult(Struct, frozen=True, kw_only=True):
    """The means that a paper reports of a method on a split."""

    task: str
    """The benchmark, such as ``reverie``."""
    split: str
    method: str
    """As the paper calls it."""
    scores: Mapping[str, float]
    """By metric: fractions or metres, as those of :class:`~reverie_eval.Scores`."""
    episodes: int | None
    """The number of episodes that the means are over; None for all of the split."""
    protocol: str
    """The protocol of this package by whose rules the numbers were made."""
    track: Literal["full", "grounding"]
    dataset: str
    """The version of the dataset."""
    paper: str
    """Authors, title, place and year."""
    title: str
    """What the paper's table is about."""
    source: str
    """Where the paper is."""


class _Table(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    task: str
    paper: str
    title: str
    source: str
    dataset: str
    protocol: str
    track: Literal["full", "grounding"] = "full"
    episodes: int | None = None
    metrics: Sequence[str]
    results: Mapping[str, Mapping[str, Sequence[str | int]]]
    """A value for each metric, by split and method."""


class _Tables(Struct, frozen=True, forbid_unknown_fields=True):
    table: Sequence[_Table]


def published_results(file: str | PathLike[str] | None = None) -> Sequence[PublishedResult]:
    """Return published results, in the order of their tables.

    Parameters
    ----------
    file : path, optional
        A file of the form of ``published.toml``; by default that, with all that ship with the
        package.

    Raises
    ------
    ReverieEvalError
        If the file has another form, or a value out of its metric's bounds.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> (best,) = [
    ...     each
    ...     for each in published_results()
    ...     if (each.split, each.method) == ("val_unseen", "FAST-Short")
    ... ]
    >>> best.scores["rgs"], best.paper
    (0.0624, 'Qi et al., REVERIE, CVPR 2020')
    """
    return _read(_FILE if file is None else Path(file))


def published_on(
    task: str, split: str, track: str, file: str | PathLike[str] | None = None
) -> Mapping[str, PublishedResult]:
    """Return the published results of a task, split and track by method."""
    return {
        each.method: each
        for each in published_results(file)
        if (each.task, each.split, each.track) == (task, split, track)
    }


@cache
def _read(file: Path) -> Sequence[PublishedResult]:
    try:
        # Numbers stay text, so that they are converted as everywhere else.
        content = parse_toml(file.read_text("utf-8"), parse_float=str)
        return list(_results(msgspec.convert(content, _Tables)))
    except (ValueError, KeyError) as error:  # those of the TOML, of its form, and of a number
        raise ReverieEvalError(
            f"{file}: {error}; the form is that of {_FILE.name}, which ships with reverie-eval: "
            f"{_FILE}"
        ) from None


def _results(tables: _Tables) -> Iterator[PublishedResult]:
    for table in tables.table:
        for split, results in table.results.items():
            for method, values in results.items():
                pairs = zip(table.metrics, values, strict=True)
                yield PublishedResult(
                    task=table.task,
                    split=split,
                    method=method,
                    scores={key: printed_value(CATALOGUE[key], str(it)) for key, it in pairs},
                    episodes=table.episodes,
                    protocol=table.protocol,
                    track=table.track,
                    dataset=table.dataset,
                    paper=table.paper,
                    title=table.title,
                    source=table.source,
                )
