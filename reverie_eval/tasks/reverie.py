"""REVERIE: find an object from a high-level instruction, and name it."""

from types import MappingProxyType
from typing import Annotated

from msgspec import Meta, field

from reverie_eval.arrays import LARGEST_OBJECT_ID
from reverie_eval.metrics import PRIMARY_METRIC
from reverie_eval.tasks._fields import ANSWER
from reverie_eval.tasks._task import Paper, PathAnnotation, Protocol, Task


class ReverieAnnotation(PathAnnotation, frozen=True, kw_only=True):
    """One record of ``REVERIE_{split}.json``: a path, a target and up to three instructions."""

    published_id: Annotated[str, Meta(min_length=1)] | int = field(name="id")
    target_id: Annotated[int, Meta(ge=0, le=LARGEST_OBJECT_ID)] | None = field(
        name="objId", default=None
    )
    """The target object's id within the scan; absent from a public test file."""

    @property
    def name(self) -> str:
        """The published id; episode ``k`` of the record is ``{id}_{k}``."""
        return str(self.published_id)

    @property
    def target(self) -> int | None:
        """The target object."""
        return self.target_id

    @property
    def has_solution(self) -> bool:
        """Whether the record has a target."""
        return self.target_id is not None


_PROTOCOLS = (
    Protocol(
        name="official-v1",
        summary="the dataset's own script: the target is visible at the stop",
        source="YuankaiQi/REVERIE 0fe0955, tasks/REVERIE/eval_release.py",
    ),
    Protocol(
        name="paper",
        summary="the paper's rule of grounding, which counts only with success; success is that of "
        "the dataset's script, visibility, which reaches 2 m in v1, and not the text's 3 m",
        source="Qi et al., REVERIE, CVPR 2020, section 3",
        grounding="only with success",
        nested_hops="no evaluator",
    ),
    Protocol(
        name="paper-3m",
        summary="the paper's text: at most 3 m from the target object, visible or not, and "
        "grounding counts only there",
        source="Qi et al., REVERIE, CVPR 2020, section 3",
        goal="at most 3 m from the object",
        grounding="only with success",
        nested_hops="no evaluator",
    ),
    Protocol(
        name="challenge-2022",
        summary="the 2022 challenge: visible, and the camera at most 3 m from the object's centre",
        source="YanyuanQiao/HOP-REVERIE-Challenge 74738b3, r2r_src/eval.py",
        goal="visible and near the object",
        spl_floor=0.01,
        text_ids_count=False,
    ),
    Protocol(
        name="airbert",
        summary="Airbert and Rec-VLN-BERT: like the dataset's script, with a floor in SPL",
        source="airbert-vln/airbert-recurrentvln d65a71e, reverie_src/eval.py",
        spl_floor=0.01,
    ),
    Protocol(
        name="duet",
        summary="DUET, HAMT and their families: SPL over the annotated path's length",
        source="cshizhe/VLN-DUET 93e8b23, map_nav_src/reverie/env.py; cshizhe/VLN-HAMT c8b9ee1",
        spl_numerator="annotated",
        spl_floor=0.01,
        rgspl_floor=0.01,
        nested_hops="every viewpoint",
    ),
    Protocol(
        name="scalevln",
        summary="ScaleVLN and HM3DAutoVLN: like DUET, and grounding needs success",
        source="wz0919/ScaleVLN 3bdff0d, VLN-DUET-RVR; cshizhe/HM3DAutoVLN b5ba669",
        spl_numerator="annotated",
        spl_floor=0.01,
        rgspl_floor=0.01,
        grounding="only with success",
        nested_hops="every viewpoint",
    ),
    Protocol(
        name="r2r-style",
        summary="Room-to-Room's rule: less than 3 m from the end of the annotated path",
        source="peteanderson80/Matterport3DSimulator 589d091, tasks/R2R/eval.py",
        goal="near the path's end",
        grounding="not scored",
        nested_hops="rejected",
    ),
    Protocol(
        name="navrag",
        summary="NavRAG and MapGPT: Room-to-Room's rule, with SPL over the annotated path's length",
        source="MrZihan/NavRAG 7dd133e, VLN-DUET-RVR/map_nav_src/reverie/env.py lines 314-372; "
        "chen-judge/MapGPT 37ed94b, vln/env.py lines 314-372",
        goal="near the path's end",
        spl_numerator="annotated",
        spl_floor=0.01,
        grounding="not scored",
        nested_hops="every viewpoint",
    ),
)

