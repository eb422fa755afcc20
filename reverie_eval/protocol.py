"""The rules a score is made by: thresholds with names, and protocols as data.

A protocol's numbers never change once it is released; a correction is a new protocol.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from reverie_eval.errors import ProtocolError

IOU_THRESHOLD = 0.5
"""A box answers right if its intersection over union with the target's is at least this.

Source: Qi et al., "REVERIE: Remote Embodied Visual Referring Expression in Real Indoor
Environments", CVPR 2020, section 3 on the evaluation of REVERIE success.
"""


@dataclass(frozen=True, slots=True)
class Protocol:
    """The rules that a published evaluator scores by."""

    name: str
    summary: str
    source: str


OFFICIAL_V1 = Protocol(
    name="official-v1",
    summary="The target is visible where the agent stops; grounding counts on its own.",
    source="github.com/YuankaiQi/REVERIE, tasks/REVERIE/eval_release.py at 0fe0955",
)

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType({OFFICIAL_V1.name: OFFICIAL_V1})
DEFAULT_PROTOCOL = OFFICIAL_V1.name


def protocol_named(name: str) -> Protocol:
    """Return the protocol of that name.

    Raises
    ------
    ProtocolError
        If there is none.
    """
    if name not in PROTOCOLS:
        raise ProtocolError(f"no protocol {name!r}; choose one of: {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]
