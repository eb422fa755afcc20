"""Tasks and protocols: all that benchmarks and their published evaluators differ in, as data.

The records of their annotation files have a form in common here. A protocol's numbers never change
once it is released; a correction is a new protocol. Thresholds that protocols share are defined
with the arithmetic that uses them, in :mod:`reverie_eval.metrics`.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal, TypeAlias, get_args

from msgspec import Meta, Struct

from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import CATALOGUE, Metric, Need
from reverie_eval.tasks._fields import INSTR_ID, Field
from reverie_eval.text import did_you_mean

ViewpointId: TypeAlias = Annotated[str, Meta(min_length=1)]
Outline: TypeAlias = Sequence[tuple[float, float]]
"""The centre of a target and its four corners as a viewpoint sees them: heading and elevation, in
turns."""
AnnotatedPath: TypeAlias = Annotated[list[ViewpointId], Meta(min_length=1)]
"""Viewpoints in walking order."""


def turns_of(heading: float, elevation: float) -> tuple[float, float]:
    """Return a direction in radians as outlines and answers have it: in turns, each from 0.

    >>> turns_of(math.pi, 0.0)
    (0.5, 0.5)
    """
    turn = 2 * math.pi
    return heading / turn, (elevation + math.pi) / turn


class Annotation(Struct, frozen=True, kw_only=True):
    """What the episodes of one record share; a task's own class adds the published fields.

    msgspec reads a record into it by names and types, and ignores fields that the class does not
    have. A public test file gives only the start.
    """

    scan: Annotated[str, Meta(min_length=1)]

    @property
    def parts(self) -> "Sequence[Annotation]":
        """The annotations in the record: itself, unless it has several starts."""
        return [self]

    @property
    def name(self) -> str:
        """The record's id, for messages."""
        raise NotImplementedError

    @property
    def instr_ids(self) -> Sequence[str]:
        """The ids of the record's episodes, one for each instruction."""
        return [f"{self.name}_{index}" for index in range(len(self.texts))]

    @property
    def texts(self) -> Sequence[str]:
        """The instruction of each episode."""
        raise NotImplementedError

    @property
    def language(self) -> str:
        """The language of the instructions; empty in a task of one language."""
        return ""

    @property
    def start_heading(self) -> float:
        """Where the agent looks at the start, in radians; 0, north, where the task does not say."""
        return 0.0

    @property
    def reference(self) -> Sequence[str]:
        """The annotated path by which the task's default protocol scores, the start first."""
        raise NotImplementedError

    @property
    def further_paths(self) -> Mapping[str, Sequence[str]]:
        """Other annotated paths by name, for protocols that score by one of them."""
        return {}

    @property
    def goals(self) -> Sequence[str]:
        """The goal viewpoints, where the task annotates them beside the path."""
        return ()

    @property
    def outlines(self) -> Sequence[Outline]:
        """The target as each of the goal viewpoints sees it, where the task annotates that."""
        return ()

    @property
    def target(self) -> int | None:
        """The target object's id within the scan; None in a task without target objects."""
        return None

    @property
    def has_solution(self) -> bool:
        """Whether the record has what the public file of a private split leaves out.

        A path that stays at its first viewpoint is no solution, however often it lists it.
        """
        return len(set(self.reference)) > 1


class EpisodeAnnotation(Annotation, frozen=True, kw_only=True):
    """A record of one episode, which has the record's own id."""

    @property
    def instr_ids(self) -> Sequence[str]:
        """The id of the one episode."""
        return [self.name]


class PathAnnotation(Annotation, frozen=True, kw_only=True):
    """A path with its instructions, in the fields that R2R gave them and REVERIE kept."""

    path: AnnotatedPath
    instructions: Annotated[list[str], Meta(min_length=1)]
    heading: float = 0.0

    @property
    def start_heading(self) -> float:
        """The published heading."""
        return self.heading

    @property
    def texts(self) -> Sequence[str]:
        """The instructions."""
        return self.instructions

    @property
    def reference(self) -> Sequence[str]:
        """The annotated path."""
        return self.path


# Tasks and protocols.

