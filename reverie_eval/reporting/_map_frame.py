"""Which part of a scan a map shows, and where on the page its places come to lie."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting._bins import round_numbers
from reverie_eval.reporting._maps import EpisodeMap, Route

MARGIN = 1.5
"""Metres of the scan that are shown around what the episode is about, at least."""
LEAST_METRES = 8.0
"""Shown across, at least."""
LANE = 3.4
"""By how much a route keeps to the right of the way, so that going and coming are two lines."""
_ARROW_AT = 0.62
"""Share of a leg that an arrow stands behind."""
_BAR_SHARE = 0.25
"""Of the width that the scale's bar has at most."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A window on a scan: metres inside, the page's own units outside, y downwards."""

    width: float
    height: float
    left: float
    """Metres, of the left edge."""
    top: float
    """Metres, of the upper edge."""
    scale: float
    """Units of the page for a metre."""

    @classmethod
    def around(cls, episode_map: EpisodeMap, width: float, height: float) -> Self:
        """Show all that the episode is about, as large as it can be."""
        place = episode_map.position[episode_map.concerned, :2]
        low, high = place.min(axis=0) - MARGIN, place.max(axis=0) + MARGIN
        across, down = high - low
        metres = max(across, down * width / height, LEAST_METRES)
        x, y = (low + high) / 2
        scale = width / metres
        return cls(width, height, float(x - metres / 2), float(y + height / scale / 2), scale)

    def place(self, position: FloatArray) -> FloatArray:
        """Return where positions, in metres with x and y first, come to lie: shape (..., 2)."""
        x, y = position[..., 0] - self.left, self.top - position[..., 1]
        return self.scale * np.stack([x, y], axis=-1)

    @property
    def bar(self) -> int:
        """The length of the scale's bar: a round number of metres."""
        most = _BAR_SHARE * self.width / self.scale
        length = 1
        for metres in round_numbers():
            if metres > most:
                break
            length = metres
        return length

    def lane_of(self, episode_map: EpisodeMap, route: Route) -> FloatArray:
        """Return both ends of every leg of a route, on its own lane: shape (n_legs, 2, 2)."""
        ends = self.place(episode_map.position[route.legs])
        along = ends[:, 1] - ends[:, 0]
        length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
        to_the_right = np.stack([-along[:, 1], along[:, 0]], axis=-1) / length
        lane = 2 * _number(episode_map, route) + 1
        return ends + LANE * lane / 2 * to_the_right[:, None]


def _number(episode_map: EpisodeMap, route: Route) -> int:
    return next(n for n, each in enumerate(episode_map.routes) if each is route)


def arrows(lane: FloatArray, size: float) -> Iterator[FloatArray]:
    """Return a triangle, shape (3, 2), on each leg that has room for one.

    Beyond its middle, so that those of going and coming stand side by side.
    """
    for start, end in lane:
        length = float(np.hypot(*(end - start)))
        if length > 2 * size:
            ahead = (end - start) / length
            aside = np.array([-ahead[1], ahead[0]])
            place = start + _ARROW_AT * (end - start)
            tip, tail = place + 0.6 * size * ahead, place - 0.6 * size * ahead
            yield np.array([tip, tail + 0.55 * size * aside, tail - 0.55 * size * aside])
