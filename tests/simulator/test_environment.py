"""The environment: what is observed, what can be done, what comes out, and what was read."""

import copy
import json
import math
import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from itertools import islice
from pathlib import Path
from random import Random
from typing import Any, cast

import numpy as np
import pytest

from fixtures.demo_world.world import demo_world
from reverie_eval import GroundTruth, ReverieEvalError, validate
from reverie_eval.geometry import view_angles
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle, Episodes
from reverie_eval.ground_truth._bundle import pack_texts
from reverie_eval.simulator import (
    Action,
    ActionError,
    Answer,
    AnswerBox,
    Box,
    Environment,
    Go,
    MatterSim,
    Observation,
    Point,
    Stop,
    Turn,
)
from tests.simulator.test_recorded_states import viewpoints
from tests.support.amounts import is_evidence
from tests.support.buildings import forget_buildings
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.skyboxes import write_skybox
from tests.support.sweeps import expected
from tests.support.worlds import ground_truth_of, write_world

QUARTER = math.pi / 2
BOX = (40, 50, 60, 70)
WORLD = World(
    {
        "house": Scan(
            {
                "hall": Viewpoint((0.0, 0.0, 1.5), views={8: [12, 13]}, boxes={(8, 13): BOX}),
                "north": Viewpoint((0.0, 2.0, 1.5), views={5: [0], 7: [35]}),
                "east": Viewpoint((3.0, 0.0, 5.5)),
                "far": Viewpoint((0.0, 9.0, 1.5), views={5: [12], 6: [1]}),
            },
            frozenset({("hall", "north"), ("hall", "east"), ("north", "far")}),
        )
    },
    [Item("7_5", "house", ["hall", "north", "far"], 5, instructions=2)],
)
TASKS = ["reverie", "r2r", "r4r", "rxr", "ndh", "soon"]


@pytest.fixture(scope="module")
def truth() -> GroundTruth:
    return ground_truth_of(WORLD)


@pytest.fixture
def environment(truth: GroundTruth) -> Environment:
    return Environment(truth)


def bundle_of(task: str) -> Path:
    return DEMO_BUNDLES / ("" if task == "reverie" else task) / "val_unseen.npz"


def demo_of(task: str) -> GroundTruth:
    return GroundTruth.load(bundle_of(task))


def public_of(task: str) -> GroundTruth:
    return GroundTruth.from_bundle(Bundle.load(bundle_of(task)).public())


# What is observed.


def test_neighbours_are_relative_to_where_the_agent_looks(environment: Environment) -> None:
    environment.reset("7_5_0")
    seen = environment.step(Turn(QUARTER, 0.5))
    assert (seen.scan_id, seen.viewpoint_id) == ("house", "hall")
    assert (seen.heading, seen.elevation, seen.is_over) == (QUARTER, 0.5, False)
    north, east = seen.neighbours
    assert [north.viewpoint_id, east.viewpoint_id] == ["north", "east"]
    assert (north.relative_heading, north.relative_elevation) == (-QUARTER, -0.5)
    assert (north.distance, north.view) == (2.0, 12)
    up = math.atan2(4, 3)
    assert east.relative_heading == 0.0
    assert east.relative_elevation == pytest.approx(up - 0.5)
    assert (east.distance, east.view) == (5.0, 24 + 3)


@pytest.mark.parametrize("task", ["reverie", "r2r", "rxr", "ndh", "soon"])
def test_an_episode_begins_at_the_published_heading(task: str) -> None:
    """In SOON, which publishes none, facing north. R4R's records have the fields of R2R's."""
    truth = public_of(task)
    environment, item = Environment(truth), demo_world().items["val_unseen"][0]
    seen = environment.reset(environment.episodes[0])
    assert (seen.heading, seen.elevation) == (0.0 if task == "soon" else item.heading, 0.0)


@pytest.mark.parametrize(
    ("heading", "relative"),
    [
        pytest.param(0.0, 0.0, id="ahead"),
        pytest.param(0.25, -0.25, id="left"),
        pytest.param(6.0, math.tau - 6.0, id="right, across north"),
        pytest.param(-0.25, 0.25, id="a heading below zero"),
    ],
)
def test_relative_headings_are_less_than_half_a_turn(
    heading: float, relative: float, environment: Environment
) -> None:
    environment.reset("7_5_0")
    north, _ = environment.step(Turn(heading)).neighbours
    assert north.relative_heading == pytest.approx(relative, abs=1e-12)


