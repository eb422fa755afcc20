"""A person walks an episode: what they see, where they can go, and how it is scored."""

import json
import re
from dataclasses import replace
from functools import partial
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval import CATALOGUE, GroundTruth
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.reporting.answer_svg import WIDTH
from reverie_eval.reporting.skyboxes import PANORAMAS_VARIABLE
from reverie_eval.runner import run_agent
from reverie_eval.server.errors import MalformedError, NotFoundError
from reverie_eval.server.explore.episodes import Annotations, Browsing, EpisodeService
from reverie_eval.server.explore.play_page import HumanWalk, sample
from reverie_eval.server.scoring.boards import load_board
from reverie_eval.server.settings import Split
from reverie_eval.server.state import Reading
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.serving import (
    OPEN,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
)
from tests.support.visiting import Visitor, said
from tests.support.worlds import write_world

TRUTH = GroundTruth.load(DEMO_BUNDLES / f"{OPEN}.npz")
RECORDS = {record["instr_id"]: record for record in run_agent("shortest", TRUTH)}
"""Walks to the goal that end with the right answer."""
EPISODES = [1, 2, 3]
"""Numbers of episodes in the sample of seed 0."""


def numbers(truth: GroundTruth, record: dict[str, Any]) -> list[int]:
    """Return the steps of a walk: viewpoints after the start, counted within their scan."""
    graph = truth.graph
    visited = np.array([graph.index[viewpoint_id] for viewpoint_id, *_ in record["trajectory"]])
    first = np.flatnonzero(graph.viewpoint_scan == graph.viewpoint_scan[visited[0]])[0]
    return [int(each) for each in visited[1:] - first]


def address(number: int, steps: list[int], answer: str = "") -> str:
    return f"/play/{OPEN}/{number}?walk={'.'.join(map(str, steps))}&answer={answer}"


def walked_to(record: dict[str, Any], made: int) -> list[str]:
    """Return the viewpoints of the first steps of a walk."""
    return [viewpoint_id for viewpoint_id, *_ in record["trajectory"][1 : made + 1]]


def been(page: str) -> int:
    """Return how many viewpoints are on the map of where one has been."""
    (drawing,) = re.findall(r'<figure id="been"[^>]*>(.*?)</figure>', page, re.DOTALL)
    (data,) = re.findall(r'class="viewpoint" d="([^"]*)"', drawing)
    return len(set(data.split("M")[1:]))


@pytest.mark.parametrize("number", EPISODES)
def test_a_walk_is_found_by_links_and_scored_as_its_file(number: int, server: Serving) -> None:
    visitor, truth = Visitor(server), TRUTH
    instr_id = sample(server.state.board(OPEN), 0, number)[-1]
    record = RECORDS[instr_id]
    steps = numbers(truth, record)
    page = visitor.get(f"/play/{OPEN}/{number}")
    assert page.text.count("<image ") == 2  # what was drawn of the demo world
    assert been(page.text) == 1
    for made in range(1, len(steps) + 1):
        walk = ".".join(map(str, steps[:made]))
        (link, *_) = re.findall(rf'href="([^"]*walk={re.escape(walk)})"', page.text)
        assert "target" not in said(page)
        assert instr_id not in page.text  # it has the id of the target
        page = visitor.get(unescape(link))
        # Where one has been, and nothing else: no other viewpoint, and no room.
        assert been(page.text) == len({record["trajectory"][0][0], *walked_to(record, made)})
        assert 'class="room' not in page.text
    links = re.findall(rf'href="([^"]*choice={record["predObjId"]}#answer)"', page.text)
    page = visitor.get(unescape(links[0]))
    (chosen,) = re.findall(r"<input [^>]* checked>", page.text)
    assert f'value="{record["predObjId"]}"' in chosen
    page = visitor.get(address(number, steps, str(record["predObjId"])))
    (kept,) = re.findall(r'data-record="([^"]*)"', page.text)
    assert json.loads(unescape(kept)) == record
    values = rv.evaluate([*RECORDS.values()], split=OPEN, ground_truth=truth).episodes
    row = truth.episodes.index[instr_id]
    for key in ("path_length", "success", "spl", "rgs", "rgspl"):
        metric = CATALOGUE[key]
        label = metric.label if metric.is_binary else metric.heading
        assert f"{label} {metric.display_one(values[key][row])}" in said(page)


