"""Maps of episodes: what they show, as data and as SVG."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.geometry import Building, Line, Room
from reverie_eval.reporting.buildings import building_of
from reverie_eval.reporting.map_layout import HEIGHT, WIDTH, Frame, Layout, arrows, lanes, sector
from reverie_eval.reporting.map_marks import MAP_STYLE
from reverie_eval.reporting.map_svg import interactive_map_svg, map_key, map_picture, map_svg
from reverie_eval.reporting.maps import EpisodeMap, Step
from tests.conftest import SAMPLES
from tests.support.home_world import LAMP, OTHER_WALKS, WALKS, home_scores

SVG = "{http://www.w3.org/2000/svg}"
MARKUP = '<script src="x">&amp;'


@pytest.fixture(scope="module")
def scores(tmp_path_factory: pytest.TempPathFactory) -> rv.Scores:
    """Score an episode of every outcome."""
    return home_scores(tmp_path_factory.mktemp("home"))


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> rv.Scores:
    """Score another submission, whose agent goes downstairs once."""
    return home_scores(tmp_path_factory.mktemp("home"), OTHER_WALKS)


def map_of(scores: rv.Scores, instr_id: str) -> EpisodeMap:
    """Lay out one submission's episode."""
    return EpisodeMap.of({"": scores.episode(instr_id)})


def named(episode_map: EpisodeMap, rows: np.ndarray) -> list[str]:
    """Return the ids of viewpoints."""
    return [episode_map.viewpoint_ids[row] for row in rows]


# Data.


def test_a_map_holds_the_scan_and_the_episode(scores: rv.Scores) -> None:
    episode_map = map_of(scores, "2_4_0")
    (route,) = episode_map.routes
    assert {frozenset(named(episode_map, edge)) for edge in episode_map.edges} == {
        frozenset(pair)
        for pair in (
            ("cellar", "rack"),
            ("rack", "shelf"),
            ("shelf", "stairs"),
            ("stairs", "hall"),
            ("hall", "room"),
            ("room", "porch"),
        )
    }
    assert named(episode_map, route.viewpoint) == ["porch", "room", "porch"]
    assert named(episode_map, episode_map.annotated_path) == ["porch", "room", "hall"]
    assert sorted(named(episode_map, episode_map.goal_viewpoints)) == ["hall", "room"]
    ends = np.array([episode_map.start, route.stop, episode_map.path_end])
    assert named(episode_map, ends) == ["porch", "porch", "hall"]


def test_storeys_and_what_is_elsewhere(scores: rv.Scores) -> None:
    episode_map = map_of(scores, "1_3_0")
    storey = dict(zip(episode_map.viewpoint_ids, episode_map.storey.tolist(), strict=True))
    assert storey == {
        "cellar": 0,
        "rack": 0,
        "shelf": 0,
        "stairs": 1,  # 1.6 m is nearer to 3.0 m than to 0.0 m
        "hall": 1,
        "room": 1,
        "porch": 1,
    }
    elsewhere = named(episode_map, np.flatnonzero(episode_map.is_elsewhere))
    assert sorted(elsewhere) == ["cellar", "rack", "shelf"]
    assert episode_map.storeys == "level 2 of 2"


def test_an_agent_that_changes_storeys_is_shown_on_both(other: rv.Scores) -> None:
    episode_map = map_of(other, "1_3_0")
    assert not episode_map.is_elsewhere.any()
    assert episode_map.storeys == "levels 1 and 2 of 2"


def test_legs_leave_out_turns_on_the_spot(scores: rv.Scores) -> None:
    route = replace(map_of(scores, "1_3_0").routes[0], viewpoint=np.array([4, 4, 5, 5, 4]))
    assert route.legs.tolist() == [[4, 5], [5, 4]]


# The page.


@pytest.mark.parametrize("instr_id", ["1_3_0", "1_3_2", "2_4_0"])
def test_all_that_matters_is_in_the_frame(instr_id: str, other: rv.Scores) -> None:
    episode_map = map_of(other, instr_id)
    frame = Frame.around(episode_map.position[episode_map.visited])
    place = frame.points(episode_map.position[episode_map.visited])
    margin = 1.4 * frame.scale
    assert (place > margin).all()
    assert (place < np.array([WIDTH, HEIGHT]) - margin).all()