def test_candidates_have_their_categories_and_boxes(environment: Environment) -> None:
    environment.reset("7_5_1")
    (lamp,) = environment.reset("7_5_1").candidates
    assert (lamp.object_id, [box.view for box in lamp.boxes]) == (8, [12, 13])
    assert lamp.boxes[1] == Box(13, BOX)
    seen = environment.step(Go("north"))
    assert [it.object_id for it in seen.candidates] == [5, 7]


def test_names_are_those_of_the_categories() -> None:
    truth = demo_of("reverie")
    seen = Environment(truth).reset(truth.episodes.instr_ids[0])
    assert seen.instruction == truth.episodes.instructions[0]
    assert seen.candidates
    categories = {it.replace("#", " ") for it in truth.require_solution().candidate_categories}
    assert {it.name for it in seen.candidates} <= categories


def test_the_language_is_that_of_the_instruction() -> None:
    environment = Environment(demo_of("rxr"))
    languages = {environment.reset(it).language for it in environment.episodes}
    assert languages >= {"hi-IN", "te-IN"}


def test_observations_do_not_change(environment: Environment) -> None:
    seen = environment.reset("7_5_0")
    before = repr(seen)
    later = environment.step(Go("north"))
    assert repr(seen) == before
    assert later != seen
    assert later is not environment.reset("7_5_0")
    for name in ("viewpoint_id", "instruction"):
        with pytest.raises(FrozenInstanceError):
            setattr(seen, name, "far")


# Nothing of the annotation is in it.


def walked(environment: Environment, episode: str, steps: int = 4) -> list[Observation]:
    rng, seen = Random(0), [environment.reset(episode)]
    for _ in range(steps):
        seen.append(environment.step(Go(rng.choice(seen[-1].neighbours).viewpoint_id)))
    return [*seen, environment.step(Stop())]


def test_a_public_bundle_and_the_released_boxes_show_the_same(
    tmp_path: Path, truth: GroundTruth
) -> None:
    write_world(WORLD, tmp_path)
    boxes = tmp_path / "tasks" / "REVERIE" / "data" / "BBoxes.json"
    given = Environment(demo_of("reverie"))
    shown = Environment(public_of("reverie"), boxes=bundle_of("reverie"))
    for episode in given.episodes:
        assert walked(given, episode) == walked(shown, episode)
    without = replace(truth, solution=None)
    assert walked(Environment(truth), "7_5_0") == walked(Environment(without, boxes=boxes), "7_5_0")
    assert not any(seen.candidates for seen in walked(Environment(without), "7_5_0"))


def test_other_answers_show_the_same(truth: GroundTruth) -> None:
    elsewhere = World(WORLD.scans, [Item("7_5", "house", ["hall", "north"], 7, instructions=2)])
    observed = [walked(Environment(it), "7_5_0") for it in (truth, ground_truth_of(elsewhere))]
    assert observed[0] == observed[1]


def test_an_observation_leads_to_nothing_else() -> None:
    """What has a reference to the solution would be copied with it, and could be asked."""
    environment = Environment(demo_of("reverie"))
    seen = environment.reset(environment.episodes[0])
    packed = pickle.dumps(seen)
    assert pickle.loads(packed) == seen
    assert len(packed) < 20_000
    assert b"GroundTruth" not in packed


def test_any_viewpoint_can_be_observed_without_going_there(environment: Environment) -> None:
    seen = environment.observe("7_5_0", "north")
    environment.reset("7_5_0")
    arrived = environment.step(Go("north"))  # which faces north, too
    assert seen == arrived
    with pytest.raises(ReverieEvalError, match="no viewpoint 'attic'"):
        environment.observe("7_5_0", "attic")
    assert environment.submission() == []


def test_an_observation_has_no_id_of_the_episode() -> None:
    environment = Environment(demo_of("reverie"))
    for episode in environment.episodes:
        assert episode not in repr(environment.reset(episode))


# What can be done.


def test_the_trajectory_is_recorded_as_it_is_submitted(environment: Environment) -> None:
    environment.reset("7_5_0")
    environment.step(Turn(1.0, -0.5))
    environment.step(Go("east"))
    environment.step(Go("hall"))
    environment.step(Turn(2.0))
    assert environment.submission() == []
    assert environment.step(Answer(8)).is_over
    up = math.atan2(4, 3)
    assert environment.submission() == [
        {
            "instr_id": "7_5_0",
            "trajectory": [
                ["hall", 1.0, -0.5],
                ["east", QUARTER, up],
                ["hall", 2.0, 0.0],
            ],
            "predObjId": 8,
        }
    ]


