"""The record of a task."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.tasks._annotation import Annotation
from reverie_eval.tasks._protocol import Protocol
from reverie_eval.text import did_you_mean

Cluster = Literal["target", "path", "scan"]
"""What dependent episodes have in common: the target object, the annotated path, the building."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """What a benchmark has of its own."""

    name: str
    """As options and signatures write it."""
    title: str
    """As its paper writes it."""
    citation: str
    source: str
    """Where the annotations are published."""
    licence: str
    """Under what terms they are published."""
    annotation: type[Annotation]
    """The form of a record of an annotation file."""
    file_name: str
    """The published name of a split's annotation file, with ``{split}``."""
    folder: str
    """Where these files are in a clone."""
    published: Mapping[str, str] = field(default_factory=dict)
    """The split of each published file by its SHA-256, where these are known."""
    releases: Mapping[tuple[str, int, int], str] = field(default_factory=dict)
    """Names of releases by a split and its numbers of records and episodes, where there are
    several."""
    edited_copies: Mapping[str, str] = field(default_factory=dict)
    """What is different in copies that circulate, by their SHA-256."""
    id_pattern: str
    """What the ids of episodes look like, as a regular expression."""
    id_form: str
    """The same in words."""
    id_example: str
    id_keys: Sequence[str] = ("instr_id",)
    """The fields of a result's record that can hold the id, the official one first."""
    has_targets: bool = False
    """Whether an episode has a target object, which agents name or box."""
    protocols: Sequence[Protocol]
    """Every released protocol, the default one first."""
    aliases: Mapping[str, str] = field(default_factory=dict)
    """Other names of protocols: codebases that score the same way."""
    headline: Sequence[str]
    """The metrics of every score table, by key, in its order."""
    ranking: Sequence[str]
    """The metrics that rank submissions, by key: the first of them that is scored does."""
    cluster: Cluster
    """What makes episodes dependent, if users do not say otherwise."""

    def release(self, split: str, records: int, episodes: int, sha256: str) -> str | None:
        """Return the name of the release that a split's file is from; None if it is unknown."""
        if self.published.get(sha256) == split:
            return self.title
        return self.releases.get((split, records, episodes))

    def protocol(self, name: str) -> Protocol:
        """Return the protocol with this name or alias.

        Raises
        ------
        ProtocolError
            If there is no such protocol.
        """
        by_name = {rules.name: rules for rules in self.protocols}
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
        return [CATALOGUE[key] for key in (*headline, *boxes)]

    def primary_metric(self, scored: Collection[str]) -> Metric:
        """Return the metric that submissions are ranked by."""
        return CATALOGUE[next(key for key in self.ranking if key in scored)]
