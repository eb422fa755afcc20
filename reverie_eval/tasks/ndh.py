"""NDH, Navigation from Dialog History (CVDN): continue from a dialog towards a region."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Annotated

from msgspec import Meta, Struct, field

from reverie_eval.tasks._fields import INSTR_ID
from reverie_eval.tasks._task import (
    TO_REGION,
    AnnotatedPath,
    EpisodeAnnotation,
    Protocol,
    Task,
    ViewpointId,
)


class _Start(Struct, frozen=True):
    pano: ViewpointId
    heading: float = 0.0


class _Message(Struct, frozen=True):
    role: str
    message: str


class NdhAnnotation(EpisodeAnnotation, frozen=True, kw_only=True):
    """One instance: a dialog up to one of its answers, and what came after it."""

    inst_idx: Annotated[int, Meta(ge=0)]
    searched: str = field(name="target")
    """The kind of object that the goal region is named by."""
    start_pano: _Start
    dialog_history: list[_Message]
    end_panos: AnnotatedPath | None = None
    """The goal region; absent from a public test file, like the paths."""
    planner_path: AnnotatedPath | None = None
    """The next steps of a planner, which the answering person saw."""
    player_path: AnnotatedPath | None = None
    """Where the asking person then walked."""

    @property
    def name(self) -> str:
        """The published number, which is the id of its one episode too."""
        return str(self.inst_idx)

    @property
    def texts(self) -> Sequence[str]:
        """What is looked for, and the dialog, a message a line."""
        said = [f"{each.role}: {each.message}" for each in self.dialog_history]
        return ["\n".join([f"target: {self.searched}", *said])]

    @property
    def start_heading(self) -> float:
        """The heading at which the dialog ended."""
        return self.start_pano.heading

    @property
    def reference(self) -> Sequence[str]:
        """The trusted path: the person's if it passes the end of the planner's, else that one."""
        if self.planner_path is None or self.player_path is None:
            return [self.start_pano.pano]
        passes = self.planner_path[-1] in self.player_path[1:]
        return self.player_path if passes else self.planner_path

    @property
    def further_paths(self) -> Mapping[str, Sequence[str]]:
        """The two paths that the trusted one is chosen from."""
        start = [self.start_pano.pano]
        return {"planner": self.planner_path or start, "player": self.player_path or start}

    @property
    def goals(self) -> Sequence[str]:
        """The viewpoints of the goal region."""
        return self.end_panos or ()

    @property
    def has_solution(self) -> bool:
        """Whether the record has its paths and goal region."""
        return bool(self.end_panos and self.planner_path and self.player_path)


def _official(name: str, scored_path: str, reference: str = "") -> Protocol:
    return Protocol(
        name=name,
        summary=f"the dataset's own script, {scored_path}: less than 3 m from the path's end",
        source="mmurray/cvdn 97a4ae9, tasks/NDH/eval.py",
        goal="near the path's end",
        grounding="not scored",
        reference=reference,
        measures=frozenset({"goal region", "planner's path"}),
        rejects_jumps=True,
        nested_hops="rejected",
    )


TASK = Task(
    name="ndh",
    title="NDH",
    citation="Thomason et al., Vision-and-Dialog Navigation, CoRL 2019",
    source="github.com/mmurray/cvdn",
    licence="Matterport3D terms of use",
    annotation=NdhAnnotation,
    file_name="{split}.json",
    folder="tasks/NDH/data",
    published=MappingProxyType(
        {
            "9fc7963ffcb41a8e592db21eb6201e910096c3d3921bceb670a22f683f31f273": "val_seen",
            "7cf9e3ccc5f45286ce1a333232e384f73fceb7b40da1d6f2b3f6e96c742efc5f": "val_unseen",
        }
    ),
    id_pattern=r"\d+",
    id_form="the numbers inst_idx of the annotations",
    id_example="5354",
    id_field=replace(INSTR_ID, name="inst_idx", also=("instr_id",)),
    has_numbers=True,
    goal="the end of the protocol's path is less than 3 m away (hamt: the goal region is reached)",
    protocols=(
        _official("official-v1", "trusted path"),
        _official("official-planner", "planner's path", "planner"),
        _official("official-player", "player's path", "player"),
        Protocol(
            name="hamt",
            summary="HAMT: at a viewpoint of the goal region",
            source="cshizhe/VLN-HAMT c8b9ee1, finetune_src/cvdn/env.py",
            goal="at a goal viewpoint",
            spl_numerator="nearest goal",
            spl_floor=0.01,
            grounding="not scored",
            measures=frozenset({"goal region"}),
        ),
        Protocol(
            name="navillm",
            summary="NaviLLM and its family: less than 3 m from the planner's end if that is in "
            "the goal region, else from the goal viewpoint of fewest moves",
            source="zd11024/NaviLLM a221f42, tasks/datasets/cvdn.py lines 28-36 and 125-207",
            goal="near the path's end",
            spl_numerator="annotated",
            spl_floor=0.01,
            grounding="not scored",
            reference=TO_REGION,
            measures=frozenset({"goal region", "planner's path"}),
            nested_hops="every viewpoint",
        ),
    ),
    headline=("goal_progress", "path_length", "oracle_success", "success", "spl"),
    ranking=("goal_progress",),
)
