"""The geometry of panoramas and buildings: views, projection, boxes from elsewhere; rooms."""

from importlib import import_module
from typing import TYPE_CHECKING

from reverie_eval.geometry._polygons import are_inside, clip_at_depth, polygon_overlap, warp
from reverie_eval.geometry._views import (
    FAR_OFF,
    FIELD_OF_VIEW,
    FOCAL_LENGTH,
    HEIGHT,
    N_HEADINGS,
    N_VIEWS,
    NEAR,
    STEP,
    VIEW_AXES,
    WIDTH,
    Picture,
    axes,
    degrees_off,
    is_on_grid,
    level_view,
    pixels_of,
    rays_of,
    snap,
    view_angles,
    world_to_camera,
)

if TYPE_CHECKING:
    from reverie_eval.geometry._buildings import (
        Building,
        Line,
        Room,
        Sightings,
        Tread,
        Wall,
        door_spans,
        floors_of,
        model_building,
    )
    from reverie_eval.geometry._framing import OrientedBoxes, boxes_in_views
    from reverie_eval.geometry._kinds import BLOCK, Kind, kind_of
    from reverie_eval.geometry._room_views import RoomView, Seen
    from reverie_eval.geometry._shells import Face, floor_joints
    from reverie_eval.geometry._solids import Solids, sides_of

__all__ = [
    "BLOCK",
    "FAR_OFF",
    "FIELD_OF_VIEW",
    "FOCAL_LENGTH",
    "HEIGHT",
    "NEAR",
    "N_HEADINGS",
    "N_VIEWS",
    "STEP",
    "VIEW_AXES",
    "WIDTH",
    "Building",
    "Face",
    "Kind",
    "Line",
    "OrientedBoxes",
    "Picture",
    "Room",
    "RoomView",
    "Seen",
    "Sightings",
    "Solids",
    "Tread",
    "Wall",
    "are_inside",
    "axes",
    "boxes_in_views",
    "clip_at_depth",
    "degrees_off",
    "door_spans",
    "floor_joints",
    "floors_of",
    "is_on_grid",
    "kind_of",
    "level_view",
    "model_building",
    "pixels_of",
    "polygon_overlap",
    "rays_of",
    "sides_of",
    "snap",
    "view_angles",
    "warp",
    "world_to_camera",
]


def __getattr__(name: str) -> object:
    # Scoring a file needs none of these, which take four fifths of the time to import geometry.
    for module in (
        ("_buildings", "_framing", "_kinds", "_room_views", "_shells", "_solids")
        if name in __all__
        else ()
    ):
        found = vars(import_module(f"{__name__}.{module}"))
        if name in found:
            return found[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
