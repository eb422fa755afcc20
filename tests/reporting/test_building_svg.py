"""Buildings as stacked floors, and walks that play in them."""

import math
import os
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import shapely
from imageio_ffmpeg import get_ffmpeg_exe

import reverie_eval as rv
from benchmarks.buildings import Scan, plan_picture
from reverie_eval.analysis import Episode
from reverie_eval.geometry import Building, Line, Room, Sightings, Solids, door_spans
from reverie_eval.reporting.building_svg import BuildingPicture
from reverie_eval.reporting.buildings import building_of
from reverie_eval.reporting.floors_svg import Sheets
from reverie_eval.reporting.map_layout import WIDTH, Mark, text_box
from reverie_eval.reporting.map_svg import interactive_map_svg
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.reporting.walls import off_the_walls, wall_pieces, walls_of
from tests.conftest import SAMPLES, unavailable
from tests.support.flat_world import Run

EPISODE = "1196_0_0"
"""The episode whose walk has four moves on one of two levels."""


@pytest.fixture(scope="module")
def scores() -> rv.Scores:
    return rv.evaluate(SAMPLES / "mediocre.json", split="val_unseen")


@pytest.fixture(scope="module")
def episode(scores: rv.Scores) -> Episode:
    found: Episode = scores.episode(EPISODE)
    return found


def picture_of(episode: Episode, target: int | None = None) -> BuildingPicture:
    return BuildingPicture(EpisodeMap.of({"": episode}), target)


def of_class(svg: str, word: str) -> list[ET.Element]:
    return [each for each in ET.fromstring(svg).iter() if word in each.get("class", "").split()]


def points(shape: ET.Element) -> np.ndarray:
    """Return the points of a path of lines."""
    numbers = shape.get("d", "").replace("h0", "").replace("z", "").replace("M", "L").split("L")
    return np.array([each.split() for each in numbers if each], dtype=float)


@pytest.mark.parametrize(
    ("doors", "expected"),
    [
        pytest.param([], [(0, 1), (1, 2)], id="none"),
        pytest.param([(0.5, 1.5)], [(0, 0.5), (1.5, 2)], id="in the middle"),
        pytest.param([(-0.5, 0.5)], [(0.5, 2)], id="across a corner"),
        pytest.param([(1.7, 1.9), (0.1, 0.3)], [(0, 0.1), (0.3, 1.7), (1.9, 2)], id="two"),
        pytest.param([(0.6, 1.5), (0.2, 1.1)], [(0, 0.2), (1.5, 2)], id="overlapping"),
    ],
)
def test_walls_have_gaps_for_doors(
    doors: list[tuple[float, float]], expected: list[tuple[float, float]]
) -> None:
    """A wall from (3, 0) to (3, 2), in pieces of at most 1.5 m; a door in another wall is none."""
    ends = [[(3, low), (3, high)] for low, high in doors] + [[(1, 0), (1, 2)]]
    wall = np.array([3.0, 0.0]), np.array([3.0, 2.0])
    spans = door_spans([Line(0, np.array(each, float)) for each in ends], *wall)
    pieces = list(wall_pieces(*wall, spans))
    assert [tuple(piece[:, 1].round(9)) for piece in pieces] == expected


def two_rooms(axes: np.ndarray, names: list[str]) -> Building:
    """Return two rooms with four objects, 1 m wide.

    One is beside an outer wall; the others beside an inner one, at a door, and amid a room.
    """
    square = np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)])
    centre = np.array([(1.0, 0.9), (3.8, 2.0), (6.0, 3.9), (2.0, 2.0)])
    nowhere = np.zeros(len(names), dtype=np.int64)
    solids = Solids(
        object_id=np.arange(len(names)),
        names=names,
        storey=nowhere,
        room=nowhere,
        centre=np.column_stack([centre @ axes, np.ones(len(names))]),
        half=np.full((len(names), 3), 0.5),
        back=np.array([3, 0, 1, 3]),
        axes=axes,
    )
    return Building(
        storey=np.zeros(1, dtype=np.int64),
        room=np.zeros(1, dtype=np.int64),
        rooms=[Room("", 0, [(square + np.array([x, 0])) @ axes], 16.0) for x in (0, 4)],
        doors=[Line(0, np.array([(5.5, 4.0), (6.4, 4.0)]) @ axes)],
        treads=[],
        solids=solids,
    )


