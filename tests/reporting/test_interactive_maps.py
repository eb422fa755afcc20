"""Interactive maps: legs one by one, and storeys apart."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.reporting.map_layout import MOST_POSES
from reverie_eval.reporting.map_svg import interactive_map_svg, map_key, map_svg
from reverie_eval.reporting.maps import EpisodeMap
from tests.support.home_world import LAMP, OTHER_WALKS, WALKS, home_scores

MARKUP = '<script src="x">&amp;"\''


@pytest.fixture(scope="module")
def scores(tmp_path_factory: pytest.TempPathFactory) -> rv.Scores:
    """Score another submission, whose agent goes downstairs once."""
    return home_scores(tmp_path_factory.mktemp("home"), OTHER_WALKS)


def map_of(scores: rv.Scores, instr_id: str) -> EpisodeMap:
    return EpisodeMap.of({"": scores.episode(instr_id)})


def pieces(svg: str, kind: str) -> list[ET.Element]:
    """Return the groups that hold something of a class."""
    groups = ET.fromstring(svg).iter("g")
    return [g for g in groups if any(kind in each.get("class", "").split() for each in g)]


def test_every_piece_says_which_storeys_it_is_on(scores: rv.Scores) -> None:
    svg = interactive_map_svg(map_of(scores, "1_3_0"))
    levels = {g.get("data-viewpoint"): g.get("data-levels") for g in pieces(svg, "viewpoint")}
    alone = interactive_map_svg(map_of(scores, "1_3_1"))
    # The cellar is farther from the episode than stacked floors show.
    below, above = ("rack", "shelf"), ("stairs", "hall", "room", "porch")
    assert levels == dict.fromkeys(below, "1") | dict.fromkeys(above, "2")
    edges = {g.get("data-levels"): g[0].get("d", "").count("M") for g in pieces(alone, "edge")}
    assert edges == {"1": 2, "1 2": 1, "2": 3}
    assert [g.get("data-levels") for g in pieces(svg, "route")] == ["2", "1 2"]
    assert [g.get("data-levels") for g in pieces(svg, "annotated")] == ["2"]


def test_an_annotated_path_is_in_pieces_by_storey(tmp_path: Path) -> None:
    """Down the stairs: a leg above, one between, one below."""
    scores = home_scores(tmp_path)
    episode_map = map_of(scores, "1_3_0")
    place = {name: row for row, name in enumerate(episode_map.viewpoint_ids)}
    path = np.array([place[name] for name in ("room", "hall", "stairs", "shelf", "rack", "cellar")])
    svg = interactive_map_svg(replace(episode_map, annotated_path=path))
    drawn = [(g.get("data-levels"), g[0].get("d", "")) for g in pieces(svg, "annotated")]
    assert [(levels, d.count("M"), d.count("L")) for levels, d in drawn] == [
        ("2", 1, 2),
        ("1 2", 1, 1),
        ("1", 1, 2),
    ]
    ends = [d.split("L") for _, d in drawn]
    assert ends[1][0] == f"M{ends[0][-1]}"
    assert ends[2][0] == f"M{ends[1][-1]}"


def test_what_is_elsewhere_is_faint(tmp_path: Path) -> None:
    svg = interactive_map_svg(map_of(home_scores(tmp_path), "1_3_0"))
    faint = {
        g.get("data-viewpoint")
        for g in pieces(svg, "viewpoint")
        if (g.get("opacity"), g.get("data-elsewhere")) == ("0.35", "")
    }
    assert faint == {"cellar", "rack", "shelf"}


def test_legs_are_apart_and_join(scores: rv.Scores) -> None:
    svg = interactive_map_svg(map_of(scores, "1_3_0"))
    first, second = pieces(svg, "route")
    assert [(g.get("data-route"), g.get("data-leg")) for g in (first, second)] == [
        ("1", "1"),
        ("1", "2"),
    ]
    assert second[0].get("d", "").startswith(f"M{first[0].get('d', '').split('L')[-1]}")


def test_a_jump_begins_where_it_begins(tmp_path: Path) -> None:
    walk = ["hall", "room", "stairs", "hall"]
    svg = interactive_map_svg(
        map_of(home_scores(tmp_path, {**WALKS, "1_3_0": (walk, LAMP)}), "1_3_0")
    )
    legs = pieces(svg, "route")
    assert [leg[0].get("class") for leg in legs] == [
        "route route-1",
        "route jump route-1",
        "route route-1",
    ]
    assert [leg[0].get("d", "").count("L") for leg in legs] == [1, 1, 1]
    assert [len(leg) for leg in legs] == [2, 2, 2]  # each with its arrow


def test_what_was_annotated_alone(scores: rv.Scores) -> None:
    """An agent that stays where it starts adds no place to what the episode is about."""
    alone = map_of(scores, "2_4_0").without_routes()
    svg = interactive_map_svg(alone)
    assert not pieces(svg, "route")
    assert not pieces(svg, "stop")
    assert "The agent" not in alone.description
    assert "route" not in map_key(alone).replace("class=", "")


def test_it_shows_what_the_plain_map_shows(scores: rv.Scores) -> None:
    episode_map = map_of(scores, "1_3_0")
    plain, walkable = (ET.fromstring(draw(episode_map)) for draw in (map_svg, interactive_map_svg))
    for kind in ("start", "end", "goal", "stop", "level"):
        one, other = (
            [
                (each.tag, each.get("d"), each.get("cx"), each.get("x"), each.findtext("title"))
                for each in svg.iter()
                if kind in each.get("class", "").split()
            ]
            for svg in (plain, walkable)
        )
        assert one == other != []
    assert plain.findtext("desc") == walkable.findtext("desc")


def test_a_very_long_walk_is_cut_but_counted_whole(scores: rv.Scores) -> None:
    episode_map = map_of(scores, "1_3_0")
    (route,) = episode_map.routes
    hall, stairs, shelf = route.viewpoint.tolist()
    endless = replace(route, viewpoint=np.array([hall, stairs] * MOST_POSES + [shelf]))
    svg = interactive_map_svg(replace(episode_map, routes=[endless]))
    assert len(pieces(svg, "route")) == MOST_POSES - 1
    assert "makes 2,000 moves" in svg
    assert [g.get("data-viewpoint") for g in pieces(svg, "stop")] == ["shelf"]


def test_every_name_is_escaped_and_nothing_is_styled(scores: rv.Scores) -> None:
    episode_map = map_of(scores, "1_3_0")
    (route,) = episode_map.routes
    spoiled = replace(
        episode_map,
        instr_id=MARKUP,
        scan=MARKUP,
        viewpoint_ids=[MARKUP] * len(episode_map.viewpoint_ids),
        routes=[replace(route, name=MARKUP, outcome=MARKUP)],
    )
    svg = interactive_map_svg(spoiled)
    root = ET.fromstring(svg)
    assert {each.tag for each in root.iter()} <= {
        *("svg", "title", "desc", "g", "rect", "path", "circle", "text")
    }
    assert not any("style" in each.attrib for each in root.iter())
    assert {g.get("data-viewpoint") for g in pieces(svg, "viewpoint")} == {MARKUP}
