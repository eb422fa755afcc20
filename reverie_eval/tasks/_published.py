"""What others have published: results in papers, and codebases that score or write files.

Results have their split, protocol and source, and stand in ``published.toml``, nowhere else. Of
codebases, ``codebases.toml`` says by which protocol their numbers are reproduced, and what their
files look like.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Literal

import msgspec
from msgspec import Struct

from reverie_eval.errors import ProtocolError, ReverieEvalError
from reverie_eval.files import parse_toml
from reverie_eval.metrics import CATALOGUE, printed_value
from reverie_eval.tasks._registry import BUILT_IN, find_task

_RESULTS = Path(__file__).with_name("published.toml")


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
    return _read(_RESULTS if file is None else Path(file))


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
            f"{file}: {error}; the form is that of {_RESULTS.name}, which ships with reverie-eval: "
            f"{_RESULTS}"
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


# Public codebases.

_CODEBASES = Path(__file__).with_name("codebases.toml")
_ON_GITHUB = re.compile(r"github\.com[:/]([^/]+/[^/]+)")
# How similar an unknown name must be to be asked about: FAST is not FSTTA.
_CLOSE = 0.7


class _Tried(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Code that was executed, or only read."""

    executed: date | None = None
    """When it was last run here; None if it was only read."""

    @property
    def standing(self) -> str:
        """Whether it was executed, and when."""
        return "read" if self.executed is None else f"executed {self.executed}"


class CodebaseEvaluator(_Tried, frozen=True, kw_only=True):
    """How a codebase scores one task."""

    task: str
    protocol: str
    """The protocol of the task that gives the same values for every episode, apart from
    ``differs``."""
    source: str
    """The file and lines in the repository; empty if it has no evaluator for the task."""
    differs: str = ""
    """What the evaluator does otherwise than the protocol, as sentences."""


class CodebaseFile(_Tried, frozen=True, kw_only=True):
    """What a codebase's own result writer writes."""

    name: str = ""
    """The name of the file, with ``{split}``."""
    form: str
    """The records, trajectories and answers, in a sentence."""
    example: str = ""
    """A record as the writer wrote it, on made-up viewpoints; empty if it was only read."""


class Codebase(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A public repository that scores a task, or writes files to be scored."""

    name: str
    """What papers and tables call the method."""
    repository: str
    """``owner/name`` on GitHub."""
    commit: str
    """The commit that was executed or read."""
    also: Sequence[str] = ()
    """Other names that the codebase is known by."""
    evaluator: Sequence[CodebaseEvaluator] = ()
    """How the codebase scores, for each task that it does."""
    file: Sequence[CodebaseFile] = ()
    """What the codebase writes, for each form of a file."""

    @property
    def names(self) -> Sequence[str]:
        """Everything that the codebase can be looked up by."""
        return [self.name, *self.also, self.repository, self.repository.partition("/")[2]]


class _Codebases(Struct, frozen=True, forbid_unknown_fields=True):
    codebase: Sequence[Codebase]


@cache
def codebases() -> Sequence[Codebase]:
    """Return all codebases, by name."""
    found = msgspec.convert(parse_toml(_CODEBASES.read_text("utf-8")), _Codebases)
    return sorted(found.codebase, key=lambda each: each.name.casefold())


def find_codebase(name: str) -> Codebase:
    """Return a codebase by its name, another name, or its repository; case does not matter.

    Raises
    ------
    ProtocolError
        If there is no such codebase; the message suggests the most similar name.

    Examples
    --------
    >>> find_codebase("vln-duet").name, find_codebase("git@github.com:cshizhe/VLN-DUET.git").name
    ('DUET', 'DUET')
    """
    from difflib import get_close_matches  # slow to import, and only needed in errors

    address = _ON_GITHUB.search(name)
    wanted = (name if address is None else address[1]).strip("/").removesuffix(".git").casefold()
    by_name = {key.casefold(): each for each in codebases() for key in each.names}
    if wanted in by_name:
        return by_name[wanted]
    scored = [task for task in map(find_task, BUILT_IN) if task.has_protocol(name)]
    if scored:
        options = " or ".join(f"--task {task.name} --protocol {name}" for task in scored)
        raise ProtocolError(f"{name!r} is a protocol itself: score with {options}")
    close = get_close_matches(wanted, by_name, n=1, cutoff=_CLOSE)
    guess = f"did you mean {by_name[close[0]].name}? " if close else ""
    raise ProtocolError(f"unknown codebase {name!r}; {guess}`reverie-eval protocol` lists all")