@pytest.mark.parametrize(
    ("name", "centre", "wide", "expected"),
    [
        pytest.param("desk", (1.0, 0.9), 1.0, (1.0, 0.9), id="beside a wall"),
        pytest.param("desk", (2.0, 0.5), 1.0, (2.0, 0.65), id="in an outer wall"),
        pytest.param("desk", (0.3, 0.2), 1.0, (0.65, 0.65), id="in a corner"),
        pytest.param("desk", (3.8, 2.0), 1.0, (3.43, 2.0), id="in an inner wall"),
        pytest.param("desk", (4.2, 2.0), 1.0, (4.57, 2.0), id="in it from the other side"),
        pytest.param("desk", (6.0, 3.9), 0.8, (6.0, 3.9), id="in a door"),
        pytest.param("picture", (0.1, 2.0), 1.0, (0.1, 2.0), id="on a wall"),
        pytest.param("desk", (2.5, 2.0), 5.0, (2.04, 2.0), id="wider than its room"),
    ],
)
@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_furniture_stands_beside_walls(
    name: str,
    centre: tuple[float, float],
    wide: float,
    expected: tuple[float, float],
    turn: float,
) -> None:
    axes = np.array([(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))])
    building = two_rooms(axes, [name] * 4)
    solids = replace(
        building.solids.take(np.array([0])),
        centre=np.append(np.array(centre) @ axes, 1.0)[None],
        half=np.array([(wide / 2, 0.5, 0.5)]),
    )
    moved = off_the_walls(solids, building, 0)
    assert moved.centre[0, :2] @ axes.T == pytest.approx(expected)
    assert moved.centre[0, 2] == 1.0
    assert moved.half[0] == pytest.approx((min(wide, 3.78) / 2, 0.5, 0.5))


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_windows_are_in_outer_walls(turn: float) -> None:
    """One beside an outer wall; not those beside an inner one, at a door, and amid a room."""
    axes = np.array([(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))])
    building = two_rooms(axes, ["bay window", "window", "windows", "window"])
    pieces = [each for each in walls_of(building, 0, axes, 0.0) if each.material != "wood"]
    (pane,) = [piece for piece in pieces if piece.material == "glass"]
    assert np.sort(pane.ends @ axes.T, axis=0) == pytest.approx(np.array([(0.5, 0), (1.5, 0)]))
    thickness = {round(2 * piece.half, 6) for piece in pieces}
    assert thickness == {0.3, 0.14, 0.1}
    # Below the pane is a wall.
    feet = [piece for piece in pieces if piece.low == 0]
    assert len(feet) == len(pieces) - 1
    length = sum(np.hypot(*(piece.ends[1] - piece.ends[0])) for piece in feet)
    # Corners are closed: outer walls, of which there are four lines, are longer by their thickness.
    assert length == pytest.approx(24 + 4 * 0.3 + 4 + 0.14 - 0.9)
    corners = pane.corners(axes)
    assert np.ptp(corners, axis=0) == pytest.approx([1.0, 0.1, 0.5])


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_outer_walls_beyond_their_rooms_are_high(turn: float) -> None:
    """There are a window with a wall above it, and a picture with its frame; none nearer."""
    axes = np.array([(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))])
    building = two_rooms(axes, ["picture", "window", "picture", "picture"])
    moved = building.solids.centre.copy()
    moved[:3, :2] = np.array([(1.0, 0.1), (3.0, 3.8), (1.0, 3.8)]) @ axes
    building = replace(building, solids=replace(building.solids, centre=moved))
    pieces = [*walls_of(building, 0, axes, 0.0)]
    high = [piece for piece in pieces if piece.high == 1.5]
    assert {piece.material for piece in high} == {"wall"}
    # Its corners are closed, and it has a door.
    length = sum(np.hypot(*(piece.ends[1] - piece.ends[0])) for piece in high)
    assert length == pytest.approx(8 + 0.3 - 0.9)
    assert all((piece.ends @ axes.T)[:, 1] == pytest.approx([4, 4]) for piece in high)
    (pane,) = [piece for piece in pieces if piece.material == "glass"]
    assert (pane.low, pane.high) == (0.3, 1.2)
    (middle,) = [piece for piece in pieces if piece.material == "white"]
    assert np.sort((middle.ends @ axes.T)[:, 0]) == pytest.approx([0.56, 1.44])
    assert (middle.low, middle.high) == pytest.approx((0.36, 0.84))