def test_north_is_up_and_a_metre_is_as_long_both_ways(scores: rv.Scores) -> None:
    frame = Frame.around(map_of(scores, "1_3_0").position)
    origin, east, north = frame.points(np.array([[0, 0], [1, 0], [0, 1]], dtype=float))
    assert (east - origin).tolist() == pytest.approx([frame.scale, 0])
    assert (north - origin).tolist() == pytest.approx([0, -frame.scale])


def test_going_and_coming_are_two_lines(scores: rv.Scores) -> None:
    """The agent goes south and back: to its right is west, then east."""
    episode_map = map_of(scores, "2_4_0")
    frame = Frame.around(episode_map.position[episode_map.visited])
    (route,) = episode_map.routes
    going, coming = lanes(frame.points(episode_map.position[route.legs]), route.number)
    assert going[0][0] == going[1][0] < coming[0][0] == coming[1][0]
    assert going[0][1] < going[1][1]


def test_an_arrow_points_ahead() -> None:
    leg = np.array([[[0.0, 0.0], [100.0, 0.0]]])
    (arrow,) = arrows(leg)
    assert arrow is not None
    tip, left, right = arrow
    assert tip[0] > left[0] == right[0]
    assert tip[1] == 0
    assert list(arrows(leg / 10)) == [None]  # no room


@pytest.mark.parametrize(
    ("scale", "metres"),
    [(40.0, 2), (25.0, 2), (20.0, 5), (10.0, 10), (200.0, 1)],
)
def test_the_scale_s_bar_is_round(scale: float, metres: int) -> None:
    assert Frame(0.0, 0.0, scale).bar_metres == metres


# SVG.


def elements(svg: str, kind: str) -> Iterator[ET.Element]:
    """Parse a picture and return its elements of a class."""
    root = ET.fromstring(svg)
    return (each for each in root.iter() if kind in each.get("class", "").split())


def test_a_picture_counts(scores: rv.Scores) -> None:
    svg = map_svg(map_of(scores, "2_4_0"))
    (edges, elsewhere) = reversed([each.get("d", "") for each in elements(svg, "edge")])
    assert (edges.count("L"), elsewhere.count("L")) == (3, 3)  # the stairs' foot is elsewhere
    assert [each.get("d", "").count("M") for each in elements(svg, "viewpoint")] == [3, 4]
    assert len(list(elements(svg, "goal"))) == 2
    assert [len(list(elements(svg, kind))) for kind in ("start", "end", "stop")] == [1, 1, 1]
    (arrow,) = elements(svg, "arrow")
    assert arrow.get("d", "").count("z") == 2


def test_a_picture_says_what_it_shows(scores: rv.Scores) -> None:
    root = ET.fromstring(map_picture(map_of(scores, "2_4_0")))
    assert root.get("role") == "img"
    assert root.findtext(f"{SVG}title") == "Map of episode 2_4_0"
    assert root.findtext(f"{SVG}desc") == (
        "Scan home, level 2 of 2, seen from above. The annotated path has 2 steps, the "
        "episode 2 goal viewpoints. The agent makes 2 moves; overshot."
    )
    titles = [
        each.findtext(f"{SVG}title")
        for each in elements(map_picture(map_of(scores, "2_4_0")), "stop")
    ]
    assert titles == ["stop: porch"]


def test_two_routes_on_one_map(scores: rv.Scores, other: rv.Scores) -> None:
    both = EpisodeMap.of({"a": scores.episode("1_3_0"), "b": other.episode("1_3_0")})
    svg = map_svg(both)
    assert [each.get("class") for each in elements(svg, "stop")] == ["stop route-1", "stop route-2"]
    assert (
        "The agent of a makes 1 move; correct. The agent of b makes 2 moves; never reached; "
        "stopped on level 1, the path ends on level 2." in svg
    )
    assert not both.is_elsewhere.any()


def test_a_jump_is_drawn_apart(tmp_path: Path) -> None:
    walk = ["hall", "porch", "room", "hall"]
    scores = home_scores(tmp_path, {**WALKS, "1_3_0": (walk, LAMP)})
    episode_map = map_of(scores, "1_3_0")
    assert episode_map.is_jump(episode_map.routes[0]).tolist() == [True, False, False]
    assert (
        "The agent makes 3 moves, 1 of them between unconnected viewpoints; correct object at the "
        "wrong stop." in map_svg(episode_map)
    )
    jumped, walked = (each.get("d", "") for each in elements(map_svg(episode_map), "route"))
    assert (walked.count("M"), walked.count("L")) == (1, 3)
    assert (jumped.count("M"), jumped.count("L")) == (1, 1)