DEFAULT_PROTOCOL = "official-v1"
"""Every task has a protocol of this name: the rules of the dataset's own authors."""
CHANGED = " (changed)"
"""The end of a release's name, for a file of its size with other content."""
KnownSplit = Literal["train", "val_seen", "val_unseen", "val_unseen_house", "test"]
"""Splits of the tasks of this package, for editors to complete; others have other names."""
KNOWN_SPLITS: Sequence[str] = get_args(KnownSplit)
"""These splits, in the order in which papers have them."""
GoalRule = Literal[
    "visible",
    "visible and near the object",
    "at most 3 m from the object",
    "near the path's end",
    "at most 3 m from the path's end",
    "at a goal viewpoint",
    "near the path's end, which a stop at a goal viewpoint becomes",
]
TO_REGION = "planner's path or to the goal region"
"""The reference of protocols that score by the planner's path if it ends at a goal viewpoint, and
otherwise by the shortest route to one: that of fewest moves, to the first of several [1]_.

References
----------
.. [1] ``tasks/datasets/cvdn.py`` lines 28-36 of zd11024/NaviLLM at a221f42.
"""
Grounding = Literal["anywhere", "only with success", "not scored"]
HopReading = Literal["first viewpoint", "every viewpoint", "rejected", "no evaluator"]
"""How a published evaluator reads a nested hop with several viewpoints."""