def test_doors_between_walls_stand_open() -> None:
    """Not outwards; none where there is no wall on both sides, and none of wide ones."""
    building = two_rooms(np.eye(2), ["rug"] * 4)

    def leaves(*doors: tuple[tuple[float, float], tuple[float, float]]) -> list[list[float]]:
        lines = [Line(0, np.array(ends)) for ends in doors]
        pieces = walls_of(replace(building, doors=lines), 0, np.eye(2), 0.0)
        leaves = [piece.ends for piece in pieces if piece.material == "wood"]
        return [np.sort(ends, axis=0).round(6).ravel().tolist() for ends in leaves]

    assert leaves(((5.5, 4.0), (6.4, 4.0))) == [[6.4, 3.1, 6.4, 4.0]]
    assert leaves(((4.0, 1.0), (4.0, 1.9))) == [[3.1, 1.0, 4.0, 1.0]]
    assert leaves(((4.0, 0.0), (4.0, 0.9))) == []
    assert leaves(((4.0, 1.0), (4.0, 2.9))) == []
    assert leaves(((4.0, 1.0), (4.0, 1.9)), ((4.0, 1.9), (4.0, 2.8))) == []


def test_walls_are_dark_where_they_end(episode: Episode) -> None:
    """Not between two pieces of a wall."""
    (dark, *others) = of_class(picture_of(episode).svg(), "cut")
    assert {each.get("class") for each in (dark, *others)} == {"wall cut"}


def test_doors_that_are_seen_are_in_outer_walls() -> None:
    """A closed one, from the floor; no door to another room, and none where a way leads through."""
    building = two_rooms(np.eye(2), ["front door", "door", "door", "door"])
    pieces = [*walls_of(building, 0, np.eye(2), 0.0)]
    (leaf,) = [piece for piece in pieces if piece.material == "wood" and piece.half == 0.05]
    assert np.sort(leaf.ends, axis=0) == pytest.approx(np.array([(0.5, 0), (1.5, 0)]))
    assert np.ptp(leaf.corners(np.eye(2)), axis=0) == pytest.approx([1.0, 0.1, 0.8])
    spans = [np.sort(each.ends[:, 0]) for each in pieces if not each.ends[:, 1].any()]
    assert sum(np.ptp(span) for span in spans) == pytest.approx(8.3)


@pytest.mark.parametrize(
    ("n_levels", "size", "columns"),
    [
        pytest.param(1, (4, 30), 1, id="one"),
        pytest.param(2, (30, 10), 1, id="two that are wide"),
        pytest.param(2, (4, 10), 2, id="two that are narrow"),
        pytest.param(3, (4, 10), 2, id="three that are narrow"),
        pytest.param(4, (30, 4), 1, id="four that are wide"),
        pytest.param(5, (4, 10), 2, id="five that are narrow"),
    ],
)
def test_levels_are_in_two_columns_if_they_are_larger_so(
    n_levels: int, size: tuple[float, float], columns: int
) -> None:
    corners = np.array([(0, 0), size], dtype=float)
    sheets = Sheets.of(dict.fromkeys(range(n_levels)[::-1], corners), below=10.0)
    assert len({float(left) for left in sheets.title_left.values()}) == columns
    placed = {level: sheets.scale * corners + its for level, its in sheets.origin.items()}
    assert (np.vstack(list(placed.values())) >= 0).all()
    assert all((its <= (WIDTH, sheets.height - 10)).all() for its in placed.values())
    assert sheets.height <= 560
    assert sheets.title_left[0] == min(sheets.title_left.values())
    bottom = max(its[1, 1] for its in placed.values())
    assert placed[0][1, 1] == pytest.approx(bottom)
    top = min(its[0, 1] for its in placed.values())
    assert placed[n_levels - 1][0, 1] == pytest.approx(top)
    assert all(
        placed[level][1, 1] < placed[level - 1][0, 1]
        for level in range(1, n_levels)
        if sheets.title_left[level] == sheets.title_left[level - 1]
    )


