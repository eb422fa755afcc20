"""Boxes of any orientation in the world, many at once."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import BoolArray, FloatArray, IntArray, frozen

CORNER_SIDES: FloatArray = frozen(np.array(list(product((-1.0, 1.0), repeat=3))))
"""Shape (8, 3): the side of the centre on which each corner lies, along each axis."""

EDGES: IntArray = frozen(
    np.array(
        [
            (a, b)
            for a in range(len(CORNER_SIDES))
            for b in range(a)
            if np.count_nonzero(CORNER_SIDES[a] != CORNER_SIDES[b]) == 1
        ]
    )
)
"""Shape (12, 2): the two corners of each edge."""


@dataclass(frozen=True, eq=False, slots=True)
class OrientedBoxes:
    """Boxes in a metric frame, the world's or a camera's."""

    centre: FloatArray
    """Shape (n, 3)."""
    axes: FloatArray
    """Shape (n, 3, 3): rows of orthogonal unit vectors."""
    radii: FloatArray
    """Shape (n, 3): metres from the centre to the faces, along each axis; not negative."""

    @classmethod
    def along(
        cls,
        centre: FloatArray,
        first_axis: FloatArray,
        second_axis: FloatArray,
        radii: FloatArray,
    ) -> Self:
        """Build boxes from two of their axes; the third is the cross product.

        All arrays have the shape (n, 3). Axes may have any length. If they are not quite
        orthogonal, as when they were written with a few digits, the second is made so.

        >>> up, rightish = np.array([[0.0, 0.0, 2.0]]), np.array([[1.0, 0.0, 0.1]])
        >>> OrientedBoxes.along(np.zeros((1, 3)), up, rightish, np.ones((1, 3))).axes[0].tolist()
        [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        """
        first, second = _unit(first_axis), _scaled(second_axis)
        second = _unit(second - (second * first).sum(axis=-1, keepdims=True) * first)
        axes = np.stack([first, second, np.cross(first, second)], axis=-2)
        return cls(centre, axes, radii)

    def __len__(self) -> int:
        return len(self.centre)

    def __getitem__(self, which: IntArray | BoolArray) -> Self:
        return type(self)(self.centre[which], self.axes[which], self.radii[which])

    def seen_by(self, position: FloatArray, camera_axes: FloatArray) -> Self:
        """Return the boxes in the frames of cameras, one camera per box.

        Parameters
        ----------
        position : float array, shape (3,)
            Of all cameras.
        camera_axes : float array, shape (n, 3, 3)
            The unit vectors right, up and forward of each camera, as rows.
        """
        centre: FloatArray = np.einsum("nj,nij->ni", self.centre - position, camera_axes)
        return type(self)(centre, np.einsum("naj,nij->nai", self.axes, camera_axes), self.radii)

    def corners(self) -> FloatArray:
        """Shape (n, 8, 3): the corners, in the order of ``CORNER_SIDES``."""
        half_edges = self.axes * self.radii[:, :, None]
        return np.asarray(self.centre[:, None] + np.einsum("ca,nai->nci", CORNER_SIDES, half_edges))


def _unit(vectors: FloatArray) -> FloatArray:
    vectors = _scaled(vectors)
    return np.asarray(vectors / np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True)))


def _scaled(vectors: FloatArray) -> FloatArray:
    """Scale vectors to a length near 1, so that their squares neither overflow nor underflow."""
    # Dividing by a power of two changes no digit.
    _, exponent = np.frexp(np.abs(vectors).max(axis=-1, keepdims=True))
    return np.asarray(np.ldexp(vectors, -exponent))
