"""Storeys, rooms, doors and stairs of small houses."""

from dataclasses import replace

import numpy as np
import pytest

from reverie_eval.geometry import (
    FOCAL_LENGTH,
    Building,
    Room,
    Sightings,
    Tread,
    model_building,
)
from reverie_eval.geometry._buildings import find_storeys
from reverie_eval.geometry._plans import Plan
from reverie_eval.geometry._room_names import name_room

HALL, KITCHEN = (1.0, 1.0), (11.0, 1.0)
"""The cameras in the two rooms of a house, 1.5 m above the floor, 10 m apart."""
OBJECTS = np.array([(-2.0, -2.0, -1.0), (-2.0, 2.0, 0.0), (2.0, -2.0, 1.0), (2.0, 2.0, 0.0)] * 3)
"""Where the objects of each of these rooms are, relative to its camera."""


def seen_from(
    position: np.ndarray, viewpoint: list[int], centre: np.ndarray, names: list[str], *, known: bool
) -> Sightings:
    """See an object from each viewpoint, in the order of ids."""
    offset = centre - position[np.array(viewpoint, dtype=np.int64)]
    distance = np.linalg.norm(offset, axis=1)
    return Sightings(
        viewpoint=np.array(viewpoint, dtype=np.int64),
        object_id=np.arange(len(names)) * 3,
        direction=offset / distance[:, None],
        distance=distance if known else np.full(len(names), np.inf),
        extent=np.full((len(names), 2), 0.25),
        names=names,
    )


