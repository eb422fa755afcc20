"""Results that papers report, with the split, the protocol and the source of each.

They stand in ``published.toml``, and nowhere else.
"""

import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Literal

import msgspec
from msgspec import Struct

from reverie_eval.metrics import CATALOGUE, printed_value

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

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


@cache
def published_results() -> Sequence[PublishedResult]:
    """Return all published results that ship with the package, in the order of their tables.

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
    # Numbers stay text, so that they are converted as everywhere else.
    content = tomllib.loads(_FILE.read_text("utf-8"), parse_float=str)
    return [
        PublishedResult(
            task=table.task,
            split=split,
            method=method,
            scores={
                key: printed_value(CATALOGUE[key], str(value))
                for key, value in zip(table.metrics, values, strict=True)
            },
            episodes=table.episodes,
            protocol=table.protocol,
            track=table.track,
            dataset=table.dataset,
            paper=table.paper,
            title=table.title,
            source=table.source,
        )
        for table in msgspec.convert(content, _Tables).table
        for split, results in table.results.items()
        for method, values in results.items()
    ]