def test_a_level_is_where_it_leaves_space() -> None:
    """Two low levels are in one column, beside a high one."""
    high, low = np.array([(0.0, 0.0), (4.0, 20.0)]), np.array([(0.0, 0.0), (4.0, 8.0)])
    sheets = Sheets.of({2: low, 1: low, 0: high}, below=0.0)
    assert sheets.title_left[2] == sheets.title_left[1] != sheets.title_left[0]
    assert sheets.origin[2][1] == pytest.approx(sheets.origin[0][1])
    assert sheets.scale == pytest.approx((560 - 2 * 14) / 20)


@pytest.mark.parametrize(
    ("sides", "is_turned"),
    [
        pytest.param((10.0, 10.5), False, id="hardly larger"),
        pytest.param((4.0, 20.0), True, id="clearly larger"),
    ],
)
def test_a_long_building_leads_up_the_page(
    episode: Episode, sides: tuple[float, float], *, is_turned: bool
) -> None:
    """A long building is drawn alike, along whichever of its axes it is long."""
    whole = EpisodeMap.of({"": episode})
    axes = whole.building.solids.axes
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
    heights = []
    for each in (sides, sides[::-1]):
        room = Room("", 0, [(corners * each) @ axes], math.prod(sides))
        building = replace(
            whole.building,
            rooms=[room],
            room=0 * whole.building.room,
            storey=0 * whole.storey,
            solids=whole.building.solids.take(np.zeros(0, dtype=np.int64)),
        )
        here = 0 * whole.position
        heights.append(BuildingPicture(replace(whole, building=building, position=here)).height)
    assert (heights[0] == pytest.approx(heights[1])) == is_turned


def test_levels_take_up_what_they_need() -> None:
    """A small one is as near to the next, and as far from the left as it is in the building."""
    large, small = np.array([(0.0, 0.0), (10.0, 12.0)]), np.array([(6.0, 5.0), (8.0, 7.0)])
    sheets = Sheets.of({1: small, 0: large}, below=0.0)
    assert sheets.origin[0][0] == sheets.origin[1][0]
    gap = (sheets.scale * large + sheets.origin[0])[0, 1] - (
        sheets.scale * small + sheets.origin[1]
    )[1, 1]
    assert gap == pytest.approx(12)
    assert sheets.height == pytest.approx(2 * 14 + 14 * sheets.scale + 12)


def test_floors_have_joints(episode: Episode) -> None:
    """Boards along one axis; tiles in the kitchen, along both."""
    svg = picture_of(episode).svg()
    (joints,) = of_class(svg, "joint")
    lines = [its.split("L") for its in joints.get("d", "").split("M")[1:]]
    ends = np.array([[each.split() for each in line] for line in lines], dtype=float)
    ways = {round(float(np.arctan2(*(last - first)[::-1])) % np.pi, 1) for first, last in ends}
    assert len(ways) == 2


@pytest.mark.parametrize(("name", "is_drawn"), [("stairs", False), ("dresser", True)])
def test_what_is_large_and_unknown_is_left_out(
    episode: Episode, name: str, *, is_drawn: bool
) -> None:
    whole = EpisodeMap.of({"": episode})
    solids = whole.building.solids
    row = solids.object_id.tolist().index(episode.target_object)
    large = solids.half.copy()
    large[row] = 0.7
    names = ["rug"] * len(solids.names)
    names[row] = name
    changed = replace(whole.building, doors=[], solids=replace(solids, half=large, names=names))
    svg = BuildingPicture(replace(whole, building=changed)).svg()
    assert bool(of_class(svg, "wood")) == is_drawn


