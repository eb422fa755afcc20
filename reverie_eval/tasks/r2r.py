"""R2R, Room-to-Room: follow an instruction to the end of a path."""

from types import MappingProxyType
from typing import Annotated

from msgspec import Meta

from reverie_eval.tasks._task import PathAnnotation, Protocol, Task


class R2RAnnotation(PathAnnotation, frozen=True, kw_only=True):
    """One record of ``R2R_{split}.json``: a path with, as a rule, three instructions."""

    path_id: Annotated[int, Meta(ge=0)]

    @property
    def name(self) -> str:
        """The published id; episode ``k`` of the path is ``{path_id}_{k}``."""
        return str(self.path_id)


TASK = Task(
    name="r2r",
    title="R2R",
    citation="Anderson et al., Vision-and-Language Navigation: Interpreting visually-grounded "
    "navigation instructions in real environments, CVPR 2018",
    source="github.com/peteanderson80/Matterport3DSimulator",
    licence="Matterport3D terms of use",
    annotation=R2RAnnotation,
    file_name="R2R_{split}.json",
    folder="tasks/R2R/data",
    published=MappingProxyType(
        {
            "755633db9d5e64d5ca71d329c5046bb722781a09f0d1d501d7e8d094c83652ec": "val_seen",
            "1cc730adc1c098998ac9191462849fc725e0c5336984a35bfbac7d5f044e682c": "val_unseen",
            "f7e28b527ab7fd209010439b327269c18d315888c68ecc81486ef20d58046f10": "test",
        }
    ),
    edited_copies=MappingProxyType(
        {
            "b9fa5a68e28e289de5e078a770660aa166d88c73fca9e0ee4a19f5168aac1343": "path 4554 lacks "
            "its first viewpoint, so its three episodes start elsewhere, and the instructions of "
            "paths 551, 933, 5014 and 7220 were retyped",
            "e12fb134dd14a4617d27cdaab560d9029b4bee5b3c740645de49dfb9e2ff585a": "the instructions "
            "of 11 paths were retyped; the paths are the same",
        }
    ),
    id_pattern=r"\d+_[0-3]",
    id_form="<path id>_<index of the instruction>, counted from 0",
    id_example="4332_0",
    id_parts=("path id", "index of the instruction"),
    goal="the path's end is less than 3 m away",
    protocols=(
        Protocol(
            name="official-v1",
            summary="the dataset's own script: less than 3 m from the path's end",
            source="peteanderson80/Matterport3DSimulator 589d091, tasks/R2R/eval.py",
            goal="near the path's end",
            grounding="not scored",
            # Its ids are made of the indices 0, 1 and 2: a fourth instruction is never scored.
            scored_instructions=3,
            rejects_jumps=True,
            nested_hops="rejected",
        ),
        Protocol(
            name="duet",
            summary="DUET, HAMT and their families: SPL over the annotated path's length",
            source="cshizhe/VLN-HAMT c8b9ee1; cshizhe/VLN-DUET 93e8b23, map_nav_src/r2r/env.py",
            goal="near the path's end",
            spl_numerator="annotated",
            spl_floor=0.01,
            grounding="not scored",
            nested_hops="every viewpoint",
        ),
    ),
    aliases=MappingProxyType({"hamt": "duet"}),
    hops_by_alias=MappingProxyType({"hamt": "first viewpoint"}),
    headline=("path_length", "navigation_error", "oracle_success", "success", "spl"),
    ranking=("spl",),
)
