"""Protocols: the rules that published evaluators score by, as data.

A protocol's numbers never change once it is released; a correction is a new protocol. Thresholds
that protocols share are defined with the arithmetic that uses them, in :mod:`reverie_eval.metrics`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from reverie_eval.errors import ProtocolError
from reverie_eval.text import did_you_mean

GoalRule = Literal["visible", "visible and near the object", "near the path's end"]
Grounding = Literal["anywhere", "only with success", "not scored"]
HopReading = Literal["first viewpoint", "every viewpoint", "rejected", "no evaluator"]
"""What a published evaluator makes of a nested hop with several viewpoints."""


@dataclass(frozen=True, slots=True)
class Protocol:
    """The rules that a published evaluator scores by."""

    name: str
    summary: str
    source: str
    # The defaults are the rules of the dataset's own script; protocols list only what differs.
    goal: GoalRule = "visible"
    """Which viewpoints are goals: those from which the target is visible; those from which it is
    visible with its centre at most 3 m from the camera; or those less than 3 m along the graph from
    the path's end."""
    spl_numerator: Literal["shortest", "annotated"] = "shortest"
    """The length in SPL's numerator: of the shortest route, or of the annotated path."""
    spl_floor: float = 0.0
    """Smallest denominator of SPL, metres."""
    rgspl_floor: float = 0.0
    """Smallest denominator of RGSPL, metres."""
    grounding: Grounding = "anywhere"
    """Where a correct answer counts: wherever the agent stops, or only with success."""
    text_ids_count: bool = True
    """Whether an object id written as text can be correct."""
    nested_hops: HopReading = "first viewpoint"
    """What the published evaluator makes of nested hops. It is not a rule of the scores, which
    count every viewpoint under all protocols."""


_RELEASED = (
    Protocol(
        name="official-v1",
        summary="the dataset's own script: the target is visible at the stop",
        source="YuankaiQi/REVERIE 0fe0955, tasks/REVERIE/eval_release.py",
    ),
    Protocol(
        name="paper",
        summary="the paper's text: grounding counts only if the target is visible at the stop",
        source="Qi et al., REVERIE, CVPR 2020, section 3",
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
)

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType({rules.name: rules for rules in _RELEASED})
"""Every released protocol by its name; the default comes first."""

ALIASES: Mapping[str, str] = MappingProxyType({"hamt": "duet", "hm3d": "scalevln"})
"""Other names of protocols: codebases that score the same way."""

DEFAULT_PROTOCOL = "official-v1"

# HAMT's evaluator differs from DUET's in nothing else.
_HOPS_BY_ALIAS: Mapping[str, HopReading] = MappingProxyType({"hamt": "first viewpoint"})


def find_protocol(name: str) -> Protocol:
    """Return the protocol with this name or alias.

    Raises
    ------
    ProtocolError
        If there is no such protocol.
    """
    canonical = ALIASES.get(name, name)
    if canonical not in PROTOCOLS:
        known = [*PROTOCOLS, *ALIASES]
        raise ProtocolError(f"unknown protocol {name!r}{did_you_mean(name, known)}")
    return PROTOCOLS[canonical]


def hop_reading(name: str) -> HopReading:
    """Return what the evaluator of a protocol or alias makes of nested hops.

    Raises
    ------
    ProtocolError
        If there is no such protocol.
    """
    return _HOPS_BY_ALIAS.get(name, find_protocol(name).nested_hops)


FIRST_OF_HOP: Sequence[str] = [
    name for name in (*PROTOCOLS, *ALIASES) if hop_reading(name) == "first viewpoint"
]
"""Protocols and aliases whose evaluators read only the first viewpoint of each hop."""
