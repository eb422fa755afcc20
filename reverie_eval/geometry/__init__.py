"""The geometry of panoramas: views, projection, outlines, and boxes seen from another camera."""

from reverie_eval.geometry._polygons import are_inside
from reverie_eval.geometry._views import (
    FAR_OFF,
    FIELD_OF_VIEW,
    FOCAL_LENGTH,
    HEIGHT,
    N_VIEWS,
    NEAR,
    VIEW_AXES,
    WIDTH,
    axes,
    degrees_off,
    is_on_grid,
    pixels_of,
    rays_of,
    snap,
    view_angles,
    world_to_camera,
)

__all__ = [
    "FAR_OFF",
    "FIELD_OF_VIEW",
    "FOCAL_LENGTH",
    "HEIGHT",
    "NEAR",
    "N_VIEWS",
    "VIEW_AXES",
    "WIDTH",
    "are_inside",
    "axes",
    "degrees_off",
    "is_on_grid",
    "pixels_of",
    "rays_of",
    "snap",
    "view_angles",
    "world_to_camera",
]
