"""An episode's walk through its building, on stacked floors, as SVG. It stands, or plays."""

from collections.abc import Iterator
from functools import cached_property
from itertools import chain

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting.answer_svg import ANSWER_STYLE
from reverie_eval.reporting.drawing import element, image_svg, line_data, path, path_data
from reverie_eval.reporting.floors_svg import Floors
from reverie_eval.reporting.map_layout import WIDTH, Layout, Mark
from reverie_eval.reporting.map_marks import MAP_STYLE, draw_mark
from reverie_eval.reporting.maps import EpisodeMap, Route
from reverie_eval.reporting.resources import text_of

BUILDING_STYLE = MAP_STYLE + ANSWER_STYLE + text_of("shared/building.css")
"""The style sheet for pages with buildings."""
SECONDS = 8
"""How long a walk plays, as in ``building.css``."""
# The left margin of the key, and the height of its lines, in units of the page.
_MARGIN, _LINE = 14, 16
# Units of the page between the walk and a name.
_CLEAR = 7


class BuildingPicture:
    """The floors of an episode and its walk, as a drawing."""

    def __init__(self, episode_map: EpisodeMap, target: int | None = None) -> None:
        """Lay out the picture; the object ``target`` is marked, if it is given."""
        self._map, self._target = episode_map.cropped(), target
        self._key = [route for route in episode_map.routes if route.name]
        self._floors = Floors(self._map, below=_LINE * len(self._key))
        self._layout = Layout(self._map, self._floors)
        self.height = self._floors.height
        """In units of the page."""

    def svg(self, *, plays: bool = False) -> str:
        """Draw the building for a page that includes ``BUILDING_STYLE``."""
        return self._svg(self.shapes(plays=plays))

    def picture(self, *, plays: bool = False, share: float = 1.0) -> str:
        """Draw the building with its style sheet, for a file; of the walk, only a share."""
        return self._svg(self.shapes(plays=plays, share=share), BUILDING_STYLE)

    def _svg(self, shapes: str, style: str = "") -> str:
        return image_svg(
            "episode-map building",
            (WIDTH, self.height),
            shapes,
            f"Building of episode {self._map.instr_id}",
            description=self._map.description,
            style=style,
        )

    def shapes(self, *, plays: bool = False, share: float = 1.0) -> str:
        """Draw what the picture consists of."""
        return f"{self._floors.shapes}{''.join(self._walks(share, plays=plays))}{self._named}"

    @cached_property
    def _named(self) -> str:
        taken = [*self._floors.taken, *self._taken()]
        names = chain.from_iterable(
            self._layout.room_names(level, taken) for level in self._floors.levels
        )
        drawn = (draw_mark(each.mark) for each in names if each.mark)
        return "".join([*drawn, *self._key_lines()])

    def _key_lines(self) -> Iterator[str]:
        """Explain whose each route is, if they have names."""
        for row, route in enumerate(self._key):
            y = self.height - _LINE * (len(self._key) - row) + _LINE / 2
            yield path(f"route route-{route.number}", f"M{_MARGIN} {y:.1f}h24")
            yield draw_mark(Mark("right of", np.array([_MARGIN + 32.0, y + 4]), text=route.name))

    def _taken(self) -> Iterator[FloatArray]:
        """Yield the boxes, shape (2, 2), of the walks and the target's pin."""
        for rows in (self._map.annotated_path, *(each.viewpoint for each in self._map.routes)):
            for point in _points_along(self._layout.point[rows]):
                yield np.stack([point - _CLEAR, point + _CLEAR])
        if (spot := self._target_point()) is not None:
            yield spot + np.array([(-8, -26), (8, 2)])

    def _walks(self, share: float, *, plays: bool) -> Iterator[str]:
        yield path("annotated", line_data(self._layout.point[self._map.annotated_path]))
        for route in self._map.routes:
            yield from self._walk(route, share, plays=plays)
        for piece in self._layout.ends():
            if piece.mark and (piece.mark.kind != "stop" or (share == 1 and not plays)):
                yield draw_mark(piece.mark)
        if (spot := self._target_point()) is not None:
            yield path("pin", f"M{spot[0]:.1f} {spot[1]:.1f}v-16")
            yield element("circle", f'class="pin" cx="{spot[0]:.1f}" cy="{spot[1] - 18:.1f}" r="5"')

    def _walk(self, route: Route, share: float, *, plays: bool) -> Iterator[str]:
        whole = self._layout.point[route.viewpoint]
        data, kind = line_data(cut(whole, share)) + "h0", f"route route-{route.number}"
        playing = ' pathLength="1"' if plays else ""
        yield element("path", f'class="{kind}{" plays" * plays}" d="{data}"{playing}')
        climbs = np.flatnonzero(np.diff(self._map.storey[route.viewpoint]))
        if len(climbs):
            between = [whole[leg : leg + 2] for leg in climbs.tolist()]
            yield path("between", path_data("between", between))
        if plays:
            yield element("path", f'class="{kind} walker" d="{data}"{playing}')
        elif share < 1:
            yield path(f"{kind} at", line_data(cut(whole, share)[-1:]) + "h0")

    def _target_point(self) -> FloatArray | None:
        """Return where the target is; None if it is not marked, or not on these levels."""
        solids = self._map.building.solids
        rows = np.flatnonzero(solids.object_id == self._target)
        if not len(rows) or int(solids.storey[rows[0]]) not in self._floors.levels:
            return None
        return self._floors.points(solids.centre[rows[0]], int(solids.storey[rows[0]]))


def cut(line: FloatArray, share: float) -> FloatArray:
    """Return the first part of a line of shape (n, 2).

    Examples
    --------
    >>> cut(np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0)]), 0.75).tolist()
    [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]
    """
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    walked = share * length[-1]
    end = [np.interp(walked, length, line[:, axis]) for axis in (0, 1)]
    return np.vstack([line[length < walked], end])


def _points_along(line: FloatArray) -> FloatArray:
    """Return points on a line, not farther apart than a name could hide between them."""
    length = np.hypot(*np.diff(line, axis=0).T).sum()
    shares = np.linspace(0, 1, int(length // _CLEAR) + 1)
    return np.array([cut(line, share)[-1] for share in shares])
