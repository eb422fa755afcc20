"""The reference agents: their trajectories on the graphs, their answers and their scores."""

import json
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from reverie_eval import CATALOGUE, GroundTruth, GroundTruthError, Scores, evaluate
from reverie_eval.agents import AGENTS, MAX_RANDOM_STEPS
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle
from reverie_eval.runner import Record, run_agent
from reverie_eval.submissions._fast import read_fast
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.worlds import ground_truth_of, with_arrays

BUNDLES = {
    "train": DEMO_BUNDLES / "train.npz",
    "val_seen": DEMO_BUNDLES / "val_seen.npz",
    "val_unseen": DEMO_BUNDLES / "val_unseen.npz",
    "test": DEMO_BUNDLES / "private" / "test.npz",
}
SEEDS = range(5)


walk = cache(run_agent)
"""Runs an agent once on a split with a seed; many tests look at the same walks."""


@pytest.fixture(scope="module", params=list(BUNDLES))
def truth(request: pytest.FixtureRequest) -> GroundTruth:
    """Load the ground truth of every demo split with its answers."""
    return GroundTruth.load(BUNDLES[request.param])


@cache
def scores_of(name: str, truth: GroundTruth, seed: int = 0) -> Scores:
    """Score an agent."""
    records = walk(name, truth, seed)
    return evaluate(records, split=truth.split, ground_truth=truth)


def viewpoints(record: Record) -> list[str]:
    """Return the viewpoints of a record."""
    return [viewpoint_id for viewpoint_id, *_ in record["trajectory"]]


# Shortest.


@pytest.mark.parametrize("key", ["success", "spl", "rgs", "rgspl", "oracle_success", "sdtw"])
def test_shortest_scores_100_percent(key: str, truth: GroundTruth) -> None:
    """Except for path fidelity, where annotated paths have detours."""
    value = scores_of("shortest", truth)[key]
    assert value <= 1 if key == "sdtw" else value == 1


def test_shortest_walks_the_shortest_length(truth: GroundTruth) -> None:
    episodes = scores_of("shortest", truth).episodes
    assert episodes["path_length"] == pytest.approx(episodes["shortest_length"], abs=1e-9, rel=0)
    assert not episodes["jumps"].any()
    assert not episodes["navigation_error"].any()


def test_shortest_takes_the_shorter_way_round() -> None:
    """The annotated path is 7 m long, the shortest route 5 m."""
    places = {"door": (0.0, 0.0), "hall": (0.0, 4.0), "yard": (1.0, 0.0), "bath": (3.0, 4.0)}
    house = Scan(
        {
            name: Viewpoint((x, y, 0.0), views={5: [12]} if name == "bath" else {})
            for name, (x, y) in places.items()
        },
        frozenset({("door", "hall"), ("hall", "bath"), ("door", "bath"), ("door", "yard")}),
    )
    world = World({"house": house}, [Item("7_1", "house", ["door", "hall", "bath"], 5)])
    (record,) = run_agent("shortest", ground_truth_of(world))
    assert (viewpoints(record), record["predObjId"]) == (["door", "bath"], 5)


# Random.


def test_shortest_predicts_nothing_if_the_target_is_not_visible() -> None:
    whole = Bundle.load(DEMO_BUNDLES / "val_unseen.npz")
    target = np.full_like(whole.arrays["task_target"], 10**6)
    records = run_agent("shortest", GroundTruth.from_bundle(with_arrays(whole, task_target=target)))
    assert {record["predObjId"] for record in records} == {-1}


def test_random_repeats_itself_with_the_same_seed(truth: GroundTruth) -> None:
    assert run_agent("random", truth, seed=1) == run_agent("random", truth, seed=1)
    assert run_agent("random", truth, seed=1) != run_agent("random", truth, seed=2)


@pytest.mark.parametrize("seed", SEEDS)
def test_random_takes_up_to_ten_steps_along_edges(seed: int, truth: GroundTruth) -> None:
    episodes = scores_of("random", truth, seed).episodes
    assert MAX_RANDOM_STEPS == 10
    assert episodes["steps"].max() <= MAX_RANDOM_STEPS
    assert not episodes["jumps"].any()


@pytest.mark.parametrize("seed", SEEDS)
def test_random_never_stays_if_there_is_an_edge(seed: int, truth: GroundTruth) -> None:
    for record in walk("random", truth, seed):
        assert all(here != there for here, there in pairwise(viewpoints(record)))