def renamed(episode: Episode, name: str, up: float) -> str:
    """Draw a building whose only large object has a name and begins so far above its floor."""
    whole = EpisodeMap.of({"": episode})
    solids = whole.building.solids
    row = solids.object_id.tolist().index(episode.target_object)
    half, centre = np.full_like(solids.half, 0.1), solids.centre.copy()
    half[row] = 0.5
    floor = float(np.median(whole.position[whole.storey == solids.storey[row], 2])) - 1.5
    centre[row, 2] = floor + up + 0.5
    names = ["lamp"] * len(solids.names)
    names[row] = name
    moved = replace(solids, half=half, centre=centre, names=names)
    building = replace(whole.building, doors=[], solids=moved)
    return BuildingPicture(replace(whole, building=building)).svg()


def foot(svg: str) -> float:
    """Return how low on the page wood is, whose outlines go from corner to corner."""
    outlines = [
        np.array(outline.rstrip("z").replace("l", " ").split(), dtype=float).reshape(-1, 2)
        for each in of_class(svg, "wood")
        for outline in each.get("d", "").split("M")[1:]
    ]
    return max(float(outline.cumsum(axis=0)[:, 1].max()) for outline in outlines)


@pytest.mark.parametrize(
    ("name", "up", "is_drawn"),
    [
        pytest.param("bookcase", 0.0, True, id="stands"),
        pytest.param("bookcase", 0.6, True, id="reaches down"),
        pytest.param("box", 0.0, True, id="lies on the floor"),
        pytest.param("box", 0.6, False, id="floats"),
    ],
)
def test_nothing_floats(episode: Episode, name: str, up: float, *, is_drawn: bool) -> None:
    svg = renamed(episode, name, up)
    assert bool(of_class(svg, "wood")) == is_drawn
    if is_drawn:
        assert foot(svg) == pytest.approx(foot(renamed(episode, name, 0.0)), abs=0.11)


def test_gardens_have_no_walls_and_no_names(episode: Episode) -> None:
    whole = EpisodeMap.of({"": episode})
    rooms = [room._replace(is_outdoors=True) for room in whole.building.rooms]
    svg = BuildingPicture(replace(whole, building=replace(whole.building, rooms=rooms))).svg()
    assert of_class(svg, "outdoors")
    assert not [*of_class(svg, "wall"), *of_class(svg, "joint"), *of_class(svg, "room-name")]


def test_levels_are_stacked(scores: rv.Scores) -> None:
    """Only those of the episode, the highest first, each in its part of the page."""
    maps = [EpisodeMap.of({"": scores.episode(each)}) for each in scores.instr_ids]
    several = next(each for each in maps if len(each.levels(each.visited)) == 2)
    titles = of_class(BuildingPicture(several).svg(), "level")
    assert [each.text for each in titles] == ["level 2", "level 1"]
    single = next(each for each in maps if each.levels(each.visited) == [1])
    assert [each.text for each in of_class(BuildingPicture(single).svg(), "level")] == ["level 1"]


def test_a_title_stands_above_a_room_that_fills_its_corner(episode: Episode) -> None:
    """A long room begins where titles are: at the foot of the left side."""
    whole = EpisodeMap.of({"": episode})
    building, level = whole.building, whole.start_storey
    corners = np.array([(-30, -3), (30, -3), (30, 3), (-30, 3)]) @ building.solids.axes
    room = next(iter(building.rooms_on(level)))
    long = room._replace(outlines=[corners + whole.position[whole.visited[0], :2]])
    rooms = [long if each is room else each for each in building.rooms]
    svg = BuildingPicture(replace(whole, building=replace(building, rooms=rooms))).svg()
    (title,) = of_class(svg, "level")
    spot = np.array([float(title.get(axis, "")) for axis in "xy"])
    low, high = text_box(Mark("right of", spot, text=str(title.text)))
    sheets = [shapely.Polygon(points(each)) for each in of_class(svg, "room")]
    assert not shapely.intersects(sheets, shapely.box(*low, *high)).any()


