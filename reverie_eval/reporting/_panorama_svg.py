"""The panorama around a person who plays an episode, as SVG with links to objects and moves."""

from collections.abc import Iterator, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from reverie_eval.analysis import VisibleObject
from reverie_eval.reporting._answer_svg import (
    HIGHEST,
    STRIP_HEIGHT,
    TICKS_HEIGHT,
    WIDTH,
    on_panorama,
    panorama_grid,
    strip_place,
)
from reverie_eval.reporting._answer_views import span_of
from reverie_eval.reporting._skyboxes import Skybox

_RADIUS = 4


class ObjectLink(NamedTuple):
    """An object, and the address to which its link leads."""

    seen: VisibleObject
    name: str
    """Shown above it."""
    label: str
    """Distinguishes it from other objects of the same name."""
    href: str


class WayLink(NamedTuple):
    """A viewpoint that the person can move to, and the address to which its link leads."""

    heading: float
    """Degrees."""
    elevation: float
    """Degrees."""
    label: str
    href: str


def panorama_svg(
    objects: Sequence[ObjectLink],
    ways: Sequence[WayLink],
    heading: float,
    skybox: Skybox | None = None,
) -> str:
    """Draw a panorama for a page that includes ``ANSWER_STYLE``.

    Parameters
    ----------
    objects, ways
        What is drawn, as links.
    heading : float
        The heading in the middle, degrees.
    skybox : Skybox, optional
        The photographs under the links, if there are any.
    """
    height = STRIP_HEIGHT + TICKS_HEIGHT
    photograph = skybox.panorama(heading, HIGHEST) if skybox else ""
    title = f"Panorama, with heading {heading % 360:.0f}° in the middle"
    return "".join(
        [
            f'<svg class="answer-view panorama" viewBox="0 0 {WIDTH} {height:.0f}">',
            f"<title>{escape(title)}</title>",
            *panorama_grid(heading, photograph),
            *(element for link in objects for element in _object(link, heading)),
            *(element for link in ways for element in _way(link, heading)),
            "</svg>",
        ]
    )


def _object(link: ObjectLink, middle: float) -> Iterator[str]:
    span = span_of(link.seen)
    x, y = strip_place(np.array([span.middle, span.high]), middle)
    yield f'<a href="{escape(link.href)}" aria-label="{escape(link.label)}">'
    yield from on_panorama("other", span, middle, link.label)
    yield f'<text class="name" x="{x:.1f}" y="{max(y - 1, 5):.1f}">{escape(link.name)}</text></a>'


def _way(link: WayLink, middle: float) -> Iterator[str]:
    x, y = strip_place(np.array([link.heading, link.elevation]), middle)
    place = f'cx="{x:.1f}" cy="{y:.1f}" r="{_RADIUS}"'
    yield f'<a href="{escape(link.href)}" aria-label="{escape(link.label)}">'
    yield f'<circle class="way" {place}><title>{escape(link.label)}</title></circle></a>'
