"""SOON: find an object from any of ten starts, and point at it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated

from msgspec import Meta, Struct

from reverie_eval.tasks._fields import ITEM_MARK, POINT
from reverie_eval.tasks._task import (
    AnnotatedPath,
    Annotation,
    EpisodeAnnotation,
    Outline,
    Protocol,
    Task,
    ViewpointId,
    turns_of,
)

_Parts = Annotated[list[str], Meta(min_length=1)]


class _Direction(Struct, frozen=True):
    heading: float
    elevation: float


class _Target(Struct, frozen=True):
    center: _Direction
    left_top: _Direction
    right_top: _Direction
    right_bottom: _Direction
    left_bottom: _Direction


class _Box(Struct, frozen=True):
    image_id: ViewpointId
    target: _Target
    scan: str = ""

    @property
    def outline(self) -> Outline:
        """The centre and the corners as evaluators join them, scaled as answers are submitted."""
        it = self.target
        points = it.center, it.left_top, it.right_top, it.right_bottom, it.left_bottom
        return [turns_of(point.heading, point.elevation) for point in points]


class SoonAnnotation(Annotation, frozen=True, kw_only=True):
    """One item: a target, where it is seen from, and a path to one of these from each start."""

    scan: str = ""  # files with the solution give it in the boxes
    instr_id: Annotated[int, Meta(ge=0)] | ViewpointId
    instructions: Annotated[list[str | _Parts], Meta(min_length=1)]  # one or several
    path: Annotated[list[AnnotatedPath], Meta(min_length=1)]
    bboxes: list[_Box]  # one where the target is seen; none in a public test file

    def __post_init__(self) -> None:
        """Refuse an item of no scan."""
        if not self.scan and not any(box.scan for box in self.bboxes):
            raise ValueError("neither the item nor its bboxes have a scan")

    @property
    def parts(self) -> Sequence[Annotation]:
        """A walk for each start."""
        scan = self.scan or next(box.scan for box in self.bboxes if box.scan)
        return [_Walk(scan=scan, item=self, start=index) for index in range(len(self.path))]


class _Walk(EpisodeAnnotation, frozen=True, kw_only=True):
    """An episode: one of an item's starts, given by its index."""

    item: SoonAnnotation
    start: int

    @property
    def name(self) -> str:
        """The id of the one episode."""
        return f"{self.item.instr_id}{ITEM_MARK}{self.start}"

    @property
    def texts(self) -> Sequence[str]:
        """The full text of the first instruction, which is the last of its parts."""
        first, last = self.item.instructions[0], self.item.instructions[-1]
        return [str(last if isinstance(first, str) else first[-1])]

    @property
    def reference(self) -> Sequence[str]:
        """The first of the item's paths from this viewpoint: the official script stops there."""
        here = self.item.path[self.start][0]
        return next(path for path in self.item.path if path[0] == here)

    @property
    def further_paths(self) -> Mapping[str, Sequence[str]]:
        """The path from this start, by name."""
        return {"own": self.item.path[self.start]}

    @property
    def goals(self) -> Sequence[str]:
        """The viewpoints from which the target is seen."""
        return [box.image_id for box in self.item.bboxes]

    @property
    def outlines(self) -> Sequence[Outline]:
        """The target as it is seen from each of the goal viewpoints."""
        return [box.outline for box in self.item.bboxes]

    @property
    def has_solution(self) -> bool:
        """Whether the item has boxes."""
        return bool(self.item.bboxes)


_OFFICIAL = Protocol(
    name="official-v1",
    summary="the challenge's script: where the target is seen, or under 3 m from the path's end",
    source="ZhuFengdaaa/SOON-EvalAI-Starters 66f5e37, evaluation_script/main.py lines 16-204",
    goal="near the path's end, which a stop at a goal viewpoint becomes",
    spl_floor=0.01,
    grounding="not scored",
    measures=frozenset({"goal region", "outline"}),
)

TASK = Task(
    name="soon",
    title="SOON",
    citation="Zhu et al., SOON: Scenario Oriented Object Navigation with Graph-Based Exploration, "
    "CVPR 2021",
    source="github.com/ZhuFengdaaa/SOON",
    licence="none stated; Matterport3D terms of use for the scans",
    unseen="files with the solution",
    annotation=SoonAnnotation,
    file_name="{split}.json",
    folder="tasks/SOON/data",
    id_pattern=r"\d+#\d+",
    id_form="<instr_id of the item>#<index of the start>, counted from 0",
    id_example="12#3",
    has_numbers=True,
    point_fields=POINT,
    goal="the target is seen, or the path's end less than 3 m away (navillm: only the latter),",
    protocols=(
        _OFFICIAL,
        replace(
            _OFFICIAL,
            name="duet",
            summary="DUET: the same, with each start's own path",
            source="cshizhe/VLN-DUET 93e8b23, map_nav_src/soon/env.py lines 71-93 and 318-423",
            reference="own",
            repeated_outlines="last",
            point_errors="where the target is seen",
            nested_hops="every viewpoint",
        ),
        replace(
            _OFFICIAL,
            name="navillm",
            summary="NaviLLM: less than 3 m from the end of each start's own path, even where the "
            "target is seen; SFPL needs no success",
            source="zd11024/NaviLLM a221f42, tasks/datasets/soon.py lines 107-223",
            goal="near the path's end",
            reference="own",
            repeated_outlines="last",
            point_errors="where the target is seen",
            # It does not report goal progress.
            measures=frozenset({"outline"}),
            nested_hops="every viewpoint",
        ),
    ),
    headline=("path_length", "oracle_success", "success", "spl", "detection_success", "sfpl"),
    ranking=("sfpl",),
)