def test_an_agent_that_stays_has_no_route(scores: rv.Scores) -> None:
    svg = map_svg(map_of(scores, "2_4_1"))
    assert not list(elements(svg, "route"))
    assert len(list(elements(svg, "stop"))) == 1


def test_a_picture_stands_for_itself(scores: rv.Scores) -> None:
    episode_map = map_of(scores, "1_3_0")
    svg = map_picture(episode_map)
    assert f"<style>{MAP_STYLE}</style>" in svg
    assert "prefers-color-scheme: dark" in MAP_STYLE
    assert "url(" not in svg
    assert svg == map_picture(map_of(scores, "1_3_0"))
    bare = map_svg(episode_map)
    assert "<style>" not in bare
    assert "http" not in bare


def test_every_name_is_escaped(scores: rv.Scores) -> None:
    episode_map = map_of(scores, "1_3_0")
    (route,) = episode_map.routes
    spoiled = replace(
        episode_map,
        instr_id=MARKUP,
        scan=MARKUP,
        viewpoint_ids=[MARKUP] * len(episode_map.viewpoint_ids),
        routes=[replace(route, name=MARKUP, outcome=MARKUP)],
    )
    root = ET.fromstring(map_picture(spoiled))
    assert not list(root.iter(f"{SVG}script"))
    assert root.findtext(f"{SVG}title") == f"Map of episode {MARKUP}"
    assert "<script" not in map_key(spoiled)


def test_a_notebook_shows_the_map_and_a_caption(tmp_path: Path) -> None:
    scores = home_scores(tmp_path, go_there="turn on <b>the lamp</b>")
    html = scores.episode("1_3_0")._repr_html_()
    assert "<q>turn on &lt;b&gt;the lamp&lt;/b&gt;</q>" in html
    assert "correct: predicted the target, object 3; walked 6.0 m" in html
    assert '<svg class="episode-map" role="img"' in html


# Levels.


def test_a_route_that_changes_levels_is_drawn_on_stacked_floors(other: rv.Scores) -> None:
    """The agent goes downstairs and stops in the cellar, the path ends above."""
    episode_map = map_of(other, "1_3_0")
    svg = map_svg(episode_map)
    legs = {each.get("class"): each.get("d", "").count("L") for each in elements(svg, "route")}
    assert legs == {"route route-1": 1, "route climb route-1": 2}  # joined to the leg before
    above, below = elements(svg, "level")
    assert (above.text, below.text) == ("level 2", "level 1")
    (start,), (stop,) = elements(svg, "start"), elements(svg, "stop")
    heights = [float(each.get(name, "")) for each, name in ((start, "cy"), (stop, "y"))]
    assert heights[0] < float(above.get("y", "")) < heights[1] < float(below.get("y", ""))
    assert episode_map.level_notes == ["stopped on level 1, the path ends on level 2"]


def test_one_level_is_seen_from_above(scores: rv.Scores) -> None:
    episode_map = map_of(scores, "2_4_0")
    svg = map_svg(episode_map)
    assert not [kind for kind in ("climb", "solids", "level") if list(elements(svg, kind))]
    assert episode_map.level_notes == [""]


def test_a_jump_to_another_level_is_a_jump(tmp_path: Path) -> None:
    walks = {**WALKS, "1_3_0": (["hall", "rack"], LAMP)}
    episode_map = map_of(home_scores(tmp_path, walks), "1_3_0")
    assert [each.get("class") for each in elements(map_svg(episode_map), "route")] == [
        "route jump route-1"
    ]


@pytest.mark.parametrize(
    ("instr_id", "kinds"),
    [
        ("1_3_0", "stop sight start annotated end goal elsewhere"),  # correct
        ("1_3_2", "stop start annotated end goal elsewhere"),  # no view shows the answer
    ],
)
def test_a_key_explains_what_is_on_the_map(instr_id: str, kinds: str, scores: rv.Scores) -> None:
    assert [sign.kind for sign in map_of(scores, instr_id).signs] == kinds.split()


def test_a_key_of_levels(other: rv.Scores) -> None:
    kinds = {sign.kind for sign in map_of(other, "1_3_0").signs}
    assert "climb" in kinds
    assert not {"elsewhere", "jump", "sight"} & kinds