@pytest.mark.parametrize(
    ("action", "fields"),
    [
        pytest.param(Stop(), {"predObjId": -1}, id="no answer"),
        pytest.param(Answer(8), {"predObjId": 8}, id="an object"),
        pytest.param(AnswerBox(13, BOX), {"predBox": list(BOX), "predView": 13}, id="a box"),
    ],
)
def test_how_an_episode_ends(
    action: Action, fields: dict[str, Any], environment: Environment
) -> None:
    environment.reset("7_5_0")
    assert environment.step(action).is_over
    (record,) = environment.submission()
    assert {key: record[key] for key in record if key.startswith("pred")} == fields


def test_the_answer_in_soon_is_a_direction() -> None:
    environment = Environment(demo_of("soon"))
    environment.reset(environment.episodes[0])
    environment.step(Point(math.pi, 0.0))
    ((point,),) = (record["trajectory"] for record in environment.submission())
    assert (point["obj_heading"], point["obj_elevation"]) == (0.5, 0.5)


def test_an_episode_that_is_walked_again_replaces_its_record(environment: Environment) -> None:
    for answer in (Answer(8), Stop()):
        environment.reset("7_5_0")
        environment.step(answer)
    environment.reset("7_5_0")  # begun, but not ended
    assert [record["predObjId"] for record in environment.submission()] == [-1]


NOT_VISIBLE = (
    "object 5 is not visible from where the agent is; answer with one of the observation's"
)


@pytest.mark.parametrize(
    ("action", "says"),
    [
        pytest.param(
            Go("far"),
            "'far' is not a neighbour of hall; go to one of the observation's neighbours",
            id="not a neighbour",
        ),
        pytest.param(Go("hall"), "'hall' is not a neighbour of hall", id="where it is"),
        pytest.param(Answer(5), NOT_VISIBLE, id="an object elsewhere"),
        pytest.param(Turn(math.nan), "is not a direction; angles are radians", id="nowhere"),
        pytest.param(Turn(0.0, 30.0), "is not a direction; angles are radians", id="degrees"),
        pytest.param(AnswerBox(36, BOX), "is not a box; expected left, top", id="no view"),
        pytest.param(AnswerBox(0, (1, 2, 0, 4)), "is not a box", id="a box without width"),
        pytest.param(AnswerBox(0, cast("Any", None)), "is not a box", id="no box"),
        *(
            pytest.param(
                Answer(cast("Any", wrong)),
                f"{Answer(cast('Any', wrong))!r} has no object id; expected a whole number",
                id=f"the object {wrong!r}",
            )
            for wrong in ("5", True, 5.0, [5], None)
        ),
        pytest.param(Turn(cast("Any", "left")), "is not a direction", id="a word"),
        pytest.param(Turn(10**400), "is not a direction", id="a huge angle"),
        pytest.param(Point(0.0, 0.0), "the answer in REVERIE is not a direction", id="a point"),
        pytest.param("north", "'north' is not an action, such as a Go", id="a name"),
        pytest.param(None, "None is not an action, such as a Go", id="nothing"),
        pytest.param([Stop()], "1 episode began; call reset(), then step()", id="a batch"),
    ],
)
def test_what_cannot_be_done_changes_nothing(
    action: Any, says: str, environment: Environment
) -> None:
    seen = environment.reset("7_5_0")
    with pytest.raises(ActionError) as told:
        environment.step(action)
    assert says in str(told.value)
    assert environment.step(Turn(0.0)) == seen


def test_nothing_can_be_done_before_and_after_an_episode(environment: Environment) -> None:
    with pytest.raises(ActionError, match="0 episodes began"):
        environment.step(Stop())
    environment.reset("7_5_0")
    environment.step(Stop())
    with pytest.raises(ActionError, match=r"the episode is over; .* after its end"):
        environment.step(Go("north"))


def test_tasks_without_objects_have_no_answers() -> None:
    environment = Environment(demo_of("r2r"))
    environment.reset(environment.episodes[0])
    with pytest.raises(ActionError, match="R2R has no target objects; end the episode with a Stop"):
        environment.step(Answer(1))


def test_an_unknown_episode_is_named(environment: Environment) -> None:
    with pytest.raises(ReverieEvalError, match="no episode '7_5_9' among the 2 episodes"):
        environment.reset("7_5_9")


