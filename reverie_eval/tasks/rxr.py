"""RxR, Room-across-Room: follow a long instruction in English, Hindi or Telugu."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Literal

from msgspec import Meta, field

from reverie_eval.tasks._fields import INSTR_ID
from reverie_eval.tasks._task import AnnotatedPath, EpisodeAnnotation, Protocol, Task


class RxRAnnotation(EpisodeAnnotation, frozen=True, kw_only=True):
    """One line of ``rxr_{split}_guide.jsonl.gz``: an instruction; several share a path."""

    instruction_id: Annotated[int, Meta(ge=0)]
    path_id: Annotated[int, Meta(ge=0)] | None = None
    """Absent from a public test file."""
    path: AnnotatedPath
    heading: float = 0.0
    instruction: str
    language_tag: Literal["en-IN", "en-US", "hi-IN", "te-IN"] = field(name="language")

    @property
    def name(self) -> str:
        """The id of the one episode: that of the path, and that of the instruction."""
        number = str(self.instruction_id)
        return number if self.path_id is None else f"{self.path_id}_{number}"

    @property
    def texts(self) -> Sequence[str]:
        """The one instruction."""
        return [self.instruction]

    @property
    def language(self) -> str:
        """The language of the instruction, such as ``en-US``."""
        return self.language_tag

    @property
    def start_heading(self) -> float:
        """The published heading."""
        return self.heading

    @property
    def reference(self) -> Sequence[str]:
        """The annotated path, which is not a shortest one as a rule."""
        return self.path


TASK = Task(
    name="rxr",
    title="RxR",
    citation="Ku et al., Room-Across-Room: Multilingual Vision-and-Language Navigation with Dense "
    "Spatiotemporal Grounding, EMNLP 2020",
    source="github.com/google-research-datasets/RxR",
    licence="CC BY 4.0, and the Matterport3D terms of use",
    unseen="published files",
    annotation=RxRAnnotation,
    file_name="rxr_{split}_guide.jsonl.gz",
    folder="tasks/RxR/data",
    id_pattern=r"\d+_\d+",
    id_form="<path id>_<instruction id>, or the instruction id alone",
    id_example="90066_900394",
    id_parts=("path id", "instruction id"),
    id_field=replace(INSTR_ID, also=("instruction_id",)),
    has_numbers=True,
    has_short_ids=True,
    goal="the path's end is less than 3 m away (official-v1: at most 3 m)",
    protocols=(
        Protocol(
            name="official-v1",
            summary="the authors' metrics: at most 3 m from the path's end counts in SDTW; their "
            "server's own scorer is not public",
            source="google-research/google-research 066e6a1, r4r/dtw.py (class DTW) and "
            "r4r/cls.py (class CLS)",
            goal="at most 3 m from the path's end",
            grounding="not scored",
            rejects_jumps=True,
            nested_hops="rejected",
        ),
        Protocol(
            name="hamt",
            summary="HAMT: less than 3 m from the path's end, and SPL over the annotated path's "
            "length",
            source="cshizhe/VLN-HAMT c8b9ee1, finetune_src/r2r/env.py lines 322-386 and "
            "eval_utils.py lines 74-110",
            goal="near the path's end",
            spl_numerator="annotated",
            spl_floor=0.01,
            grounding="not scored",
        ),
    ),
    headline=("path_length", "navigation_error", "success", "spl", "ndtw", "sdtw"),
    ranking=("ndtw",),
)