def test_without_photographs_the_room_is_drawn(
    server: Serving, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The view turns by links; its boxes are those of the views that show it."""
    monkeypatch.setenv(PANORAMAS_VARIABLE, str(tmp_path))
    visitor = Visitor(server)
    headings: list[str] = []
    page = visitor.get(f"/play/{OPEN}/1?facing=0")
    while len(headings) < 12:
        (view,) = re.findall(
            r'<svg class="answer-view ahead in-room".*?</svg>', page.text, re.DOTALL
        )
        headings += re.findall(r"<title>The view ahead, heading (\d+)°</title>", view)
        assert ('class="solids"' in view, "target" in view) == (True, False)
        (link,) = re.findall(r'<a href="([^"]*)" data-turn>Turn right', page.text)
        page = visitor.get(unescape(link))
    assert [*map(int, headings)] == [*range(0, 360, 30)]
    assert "facing 0°" in said(page)
    page = visitor.get(f"/play/{OPEN}/1?facing=343")
    assert "facing 330°" in said(page)
    assert "The view ahead, heading 330°" in page.text


def test_the_panorama_frames_what_the_picture_shows(
    server: Serving, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A photograph shows 75 degrees of heading, and a drawn room 102."""
    widths = []
    for _ in range(2):
        page = Visitor(server).get(f"/play/{OPEN}/1?facing=0").text
        (frame,) = re.findall(r'<polygon class="box frame" points="([^"]*)"', page)
        across = [float(point.split(",")[0]) for point in frame.split()]
        widths.append(np.ptp(across) * 360 / WIDTH)
        monkeypatch.setenv(PANORAMAS_VARIABLE, str(tmp_path))  # no photographs there
    assert widths == pytest.approx([75.2, 101.6], abs=0.2)


def test_a_walk_is_compared_with_those_of_methods(server: Serving) -> None:
    """One of two methods is right, but it walks to and fro, farther than the person."""
    instr_id = sample(server.state.board(OPEN), 0, EPISODES[0])[-1]
    record = RECORDS[instr_id]
    path = record["trajectory"]
    detour = {**record, "trajectory": [*path, *path[-2::-1], *path[1:]]}
    nowhere = {**record, "trajectory": path[:1], "predObjId": -1}
    own = address(EPISODES[0], numbers(TRUTH, record), str(record["predObjId"]))
    assert "You against" not in said(server.client.get(own))
    for who, its in ((OWNER, detour), (OTHER, nowhere)):
        content = json.dumps([*({**RECORDS, instr_id: its}).values()]).encode()
        identity = server.upload(who, content).json()["submission"]["id"]
        shown = {"published": True, "shows_episodes": True}
        server.ask(who, "PATCH", f"/submissions/{identity}", json=shown)
    metres = (
        3 * rv.evaluate([*RECORDS.values()], split=OPEN).episode(instr_id).values["path_length"]
    )
    told = f"You against 2 methods: 1 of them solves this episode, walking {metres:.1f} m"
    assert f"{told}; 1 of those walks farther than you." in said(server.client.get(own))
    lost = said(server.client.get(address(EPISODES[0], [], "none")))
    assert f"{told}." in lost
    episode = said(server.client.get(f"/episodes/{OPEN}/{instr_id}"))
    assert "Solved by 1 of 2 methods: Walker." in episode


def test_no_answer_is_an_answer(server: Serving) -> None:
    page = Visitor(server).get(address(EPISODES[0], [], "none"))
    assert "You predicted no object." in said(page)
    assert '"predObjId":-1' in unescape(page.text)


@pytest.mark.parametrize(
    ("path", "status", "says"),
    [
        pytest.param(address(EPISODES[0], [99999]), 400, "does not exist", id="no viewpoint"),
        pytest.param(address(EPISODES[0], [0] * 300), 400, "at most 200 steps", id="too long"),
        pytest.param(address(EPISODES[0], [], "99999"), 400, "not visible", id="another object"),
        pytest.param(f"/play/{OPEN}/{EPISODES[0]}?walk=a", 400, "walk", id="no numbers"),
        pytest.param(f"/play/{OPEN}/{EPISODES[0]}?walk=1..2", 400, "walk", id="two dots"),
        pytest.param(f"/play/{OPEN}/{EPISODES[0]}?answer=lamp", 400, "answer", id="no id"),
        pytest.param(f"/play/{OPEN}?seed=-1", 400, "seed", id="a seed below zero"),
        pytest.param(f"/play/{OPEN}?n=0", 400, "n", id="no episodes"),
        pytest.param(f"/play/{OPEN}/none", 400, "number", id="no number"),
        pytest.param(f"/play/{OPEN}/0", 400, "number", id="number zero"),
        pytest.param(f"/play/{OPEN}/85", 404, "has 84 episodes", id="too high a number"),
        pytest.param(f"/play/{PRIVATE}", 404, "private", id="a private split"),
        pytest.param(f"/play/{PRIVATE}/{EPISODES[0]}", 404, "private", id="an episode of one"),
    ],
)
def test_what_cannot_be_walked(path: str, status: int, says: str, server: Serving) -> None:
    reply = Visitor(server).get(path)
    assert reply.status_code == status
    assert says in said(reply)


def test_a_step_leads_to_a_neighbour(server: Serving) -> None:
    truth, instr_id = TRUTH, sample(server.state.board(OPEN), 0, 1)[0]
    graph, start = truth.graph, truth.episodes.start[truth.episodes.index[instr_id]]
    scan = np.flatnonzero(graph.viewpoint_scan == graph.viewpoint_scan[start])
    far = int(np.flatnonzero(~graph.has_edge(np.full_like(scan, start), scan))[-1])
    reply = Visitor(server).get(address(1, [far]))
    assert reply.status_code == 400
    assert "not connected" in said(reply)


def test_fifty_objects_at_a_viewpoint_can_all_be_answered(
    tmp_path: Path, folder: Path, open_server: OpenServer
) -> None:
    """As many as some viewpoints of real buildings have, in the same views as each other."""
    views = {object_id: [12 + object_id % 12] for object_id in range(1, 51)}
    boxes = {(each, views[each][0]): (10 * each, 8 * each, 40, 30) for each in views}
    hall = Viewpoint((0.0, 0.0, 0.0), views=views, boxes=boxes)
    world = World(
        {
            "hall": Scan(
                {"here": hall, "there": Viewpoint((0.0, 3.0, 0.0))}, frozenset({("here", "there")})
            )
        },
        [Item("1_7", "hall", ["there", "here"], 7)],
    )
    write_world(world, tmp_path / "world")
    bundle = compile_split(DatasetFiles.find(tmp_path / "world", split=OPEN), OPEN)
    bundle.save(folder / "bundles" / f"{OPEN}.npz")
    server = open_server()
    page = server.client.get(address(1, [0]))
    radios = re.findall(r'type="radio"[^>]*value="(\d+)"|value="(\d+)"[^>]*type="radio"', page.text)
    assert sorted(int(one or other) for one, other in radios) == [*views]
    assert {int(each) for each in re.findall(r'data-object="(\d+)"', page.text)} == {*views}
    assert len(page.content) < 70_000
    assert "predicted the target" in said(server.client.get(address(1, [0], "7")))
    assert "the target is" in said(server.client.get(address(1, [0], "50")))


def test_nobody_walks_where_answers_alone_are_scored(folder: Path, open_server: OpenServer) -> None:
    server = open_server(adjusted(settings_of(folder), OPEN, track="grounding"))
    visitor = Visitor(server)
    assert visitor.get(f"/play/{OPEN}/{EPISODES[0]}").status_code == 404
    assert f"/play/{OPEN}" not in visitor.get("/episodes").text


def test_a_sample_is_the_same_for_everyone_and_repeats_targets_last(server: Serving) -> None:
    board, episodes = server.state.board(OPEN), TRUTH.episodes
    everything = len(episodes.instr_ids)
    drawn = sample(board, 7, everything)
    items = [int(episodes.item[episodes.index[instr_id]]) for instr_id in drawn]
    targets = len(set(items))
    assert sorted(drawn) == sorted(episodes.instr_ids)
    assert len(set(items[:targets])) == targets
    second = items[targets : 2 * targets]
    assert len(set(second)) == len(second), "some target is drawn a third time too early"
    assert sample(board, 7, 5) == drawn[:5]
    assert sample(board, 8, everything) != drawn


def browsing(server: Serving) -> Browsing:
    with server.state.database.reading() as session:
        reading = Reading(server.state, session, server.clock())
        return server.state.get(EpisodeService).browse(reading, None, OPEN, [])


def refused(error: type[Exception], action: Any, *given: Any) -> str:
    with pytest.raises(error) as told:
        action(*given)
    return str(told.value)


def test_what_cannot_be_walked_says_why(server: Serving) -> None:
    seen = browsing(server)
    of = partial(HumanWalk.of, seen, 0)
    start = of(1, [])
    (way, *_) = start.ways
    scan = viewpoints_of_scan(start)
    home = scan.index(start.seen.viewpoint_id)
    there_and_back = [way.number, home] * 100
    assert len(of(1, there_and_back).visited) == 201
    told = "a walk has at most 200 steps"
    assert refused(MalformedError, of, 1, [*there_and_back, way.number]) == told
    near = {each.number for each in start.ways} | {home}
    far = next(number for number in range(len(scan)) if number not in near)
    unconnected = "the walk has a step to a viewpoint that is not connected"
    assert refused(MalformedError, of, 1, [way.number, home, far]) == unconnected
    nowhere = "the walk has a step to a viewpoint that does not exist"
    assert refused(MalformedError, of, 1, [len(scan)]) == nowhere
    assert refused(NotFoundError, of, 85, []) == "val_unseen has 84 episodes"
    assert of(84, []).instr_id == sample(seen.board, 0, 84)[-1]
    hidden = "object 99999 is not visible from where the walk ends"
    assert refused(MalformedError, start.end, 99999) == hidden
    split = seen.board.settings.model_copy(update={"track": "grounding"})
    answers = replace(seen, board=replace(seen.board, settings=split))
    assert refused(NotFoundError, HumanWalk.of, answers, 0, 1, []) == (
        "val_unseen scores answers alone; there are no walks"
    )


def viewpoints_of_scan(walk: HumanWalk) -> list[str]:
    graph = walk.board.truth.graph
    scans = map(graph.scan_of, range(len(graph.viewpoint_ids)))
    pairs = zip(graph.viewpoint_ids, scans, strict=True)
    return [viewpoint_id for viewpoint_id, scan_id in pairs if scan_id == walk.seen.scan_id]


def test_a_walk_and_its_answer_are_scored_as_they_are(server: Serving) -> None:
    seen = browsing(server)
    instr_id = sample(seen.board, 0, 1)[0]
    record = RECORDS[instr_id]
    steps = numbers(TRUTH, record)
    right, written = HumanWalk.of(seen, 0, 1, steps).end(record["predObjId"])
    assert (right.instr_id, right.predicted_object) == (instr_id, record["predObjId"])
    assert [right.values[key] for key in ("success", "rgs")] == [1, 1]
    assert written == record
    nothing, written = HumanWalk.of(seen, 0, 1, steps).end(None)
    assert [nothing.values[key] for key in ("success", "rgs")] == [1, 0]
    assert written == {**record, "predObjId": -1}


@pytest.mark.parametrize(
    ("task", "fields"),
    [
        pytest.param("r2r", {"instr_id": str, "trajectory": list}, id="r2r"),
        pytest.param("soon", {"instr_id": int, "trajectory": list}, id="soon: an item's record"),
    ],
)
def test_a_walk_without_a_target_has_no_answer(task: str, fields: dict[str, type]) -> None:
    path = DEMO_BUNDLES / task / "val_unseen.npz"
    split = Split(visibility="open", bundle=path, task=task)
    board = load_board(f"{task}-val_unseen", split, path)
    walk = HumanWalk.of(
        Browsing(board, Annotations.of(board), [], [], lambda: (None, False)), 0, 1, []
    )
    _, record = walk.end(None)
    assert {key: type(value) for key, value in record.items()} == fields