def test_the_view_of_the_answer_is_a_sector(scores: rv.Scores) -> None:
    """The lamp is in view 13 of the porch: 30 degrees to the right of north, 75 degrees wide."""
    episode_map = map_of(scores, "2_4_0")
    assert episode_map.routes[0].sight == pytest.approx(np.pi / 6)
    left, *_, right = sector(np.pi / 6)[1:]
    turns = [np.rad2deg(np.arctan2(x, -y)) for x, y in (left, right)]
    assert turns == pytest.approx([30 - 37.589, 30 + 37.589], abs=1e-3)
    assert len(list(elements(map_svg(episode_map), "sight"))) == 1


# Step by step.


def test_steps_of_a_walk(other: rv.Scores) -> None:
    """The stairs' foot is 2.5 m along and 1.5 m down: 2.5 m of way over 2.0 by 1.5."""
    episode_map = map_of(other, "1_3_0")
    hall, stairs, shelf = episode_map.steps(episode_map.routes[0])
    assert (hall.viewpoint_id, hall.level, hall.walked) == ("hall", 2, 0.0)
    assert hall.to_path_end == pytest.approx(6.0)
    assert hall.to_goal == pytest.approx(6.0)  # the lamp is visible from the room
    assert (stairs.viewpoint_id, stairs.level) == ("stairs", 2)
    assert stairs.walked == pytest.approx((4.0**2 + 1.4**2) ** 0.5)
    assert (shelf.viewpoint_id, shelf.level, shelf.number) == ("shelf", 1, 2)
    assert shelf.walked - stairs.walked == pytest.approx(2.5)
    assert shelf.to_path_end == pytest.approx(6.0 + shelf.walked)
    assert not any(step.is_goal or step.is_jump for step in (hall, stairs, shelf))


def test_turns_on_the_spot_are_not_steps(tmp_path: Path) -> None:
    walk = ["hall", "hall", "room", "room", "cellar"]
    scores = home_scores(tmp_path, {**WALKS, "1_3_0": (walk, LAMP)})
    episode_map = map_of(scores, "1_3_0")
    steps = episode_map.steps(episode_map.routes[0])
    assert [(step.viewpoint_id, step.is_goal, step.is_jump) for step in steps] == [
        ("hall", False, False),
        ("room", True, False),
        ("cellar", False, True),
    ]


@pytest.mark.parametrize(
    ("given", "facing"),
    [
        pytest.param([], [0, 225, 225], id="none: onward, and at the stop as it came"),
        pytest.param([1, 2, 3, 4, -1], [115, 229, 303], id="as it leaves each viewpoint"),
        pytest.param([1, None, 3, 20, 5], [0, 66, 286], id="one is missing; more than a turn"),
        pytest.param([1, 2, 3], [0, 225, 225], id="not one for each pose"),
    ],
)
def test_where_an_agent_looks(given: list[float | None], facing: list[int], tmp_path: Path) -> None:
    """From the hall, the room is 6 m along y; from there, the cellar is 10 m along both, back."""
    walk = ["hall", "hall", "room", "room", "cellar"]
    episode_map = map_of(home_scores(tmp_path, {**WALKS, "1_3_0": (walk, LAMP)}), "1_3_0")
    steps = episode_map.steps(episode_map.routes[0], given)
    assert [step.facing for step in steps] == facing


@pytest.mark.parametrize(
    ("number", "notable", "expected"),
    [
        pytest.param(0, set(), "start", id="start"),
        pytest.param(1, set(), "", id="on the way"),
        pytest.param(
            1, {"goal", "jump"}, "jump between unconnected viewpoints, goal viewpoint", id="jump"
        ),
        pytest.param(2, {"goal", "stop"}, "stop, goal viewpoint", id="stop"),
    ],
)
def test_remarks(number: int, notable: set[str], expected: str) -> None:
    is_goal, is_jump, is_stop = (name in notable for name in ("goal", "jump", "stop"))
    notes = {"is_goal": is_goal, "is_jump": is_jump, "is_stop": is_stop}
    step = Step(number, "hall", 1, 0.0, 0.0, 0.0, **notes, facing=None)
    assert step.note == expected


# The plan.

FLOOR = np.array([(6.0, -1.0), (16.0, -1.0), (16.0, 9.0), (6.0, 9.0)])
"""Around the hall, the stairs' head and half of the way to the room."""


