"""Photographs under pictures of answers: Matterport3D's, or drawn ones of the demo world.

The environment variable ``REVERIE_EVAL_PANORAMAS`` names the folder of the scans, as
Matterport3DSimulator lays it out. A panorama there is a skybox: the six faces of a cube around the
camera, side by side in one file [1]_. Photographs that cannot be used are left out, and the log
says why. Without the variable, only the demo world has pictures, those drawn of it. Pixels are
blended as in the simulator's own pictures.

References
----------
.. [1] ``scripts/downsize_skybox.py`` of peteanderson80/Matterport3DSimulator.
"""

import logging
import os
from collections.abc import Callable
from functools import cache, lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.errors import MissingPartError, naming_missing_parts
from reverie_eval.geometry import HEIGHT, VIEW_AXES, WIDTH, rays_of
from reverie_eval.ground_truth import DEMO_BUNDLES, NavigationGraph
from reverie_eval.simulator import colours_of_skybox, jpeg_url

PANORAMAS_VARIABLE = "REVERIE_EVAL_PANORAMAS"
"""The environment variable that names the folder of the scans."""
DEMO_PANORAMAS = DEMO_BUNDLES / "panoramas"
"""The skyboxes of the demo world, by scan and viewpoint."""
_FACES = 6
# Pixels of a photograph for each pixel of a view.
_SHRINK = 0.625
# Quality of JPEG: a page with two answers and a target, all with many details, is below 300 kB.
_QUALITY = 70
# Pages show the same pictures again and again; each takes 100 kB at most.
_PICTURES_KEPT = 128
_log = logging.getLogger(__name__)


class Skybox(NamedTuple):
    """The skybox of a viewpoint."""

    path: Path
    rotation: FloatArray
    """Shape (3, 3): from the camera's frame (right, down, forward) to the scan's."""

    def view(self, view: int) -> str:
        """Return what a view shows as a ``data:`` URL; empty if the file cannot be used."""
        return self._picture(_directions_of_view, view)

    def panorama(self, middle: float, highest: float) -> str:
        """Return the panorama as a ``data:`` URL; empty if the file cannot be used.

        The heading ``middle`` is in the middle; the upper edge has the elevation ``highest``, and
        the lower one is as far down. Both are degrees.
        """
        return self._picture(_directions_of_panorama, middle, highest)

    def _picture(self, directions: Callable[..., FloatArray], *shown: float) -> str:
        try:
            with naming_missing_parts():
                from PIL import Image
        except MissingPartError as error:  # what is drawn without photographs is still of use
            warn_once(str(error))
            return ""
        try:
            changed = self.path.stat().st_mtime_ns
            return _data_url(self.path, changed, self.rotation.tobytes(), directions, shown)
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
            warn_once(f"{self.path} is left out: {error}")
            return ""


def _directions_of_view(view: int) -> FloatArray:
    columns, rows = round(_SHRINK * WIDTH), round(_SHRINK * HEIGHT)
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    directions: FloatArray = rays_of(np.stack([x, y], axis=-1) / _SHRINK) @ VIEW_AXES[view]
    return directions


def _directions_of_panorama(middle: float, highest: float) -> FloatArray:
    columns = round(_SHRINK * WIDTH)
    rows = round(columns * highest / 180)
    across = middle + 360 * ((np.arange(columns) + 0.5) / columns - 0.5)
    down = highest - 2 * highest * (np.arange(rows) + 0.5) / rows
    heading, elevation = np.meshgrid(np.deg2rad(across), np.deg2rad(down))
    flat = np.cos(elevation)
    parts = [np.sin(heading) * flat, np.cos(heading) * flat, np.sin(elevation)]
    return np.stack(parts, axis=-1)


@lru_cache(maxsize=_PICTURES_KEPT)
def _data_url(
    path: Path,
    _changed: int,
    rotation: bytes,
    directions: Callable[..., FloatArray],
    shown: tuple[float, ...],
) -> str:
    """Return the picture whose pixels show directions of shape (rows, columns, 3).

    Of a file that has been changed since, another picture is drawn.

    Raises OSError, SyntaxError, ValueError or DecompressionBombError if the file cannot be used.
    """
    from PIL import Image

    with Image.open(path) as file:
        faces = np.asarray(file.convert("RGB"))
    size, width, _ = faces.shape
    if width != _FACES * size:
        raise ValueError(f"{width} x {size} pixels, expected six squares")
    camera = np.frombuffer(rotation).reshape(3, 3)
    return jpeg_url(colours_of_skybox(faces, directions(*shown) @ camera), _QUALITY)


def find_skybox(graph: NavigationGraph, viewpoint_id: str) -> Skybox | None:
    """Return the skybox of a viewpoint, if there is one."""
    folder = os.environ.get(PANORAMAS_VARIABLE)
    viewpoint = graph.index[viewpoint_id]
    scan_id = graph.scan_of(viewpoint)
    if folder and not Path(folder).is_dir():
        warn_once(f"{PANORAMAS_VARIABLE}={folder} is not a folder; pictures have no photographs")
        return None
    if folder:
        images = Path(folder) / scan_id / "matterport_skybox_images"
        path = images / f"{viewpoint_id}_skybox_small.jpg"
    else:
        path = DEMO_PANORAMAS / scan_id / f"{viewpoint_id}.webp"
    if not path.is_file():
        return None
    return Skybox(path, graph.viewpoint_rotation[viewpoint].astype(np.float64))


@cache
def warn_once(text: str) -> None:
    """Log a warning once."""
    _log.warning(text)
