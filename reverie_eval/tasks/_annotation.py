"""The record of an annotation file, in a form common to all tasks."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, TypeAlias

from msgspec import Meta, Struct

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
