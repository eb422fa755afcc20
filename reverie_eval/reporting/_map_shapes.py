"""What a map is drawn of: its signs and lines as SVG, coloured by the classes that they carry."""

from collections.abc import Iterable, Iterator
from html import escape

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting._map_frame import Frame

_STAR = np.array(
    [
        (radius * np.sin(turn), -radius * np.cos(turn))
        for turn, radius in zip(np.arange(10) * np.pi / 5, [7.5, 3.2] * 5, strict=True)
    ]
)
_RADIUS = {"start": 5.5, "success": 7.0}


def path(kind: str, pieces: Iterable[str]) -> str:
    """Draw one path of many pieces."""
    return f'<path class="{kind}" d="{"".join(pieces)}"/>'


def circle(kind: str, place: FloatArray, title: str = "") -> str:
    """Draw the sign of a ``start`` or a ``success``."""
    x, y = place
    shape = f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{_RADIUS[kind]:g}">'
    return f"{shape}{title_of(title)}</circle>"


def goal(place: FloatArray, title: str = "") -> str:
    """Draw the star at the end of an annotated path."""
    return f'<path class="goal" d="{line(_STAR + place)}z">{title_of(title)}</path>'


def stop(place: FloatArray, number: int, title: str = "") -> str:
    """Draw where the agent of the submission with this number stopped."""
    x, y = place - 4.5
    shape = f'<rect class="stop route-{number}" x="{x:.1f}" y="{y:.1f}" width="9" height="9">'
    return f"{shape}{title_of(title)}</rect>"


def scale(frame: Frame) -> Iterator[str]:
    """Draw a bar of so many metres in the lower left corner."""
    length, bottom = frame.bar * frame.scale, frame.height
    yield f'<path class="scale" d="M10 {bottom - 14:g}v4h{length:.1f}v-4"/>'
    yield f'<text class="scale" x="14" y="{bottom - 16:g}">{frame.bar} m</text>'


def title_of(text: str) -> str:
    """Name a shape for whoever points at it, if there is something to say."""
    return f"<title>{escape(text)}</title>" if text else ""


def line(points: FloatArray) -> str:
    """Return a path's piece through points of shape (n_points, 2)."""
    return "M" + "L".join(map(coordinates, points))


def coordinates(point: FloatArray) -> str:
    """Write one point."""
    x, y = point
    return f"{x:.1f} {y:.1f}"
