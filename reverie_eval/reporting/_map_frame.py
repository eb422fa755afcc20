"""Where a map's viewpoints, routes and arrows are on the page."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.geometry import FOCAL_LENGTH
from reverie_eval.geometry import WIDTH as VIEW_WIDTH
from reverie_eval.reporting._charts import round_numbers
from reverie_eval.reporting._maps import EpisodeMap, Route

WIDTH, HEIGHT = 400, 300
"""Size of a map, in units of the page."""
_MARGIN = 1.5
"""Smallest margin around the viewpoints of the episode, in metres."""
_LEAST_METRES = 8.0
"""Smallest width of a map, in metres."""
_LANE = 3.4
"""Units of the page between two routes; the first is half of it to the right of the edges, so that
the way there and the way back are two lines."""
_ARROW_SIZE = 9.0
_ARROW_PLACE = 0.62
"""Position along a leg: beyond its middle, so that arrows of both directions are side by side."""
_BAR_SHARE = 0.25
"""Greatest length of the scale's bar, as a fraction of the width."""
STAIRS = ((-6, -5), (-6, -2), (-2, -2), (-2, 1), (2, 1), (2, 4), (6, 4))
"""The sign for stairs, in units of the page to the right and upwards."""
_VIEW_ANGLE = 2 * np.arctan(VIEW_WIDTH / 2 / FOCAL_LENGTH)
"""Horizontal field of view of a view, radians."""
_SIGHT_RADIUS, _SIGHT_POINTS = 30.0, 9


@dataclass(frozen=True, slots=True)
class Frame:
    """The part of a scan that is shown; units of the page go to the right and down."""

    left: float
    """Metres."""
    top: float
    """Metres."""
    scale: float
    """Units of the page per metre."""

    @classmethod
    def around(cls, episode_map: EpisodeMap) -> Self:
        """Show all viewpoints of the episode, as large as possible."""
        place = episode_map.position[episode_map.visited, :2]
        low, high = place.min(axis=0) - _MARGIN, place.max(axis=0) + _MARGIN
        across, down = high - low
        metres = max(across, down * WIDTH / HEIGHT, _LEAST_METRES)
        x, y = (low + high) / 2
        scale = WIDTH / metres
        return cls(float(x - metres / 2), float(y + HEIGHT / scale / 2), scale)

    def place(self, position: FloatArray) -> FloatArray:
        """Return where positions, in metres with x and y first, are on the page: shape (..., 2)."""
        x, y = position[..., 0] - self.left, self.top - position[..., 1]
        return self.scale * np.stack([x, y], axis=-1)

    def lanes(self, episode_map: EpisodeMap, route: Route) -> FloatArray:
        """Return the ends of a route's legs, shape (n_legs, 2, 2), moved aside for other routes."""
        ends = self.place(episode_map.position[route.legs])
        along = ends[:, 1] - ends[:, 0]
        length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
        to_the_right = np.stack([-along[:, 1], along[:, 0]], axis=-1) / length
        return ends + _LANE * (route.number - 0.5) * to_the_right[:, None]

    @property
    def bar_metres(self) -> int:
        """The length of the scale's bar, a round number of metres."""
        most = _BAR_SHARE * WIDTH / self.scale
        length = 1
        for metres in round_numbers():
            if metres > most:
                break
            length = metres
        return length


def arrows(lanes: FloatArray) -> Iterator[FloatArray | None]:
    """Yield an arrowhead for each leg, a triangle of shape (3, 2); None if it has no room."""
    for start, end in lanes:
        length = float(np.hypot(*(end - start)))
        if length <= 2 * _ARROW_SIZE:
            yield None
            continue
        ahead = _ARROW_SIZE * (end - start) / length
        aside = np.array([-ahead[1], ahead[0]])
        place = start + _ARROW_PLACE * (end - start)
        tip, tail = place + 0.6 * ahead, place - 0.6 * ahead
        yield np.array([tip, tail + 0.55 * aside, tail - 0.55 * aside])


def sector(heading: float) -> FloatArray:
    """Return the outline, shape (n, 2), of a view's field of view, relative to its camera."""
    turns = heading + _VIEW_ANGLE * np.linspace(-0.5, 0.5, _SIGHT_POINTS)
    arc = _SIGHT_RADIUS * np.column_stack([np.sin(turns), -np.cos(turns)])
    return np.vstack([np.zeros(2), arc])


def level_labels(episode_map: EpisodeMap) -> Iterator[tuple[str, Sequence[int]]]:
    """Label stairs and the ends of the episode with their levels, if it is on several.

    Yields each label with the viewpoints that it belongs to: two for stairs, one for an end.
    """
    if not episode_map.leaves_level:
        return
    for stairs in episode_map.stairs.tolist():
        yield "-".join(map(str, episode_map.levels(stairs))), stairs
    ends = [episode_map.start, episode_map.path_end, *(each.stop for each in episode_map.routes)]
    for row in dict.fromkeys(ends):
        (level,) = episode_map.levels([row])
        yield f"level {level}", [row]
