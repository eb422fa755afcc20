"""The rules a score is made by: thresholds with names, and protocols as data.

A protocol's numbers never change once it is released; a correction is a new protocol.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from reverie_eval.errors import ProtocolError

IOU_THRESHOLD = 0.5
"""A box answers right if its intersection over union with the target's is at least this.

Source: Qi et al., "REVERIE: Remote Embodied Visual Referring Expression in Real Indoor
Environments", CVPR 2020, section 3 on the evaluation of REVERIE success.
"""

LOOSE_IOU_THRESHOLD, STRICT_IOU_THRESHOLD = 0.25, 0.75
"""Shown beside the benchmark's own threshold, to tell nearly right boxes from exact ones."""

SUCCESS_DISTANCE = 3.0
"""Metres that count as near, in protocols that measure. Source: Anderson et al.,
"Vision-and-Language Navigation", CVPR 2018, section 4.2; each protocol's comparison is its own."""

FIDELITY_DISTANCE = 3.0
"""Metres at which path fidelity has fallen to 1/e. Source: arXiv:1907.05446, arXiv:1905.12255."""

GoalRule = Literal["visible", "visible and near the object", "near the path's end"]
Grounding = Literal["anywhere", "only with success", "not scored"]


@dataclass(frozen=True, slots=True)
class Protocol:
    """The rules that a published evaluator scores by."""

    name: str
    summary: str
    source: str
    goal: GoalRule = "visible"
    """Which viewpoints count: where the target is visible; where it is visible and the camera at
    most 3 m from its centre; or less than 3 m along the graph from the annotated path's end."""
    spl_numerator: Literal["shortest", "annotated"] = "shortest"
    """Whose length success is weighted with: the shortest route's or the annotated path's."""
    spl_floor: float = 0.0
    """Metres that SPL's denominator is at least."""
    rgspl_floor: float = 0.0
    """Metres that RGSPL's denominator is at least."""
    grounding: Grounding = "anywhere"
    """Whether the right object counts wherever the agent stops, or only where it succeeds."""
    text_ids_count: bool = True
    """Whether an object id that is written as text can be right."""


_RELEASED = (
    Protocol(
        name="official-v1",
        summary="the dataset's own script: the target is visible at the stop",
        source="YuankaiQi/REVERIE 0fe0955, tasks/REVERIE/eval_release.py",
    ),
    Protocol(
        name="paper",
        summary="the paper's text: grounding counts only where the target is visible at the stop",
        source="Qi et al., REVERIE, CVPR 2020, section 3",
        grounding="only with success",
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
        summary="Airbert and Rec-VLN-BERT: as the dataset's script, with a floor in SPL",
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
    ),
    Protocol(
        name="scalevln",
        summary="ScaleVLN and HM3DAutoVLN: as DUET, and grounding needs success",
        source="wz0919/ScaleVLN 3bdff0d, VLN-DUET-RVR; cshizhe/HM3DAutoVLN b5ba669",
        spl_numerator="annotated",
        spl_floor=0.01,
        rgspl_floor=0.01,
        grounding="only with success",
    ),
    Protocol(
        name="r2r-style",
        summary="Room-to-Room's rule: less than 3 m from the end of the annotated path",
        source="peteanderson80/Matterport3DSimulator 589d091, tasks/R2R/eval.py",
        goal="near the path's end",
        grounding="not scored",
    ),
)

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType({rules.name: rules for rules in _RELEASED})
"""Every released protocol by its name, the default first."""

ALIASES: Mapping[str, str] = MappingProxyType({"hamt": "duet", "hm3d": "scalevln"})
"""Other names of protocols: codebases that score alike."""

DEFAULT_PROTOCOL = "official-v1"


def protocol_named(name: str) -> Protocol:
    """Return the protocol of that name or alias.

    Raises
    ------
    ProtocolError
        If there is none.
    """
    canonical = ALIASES.get(name, name)
    if canonical not in PROTOCOLS:
        known = ", ".join([*PROTOCOLS, *ALIASES])
        raise ProtocolError(f"no protocol {name!r}; choose one of: {known}")
    return PROTOCOLS[canonical]