_PAPER = Paper(
    title="REVERIE: Remote Embodied Visual Referring Expression in Real Indoor Environments",
    year="2020",
    url="https://arxiv.org/abs/1904.10151",
    bibtex=r"""@inproceedings{qi2020reverie,
  author = {Qi, Yuankai and Wu, Qi and Anderson, Peter and Wang, Xin and Wang, William Yang and
            Shen, Chunhua and van den Hengel, Anton},
  title = {{REVERIE}: Remote Embodied Visual Referring Expression in Real Indoor Environments},
  booktitle = {IEEE/CVF Conference on Computer Vision and Pattern Recognition (CVPR)},
  year = {2020},
  url = {https://arxiv.org/abs/1904.10151},
}
""",
)

# Of open splits: the file of test that has the solution is the authors' alone.
_DIGESTS = {
    "3a9e6ee1d202446fbbc2eeb59f04fc7acfb8f34ae50060cdc6b68ea30674c62a": ("val_seen", 515, 1423),
    "4df35a0847e242df6db1794b1e0d8676fee0f2f2432a599311a643388550e63c": ("val_unseen", 1328, 3521),
    "67ce4fd05a0eaf6fd3bb7dad32d671330e7a91fa8dedfc5ca8f002a7304aceb4": ("train", 4071, 10290),
    "6776ce0c5e8c2c928742c05c693a353e30e15fab293e441991c65f700a876b61": ("val_seen", 501, 1384),
    "c150d0ffec4484a45c710ad240ae6b62ffa05626c2bb46a9d69ac93fa6124de5": ("val_unseen", 1292, 3433),
}

TASK = Task(
    name="reverie",
    title="REVERIE",
    citation=f"Qi et al., {_PAPER.title}, CVPR {_PAPER.year}",
    paper=_PAPER,
    source="github.com/YuankaiQi/REVERIE",
    licence="Matterport3D terms of use",
    annotation=ReverieAnnotation,
    file_name="REVERIE_{split}.json",
    folder="tasks/REVERIE/data",
    releases=MappingProxyType(
        {
            ("val_seen", 515, 1423): "REVERIE v1",
            ("val_unseen", 1328, 3521): "REVERIE v1",
            ("test", 2304, 6292): "REVERIE v1",
            ("train", 4071, 10290): "REVERIE v2",
            ("val_seen", 501, 1384): "REVERIE v2",
            ("val_unseen", 1292, 3433): "REVERIE v2",
            ("test", 2244, 6144): "REVERIE v2",
        }
    ),
    digests=MappingProxyType(_DIGESTS),
    id_pattern=r"\d+_\d+_\d+",
    id_form="<item id>_<index of the instruction>, counted from 0",
    id_example="4774_267_1",
    id_parts=("path id", "object id", "index of the instruction"),
    answer_fields=ANSWER,
    goal="the target object is visible",
    protocols=_PROTOCOLS,
    aliases=MappingProxyType(
        {"hamt": "duet", "navillm": "duet", "hm3d": "scalevln", "mapgpt": "navrag"}
    ),
    hops_by_alias=MappingProxyType({"hamt": "first viewpoint"}),
    headline=("path_length", "success", "oracle_success", "spl", "rgs", PRIMARY_METRIC),
    ranking=(PRIMARY_METRIC, "rgs", "spl"),
)