@pytest.mark.parametrize("task", TASKS)
def test_public_bundles_suffice_for_a_submission(task: str) -> None:
    truth = public_of(task)
    environment = Environment(truth)
    for episode in environment.episodes:
        walked(environment, episode)
    report = validate(environment.submission(), split="val_unseen", ground_truth=truth, task=task)
    assert len(report.abstained) == len(environment.episodes)
    assert not report.jumps.any()


# Batches.


def test_a_batch_is_its_episodes_side_by_side(truth: GroundTruth) -> None:
    batch, alone = Environment(truth), Environment(truth)
    first, second = batch.reset(["7_5_0", "7_5_1"])
    assert first == alone.reset("7_5_0")
    first, second = batch.step([Go("east"), Stop()])
    assert first == alone.step(Go("east"))
    assert (first.is_over, second.is_over) == (False, True)
    first, second = batch.step([Answer(5) if first.candidates else Stop(), None])
    assert [len(it["trajectory"]) for it in batch.submission()] == [2, 1]
    assert [it["instr_id"] for it in batch.submission()] == ["7_5_0", "7_5_1"]


@pytest.mark.parametrize(
    ("actions", "says"),
    [
        pytest.param([Go("east")], "2 episodes began as a batch", id="too few"),
        pytest.param(Go("east"), "2 episodes began as a batch", id="no list"),
        pytest.param([Go("east"), Go("far")], "not a neighbour", id="the second impossible"),
        pytest.param([Go("east"), None], "None is not an action", id="one that goes on"),
    ],
)
def test_a_batch_does_all_actions_or_none(
    actions: Any, says: str, environment: Environment
) -> None:
    seen = environment.reset(["7_5_0", "7_5_1"])
    with pytest.raises(ActionError, match=says):
        environment.step(actions)
    assert environment.step([Turn(0.0), Turn(0.0)]) == seen


# What was read.


@pytest.mark.parametrize(
    ("read", "parts"),
    [
        pytest.param(lambda seen: seen.viewpoint_id, set(), id="where it is"),
        pytest.param(lambda seen: seen.instruction, {"instruction"}, id="instruction"),
        pytest.param(lambda seen: seen.neighbours[0].viewpoint_id, set(), id="neighbours"),
        pytest.param(lambda seen: seen.neighbours[0].distance, {"geometry"}, id="distance"),
        pytest.param(lambda seen: seen.neighbours[1].view, {"geometry"}, id="view"),
        pytest.param(lambda seen: seen.candidates[0].object_id, set(), id="objects"),
        pytest.param(lambda seen: seen.candidates[0].name, {"names"}, id="names"),
        pytest.param(lambda seen: seen.candidates[0].boxes, {"boxes"}, id="boxes"),
        pytest.param(lambda seen: copy.deepcopy(seen).instruction, {"instruction"}, id="a copy"),
        pytest.param(
            repr, {"instruction", "geometry", "names", "boxes"}, id="all of it, as in a prompt"
        ),
    ],
)
def test_the_parts_that_were_read_are_noted(
    read: Callable[[Observation], object], parts: set[str], environment: Environment
) -> None:
    seen = environment.reset("7_5_0")
    assert environment.parts_read == set()
    read(seen)
    assert environment.parts_read == parts


def test_a_picture_that_was_asked_for_is_noted(environment: Environment) -> None:
    with pytest.raises(ReverieEvalError, match=r"Environment\(..., pictures=folder\) has them"):
        environment.reset("7_5_0").image()
    assert environment.parts_read == {"pictures"}


# The same as on MatterSim.


def test_pictures_are_those_of_the_simulator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MATTERSIM_CACHE", "")
    forget_buildings(monkeypatch)
    truth = demo_of("reverie")
    graph, here = truth.graph, int(truth.episodes.start[0])
    name, scan, pose = graph.viewpoint_ids[here], graph.scan_of(here), np.eye(4)
    pose[:3, :3], pose[:3, 3] = graph.viewpoint_rotation[here], graph.viewpoint_position[here]
    record = {"image_id": name, "included": True, "unobstructed": [False]}
    record["pose"] = pose.ravel().tolist()
    (tmp_path / f"{scan}_connectivity.json").write_text(json.dumps([record]))
    (tmp_path / "scans.txt").write_text(scan)
    write_skybox(tmp_path, truth)
    simulator = MatterSim.Simulator()
    simulator.setNavGraphPath(str(tmp_path))
    simulator.setDatasetPath(str(tmp_path))
    simulator.setCameraResolution(640, 480)
    simulator.setCameraVFOV(math.radians(60))
    simulator.newEpisode([scan], [name], [1.0], [0.5])
    environment = Environment(truth, pictures=tmp_path)
    environment.reset(environment.episodes[0])
    image = environment.step(Turn(1.0, 0.5)).image()
    assert image.shape == (480, 640, 3)
    assert image.dtype == np.uint8
    assert (image == simulator.getState()[0].rgb[..., ::-1]).all()
    view = environment.step(Turn(math.pi / 3, 0.0))  # 60 degrees, level: the view 14
    assert (view.image() == environment.step(Turn(1.0, 0.5)).image(view=14)).all()