def house(turn: float = 0.0) -> Building:
    """Model two rooms, 4 by 4 m, with a hall between."""
    position = np.array([(*HALL, 1.5), (*KITCHEN, 1.5)])
    centre = np.vstack([position[0] + OBJECTS, position[1] + OBJECTS])
    turned = np.array(
        [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    position, centre = position @ turned, centre @ turned
    names = ["lamp"] * len(OBJECTS) + ["oven", *["kitchen cabinet"] * (len(OBJECTS) - 1)]
    viewpoint = [0] * len(OBJECTS) + [1] * len(OBJECTS)
    seen = seen_from(position, viewpoint, centre, names, known=True)
    return model_building(position, np.array([[0, 1]]), seen)


@pytest.mark.parametrize(
    ("height", "expected"),
    [
        pytest.param([1.5], [0], id="one viewpoint"),
        pytest.param([0.0, 0.4, 0.8, 1.2], [0, 0, 0, 0], id="a ramp"),
        pytest.param([0, 0, 0, 1.9, 1.9, 1.9], [0, 0, 0, 1, 1, 1], id="1.9 m apart"),
        pytest.param([0, 0, 0, 1.8, 1.8, 1.8], [0] * 6, id="less apart"),
        pytest.param([3, 0, 3, 0, 3, 0], [1, 0, 1, 0, 1, 0], id="in any order"),
        pytest.param([0, 0, 0, 2.5], [0] * 4, id="one viewpoint is a landing"),
        pytest.param([0] * 98 + [2.5] * 2, [0] * 98 + [1] * 2, id="two are a storey"),
        pytest.param([0] * 149 + [2.5] * 2, [0] * 151, id="unless the building is large"),
        pytest.param([0, 0, 0, 3, 3, 3, 6, 6, 6, 4], [0, 0, 0, 1, 1, 1, 2, 2, 2, 1], id="three"),
    ],
)
def test_storeys_by_height(height: list[float], expected: list[int]) -> None:
    assert find_storeys(np.array(height, dtype=float)).tolist() == expected


def corners(room: Room) -> list[list[float]]:
    """Return the corners of a room of one outline, sorted."""
    (outline,) = room.outlines
    return sorted(outline.round(6).tolist())


def test_rooms_are_runs_of_objects() -> None:
    """Objects 4 m apart are of one room, those 6 m to the east of the next; a hall is between."""
    building = house()
    assert [corners(room) for room in building.rooms] == [
        [[-1, -1], [-1, 3], [3, -1], [3, 3]],
        [[9, -1], [9, 3], [13, -1], [13, 3]],
        [[3, 0.3], [3, 1.7], [9, 0.3], [9, 1.7]],
    ]
    assert building.room.tolist() == [0, 1]
    assert [room.name for room in building.rooms] == ["", "kitchen", ""]
    assert [room.area for room in building.rooms] == pytest.approx([16, 16, 8.4])
    assert [room.is_hall for room in building.rooms] == [False, False, True]


def test_a_wall_is_one_although_two_rooms_have_it() -> None:
    """Each room has a wall to the hall, and its other walls are outer ones."""
    walls = [(wall.ends.round(6).tolist(), wall.is_outer) for wall in house().walls_on(0)]
    inner = [ends for ends, is_outer in walls if not is_outer]
    assert sorted(inner) == [[[3, 0.3], [3, 1.7]], [[9, 0.3], [9, 1.7]]]
    beside = [ends for ends, is_outer in walls if is_outer and ends[0][0] == ends[1][0] == 3]
    assert sorted(beside) == [[[3, -1], [3, 0.3]], [[3, 1.7], [3, 3]]]
    length = sum(np.hypot(*np.subtract(*ends)) for ends, is_outer in walls if is_outer)
    assert length == pytest.approx(2 * (16 - 1.4) + 2 * 6)
    assert not [*house().walls_on(1)]


def test_a_wall_that_would_be_a_door_is_open() -> None:
    """From x = 1 to x = 11 along y = 1, through both ends of the hall, which are 1.4 m wide."""
    assert [(door.storey, door.ends.round(6).tolist()) for door in house().doors] == [
        (0, [[3, 0.3], [3, 1.7]]),
        (0, [[9, 0.3], [9, 1.7]]),
    ]


SQUARE = np.array([(0.0, 0.0), (3.0, 3.0)])


def plan_of(rooms: list[np.ndarray], legs: np.ndarray) -> Plan:
    """Lay out rooms with an object in two corners of each."""
    return Plan.of(np.array(rooms), [(room, np.zeros((0, 2))) for room in rooms], legs)


def test_one_door_in_each_wall() -> None:
    """A hall between two rooms has a door to each, and two ways 0.6 m apart share them."""
    legs = np.array([[(1.0, 1.0), (8.0, 1.0)], [(1.0, 1.6), (8.0, 1.6)]])
    plan = plan_of([SQUARE, SQUARE + np.array([6.5, 0])], legs)
    assert plan.n_rooms == 3
    assert [ends.mean(axis=0).tolist() for ends in plan.doors(legs)] == [[3, 1], [6.5, 1]]


@pytest.mark.parametrize(("apart", "area"), [(1.5, 40.5), (1.6, 27)])
def test_what_is_narrow_between_two_rooms_is_a_part_of_one(apart: float, area: float) -> None:
    room = SQUARE * (1, 3)
    plan = plan_of([room, room + np.array([3 + apart, 0])], np.zeros((0, 2, 2)))
    assert plan.area(0) == pytest.approx(area)
    assert plan.area(1) == pytest.approx(27)


@pytest.mark.parametrize(("side", "open_to_the_sky"), [(4.4, 0.0), (4.5, 4.5**2)])
def test_what_is_small_among_rooms_is_a_part_of_one(side: float, open_to_the_sky: float) -> None:
    """A court of 19 square metres between four rooms is; a larger one is not."""
    low, high = 2.0, 2.0 + side
    around = [
        np.array([(0.0, 0.0), (low, high + 2)]),
        np.array([(low, 0.0), (high + 2, low)]),
        np.array([(high, low), (high + 2, high + 2)]),
        np.array([(low, high), (high, high + 2)]),
    ]
    plan = plan_of(around, np.zeros((0, 2, 2)))
    total = sum(plan.area(room) for room in range(4))
    assert total == pytest.approx((high + 2) ** 2 - open_to_the_sky)


def test_ways_beside_rooms_are_halls() -> None:
    """Two ways that meet are in one hall, 1.4 m wide; a place apart is another."""
    legs = np.array(
        [[(1.0, 2.5), (8.0, 2.5)], [(8.0, 2.5), (8.0, 6.5)], [(20.0, 2.5), (20.0, 2.5)]]
    )
    plan = plan_of([np.array([(0.0, 0.0), (3.0, 5.0)])], legs)
    assert plan.n_rooms == 3
    assert plan.area(0) == pytest.approx(15)
    assert plan.area(1) == pytest.approx(5.7 * 1.4 + 1.4 * 4)
    assert plan.area(2) == pytest.approx(1.4**2)


def test_walls_follow_the_building() -> None:
    """Turned by 20 degrees, the house has the same rooms and doors, turned."""
    turn = np.deg2rad(20)
    back = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    straight, turned = house(), house(turn)
    for one, other in zip(straight.rooms, turned.rooms, strict=True):
        (outline,) = other.outlines
        assert sorted((outline @ back).round(6).tolist()) == corners(one)
    ends = np.array([np.sort(door.ends @ back, axis=0) for door in turned.doors])
    assert ends == pytest.approx(np.array([door.ends for door in straight.doors]))


def test_stairs_between_two_storeys() -> None:
    """A climb of 3 m on a run of 10: 16 treads, half of them also on the plan above; no door."""
    position = np.array([(*HALL, 1.5), (*HALL, 1.5), (*KITCHEN, 4.5), (*KITCHEN, 4.5)])
    nothing = seen_from(position, [], np.zeros((0, 3)), [], known=True)
    building = model_building(position, np.array([[0, 1], [0, 2], [2, 3]]), nothing)
    assert building.storey.tolist() == [0, 0, 1, 1]
    assert (building.rooms, building.doors, building.room.tolist()) == ([], [], [-1] * 4)
    assert [tread.storey for tread in building.treads] == [0] * 8 + [0, 1] * 8
    first = building.treads[0].ends
    assert first.mean(axis=0) == pytest.approx([1 + 10 / 32, 1])
    assert np.ptp(first, axis=0) == pytest.approx([0, 0.9])


def test_stairs_are_in_a_room_with_a_door() -> None:
    """Out of the kitchen, through its wall at y = 3, up to a storey without objects."""
    position = np.array([(*HALL, 1.5), (*KITCHEN, 1.5), (11.5, 6.0, 4.5), (13.5, 6.0, 4.5)])
    centre = np.vstack([position[0] + OBJECTS, position[1] + OBJECTS])
    viewpoint = [0] * len(OBJECTS) + [1] * len(OBJECTS)
    seen = seen_from(position, viewpoint, centre, ["lamp"] * len(centre), known=True)
    building = model_building(position, np.array([[0, 1], [1, 2], [2, 3]]), seen)
    assert {tread.storey for tread in building.treads} == {0, 1}
    for tread in building.treads:
        # They follow the walls, although the way up does not.
        assert np.ptp(tread.ends, axis=0) == pytest.approx([0.9, 0])
        middle = tread.ends.mean(axis=0)[None]
        assert any(room.contains(middle)[0] for room in building.rooms_on(tread.storey))
    middles = [door.ends.mean(axis=0).tolist() for door in building.doors_on(0)]
    assert pytest.approx([11.2, 3.0]) in middles


@pytest.mark.parametrize(
    ("climb", "run", "treads"),
    [
        pytest.param([0, 1.2], 2.0, 6, id="stairs"),
        pytest.param([0, 0.6, 1.2], 1.0, 6, id="in two parts"),
        pytest.param([0, 0.95], 2.0, 0, id="a step"),
        pytest.param([0, 0.6, 0.15, 0.75, 0.3, 0.9, 0.45, 1.05], 0.5, 0, id="up and down"),
        pytest.param([0, 1.2], 5.0, 0, id="a ramp"),
        pytest.param([0, 1.2], 0.4, 0, id="a ladder"),
    ],
)
def test_stairs_climb(climb: list[float], run: float, treads: int) -> None:
    """Viewpoints in a row, in a building of two storeys; there are no stairs in one of one."""
    row = [(run * index, 0.0, height) for index, height in enumerate(climb)]
    position = np.array([*row, (-1.0, 0.0, 0.0), (9.0, 9.0, 5.0), (9.0, 8.0, 5.0)])
    edges = np.column_stack([np.arange(len(row) - 1), np.arange(1, len(row))])
    nothing = seen_from(position, [], np.zeros((0, 3)), [], known=True)
    assert len(model_building(position, edges, nothing).treads) == treads
    assert not model_building(position[: len(row)], edges, nothing).treads


def test_stairs_that_fan_out_are_drawn_once() -> None:
    """The second way up, to a place 0.2 m beside the first, has no treads of its own."""
    position = np.array([(0, 0, 0), (-1, 0, 0), (4, 0, 3), (4.1, 0.2, 3)], dtype=float)
    nothing = seen_from(position, [], np.zeros((0, 3)), [], known=True)
    treads = model_building(position, np.array([[0, 2], [0, 3]]), nothing).treads
    assert len(treads) == 16 + 8


def test_stairs_that_lead_on_are_straight() -> None:
    """Past a place 0.2 m beside the way, and then around a corner; treads rise from 0 to 3 m."""
    position = np.array(
        [(0, 0, 1.5), (-1, 0, 1.5), (2, 0.2, 2.5), (4, -0.2, 3.5), (4, 2, 4.5), (4, 3, 4.5)]
    )
    edges = np.array([[0, 1], [0, 2], [2, 3], [3, 4], [4, 5]])
    nothing = seen_from(position, [], np.zeros((0, 3)), [], known=True)
    building = model_building(position, edges, nothing)
    lower, upper = building.treads_on(0), building.treads_on(1)
    assert {round(float(tread.ends[:, 1].mean()), 6) for tread in lower} == {0.0}
    height = [tread.height for tread in lower]
    assert np.diff(height) == pytest.approx(2.0 / len(height))
    assert (lower[0].height, lower[-1].height) == pytest.approx((height[0], 2.0 - height[0]))
    for tread in lower:
        assert tread.step == pytest.approx([4.0 / len(lower), 0.0])
        assert tread.ends[1] - tread.ends[0] == pytest.approx([0, -0.9])
    assert max(tread.height for tread in upper) < 0


def test_where_objects_are_without_their_distances() -> None:
    """Two rays meet at the object: the rooms are those of known distances, to two decimetres."""
    position = np.array([(0.0, 0.0, 1.5), (2.0, 0.0, 1.5), (0.0, 2.0, 1.5)])
    centre = np.array([(0, 3, 1), (3, 0, 1), (3, 3, 1)], dtype=float)
    ids = np.array([0, 1, 2, 0, 2, 1])
    once = seen_from(position, [0, 0, 0, 1, 1, 2], centre[ids], ["chair"] * 6, known=False)
    seen = replace(once, object_id=ids)
    (room,) = model_building(position, np.array([[0, 1], [0, 2]]), seen).rooms
    (outline,) = room.outlines
    assert outline.max(axis=0) == pytest.approx([3, 3], abs=0.2)
    assert outline.min(axis=0) == pytest.approx([-0.7, -0.7])


def test_a_room_ends_where_its_viewpoints_see_no_more() -> None:
    """Three metres from its camera: the fifth object is not where it seems to be."""
    around = np.array([(2.5, 0, 0), (-2.5, 0, 0), (0, 2.5, 0), (0, -2.5, 0), (3.1, 0, 0)])
    seen = seen_from(np.zeros((1, 3)), [0] * 5, around, ["chair"] * 5, known=True)
    (room,) = model_building(np.zeros((1, 3)), np.zeros((0, 2), dtype=np.int64), seen).rooms
    assert corners(room) == [[-2.5, -2.5], [-2.5, 2.5], [2.5, -2.5], [2.5, 2.5]]


def test_a_room_may_have_parts() -> None:
    """Around a corner: all are of the room, and its name stands where most of its objects are."""
    along = np.arange(0.0, 12.0, 2.0)
    floor = [*((x, 0.0) for x in along), *((10.0, y) for y in along[1:])]
    position = np.array([(*at, 1.5) for at in floor])
    floor_of_objects = [(0, 1), (2, -1), (4, 1), (6, -1), (9, 8), (11, 8)]
    centre = np.array([(*at, 1.0) for at in floor_of_objects])
    seen = seen_from(position, [0, 1, 2, 3, 9, 9], centre, ["bed"] * 6, known=True)
    edges = np.column_stack([np.arange(len(position) - 1), np.arange(1, len(position))])
    building = model_building(position, edges, seen)
    assert [(room.name, room.is_side_part) for room in building.rooms] == [
        ("bedroom", True),
        ("bedroom", False),
    ]
    assert not any(room.is_hall for room in building.rooms)
    assert building.solids.room.tolist() == [1, 1, 1, 1, 0, 0]
    for row, room in enumerate(building.room.tolist()):
        assert building.rooms[room].contains(position[row, :2][None])[0]


def test_one_ray_ends_at_the_usual_distance() -> None:
    """Objects in three directions, seen once: 1.45 m from the camera."""
    position = np.zeros((1, 3))
    around = np.array([(4.0, 0.0, 0.0), (-4.0, 0.0, 0.0), (0.0, 4.0, 0.0)])
    seen = seen_from(position, [0] * 3, around, ["chair"] * 3, known=False)
    (room,) = model_building(position, np.zeros((0, 2), dtype=np.int64), seen).rooms
    assert corners(room) == [[-1.45, -0.7], [-1.45, 1.45], [1.45, -0.7], [1.45, 1.45]]


def test_sightings_look_at_the_middle_of_whole_boxes() -> None:
    """Level view 12 looks north: a whole box around its centre; the box cut by an edge is out."""
    seen = Sightings.of_boxes(
        viewpoint=np.array([0, 0]),
        object_id=np.array([1, 2]),
        distance=np.array([np.inf, np.inf]),
        names=["bed", "lamp"],
        row=np.array([0, 0, 1]),
        view=np.array([12, 13, 15]),
        xywh=np.array([(300, 220, 40, 40), (0, 220, 300, 40), (0, 0, 640, 480)]),
    )
    assert seen.direction == pytest.approx(np.array([(0, 1, 0), (1, 0, 0)]), abs=1e-9)
    assert seen.extent * FOCAL_LENGTH == pytest.approx(np.array([(40, 40), (640, 480)]))


def test_what_is_in_a_room() -> None:
    """The wall and a hole are outside; the wall of the hole and a separate part are inside."""
    square = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    room = Room("", 0, [4 * square, square + 1, square + np.array([6, 0])], 16.0)
    points = np.array([(0.5, 0.5), (0.0, 2.0), (1.5, 1.5), (1.0, 1.5), (6.5, 0.5), (5.0, 0.5)])
    assert room.contains(points).tolist() == [True, False, False, True, True, False]


def test_what_is_around_a_point() -> None:
    """Rooms and treads at most two metres away on its storey; rooms have new numbers."""
    square = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    far, near, above = (
        Room("", storey, [square + np.array([x, 0])], 1.0)
        for storey, x in ((0, 6.1), (0, -3.0), (1, 0.0))
    )
    treads = [
        Tread(0, np.array([(x, 0.0), (x, 1.0)]), np.array([0.2, 0.0]), 0.1) for x in (2.0, -2.1)
    ]
    whole = house()
    building = replace(
        whole,
        room=np.array([0, 1, 2, -1]),
        rooms=[far, near, above],
        treads=treads,
        solids=replace(whole.solids, room=np.array([2, 1, 0, -1])),
    )
    around = building.around(np.array([(0.0, 0.5), (4.0, 0.5)]), np.array([0, 0]), 2.0)
    assert around.rooms == [near]
    assert around.room.tolist() == [-1, 0, -1, -1]
    assert around.solids.room.tolist() == [-1, 0, -1, -1]
    assert around.treads == treads[:1]
    assert not building.around(np.array([(0.0, 3.1)]), np.array([0]), 2.0).rooms
    assert building.around(np.array([(0.5, 0.5)]), np.array([1]), 0.0).rooms == [above]


@pytest.mark.parametrize(
    ("names", "room"),
    [
        pytest.param(["bed", "nightstand", "desk"], "bedroom", id="a bed decides"),
        pytest.param(["toilet", "sink"], "bathroom", id="one telling object"),
        pytest.param(["counter", "cabinet door"], "kitchen", id="half of a word; the margin"),
        pytest.param(["counter"], "", id="less than the margin"),
        pytest.param(["couch", "desk"], "", id="two rooms"),
        pytest.param(["shoes"] * 2, "closet", id="repeated, in the plural"),
        pytest.param(["chair"] * 3 + ["table"], "dining room", id="chairs around a table"),
        pytest.param(["chair"] * 2 + ["table"], "", id="two chairs"),
        pytest.param(["lamp", ""], "", id="nothing telling"),
        pytest.param([], "", id="nothing"),
    ],
)
def test_names_of_rooms(names: list[str], room: str) -> None:
    assert name_room(names, 1, 1.0) == room


@pytest.mark.parametrize(
    ("ways", "length", "room"),
    [
        pytest.param(4, 1.0, "", id="four ways"),
        pytest.param(5, 1.0, "hallway", id="five ways"),
        pytest.param(2, 4.4, "", id="long"),
        pytest.param(2, 4.5, "hallway", id="longer"),
        pytest.param(4, 4.0, "hallway", id="both"),
    ],
)
def test_halls_have_many_ways_or_are_long(ways: int, length: float, room: str) -> None:
    assert name_room(["picture"], ways, length) == room
    assert name_room(["picture", "bed"], ways, length) == "bedroom"
