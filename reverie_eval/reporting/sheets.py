"""Where the levels of a building are on a page: stacked sheets, the lowest at the bottom.

In a column, what is above something is drawn above it, and no level takes up more than it needs.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting.map_layout import WIDTH

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
    def of(cls, corners: Mapping[int, FloatArray], below: float) -> Self:
        """Stack levels, in two columns if there are many and they are larger then.

        Parameters
        ----------
        corners : mapping of int to float array of shape (n, 2)
            What each level takes up, the highest first: projected to the right and down, metres.
        below : float
            Units of the page that stay free below the sheets.
        """
        across = np.concatenate([each[:, 0] for each in corners.values()])
        wide = float(np.ptp(across))
        high = {level: float(np.ptp(each[:, 1])) for level, each in corners.items()}

        def scale_of(stacks: Sequence[Sequence[int]]) -> float:
            free = [_HIGHEST - 2 * _MARGIN - below - _GAP * (len(each) - 1) for each in stacks]
            rows = [sum(high[level] for level in each) for each in stacks]
            fitting = (WIDTH / len(stacks) - 2 * _MARGIN) / wide
            return min(fitting, *(its / row for its, row in zip(free, rows, strict=True)))

        numbers = (1, 2) if len(corners) > _STACKED else (1,)
        stacks = max((_stacks(list(corners), number) for number in numbers), key=scale_of)
        scale, width = scale_of(stacks), WIDTH / len(stacks)
        rows = [sum(scale * high[level] + _GAP for level in each) - _GAP for each in stacks]
        height = max(rows) + 2 * _MARGIN + below
        origin, title_left = {}, {}
        for column, stack in enumerate(stacks):
            left = width * (column + 0.5) - scale * (across.min() + wide / 2)
            foot = height - below - _MARGIN
            for level in reversed(stack):
                origin[level] = np.array([left, foot - scale * corners[level][:, 1].max()])
                title_left[level] = width * column + _TITLE_LEFT
                foot -= scale * high[level] + _GAP
        return cls(scale, height, origin, title_left)


def _stacks(levels: Sequence[int], number: int) -> Sequence[Sequence[int]]:
    """Return the levels of each column, the highest first; the lowest are in the first column."""
    stacks: Sequence[Sequence[int]] = [each.tolist() for each in np.array_split(levels, number)]
    return stacks[::-1]
