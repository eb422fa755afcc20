"""What is listed at a viewpoint, and what counts as hidden there."""

from dataclasses import dataclass
from typing import Literal

Occlusion = Literal["none", "paper"]
"""``none``: every box stays. ``paper``: see :func:`~.occlusion.is_hidden`."""

MAX_DISTANCE = 3.0
"""Metres. Source: Qi et al., "REVERIE", CVPR 2020, section 3: objects within 3 metres. The released
files list what is nearer than 2 metres (38,283 of their 38,293 entries)."""

EXCLUDED_NAMES = frozenset(
    {
        "ceiling",
        "delete",
        "door",
        "door frame",
        "doorframe",
        "floor",
        "handrail",
        "object",
        "remove",
        "roof",
        "shower floor",
        "stairs",
        "unknown",
        "wall",
        "wall frame",
    }
)
"""Raw category names that are frequent in Matterport3D and occur nowhere in the released files.

They are compared as they stand: ``shower wall``, ``garage door`` and ``doorway`` are listed there.
"""


@dataclass(frozen=True, slots=True)
class Rules:
    """How boxes are built."""

    max_distance: float = MAX_DISTANCE
    """Metres from the camera to an object's centre; what is not nearer is not listed."""
    occlusion: Occlusion = "none"
    excluded_names: frozenset[str] = EXCLUDED_NAMES
    """Objects of these names are not listed, and hide nothing."""
