"""The signs of maps and buildings as SVG, and what they mean."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from reverie_eval.reporting.drawing import element, line_data, path, text_at
from reverie_eval.reporting.map_layout import Mark
from reverie_eval.reporting.maps import Sign, SignKind
from reverie_eval.reporting.resources import text_of

MAP_STYLE = text_of("shared/map.css")
"""The style sheet for pages with maps and their keys."""
_STAR = np.array(
    [
        (radius * np.sin(turn), -radius * np.cos(turn))
        for turn, radius in zip(np.arange(10) * np.pi / 5, [7.5, 3.2] * 5, strict=True)
    ]
)
_RADIUS = {"start": 5.5, "goal": 7.0}
# The signs in a key that are lines: class and path data.
_KEY_LINES: Mapping[SignKind, tuple[str, str]] = MappingProxyType(
    {
        "sight": ("sight", "M8 8L34 0V16z"),
        "jump": ("route jump", "M4 8H36"),
        "annotated": ("annotated", "M6 8H34"),
        "climb": ("route climb", "M4 8H36"),
        "elsewhere": ("viewpoint elsewhere", "M12 8h0M28 8h0"),
        "plan": ("wall", "M4 13V3H16M26 3H36V13"),
    }
)


def sign_shapes(sign: Sign) -> str:
    """Draw a sign for a key, 40 units wide and 16 high."""
    middle = np.array([20.0, 8.0])
    match sign.kind:
        case "stop":
            line = path(f"route route-{sign.route}", "M2 8H30")
            return line + draw_mark(Mark("stop", np.array([33.0, 8.0]), sign.route))
        case "start" | "goal" | "end":
            return draw_mark(Mark(sign.kind, middle))
        case _:
            return path(*_KEY_LINES[sign.kind])


def draw_mark(mark: Mark, title: str = "") -> str:
    """Draw a mark, with a tooltip if it has a title."""
    x, y = mark.point
    match mark.kind:
        case "start" | "goal":
            radius = _RADIUS[mark.kind]
            shape = f'class="{mark.kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}"'
            return element("circle", shape, title)
        case "end":
            return path("end", f"{line_data(_STAR + mark.point)}z", title)
        case "stop":
            corner = f'x="{x - 4.5:.1f}" y="{y - 4.5:.1f}" width="9" height="9"'
            return element("rect", f'class="stop route-{mark.route}" {corner}', title)
        case "name":
            return text_at(x, y, mark.text, 'class="room-name" text-anchor="middle"')
        case "left of" | "right of":
            return _label(x, y, mark.text, "end" if mark.kind == "left of" else "")


def _label(x: float, y: float, text: str, anchor: str) -> str:
    attribute = f' text-anchor="{anchor}"' if anchor else ""
    return text_at(x, y, text, f'class="level"{attribute}')
