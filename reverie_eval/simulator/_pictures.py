"""What skyboxes show: the pictures of observations, and of pages and reports."""

from dataclasses import dataclass
from functools import cache

from reverie_eval.arrays import Array, FloatArray
from reverie_eval.errors import GroundTruthError, ReverieEvalError
from reverie_eval.geometry import FIELD_OF_VIEW, HEIGHT, WIDTH
from reverie_eval.simulator.on_path.MatterSim import _blended, _packed, _Renderer, _sight_of


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture that is rendered when an agent asks for it."""

    skybox: str | None
    """The file; None if the environment was given no pictures."""
    rotation: FloatArray | None
    """Shape (3, 3), from the skybox's frame to the building's; None in old bundles."""
    heading: float
    """Radians."""
    elevation: float
    """Radians."""

    def render(self) -> Array:
        """Return the picture, or raise what :meth:`Observation.image` raises."""
        if self.skybox is None:
            raise ReverieEvalError("no pictures here; Environment(..., pictures=folder) has them")
        if self.rotation is None:
            raise GroundTruthError(
                "this ground truth has no directions of cameras; compile it again with this version"
            )
        sight = _renderer().look(self.rotation, self.heading, self.elevation)
        return _renderer().colours(self.skybox, sight)[..., ::-1]  # not blue first


@cache
def _renderer() -> _Renderer:
    return _Renderer(WIDTH, HEIGHT, FIELD_OF_VIEW)


def colours_of_skybox(strip: Array, direction: FloatArray) -> Array:
    """Return the colours that a skybox shows in each direction, as ``MatterSim`` blends them.

    Parameters
    ----------
    strip : uint8 array of shape (size, 6 * size, 3)
        The six faces beside each other, red first.
    direction : float array of shape (..., 3)
        In the frame of the skybox's camera: right, down, forward.

    Returns
    -------
    uint8 array of shape (..., 3)
        Red first.
    """
    # The axes of the cube map are opposite to those of the camera.
    x, y, z = -direction.reshape(-1, 3).T
    return _blended(_packed(strip), _sight_of(x, y, z))[:, ::-1].reshape(direction.shape)