def test_what_is_far_from_the_walk_is_left_out(scores: rv.Scores) -> None:
    """Each level has the viewpoints within 4 m of one that the episode visits."""
    maps = [EpisodeMap.of({"": scores.episode(each)}) for each in scores.instr_ids]
    several = next(each for each in maps if each.leaves_level)
    near = {
        several.viewpoint_ids[row]
        for row in range(len(several.storey))
        for visited in several.visited.tolist()
        if several.storey[row] == several.storey[visited]
        and math.dist(several.position[row, :2], several.position[visited, :2]) <= 4
    }
    drawn = of_class(interactive_map_svg(several), "viewpoint")
    assert {each.findtext("title") for each in drawn} == near
    levels = several.levels(several.visited)
    assert len(near) < sum(level in levels for level in several.storey + 1)


def test_plans_for_contact_sheets_have_all_levels(scores: rv.Scores) -> None:
    truth, name = scores.ground_truth, "DemoMansion"
    rows = truth.graph.viewpoints_of(name)
    nobody = np.zeros(0, dtype=np.int64)
    unseen = Sightings(nobody, nobody, np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2)), ())
    scan = Scan(name, truth.graph.viewpoint_position[rows], truth.graph.edges_of(name), unseen, ())
    building = building_of(truth.graph, truth.require_solution(), name)
    svg = plan_picture(truth.graph, scan, building).svg()
    assert [each.text for each in of_class(svg, "level")] == ["level 2", "level 1"]
    assert len(of_class(svg, "room")) == len(building.rooms)


def test_all_is_on_the_page(episode: Episode) -> None:
    picture = picture_of(episode)
    rooms = [points(each) for each in of_class(picture.svg(), "room")]
    corners = np.vstack(rooms)
    assert (corners > 0).all()
    assert (corners < (WIDTH, picture.height)).all()
    names = [each.text for each in of_class(picture.svg(), "room-name")]
    assert set(names) == {"bedroom", "kitchen"}


def test_objects_without_a_room_are_left_out(episode: Episode) -> None:
    whole = EpisodeMap.of({"": episode})
    solids = whole.building.solids
    bare = replace(
        whole.building,
        room=np.full_like(whole.building.room, -1),
        rooms=[],
        doors=[],
        solids=replace(solids, room=np.full_like(solids.room, -1)),
    )
    svg = BuildingPicture(replace(whole, building=bare)).svg()
    assert not of_class(svg, "wood")
    # There is a floor beneath its ways, and beneath none in a room.
    (way,) = of_class(svg, "way")
    assert "z" not in way.get("d", "")
    assert float(way.get("stroke-width", "")) > 0
    assert not of_class(BuildingPicture(whole).svg(), "way")
    assert len(of_class(svg, "route-1")) == len(of_class(BuildingPicture(whole).svg(), "route-1"))


def test_furniture_is_drawn_in_whichever_room_it_stands(episode: Episode) -> None:
    whole = EpisodeMap.of({"": episode})
    solids = whole.building.solids
    other = replace(whole.building, solids=replace(solids, room=np.full_like(solids.room, -1)))
    assert BuildingPicture(replace(whole, building=other)).svg() == picture_of(episode).svg()


def test_the_target_is_marked_on_request(episode: Episode) -> None:
    assert not of_class(picture_of(episode).svg(), "pin")
    assert len(of_class(picture_of(episode, episode.target_object).svg(), "pin")) == 2


def test_named_routes_are_explained(episode: Episode) -> None:
    both = BuildingPicture(EpisodeMap.of({"Ours <1>": episode, "Other": episode}))
    *levels, ours, other = of_class(both.svg(), "level")
    assert ([each.text for each in levels], ours.text, other.text) == (
        ["level 1"],
        "Ours <1>",
        "Other",
    )
    assert float(ours.get("y", "")) < float(other.get("y", "")) < both.height
    lines = [of_class(both.svg(), f"route-{number}")[-1].get("d", "") for number in (1, 2)]
    assert [line.startswith("M14 ") for line in lines] == [True, True]


