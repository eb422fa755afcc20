"""The record of a task."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import CATALOGUE, Metric, Need
from reverie_eval.tasks._annotation import Annotation
from reverie_eval.tasks._protocol import Protocol
from reverie_eval.text import did_you_mean


@dataclass(frozen=True, kw_only=True)
class Paper:
    """The paper to cite for a task."""

    title: str
    year: str
    url: str
    bibtex: str
    """The entry as its publisher writes it, with a line break at the end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """A benchmark: everything in which it differs from others."""

    name: str
    """The name in options and signatures."""
    title: str
    """The name in its paper."""
    citation: str
    paper: Paper | None = None
    """The same in full; None if only the citation is known."""
    source: str
    """Where the annotations are published."""
    licence: str
    """The terms under which they are published."""
    unseen: str = ""
    """The files that were not available, so that reading them was tested only on made-up ones."""
    annotation: type[Annotation]
    """The form of a record of an annotation file."""
    file_name: str
    """The published name of a split's annotation file, with ``{split}``."""
    folder: str
    """Where these files are in a clone."""
    published: Mapping[str, str] = field(default_factory=dict)
    """The split of each published file by its SHA-256, where these are known."""
    releases: Mapping[tuple[str, int, int], str] = field(default_factory=dict)
    """Names of releases by split, number of records and number of episodes, if there are
    several."""
    edited_copies: Mapping[str, str] = field(default_factory=dict)
    """How edited copies in circulation differ, by their SHA-256."""
    id_pattern: str
    """The form of episode ids, as a regular expression."""
    id_form: str
    """The same in words."""
    id_example: str
    id_parts: Sequence[str] = ()
    """What the parts of an id are, which underscores separate; empty if they are not told."""
    id_keys: Sequence[str] = ("instr_id",)
    """The fields of a result's record that can hold the id, the official one first."""
    has_numbers: bool = False
    """Whether the id may be a number; it is compared as text."""
    has_short_ids: bool = False
    """Whether the part of an id after its underscore is also accepted as an id."""
    has_json_lines: bool = False
    """Whether the official form of a result may be a record on each line instead of a list."""
    has_items: bool = False
    """Whether a result's record has several trajectories, one for each start of an item, each with
    a point where the agent sees the target. Their ids are ``<item>#<index>``."""
    has_targets: bool = False
    """Whether episodes have a target object, which agents predict by id or by box."""
    goal: str
    """When a stop is a success, in words: "the target object is visible"."""
    protocols: Sequence[Protocol]
    """Every released protocol, the default one first."""
    aliases: Mapping[str, str] = field(default_factory=dict)
    """Other names of protocols: codebases that score the same way."""
    headline: Sequence[str]
    """The metrics of every score table, by key, in its order."""
    ranking: Sequence[str]
    """The metrics that rank submissions, by key: the first that is scored ranks."""

    def release(self, split: str, records: int, episodes: int, sha256: str) -> str | None:
        """Return the name of the release that a split's file is from; None if it is unknown."""
        if self.published.get(sha256) == split:
            return self.title
        return self.releases.get((split, records, episodes))

    def has_id_like(self, instr_id: str) -> bool:
        """Whether an id looks like one of an episode."""
        return re.fullmatch(self.id_pattern, instr_id) is not None

    def id_field(self, instr_id: str) -> Mapping[str, str | int]:
        """Return the id of an episode as in the official form of a result."""
        is_number = self.has_numbers and instr_id.isdecimal()
        return {self.id_keys[0]: int(instr_id) if is_number else instr_id}

    @property
    def metrics(self) -> Sequence[str]:
        """The keys of all metrics that a submission for the task can have."""
        available: set[Need] = {"trajectory"}
        if self.has_targets:
            available |= {"answer", "box"}
        for protocol in self.protocols:
            available |= protocol.measures
        return [key for key, metric in CATALOGUE.items() if metric.needs <= available]

    def metric(self, key: str) -> Metric:
        """Return a metric with its definition by the task's goal."""
        return CATALOGUE[key].for_goal(self.goal)

    def has_protocol(self, name: str) -> bool:
        """Whether a protocol has this name or alias."""
        return name in {*self.aliases, *(protocol.name for protocol in self.protocols)}

    def protocol(self, name: str) -> Protocol:
        """Return the protocol with this name or alias.

        Raises
        ------
        ProtocolError
            If there is no such protocol.
        """
        by_name = {protocol.name: protocol for protocol in self.protocols}
        canonical = self.aliases.get(name, name)
        if canonical not in by_name:
            known = [*by_name, *self.aliases]
            raise ProtocolError(f"unknown protocol {name!r}{did_you_mean(name, known)}")
        return by_name[canonical]

    def table_metrics(self, scored: Collection[str]) -> Sequence[Metric]:
        """Return the metrics of a score table: the headline ones, and those of boxes if scored.

        Where navigation is scored, the table has a column for each headline metric, whether or not
        answers are scored.
        """
        has_all = "success" in scored
        headline = [key for key in self.headline if has_all or key in scored]
        boxes = [key for key in scored if "box" in CATALOGUE[key].needs]
        return [self.metric(key) for key in (*headline, *boxes)]

    def headline_metrics(self, scored: Collection[str]) -> Sequence[Metric]:
        """Return the headline metrics that are scored, in the order of a score table."""
        return [self.metric(key) for key in self.headline if key in scored]

    def primary_metric(self, scored: Collection[str]) -> Metric:
        """Return the metric that submissions are ranked by."""
        return self.metric(next(key for key in self.ranking if key in scored))
