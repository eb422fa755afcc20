"""Where the levels of a building are on a page: stacked sheets, the lowest at the bottom.

All sheets are as large as the whole building, so that one point of it is at the same place on each
of them.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting.map_layout import WIDTH
from reverie_eval.reporting.walls import HEIGHT as WALL_HEIGHT

# The greatest height, and the space around and between sheets, in units of the page; where titles
# begin, left of all sheets; how many sheets are always in one column.
_HIGHEST, _MARGIN, _GAP, _TITLE_LEFT, _STACKED = 560, 14, 12, 4.0, 3


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
    def of(cls, levels: Sequence[int], corners: FloatArray, below: float) -> Self:
        """Stack levels, in two columns if there are many and they are larger then.

        Parameters
        ----------
        levels : sequence of int
            The highest first.
        corners : float array of shape (n, 2)
            What the building takes up: projected to the right and down, metres.
        below : float
            Units of the page that stay free below the sheets.
        """
        wide, high = np.ptp(corners, axis=0) + np.array([0.0, WALL_HEIGHT])

        def scale_in(columns: int) -> float:
            rows = -(-len(levels) // columns)
            free = _HIGHEST - 2 * _MARGIN - below - _GAP * (rows - 1)
            return float(min((WIDTH / columns - 2 * _MARGIN) / wide, free / (rows * high)))

        columns = max((1, 2) if len(levels) > _STACKED else (1,), key=scale_in)
        scale, width = scale_in(columns), WIDTH / columns
        # The first column has the lowest levels, and the lowest of both stand side by side.
        stacks = np.array_split(levels, columns)[::-1]
        n_rows = max(map(len, stacks))
        height = n_rows * scale * high + (n_rows - 1) * _GAP + 2 * _MARGIN + below
        origin, title_left = {}, {}
        for column, stack in enumerate(stacks):
            left = width * (column + 0.5) - scale * (corners[:, 0].min() + wide / 2)
            foot = height - below - _MARGIN - scale * corners[:, 1].max()
            for row, level in enumerate(reversed(stack.tolist())):
                origin[level] = np.array([left, foot - row * (scale * high + _GAP)])
                title_left[level] = width * column + _TITLE_LEFT
        return cls(scale, height, origin, title_left)