def test_a_share_of_the_walk(episode: Episode) -> None:
    """Half of it is half as long; the agent is at its end, and the stop is not shown yet."""
    whole, half = (picture_of(episode).picture(share=share) for share in (1.0, 0.5))

    def length(svg: str) -> float:
        (line, *_) = of_class(svg, "route-1")
        return float(np.hypot(*np.diff(points(line), axis=0).T).sum())

    assert length(half) == pytest.approx(length(whole) / 2, abs=0.5)
    assert [len(of_class(svg, "at")) for svg in (whole, half)] == [0, 1]
    assert [len(of_class(svg, "stop")) for svg in (whole, half)] == [1, 0]


def test_a_walk_plays_without_scripts_and_styles(episode: Episode) -> None:
    svg = picture_of(episode).svg(plays=True)
    assert [each.get("pathLength") for each in of_class(svg, "plays")] == ["1"]
    assert [each.get("pathLength") for each in of_class(svg, "walker")] == ["1"]
    assert "style" not in svg
    assert "<script" not in svg


def test_files_that_play(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image, ImageSequence

    # Few pictures, each of which takes long.
    monkeypatch.setattr("reverie_eval.reporting.episode_figure._RATE", 1)
    try:
        import vl_convert  # noqa: F401
    except ModuleNotFoundError:
        unavailable("vl-convert is not installed")
    words = ["figure", str(SAMPLES / "mediocre.json"), EPISODE, "--split", "val_unseen"]
    for suffix in ("svg", "gif"):
        file = tmp_path / f"walk.{suffix}"
        assert run(*words, "--animate", "-o", str(file)) == (0, "", "")
    assert "prefers-reduced-motion" in (tmp_path / "walk.svg").read_text()
    image = Image.open(BytesIO((tmp_path / "walk.gif").read_bytes()))
    frames = [frame.info["duration"] for frame in ImageSequence.Iterator(image)]
    assert image.width == 2 * WIDTH
    assert sum(frames) == 8000


@pytest.mark.parametrize(
    ("output", "said"),
    [
        ("walk.pdf", "walk.pdf: expected a name that ends in .svg, .gif or .mp4"),
        ("walk.svg --columns 1", "--no-legend cannot be combined with --animate"),
        ("walk.svg --no-legend", "--no-legend cannot be combined with --animate"),
        ("walk.mp4", "walk.mp4: MP4 needs the program ffmpeg; install it, or write .gif"),
    ],
)
def test_files_that_cannot_be_written(
    output: str, said: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    words = ["figure", str(SAMPLES / "mediocre.json"), EPISODE, "--split", "val_unseen"]
    ended = run(*words, "--animate", "-o", *output.split())
    assert (ended.status, ended.out, list(tmp_path.iterdir())) == (2, "", [])
    assert said in ended.err


def test_mp4(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ffmpeg").symlink_to(get_ffmpeg_exe())
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr("reverie_eval.reporting.episode_figure._RATE", 1)
    file = tmp_path / "walk.mp4"
    words = ["figure", str(SAMPLES / "mediocre.json"), EPISODE, "--split", "val_unseen"]
    assert run(*words, "--animate", "-o", str(file)) == (0, "", "")
    assert file.read_bytes()[4:8] == b"ftyp"


@pytest.mark.parametrize(
    ("fails", "told"),
    [("echo no such codec >&2; exit 1", "no such codec"), ("exit 3", "status 3")],
    ids=["with a reason", "silently"],
)
def test_what_ffmpeg_cannot_write(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str, told: str
) -> None:
    ffmpeg = tmp_path / "bin" / "ffmpeg"
    ffmpeg.parent.mkdir()
    ffmpeg.write_text(f"#!/bin/sh\ncat > /dev/null\n{fails}\n")
    ffmpeg.chmod(0o755)
    monkeypatch.setenv("PATH", str(ffmpeg.parent), prepend=os.pathsep)
    monkeypatch.setattr("reverie_eval.reporting.episode_figure._RATE", 1)
    words = ["figure", str(SAMPLES / "mediocre.json"), EPISODE, "--split", "val_unseen"]
    ended = run(*words, "--animate", "-o", str(tmp_path / "walk.mp4"))
    assert (ended.status, ended.err) == (2, f"reverie-eval: ffmpeg failed: {told}\n")
    assert [*tmp_path.iterdir()] == [ffmpeg.parent]