def test_a_viewpoint_without_a_skybox_is_named(truth: GroundTruth, tmp_path: Path) -> None:
    seen = Environment(truth, pictures=tmp_path).reset("7_5_0")
    with pytest.raises(
        ValueError, match=r"Could not open skybox RGB files at: .*hall_skybox_small"
    ):
        seen.image()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        pytest.param("none", None, "Could not open objects at: {}", id="no such path"),
        pytest.param("", None, "{}: it has no file of a viewpoint's objects", id="other folder"),
        pytest.param("agent.py", "class Agent: ...", "{}: Expecting value", id="no JSON"),
        pytest.param("run.json", "{}", "{}: no viewpoint of the split", id="other JSON"),
    ],
)
def test_boxes_that_cannot_be_read_are_named(
    name: str, content: str | None, message: str, truth: GroundTruth, tmp_path: Path
) -> None:
    boxes = tmp_path / name
    if content is not None:
        boxes.write_text(content)
    with pytest.raises(ReverieEvalError) as caught:
        Environment(truth, boxes=boxes)
    assert str(caught.value).startswith(message.format(boxes))


def test_a_folder_of_pictures_that_is_missing_is_named(truth: GroundTruth) -> None:
    with pytest.raises(ReverieEvalError, match=r"^nope: there is no such folder of pictures$"):
        Environment(truth, pictures="nope")


@pytest.mark.dataset
def test_neighbours_appear_in_the_views_of_a_sweep_on_the_original(
    published: Path, published_bundles: Path
) -> None:
    """Up to 10 micrometres: the original rounds positions to float32."""
    truth = GroundTruth.load(published_bundles / "val_seen.npz")
    ids = truth.graph.viewpoint_ids
    everywhere = Episodes(
        ids, np.arange(len(ids)), np.arange(len(ids)), np.zeros(len(ids)), pack_texts(ids)
    )
    environment = Environment(replace(truth, episodes=everywhere))
    compared = 0
    for scan, ix, found in islice(expected(), None if is_evidence() else 300):
        names = viewpoints(published / "reverie-v1" / "connectivity", scan)
        if names[ix] not in truth.graph.index:
            continue
        neighbours = environment.reset(names[ix]).neighbours
        assert {it.viewpoint_id: it.view for it in neighbours} == {
            names[other]: view for other, (view, _) in found.items()
        }
        centres = view_angles(np.array([it.view for it in neighbours], np.int64))
        for it, (heading, elevation) in zip(neighbours, centres.tolist(), strict=True):
            off = math.remainder(it.relative_heading - heading, math.tau)
            distance = math.hypot(off, it.relative_elevation - elevation)
            within = 1e-5 / (it.distance * math.cos(it.relative_elevation))  # across the floor
            expected_distance = found[names.index(it.viewpoint_id)].distance
            assert distance == pytest.approx(expected_distance, abs=within)
        compared += 1
    assert compared > 100


def test_what_is_not_a_ground_truth_or_an_episode_is_named(environment: Environment) -> None:
    with pytest.raises(ReverieEvalError, match=r"takes a ground truth, such as .*, not 'x\.npz'"):
        Environment("x.npz")  # type: ignore[arg-type]
    with pytest.raises(ReverieEvalError, match=r"takes an episode's id or a list of them, not 5"):
        environment.reset(5)  # type: ignore[call-overload]


@pytest.mark.parametrize("name", ["packed_instructions", "packed_languages", "heading"])
def test_a_digest_has_what_is_shown_and_not_in_the_fingerprint(name: str) -> None:
    truth = demo_of("rxr")
    episodes = truth.episodes
    other: dict[str, Any] = {
        "packed_instructions": pack_texts(episodes.instructions[::-1]),
        "packed_languages": pack_texts(episodes.languages[::-1]),
        "heading": episodes.heading + 1,
    }
    changed = replace(truth, episodes=replace(episodes, **{name: other[name]}))
    digests = {Environment(each).surroundings.unscored_digest for each in (truth, changed)}
    assert len(digests) == 2
    assert truth.fingerprint == changed.fingerprint