@pytest.mark.parametrize("seed", SEEDS)
def test_random_predicts_an_object_visible_at_its_stop(seed: int, truth: GroundTruth) -> None:
    """And no object only if none is visible."""
    records = walk("random", truth, seed)
    stops = np.array([truth.graph.index[viewpoints(record)[-1]] for record in records])
    named = np.array([record["predObjId"] for record in records])
    is_visible = truth.require_solution().is_visible(named, stops)
    sees_anything = np.isin(stops, truth.require_solution().candidate_viewpoint)
    assert (is_visible == sees_anything).all()
    assert (named[~sees_anything] == -1).all()


def test_random_takes_every_number_of_steps(demo: GroundTruth) -> None:
    records = [record for seed in SEEDS for record in walk("random", demo, seed)]
    assert {len(record["trajectory"]) - 1 for record in records} == set(range(11))


def test_random_stays_if_there_is_no_edge() -> None:
    tower = Scan({"cell": Viewpoint((0.0, 0.0, 0.0), views={5: [12]})}, frozenset())
    truth = ground_truth_of(World({"tower": tower}, [Item("7_1", "tower", ["cell"], 5)]))
    for seed in SEEDS:
        (record,) = run_agent("random", truth, seed)
        assert (set(viewpoints(record)), record["predObjId"]) == ({"cell"}, 5)


# Stop.


def test_stop_stays_at_the_start_and_predicts_nothing(truth: GroundTruth) -> None:
    episodes = scores_of("stop", truth).episodes
    assert not episodes["path_length"].any()
    assert not episodes["steps"].any()
    assert not episodes["rgs"].any()
    assert {record["predObjId"] for record in walk("stop", truth, 0)} == {-1}


# All of them.


@pytest.mark.parametrize("name", list(AGENTS))
def test_agents_write_the_official_form(name: str, truth: GroundTruth) -> None:
    records = walk(name, truth, 0)
    predictions = read_fast(json.dumps(records).encode(), truth.task, truth.graph.viewpoint_table)
    assert predictions is not None
    assert list(predictions.instr_ids) == list(truth.episodes.instr_ids)
    angles = [pose[1:] for record in records for pose in record["trajectory"]]
    heading, elevation = np.array(angles).T
    assert ((heading >= 0) & (heading <= 2 * np.pi)).all()
    assert (np.abs(elevation) <= np.pi / 2).all()


@pytest.mark.parametrize(
    ("there", "heading", "elevation"),
    [
        pytest.param((0.0, 2.0, 0.0), 0.0, 0.0, id="north"),
        pytest.param((2.0, 0.0, 0.0), np.pi / 2, 0.0, id="east"),
        pytest.param((0.0, -2.0, 0.0), np.pi, 0.0, id="south"),
        pytest.param((-2.0, 0.0, 0.0), 3 * np.pi / 2, 0.0, id="west"),
        pytest.param((1.0, 1.0, 0.0), np.pi / 4, 0.0, id="north-east"),
        pytest.param((0.0, 2.0, 2.0), 0.0, np.pi / 4, id="up"),
        pytest.param((0.0, 2.0, -2.0), 0.0, -np.pi / 4, id="down"),
    ],
)
def test_poses_look_in_the_direction_of_travel(
    there: tuple[float, float, float], heading: float, elevation: float
) -> None:
    """Headings increase from north (y) to east (x), as in the simulator."""
    field = Scan(
        {"here": Viewpoint((0.0, 0.0, 0.0)), "there": Viewpoint(there, views={5: [12]})},
        frozenset({("here", "there")}),
    )
    world = World({"field": field}, [Item("7_1", "field", ["here", "there"], 5)])
    (record,) = run_agent("shortest", ground_truth_of(world))
    first, last = record["trajectory"]
    assert first == ["here", 0.0, 0.0]
    assert last == ["there", pytest.approx(heading), pytest.approx(elevation)]


def test_a_public_bundle_is_not_enough_for_shortest(truth: GroundTruth) -> None:
    public = GroundTruth.from_bundle(Bundle.load(BUNDLES[truth.split]).public())
    with pytest.raises(GroundTruthError, match="has no solution"):
        run_agent("shortest", public)


# REVERIE as published.


@pytest.mark.dataset
@pytest.mark.parametrize(
    ("split", "length"), [("val_seen", "10.53"), ("val_unseen", "9.47")], ids=str
)
def test_shortest_has_the_path_length_given_in_the_paper(
    split: str, length: str, published_bundles: Path
) -> None:
    """On val_unseen; the paper gives 7 cm less for val_seen, but was written before the release."""
    truth = GroundTruth.load(published_bundles / f"{split}.npz")
    scores = scores_of("shortest", truth)
    assert CATALOGUE["path_length"].display(scores["path_length"]) == length
    assert [scores[key] for key in ("success", "oracle_success", "spl", "rgs")] == [1, 1, 1, 1]
