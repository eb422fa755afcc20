"""R4R, Room-for-Room: follow two joined paths of R2R, and stay on them."""

from types import MappingProxyType

from reverie_eval.tasks._task import Protocol, Task
from reverie_eval.tasks.r2r import R2RAnnotation

TASK = Task(
    name="r4r",
    title="R4R",
    citation="Jain et al., Stay on the Path: Instruction Fidelity in Vision-and-Language "
    "Navigation, ACL 2019",
    source="github.com/google-research/google-research",
    licence="Matterport3D terms of use",
    annotation=R2RAnnotation,
    file_name="R4R_{split}.json",
    folder="tasks/R4R/data",
    # The splits that papers report on, from the project's README: nobody distributes them, and
    # everybody builds them from R2R.
    releases=MappingProxyType({("val_seen", 115, 1035): "R4R", ("val_unseen", 5018, 45162): "R4R"}),
    edited_copies=MappingProxyType(
        {
            "34be4ee2718b15dc990dab6a98ae10fbcc2bf2d22e0191975f953fa16b84b446": "built by the "
            "published rule from the published R2R on today's graphs, it has 5,026 paths and not "
            "the 5,018 that papers report on, so path ids may differ from those of other files",
        }
    ),
    id_pattern=r"\d+_[0-8]",
    id_form="<path id>_<index of the instruction>, counted from 0",
    id_example="12_8",
    id_parts=("path id", "index of the instruction"),
    goal="the path's end is less than 3 m away (official-v1: at most 3 m)",
    protocols=(
        Protocol(
            name="official-v1",
            summary="the authors' metrics: at most 3 m from the path's end counts in SDTW",
            source="google-research/google-research, r4r/dtw.py and r4r/cls.py",
            goal="at most 3 m from the path's end",
            grounding="not scored",
            rejects_jumps=True,
            nested_hops="rejected",
        ),
        Protocol(
            name="duet",
            summary="HAMT, DUET and their families: less than 3 m from the path's end, and SPL "
            "over the annotated path's length",
            source="cshizhe/VLN-HAMT c8b9ee1, finetune_src/r2r/env.py",
            goal="near the path's end",
            spl_numerator="annotated",
            spl_floor=0.01,
            grounding="not scored",
            nested_hops="every viewpoint",
        ),
    ),
    aliases=MappingProxyType({"hamt": "duet"}),
    hops_by_alias=MappingProxyType({"hamt": "first viewpoint"}),
    headline=("path_length", "navigation_error", "success", "cls", "ndtw", "sdtw"),
    ranking=("cls",),
)