@dataclass(frozen=True, slots=True)
class Protocol:
    """The rules that a published evaluator scores by."""

    name: str
    summary: str
    source: str
    # The defaults are the rules of the dataset's own script; protocols list only what differs.
    goal: GoalRule = "visible"
    """Which viewpoints are goals: those from which the target is visible; those from which it is
    visible with its centre at most 3 m from the camera; those with its centre at most 3 m from the
    camera in a straight line, visible or not; those less than 3 m along the graph from
    the path's end, or at most 3 m; those that the task annotates as goals; or those less than 3 m
    from the path's end, except that an annotated goal becomes the goal if the agent stops there."""
    spl_numerator: Literal["shortest", "annotated", "nearest goal"] = "shortest"
    """The length in SPL's numerator: of the shortest route, of the annotated path, or of the
    shortest route to the nearest annotated goal."""
    spl_floor: float = 0.0
    """Smallest denominator of SPL, metres."""
    rgspl_floor: float = 0.0
    """Smallest denominator of RGSPL, metres."""
    grounding: Grounding = "anywhere"
    """Where a correct answer counts: wherever the agent stops, or only with success."""
    text_ids_count: bool = True
    """Whether an object id written as text can be correct."""
    reference: str = ""
    """The annotated path to score by, among the task's further paths or ``TO_REGION``; empty for
    its own."""
    repeated_outlines: Literal["first", "last"] = "first"
    """Which outline of the target counts, where a goal viewpoint has several."""
    point_errors: Literal["detections", "where the target is seen"] = "detections"
    """Which stops have a point error."""
    measures: frozenset[Need] = frozenset()
    """What the annotations let the protocol measure besides walks and answers."""
    scored_instructions: int | None = None
    """How many instructions of each path are scored, if not all of them."""
    rejects_jumps: bool = False
    """Whether the published evaluator stops at a move between unconnected viewpoints. It is not a
    rule of the scores, which count such moves."""
    nested_hops: HopReading = "first viewpoint"
    """How the published evaluator reads nested hops. It is not a rule of the scores, which count
    every viewpoint under all protocols."""

    @property
    def basis(self) -> tuple[int | None, str]:
        """Which episodes and paths of a split are scored; equal for protocols that share these."""
        return self.scored_instructions, self.reference


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
    """The name of the benchmark in its paper."""
    citation: str
    paper: Paper | None = None
    """The paper to cite, in full; None if only the citation is known."""
    source: str
    """Where the annotations are published."""
    licence: str
    """The terms under which the annotations are published."""
    unseen: str = ""
    """The files that were not available, so that reading them was tested only on made-up ones."""
    annotation: type[Annotation]
    """The form of a record of an annotation file."""
    file_name: str
    """The published name of a split's annotation file, with ``{split}``."""
    folder: str
    """Where the annotation files are in a clone of the benchmark's repository."""
    published: Mapping[str, str] = field(default_factory=dict)
    """The split of each published file by its SHA-256, where these are known."""
    releases: Mapping[tuple[str, int, int], str] = field(default_factory=dict)
    """Names of releases by split, number of records and number of episodes, if there are
    several."""
    digests: Mapping[str, tuple[str, int, int]] = field(default_factory=dict)
    """The split and the numbers of each file of these releases by its SHA-256, where it is known:
    another file with these numbers is a changed copy."""
    edited_copies: Mapping[str, str] = field(default_factory=dict)
    """How edited copies in circulation differ, by their SHA-256."""
    id_pattern: str
    """The form of episode ids, as a regular expression."""
    id_form: str
    """The form of episode ids in words."""
    id_example: str
    id_parts: Sequence[str] = ()
    """What the parts of an id are, which underscores separate; empty if they are not told."""
    id_field: Field = INSTR_ID
    """The field of a result's record with the id."""
    has_numbers: bool = False
    """Whether the id may be a number; it is compared as text."""
    has_short_ids: bool = False
    """Whether the part of an id after its underscore is also accepted as an id."""
    answer_fields: Sequence[Field] = ()
    """The fields in which agents predict the target object, in a task with target objects."""
    point_fields: Sequence[Field] = ()
    """The fields of a point where the agent sees the target, in a task whose records have several
    trajectories, one for each start of an item. Their ids are ``<item>#<index>``."""
    goal: str
    """When a stop is a success, in words: "the target object is visible"."""
    protocols: Sequence[Protocol]
    """Every released protocol, the default one first."""
    aliases: Mapping[str, str] = field(default_factory=dict)
    """Other names of protocols: codebases that score the same way."""
    hops_by_alias: Mapping[str, HopReading] = field(default_factory=dict)
    """How the evaluators of aliases read nested hops, where they differ in that alone."""
    headline: Sequence[str]
    """The metrics of every score table, by key, in its order."""
    ranking: Sequence[str]
    """The metrics that rank submissions, by key: the first that is scored ranks."""

    @property
    def has_targets(self) -> bool:
        """Whether episodes have a target object, which agents predict by id or by box."""
        return bool(self.answer_fields)

    @property
    def has_items(self) -> bool:
        """Whether a result's record has several trajectories, one for each start of an item."""
        return bool(self.point_fields)

    def release(self, split: str, records: int, episodes: int, sha256: str) -> str | None:
        """Return the name of the release that a split's file is from; None if it is unknown.

        A file of a release's size, with other content, has the name with :data:`CHANGED`.
        """
        if self.published.get(sha256) == split:
            return self.title
        size = split, records, episodes
        name = self.releases.get(size)
        is_changed = size in self.digests.values() and self.digests.get(sha256) != size
        return f"{name}{CHANGED}" if name and is_changed else name

    def has_id_like(self, instr_id: str) -> bool:
        """Whether an id looks like one of an episode."""
        return re.fullmatch(self.id_pattern, instr_id) is not None

    def official_id(self, instr_id: str) -> Mapping[str, str | int]:
        """Return the id of an episode as in the official form of a result."""
        is_number = self.has_numbers and instr_id.isdecimal()
        return {self.id_field.name: int(instr_id) if is_number else instr_id}

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

    def hop_reading(self, name: str) -> HopReading:
        """Return how the evaluator of a protocol, by its name or alias, reads nested hops."""
        return self.hops_by_alias.get(name) or self.protocol(name).nested_hops

    def table_metrics(self, scored: Collection[str]) -> Sequence[Metric]:
        """Return the metrics of a score table: the headline ones, and those of boxes if scored.

        Where navigation is scored, the table has a column for each headline metric, whether or not
        answers are scored. Metrics of boxes are in the order of the CATALOGUE.
        """
        has_all = "success" in scored
        headline = [key for key in self.headline if has_all or key in scored]
        boxes = [key for key, it in CATALOGUE.items() if key in scored and "box" in it.needs]
        return [self.metric(key) for key in (*headline, *boxes)]

    def headline_metrics(self, scored: Collection[str]) -> Sequence[Metric]:
        """Return the headline metrics that are scored, in the order of a score table."""
        return [self.metric(key) for key in self.headline if key in scored]

    def primary_metric(self, scored: Collection[str]) -> Metric:
        """Return the metric that submissions are ranked by."""
        return self.metric(next(key for key in self.ranking if key in scored))