def furnished(episode_map: EpisodeMap) -> EpisodeMap:
    """Put a kitchen with a door on the upper storey and a bedroom below it."""
    building = replace(
        episode_map.building,
        rooms=[Room("bedroom", 0, [FLOOR], 100.0), Room("kitchen", 1, [FLOOR], 100.0)],
        doors=[Line(1, np.array([(9.5, 9.0), (10.5, 9.0)]))],
        room=np.where(episode_map.storey == 0, 0, 1),
    )
    return replace(episode_map, building=building)


def buildings_of(scores: rv.Scores) -> list[Building]:
    """Model the mansion and the rectory of the demo world."""
    truth = scores.ground_truth
    scans = ("DemoMansion", "DemoRectory")
    return [building_of(truth.graph, truth.require_solution(), scan) for scan in scans]


def test_each_scan_has_the_rooms_of_its_own_objects() -> None:
    """Names are those of the demo world's floor plans, apart from a library, which has desks."""
    scores = rv.evaluate(SAMPLES / "good.json", split="val_unseen")
    mansion, rectory = buildings_of(scores)
    names = [sorted({room.name for room in mansion.rooms_on(n)} - {""}) for n in (0, 1)]
    assert names == [["bedroom", "kitchen"], ["bedroom", "living room", "office"]]
    assert sorted(room.name for room in rectory.rooms if room.name) == [
        *("bathroom", "bedroom", "dining room", "kitchen", "laundry", "living room"),
        *("office", "office"),
    ]


def test_a_building_is_modelled_once_for_a_split() -> None:
    whole = rv.evaluate(SAMPLES / "good.json", split="val_unseen")
    part = rv.evaluate(
        SAMPLES / "good.json",
        split="val_unseen",
        ground_truth=whole.ground_truth,
        protocol="duet",
        subset=whole.instr_ids[:20],
    )
    assert all(one is other for one, other in zip(*map(buildings_of, (whole, part)), strict=True))


def test_the_plan_is_that_of_the_start(scores: rv.Scores) -> None:
    episode_map = furnished(map_of(scores, "1_3_0"))
    svg = map_svg(episode_map)
    (kitchen,) = elements(svg, "room")
    corners = [tuple(map(float, each.split())) for each in kitchen.get("d", "")[1:-1].split("L")]
    assert kitchen.get("class") == "room kitchen"
    frame = Frame.around(episode_map.position[episode_map.visited])
    assert corners == [tuple(corner.round(1)) for corner in frame.points(FLOOR)]
    assert [each.get("d", "").count("L") for each in elements(svg, "door")] == [1]
    assert [each.text for each in elements(svg, "room-name")] == ["kitchen"]
    assert "plan" in {sign.kind for sign in episode_map.signs}
    assert not list(elements(svg, "edge"))  # doors say where one can go


def test_the_plans_of_all_visited_levels_are_stacked(other: rv.Scores) -> None:
    svg = map_svg(furnished(map_of(other, "1_3_0")))
    kinds = [each.get("class") for each in elements(svg, "room")]
    assert kinds == ["room kitchen", "room bedroom"]
    assert [each.text for each in elements(svg, "room-name")] == ["kitchen", "bedroom"]


def test_names_of_rooms_cover_nothing(scores: rv.Scores) -> None:
    """A name is inside its room and beside the route; one without space is left out."""
    episode_map = furnished(map_of(scores, "1_3_0"))
    frame = Frame.around(episode_map.position[episode_map.visited])
    (name,) = Layout(episode_map, frame).room_names(1)
    assert name.mark
    drawn = frame.points(FLOOR)
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    assert (low < name.mark.point).all()
    assert (name.mark.point < high).all()
    route = frame.points(episode_map.position[episode_map.routes[0].viewpoint])
    assert abs(name.mark.point[0] - route[0, 0]) > 20  # half of the word
    narrow = [Room("kitchen", 1, [FLOOR * (0.1, 1.0) + (9.0, 0.0)], 10.0)]
    tight = replace(episode_map, building=replace(episode_map.building, rooms=narrow))
    assert not list(Layout(tight, frame).room_names(1))


def test_plans_of_all_levels_can_be_chosen(scores: rv.Scores) -> None:
    svg = interactive_map_svg(furnished(map_of(scores, "1_3_0")))
    groups = [
        (group.get("data-levels"), group.get("data-elsewhere"), group[0].get("class"))
        for group in ET.fromstring(svg).iter("g")
        if len(group) and "room" in group[0].get("class", "").split()
    ]
    assert groups == [("1", "", "room bedroom"), ("2", None, "room kitchen")]
