"""Where the levels of a building are on a page: stacked sheets, the lowest at the bottom."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting.map_layout import WIDTH
from reverie_eval.reporting.walls import HEIGHT as WALL_HEIGHT

# The greatest height, and the space around and between sheets, in units of the page; where titles
# begin, left of all sheets; how many sheets are always in one column.
_HIGHEST, _MARGIN, _GAP, _TITLE_LEFT, _STACKED = 460, 14, 20, 4.0, 3


class Sheets(NamedTuple):
    """Where the sheets of levels are."""

    scale: float
    """Units of the page per metre."""
    height: float
    """The height of the page, in its units."""
    origin: Mapping[int, FloatArray]
    """Shape (2,): where the origin of a level's projection is."""
    title_left: Mapping[int, float]
    """Where the title of a level begins."""

    @classmethod
    def of(cls, corners: Mapping[int, FloatArray], below: float) -> Self:
        """Stack levels, in two columns if there are many and they are larger then.

        Parameters
        ----------
        corners : mapping of int to float array of shape (n, 2)
            What each level takes up, the highest first: projected to the right and down, metres.
        below : float
            Units of the page that stay free below them.
        """
        choices = [
            [_Column({level: corners[level] for level in its}) for its in _split(corners, count)]
            for count in ((1, 2) if len(corners) > _STACKED else (1,))
        ]
        columns = max(choices, key=lambda each: _scale_of(each, below))
        scale, width = _scale_of(columns, below), WIDTH / len(columns)
        height = max(each.height(scale) for each in columns) + 2 * _MARGIN + below
        origin, title_left = {}, {}
        for row, column in enumerate(columns):
            left = width * (row + 0.5) - scale * column.across.mean()
            # The lowest levels of both columns stand side by side.
            top = height - below - _MARGIN - column.height(scale)
            for level, its in column.corners.items():
                origin[level] = np.array([left, top - scale * (its[:, 1].min() - WALL_HEIGHT)])
                title_left[level] = width * row + _TITLE_LEFT
                top += scale * (np.ptp(its[:, 1]) + WALL_HEIGHT) + _GAP
        return cls(scale, height, origin, title_left)


class _Column(NamedTuple):
    """Levels above each other."""

    corners: Mapping[int, FloatArray]

    @property
    def across(self) -> FloatArray:
        """The least and the greatest coordinate to the right, metres."""
        every = np.vstack(list(self.corners.values()))[:, 0]
        return np.array([every.min(), every.max()])

    @property
    def tall(self) -> float:
        """Metres, without the gaps."""
        return float(sum(np.ptp(its[:, 1]) + WALL_HEIGHT for its in self.corners.values()))

    @property
    def gaps(self) -> float:
        return _GAP * (len(self.corners) - 1)

    def height(self, scale: float) -> float:
        """Return the height at a scale, in units of the page."""
        return scale * self.tall + self.gaps


def _split(levels: Mapping[int, FloatArray], count: int) -> Sequence[Sequence[int]]:
    """Return the levels of each column, the highest first; the first column has the lowest."""
    return [its.tolist() for its in np.array_split(list(levels), count)[::-1]]


def _scale_of(columns: Sequence[_Column], below: float) -> float:
    """Return the largest scale at which columns are on a page."""
    wide, high = WIDTH / len(columns) - 2 * _MARGIN, _HIGHEST - 2 * _MARGIN - below
    scales = [
        min(wide / float(np.ptp(its.across)), (high - its.gaps) / its.tall) for its in columns
    ]
    return min(scales)
