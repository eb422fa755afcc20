"""Solids of objects, and views of the rooms that they stand in."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from reverie_eval.geometry import (
    VIEW_AXES,
    Building,
    Face,
    Line,
    Room,
    RoomView,
    Seen,
    Solids,
    pixels_of,
    world_to_camera,
)

FLOOR = np.array([(-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)])
"""A room of 6 by 6 m around a camera, 1.5 m above its floor."""
CAMERA = np.array([(0.0, 0.0, 1.5)])
NORTH, EAST = 12, 15
NOTHING = Seen(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 4), int))


def solids(names: Sequence[str], centre: Sequence[tuple[float, ...]], size: float = 1.0) -> Solids:
    """Return solids that look so wide and high, in the middle 4 by 4 m."""
    count = len(names)
    return Solids.of(
        object_id=np.arange(count),
        names=names,
        storey=np.zeros(count, int),
        room=np.zeros(count, int),
        centre=np.array(centre).reshape(-1, 3),
        size=np.full((count, 2), size),
        bounds=np.tile(np.array([(-2.0, -2.0), (2.0, 2.0)]), (count, 1, 1)),
        floors=np.zeros(1),
        axes=np.eye(2),
    )


def room_view(
    view: int,
    things: Solids,
    seen: Seen = NOTHING,
    important: Sequence[int] = (),
    camera: np.ndarray = CAMERA,
) -> RoomView:
    """Look from the middle of the room, which has a door in its northern wall."""
    building = Building(
        storey=np.zeros(1, int),
        room=np.zeros(1, int),
        rooms=[Room("", 0, [FLOOR], 36.0)],
        doors=[Line(0, np.array([(-0.5, 3.0), (0.5, 3.0)]))],
        treads=[],
        solids=things,
    )
    return RoomView(building, camera, 0, view, seen, important=important)


def look(
    view: int,
    things: Solids,
    seen: Seen = NOTHING,
    important: Sequence[int] = (),
    camera: np.ndarray = CAMERA,
) -> list[Face]:
    """Return the faces that are seen."""
    return list(room_view(view, things, seen, important, camera).faces())


@pytest.mark.parametrize(
    ("name", "centre", "half", "middle"),
    [
        pytest.param("box", (0, 0, 2), (0.5, 0.5, 0.5), 2.0, id="in the air"),
        pytest.param("box", (0, 0, 0.9), (0.5, 0.5, 0.7), 0.7, id="stands on the floor"),
        pytest.param("box", (0, 0, 1.1), (0.5, 0.5, 0.5), 1.1, id="more than half above it"),
        pytest.param("picture", (0, 1.9, 2), (0.5, 0.03, 0.5), 2.0, id="flat on the wall"),
        pytest.param("couch", (1.5, 0, 0.5), (0.25, 0.5, 0.5), 0.5, id="along the wall"),
    ],
)
def test_sizes_of_solids(
    name: str, centre: tuple[float, ...], half: tuple[float, ...], middle: float
) -> None:
    thing = solids([name], [centre])
    assert thing.half[0] == pytest.approx(half)
    assert thing.centre[0] == pytest.approx([*centre[:2], middle])


def test_some_kinds_have_a_largest_depth() -> None:
    """A cabinet 4 m wide is 1 m deep, and so it stays however large it looks from one viewpoint."""
    cabinet = solids(["cabinet"], [(0.0, 1.5, 1.0)], size=4.0)
    assert 2 * cabinet.half[0, 1] == pytest.approx(1.0)
    fitted = cabinet.fitted(CAMERA[0], np.array([NORTH]), np.array([(20, 20, 600, 440)]))
    assert 2 * fitted.half[0, 1] <= 1.0


@pytest.mark.parametrize(
    ("centre", "expected"),
    [
        pytest.param((1.9, 0.0), (1.75, 0.0), id="through a wall"),
        pytest.param((0.0, -1.8), (0.0, -1.75), id="through another"),
        pytest.param((2.5, 0.0), (2.5, 0.0), id="in another room"),
    ],
)
def test_solids_are_within_their_room(
    centre: tuple[float, float], expected: tuple[float, float]
) -> None:
    """A couch is a metre wide and half as deep, and has its back to the wall."""
    assert solids(["couch"], [(*centre, 0.5)]).centre[0, :2] == pytest.approx(expected)


def test_solids_are_no_larger_than_their_room() -> None:
    wide = solids(["box"], [(1.0, 0.0, 1.5)], size=3.9)
    assert wide.half[0, :2] == pytest.approx((1.95, 1.95))
    assert wide.centre[0, :2] == pytest.approx((0.05, 0.0))
    assert solids(["box"], [(0.5, 0.0, 1.5)], size=5.0).half[0, :2] == pytest.approx((2, 2))


def test_backs_are_at_the_nearest_wall() -> None:
    """The back of a couch is its highest box; walls to the east, north, west, south."""
    around = [(1.5, 0, 1), (0, 1.5, 1), (-1.5, 0, 1), (0, -1.5, 1)]
    corners, row, *_ = solids(["couch"] * 4, around).parts()
    highest = [max(corners[row == each], key=lambda box: box[:, 2].max()) for each in range(4)]
    backs = [box.mean(axis=0)[:2] for box in highest]
    assert np.sign(np.round(backs - np.array(around)[:, :2], 3)).tolist() == [
        [1, 0],
        [0, 1],
        [-1, 0],
        [0, -1],
    ]


@pytest.mark.parametrize("name", ["box", "picture", "table", "plant"])
@pytest.mark.parametrize("box", [(200, 150, 120, 180), (20, 300, 90, 60), (60, 40, 300, 200)])
def test_a_solid_fills_its_box(name: str, box: tuple[int, ...]) -> None:
    """Whatever its size was, to two pixels; what hangs on a wall keeps its thickness."""
    thing = solids([name], [(0.3, 1.7, 1.6)], size=0.4)
    fitted = thing.fitted(CAMERA[0], np.array([NORTH]), np.array([box]))
    pixels = pixels_of(world_to_camera(fitted.corners()[0], CAMERA[0], VIEW_AXES[NORTH]))
    assert pixels.min(axis=0) == pytest.approx(box[:2], abs=2)
    assert pixels.max(axis=0) == pytest.approx(np.add(box[:2], box[2:]), abs=2)


def test_walls_of_a_view() -> None:
    """The northern wall is 3 m away: 6 m are 831 pixels, and the floor begins 208 below eye level.

    The door in it is 1 m wide and 2.05 m high; the eastern wall has none.
    """
    faces = {face.kind: face.outlines[0] for face in look(NORTH, solids([], []))}
    wall, below = faces["wall lit"], faces["wainscot lit"]
    assert np.ptp(wall[:, 0]) == pytest.approx(831.38, abs=0.01)
    assert wall[:, 1].min() == pytest.approx(240 - 152.42, abs=0.01)
    assert wall[:, 1].max() == pytest.approx(below[:, 1].min())
    assert below[:, 1].max() == pytest.approx(240 + 207.85, abs=0.01)
    door = faces["opening"]
    assert np.ptp(door, axis=0) == pytest.approx([138.56, 284.06], abs=0.01)
    assert door[:, 0].mean() == pytest.approx(320)
    assert "opening" not in {face.kind for face in look(EAST, solids([], []))}


def test_the_floor_beyond_a_door_is_seen_through_it() -> None:
    """It begins at the door and ends 5.5 m away, between the rays through the sides of the door."""
    (beyond,) = (face.outlines[0] for face in look(NORTH, solids([], [])) if face.kind == "beyond")
    assert beyond[:, 1].min() == pytest.approx(240 + 415.692 * 1.5 / 5.5, abs=0.01)
    assert np.unique(beyond[:, 0].round(3)) == pytest.approx([320 - 69.282, 320 + 69.282], abs=0.01)


def test_no_wall_fills_the_view() -> None:
    """A wall 0.3 m away is drawn at 2.4 m, with its door: 1 m is 173 pixels there.

    At the side it is drawn at 1.6 m: it meets the eastern wall, 3 m away, 222 pixels to the left.
    """
    camera = np.array([(0.0, 2.7, 1.5)])
    faces = {face.kind: face.outlines[0] for face in look(NORTH, solids([], []), camera=camera)}
    assert faces["wainscot lit"][:, 1].max() == pytest.approx(240 + 259.81, abs=0.01)
    assert np.ptp(faces["opening"][:, 0]) == pytest.approx(173.21, abs=0.01)
    faces = {face.kind: face.outlines[0] for face in look(EAST, solids([], []), camera=camera)}
    assert faces["wall dim"][:, 0].min() == pytest.approx(320 - 221.70, abs=0.01)


def test_doors_beside_each_other_are_one_opening() -> None:
    doors = [Line(0, np.array([(x, 3.0), (x + 0.9, 3.0)])) for x in (-2.5, -1.7, 1.0)]
    building = Building(
        np.zeros(1, int), np.zeros(1, int), [Room("", 0, [FLOOR], 36.0)], doors, [], solids([], [])
    )
    faces = RoomView(building, CAMERA, 0, NORTH, NOTHING).faces()
    widths = [np.ptp(face.outlines[0][:, 0]) for face in faces if face.kind == "opening"]
    assert np.array(widths) / (415.692 / 3) == pytest.approx([0.9, 1.7], abs=0.01)


def test_a_viewpoint_outside_of_rooms_has_walls_around_it() -> None:
    building = Building(np.zeros(1, int), np.array([-1]), [], [], [], solids([], []))
    view = RoomView(building, CAMERA, 0, NORTH, NOTHING)
    wall = next(face.outlines[0] for face in view.faces() if face.kind == "wall lit")
    assert np.ptp(wall[:, 0]) == pytest.approx(554.26, abs=0.01)  # 3.2 m, 2.4 m away


def seen_box(view: int, *xywh: int) -> Seen:
    """Return an object by a box."""
    return Seen(np.zeros(1, int), np.array([view]), np.array([xywh]))


@pytest.mark.parametrize(
    ("name", "box", "floor", "ceiling"),
    [
        pytest.param("chair", (300, 300, 60, 120), 0.0, None, id="stands on the floor"),
        pytest.param("chandelier", (300, 60, 60, 60), None, 2.6, id="hangs from the ceiling"),
        pytest.param("vase", (300, 300, 60, 180), 0.0, None, id="not below the floor"),
    ],
)
def test_what_is_seen_is_where_it_belongs(
    name: str, box: tuple[int, ...], floor: float | None, ceiling: float | None
) -> None:
    """Whatever its distance is in the model, the solid fills its box."""
    seen = seen_box(NORTH, *box)
    fitted = room_view(NORTH, solids([name], [(0.0, 4.0, 1.5)]), seen).fitted
    (z,), (half,) = fitted.centre[:, 2], fitted.half[:, 2]
    if floor is not None:
        assert z - half == pytest.approx(floor, abs=0.01)
    if ceiling is not None:
        assert z + half == pytest.approx(ceiling, abs=0.01)
    pixels = pixels_of(world_to_camera(fitted.corners()[0], CAMERA[0], VIEW_AXES[NORTH]))
    assert pixels.min(axis=0) == pytest.approx(box[:2], abs=2)
    assert pixels.max(axis=0) == pytest.approx(np.add(box[:2], box[2:]), abs=2)


@pytest.mark.parametrize(("view", "axis"), [(NORTH, 1), (EAST, 0)])
def test_pictures_are_on_the_wall_behind_them(view: int, axis: int) -> None:
    """The model has them a metre in front of another wall."""
    seen = seen_box(view, 280, 180, 90, 60)
    fitted = room_view(view, solids(["picture"], [(1.0, 1.0, 1.5)]), seen).fitted
    assert fitted.centre[0, axis] == pytest.approx(3.0, abs=0.01)
    assert fitted.half[0, axis] == pytest.approx(0.05, abs=0.03)
    assert fitted.back[0] == axis


def test_the_ceiling_is_above_what_hangs_on_walls() -> None:
    """A picture 40 pixels below the upper edge is on the wall 3 m away; the ceiling meets it above.

    It is 1.44 m above the camera, and a ceiling is 1.1 m above it if nothing is higher.
    """
    picture = solids(["picture"], [(0.0, 1.9, 2.0)])
    faces = look(NORTH, picture, seen_box(NORTH, 290, 40, 60, 90))
    (wall,) = (face.outlines[0] for face in faces if face.kind == "wall lit")
    assert 240 - 415.692 * (1.44 + 0.3) / 3 < wall[:, 1].min() < 40


def test_other_rooms_are_seen_through_doors() -> None:
    """Behind the northern wall is a room with a table in its middle."""
    beyond = FLOOR + np.array([0.0, 6.0])
    rooms = [Room("", 0, [FLOOR], 36.0), Room("kitchen", 0, [beyond], 36.0)]
    middle = np.array([(0.0, 6.0, 0.4)])
    table = replace(solids(["table"], [(0.0, 0.0, 0.4)]), room=np.ones(1, int), centre=middle)
    doors = [Line(0, np.array([(-0.5, 3.0), (0.5, 3.0)]))]
    building = Building(np.zeros(1, int), np.zeros(1, int), rooms, doors, [], table)
    kinds = [face.kind for face in RoomView(building, CAMERA, 0, NORTH, NOTHING).faces()]
    floors = [kind for kind in kinds if kind.startswith("floor")]
    assert floors == ["floor tiled", "floor"]
    assert any("wood" in kind for kind in kinds[: kinds.index("floor")])
    east = RoomView(building, CAMERA, 0, EAST, NOTHING).faces()
    assert "floor tiled" not in {face.kind for face in east}


def test_a_door_before_which_something_hangs_is_closed() -> None:
    picture = solids(["picture"], [(0.0, 1.9, 1.5)])
    kinds = {face.kind for face in look(NORTH, picture, seen_box(NORTH, 290, 200, 60, 60))}
    assert "opening" not in kinds


@pytest.mark.parametrize(
    ("box", "names", "bottom"),
    [
        pytest.param((300, 330, 40, 40), ["vase"], None, id="on the wall"),
        pytest.param((300, 500, 40, 60), ["vase"], 0.0, id="on the floor"),
    ],
)
def test_nothing_hangs_in_the_air(
    box: tuple[int, ...], names: Sequence[str], bottom: float | None
) -> None:
    """What nothing carries is on the floor or on the wall, 3 m away, whichever is nearer."""
    seen = seen_box(NORTH, *box)
    fitted = room_view(NORTH, solids(names, [(0.0, 1.5, 1.0)], size=0.2), seen).fitted
    if bottom is None:
        assert fitted.centre[0, 1] == pytest.approx(3.0, abs=0.1)
    else:
        assert fitted.centre[0, 2] - fitted.half[0, 2] == pytest.approx(bottom, abs=0.02)


@pytest.mark.parametrize(
    ("name", "important", "is_drawn", "name_drawn"),
    [
        pytest.param("pillow", [], False, "pillow", id="left out"),
        pytest.param("pillow", [0], True, "pillow", id="important"),
        pytest.param("table lamp", [], True, "wall lamp", id="another form"),
        pytest.param("vase", [], True, "vase", id="as it is"),
    ],
)
def test_what_hangs_on_a_wall_looks_so(
    name: str, important: Sequence[int], name_drawn: str, *, is_drawn: bool
) -> None:
    """What never hangs there is not drawn, unless it has to be."""
    seen = seen_box(NORTH, 300, 330, 40, 40)
    view = room_view(NORTH, solids([name], [(0.0, 1.5, 1.0)], size=0.2), seen, important)
    assert any(face.object_id == 0 for face in view.faces()) == is_drawn
    assert view.left_out == (set() if is_drawn else {0})
    assert view.fitted.names == [name_drawn]


def test_chairs_are_not_wider_than_high() -> None:
    """A wide one is partly hidden; in a view, nothing tells how much of it."""
    chair = solids(["chair"], [(0.0, 1.0, 0.2)], size=0.9)
    assert 2 * chair.half[0, :2].max() == pytest.approx(max(0.5, 2 * chair.half[0, 2]))
    seen = seen_box(NORTH, 100, 300, 440, 60)
    (half,) = room_view(NORTH, chair, seen).fitted.half
    assert half[:2].max() == pytest.approx(half[2])


@pytest.mark.parametrize(
    ("name", "view", "height", "reaches"),
    [
        pytest.param("armchair", NORTH, 178, True, id="armchair"),
        pytest.param("armchair", NORTH, 177, False, id="not cut"),
        pytest.param("cabinet", NORTH, 178, True, id="cabinet"),
        pytest.param("cabinet", NORTH + 12, 178, False, id="above the horizon"),
        pytest.param("vase", NORTH, 178, False, id="may stand on something"),
    ],
)
def test_what_the_lower_edge_of_a_view_cuts_reaches_the_floor(
    name: str, view: int, height: int, *, reaches: bool
) -> None:
    """It stays as far away as it is, instead of where its lower edge would meet the floor."""
    seen = seen_box(view, 300, 300, 60, height)
    fitted = room_view(NORTH, solids([name], [(0.0, 1.2, 0.9)]), seen).fitted
    bottom = fitted.centre[0, 2] - fitted.half[0, 2]
    away = float(np.hypot(*fitted.centre[0, :2]))
    assert (bottom == pytest.approx(0.0, abs=0.01) and away < 1.5) == reaches


def test_a_picture_is_thin_however_far_its_wall_is() -> None:
    seen = seen_box(NORTH, 100, 100, 100, 100)
    fitted = room_view(NORTH, solids(["picture"], [(-1.0, 1.0, 1.8)]), seen).fitted
    assert fitted.half[0].min() == pytest.approx(0.03)


def test_a_picture_is_level_and_shows_what_is_important() -> None:
    """However high or low it is: 60 pixels around its middle, in pixels of the level view."""
    lamp = solids(["lamp"], [(0.0, 1.9, 2.9)])
    high = seen_box(NORTH + 12, 300, 60, 40, 40)  # its middle is 53.4 degrees up
    assert room_view(NORTH + 12, lamp, high).picture == (NORTH, -190, -60, 1020, 765)
    _, left, top, width, height = room_view(NORTH + 12, lamp, high, important=[0]).picture
    middle = 240 - 415.692 * np.tan(np.pi / 6 + np.arctan(160 / 415.692))
    assert middle - 60 < top < middle - 20
    assert top + height == pytest.approx(705)
    assert (left + width / 2, width / height) == pytest.approx((320, 1020 / 765))


def order(seen: Seen = NOTHING, important: Sequence[int] = ()) -> list[int]:
    """Return the order in which three boxes, 2.2, 2.8 and 2.5 m away, are drawn."""
    on_floor = [(0.0, 2.2, 0.15), (0.5, 2.8, 0.15), (-0.5, 2.5, 0.15)]
    things = solids(["box"] * 3, on_floor, size=0.3)
    drawn = [face.object_id for face in look(NORTH, things, seen, important) if face.object_id >= 0]
    return list(dict.fromkeys(drawn))


def test_the_nearest_is_drawn_last() -> None:
    assert order() == [1, 2, 0]
    assert order(important=[1]) == [2, 0, 1]


def test_nothing_hides_the_last_of_what_is_drawn_last() -> None:
    """Object 0 is in front of object 1, but an answer does not hide the target."""
    assert order(important=[0, 1]) == [2, 0, 1]
    assert order(important=[1, 0]) == [2, 1, 0]


def test_what_is_within_another_box_is_in_front_of_it() -> None:
    """Object 1 is farther away, but its box lies within that of object 0.

    Nothing carries them, so they hang on the wall, behind object 2.
    """
    boxes = np.array([(200, 150, 200, 200), (250, 200, 50, 50)])
    assert order(Seen(np.array([0, 1]), np.array([NORTH, NORTH]), boxes)) == [0, 1, 2]


@pytest.mark.parametrize(("away", "is_drawn"), [(-2.5, False), (2.0, False), (2.01, True)])
def test_what_is_behind_or_near_without_a_box_is_not_drawn(away: float, is_drawn: bool) -> None:  # noqa: FBT001
    faces = look(NORTH, solids(["box"], [(0, away, 0.5)]))
    assert (0 in {face.object_id for face in faces}) == is_drawn


def test_only_sides_that_face_the_camera_are_drawn() -> None:
    """A low box in front of the camera shows its top and its near side."""
    faces = look(NORTH, solids(["piano"], [(0, 2.5, 0.5)]))
    assert sorted(each.kind for each in faces if each.object_id == 0) == ["dark lit", "dark top"]
