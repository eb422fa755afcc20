"""The paper's networks and losses: by hand, by gradients, and on the simulator's observations."""

import math
import random
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from reverie_eval.agents.trained._agent import MOST_EXPANDED, Choice, Queue
from reverie_eval.agents.trained._coding import Layout, Panorama, Vocabulary
from reverie_eval.agents.trained._losses import (
    Walks,
    erase,
    hinge,
    imitation_loss,
    policy_loss,
    ranking_loss,
    returns_of,
)
from reverie_eval.agents.trained._recipes import RECIPES
from reverie_eval.agents.trained._world import (
    AdvisedWorld,
    World,
    hold_back,
    make_coder,
)
from reverie_eval.agents.trained.navigators import (
    ActionScores,
    Decision,
    Navigator,
    Reading,
    Sizes,
    SlotInputs,
    Slots,
    State,
    collate,
)
from reverie_eval.agents.trained.pointers import Candidates, MAttNet, Pointer, best_names
from reverie_eval.dataset import DatasetFiles, compile_for_training
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.simulator import Environment, Go


@pytest.fixture(scope="module")
def truth(demo_world: Path) -> GroundTruth:
    files = DatasetFiles.find(demo_world, split="train")
    return GroundTruth.from_bundle(compile_for_training(files, "train")[0])


@pytest.fixture(scope="module")
def world(truth: GroundTruth) -> World:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    return World(truth, make_coder(truth, np.arange(len(truth.episodes.instr_ids))))


@pytest.fixture
def batch(world: World) -> np.ndarray:
    """Return episodes of one number of words, the largest batch of them."""
    lengths = np.array([len(words) for words in world.words])
    return np.flatnonzero(lengths == np.bincount(lengths).argmax())


# What models are shown.


def test_training_sees_what_the_simulator_shows(truth: GroundTruth, world: World) -> None:
    environment = Environment(truth)
    row, episode = 3, environment.episodes[3]
    seen = environment.reset(episode)
    for viewpoint in world.path(row)[1:]:
        seen = environment.step(Go(truth.graph.viewpoint_ids[viewpoint]))
        mine, its = vars_of(world.panoramas[viewpoint]), vars_of(world.coder.panorama(seen))
        # One turn more or less, by the direction that the agent faces.
        turns = (mine["ways"] - its["ways"])[:, 0] / math.tau
        its["ways"][:, 0] += turns.round() * math.tau
        for name, value in mine.items():
            np.testing.assert_allclose(value, its[name], atol=1e-12, err_msg=name)
    assert len(world.panoramas[viewpoint].name) > 0


def vars_of(panorama: Panorama) -> dict[str, Any]:
    return {
        name: getattr(panorama, name)
        for name in Panorama.__dataclass_fields__
        if name != "viewpoint_ids"
    }


def test_what_is_held_back_shares_no_building_and_no_route(truth: GroundTruth) -> None:
    parts = hold_back(truth, elsewhere=truth.scans[:1])
    assert sorted(np.concatenate(parts)) == list(range(len(truth.episodes.instr_ids)))
    scans = np.array(truth.scans)
    ends = list(zip(truth.episodes.start, truth.require_solution().goal, strict=True))
    trained = {*scans[parts.trained]}
    assert trained.isdisjoint(scans[parts.unseen])
    assert trained.issuperset(scans[parts.seen])
    assert {ends[row] for row in parts.trained}.isdisjoint(ends[row] for row in parts.seen)
    assert scans[0] not in scans[parts.unseen]


PANORAMA = Panorama(
    viewpoint_ids=("here", "there"),
    ways=np.array([[math.pi / 2, 0.0, 2.5]]),
    viewpoint=np.array([1, 0]),
    in_slot=np.array([[True, True, True], [False, True, True]]),
    slot=np.array([0, 0, 1]),
    seen=np.array([1, 2, 2]),
    object_id=np.array([7, 8, 9]),
    name=np.array([1, 2, 2]),
    box=np.array([[0.0, 0.0, 0.5, 0.5], [0.25, 0.0, 0.5, 0.5], [0.5, 1.0, 0.25, 0.5]]),
)


def test_slots_are_worked_out_by_hand() -> None:
    alone = replace(PANORAMA, viewpoint_ids=("here",), ways=np.zeros((0, 3)))
    alone = replace(alone, viewpoint=alone.viewpoint[:1], slot=alone.slot[:2], seen=alone.seen[:2])
    matches = np.array([0.0, 0.5, 1.0])
    slots = collate([Decision(PANORAMA, math.pi / 2, matches), Decision(alone, 0.0, matches)])
    assert slots.valid.tolist() == [[True, True], [True, False]]
    # The neighbour is straight ahead, at a heading of a quarter turn, 2.5 m away.
    ahead = [0.0, 1.0, 1.0, 0.0, 0.0, 0.5, 1.0]
    assert slots.geometry[0, 1].tolist() == pytest.approx(ahead, abs=1e-6)
    assert not slots.geometry[:, 0].any()
    # Best share, sum / 4, number of names said in full / 4.
    stop, ahead, nothing = [1.0, 0.375, 0.25], [1.0, 0.25, 0.25], [0.0, 0.0, 0.0]
    assert slots.matches.tolist() == [[stop, ahead], [stop, nothing]]
    assert slots.seen.tolist() == [1, 2, 2, 1, 2]
    assert slots.begin.tolist() == [0, 2, 3, 5]


def test_the_layout_of_objects_is_worked_out_by_hand() -> None:
    layout = Layout.of(PANORAMA.name, PANORAMA.box)
    # The third is smaller and higher than the mean of the two of its name.
    own, others = [1.0, 0.25, 0.5, 0.125], [0.5, -0.125, 0.0, -0.0625]
    assert layout.location[2].tolist() == pytest.approx([*own, *others, math.log(2)])
    assert layout.around.tolist() == [[2, 2, -1, -1, -1], [1, -1, -1, -1, -1], [1, -1, -1, -1, -1]]
    # From the first to the second: a quarter turn to the right, equally large.
    assert layout.offset[0, 0].tolist() == pytest.approx([1, 0, 0, 0, 0], abs=1e-12)


def test_the_pointer_passes_on_its_best_names() -> None:
    best = best_names(np.array([0.1, 0.3, 0.2]), PANORAMA.name, PANORAMA.in_slot)
    assert best.tolist() == [[2, 2, 1], [2, 2, -1]]


def test_words_that_are_unknown_match_nothing(world: World) -> None:
    assert not world.coder.matches(world.coder.vocabulary.encode("xyzzy plugh")).any()
    shares = world.coder.matches(np.arange(len(world.coder.vocabulary.words) + 1))
    assert shares.tolist() == [0.0] + [1.0] * (len(shares) - 1)  # the first is of no name
    assert Vocabulary(("lamp", "table")).encode("the two Lamps").tolist() == [0, 0, 1]


# Losses.


class Stub(Navigator):
    """Scores actions in a fixed way."""

    def __init__(
        self, logits: list[float], progress: float | None, value: float | None = None
    ) -> None:
        super().__init__(Sizes(1000, 2, 2), SlotInputs(), 0)
        self.value = value
        self.logits, self.progress = torch.tensor(logits), progress

    def forward(self, reading: Reading, state: State, slots: Slots) -> ActionScores:  # noqa: ARG002
        """Score actions."""
        shape = slots.valid.shape
        logits = self.logits[: shape[1]].expand(shape).masked_fill(~slots.valid, -torch.inf)
        progress = None if self.progress is None else torch.full(shape[:1], self.progress)
        value = None if self.value is None else torch.full(shape[:1], self.value)
        return ActionScores(logits, state.h, state.c, torch.zeros(*shape, 2), progress, value)


def test_teacher_forcing_is_worked_out_by_hand(world: World) -> None:
    row = np.array([3])
    path = world.path(3)
    # With equal logits, each step costs the logarithm of the number of actions.
    steps = [math.log(len(world.panoramas[at].viewpoint)) for at in path]
    loss = imitation_loss(Stub([0.0] * 20, None), world, row, is_student=False)
    assert loss.item() == pytest.approx(np.mean(steps))
    # A monitor that always says "half of it" costs the mean square of what it is off by.
    left = [float(world.distance(row, np.array([at]))[0]) for at in path]
    off = [(0.5 - (1 - each / left[0])) ** 2 for each in left]
    both = imitation_loss(Stub([0.0] * 20, 0.5), world, row, is_student=False)
    assert both.item() == pytest.approx((np.mean(steps) + np.mean(off)) / 2, rel=1e-5)


def test_a_student_that_stops_is_told_where_to_go(world: World) -> None:
    logits = [50.0] + [0.0] * 19
    loss = imitation_loss(Stub(logits, None), world, np.array([3]), is_student=True)
    assert loss.item() == pytest.approx(50.0)  # one step: it stopped, and should not have


def test_hinge_is_worked_out_by_hand() -> None:
    right, wrong = torch.tensor([0.5, 0.5, 0.5]), torch.tensor([0.3, 0.45, 0.7])
    assert hinge(right, wrong).tolist() == pytest.approx([0.0, 0.05, 0.3])


def test_returns_are_worked_out_by_hand() -> None:
    # The second of three episodes is over after one step.
    rewards = [np.array([1.0, 2.0, 0.0]), np.array([0.0, -1.0]), np.array([2.0])]
    indices = [np.array([0, 1, 2]), np.array([0, 2]), np.array([0])]
    first, second, third = returns_of(rewards, indices, 3)
    assert third.tolist() == [2.0]
    assert second.tolist() == pytest.approx([0.95 * 2, -1.0])
    assert first.tolist() == pytest.approx([1 + 0.95 * 0.95 * 2, 2.0, -0.95])


def test_the_policy_gradient_is_worked_out_by_hand(world: World) -> None:
    model = Stub([50.0] + [0.0] * 19, None, value=0.25)
    # It stops at once: no way is made, and the stop is not a success. The critic expected 0.25.
    assert not world.is_success(np.array([3]), np.array([world.start[3]])).any()
    assert policy_loss(model, world, np.array([3])).item() == pytest.approx(0.5 * 0.25**2)


class Likes(Pointer):
    """Scores the first word of an expression times the number of a candidate."""

    def __init__(self) -> None:
        super().__init__(Sizes(1, 2, 2))
        self.factor = nn.Parameter(torch.tensor(0.01))

    def forward(self, words: Tensor, tokens: Tensor, candidates: Candidates) -> Tensor:  # noqa: ARG002
        """Score candidates."""
        number = candidates.name * candidates.valid
        return (self.factor * words[:, :1] * number).masked_fill(~candidates.valid, -torch.inf)


def test_the_ranking_loss_is_worked_out_by_hand(world: World) -> None:
    row = 3
    panorama, word = world.panoramas[world.goal[row]], world.words[row][0]
    scores = 0.01 * word * panorama.name
    target = int(np.flatnonzero(panorama.object_id == world.solution.target_object[row])[0])
    expected = sum(
        max(0.0, 0.1 + score - scores[target])
        for index, score in enumerate(scores)
        if index != target
    )
    # The other expression in the batch is of the same item, and so not a wrong one.
    assert ranking_loss(Likes(), world, np.array([row])).item() == pytest.approx(expected, rel=1e-5)


def test_the_word_that_is_attended_to_most_is_erased(batch: np.ndarray, world: World) -> None:
    model = RECIPES["mattnet"].build(world.coder).eval()
    assert isinstance(model, MAttNet)
    words = torch.from_numpy(np.stack([world.words[row] for row in batch[:4]]))
    weights, attention, _ = model.language(words)
    for before, after, w, a in zip(words, erase(model, words), weights, attention, strict=True):
        (changed,) = (before != after).nonzero().flatten().tolist() or [None]
        dominant = int((w[:, None] * a).sum(dim=0).argmax())
        assert after[dominant] == 0
        assert changed in {dominant, None}  # None, if it was unknown before


# Networks.


@pytest.mark.parametrize("name", RECIPES)
def test_every_weight_learns(name: str, world: World, truth: GroundTruth) -> None:
    torch.manual_seed(1)
    recipe = RECIPES[name]
    rows = np.arange(len(world.words))
    rows = rows[[len(words) == len(world.words[0]) for words in world.words]]
    model = recipe.build(world.coder)
    if isinstance(model, Pointer):
        loss = ranking_loss(model, world, rows, erases=recipe.erases)
    else:
        its: World = world
        if recipe.inputs.top:
            pointer = RECIPES["mattnet"].build(world.coder).eval()
            assert isinstance(pointer, Pointer)
            its = AdvisedWorld(truth, world.coder, pointer, world.coder)
        assert isinstance(model, Navigator)
        loss = imitation_loss(model, its, rows, is_student=False)
        if recipe.reinforced_from:
            loss += policy_loss(model, its, rows)
    loss.backward()  # type: ignore[no-untyped-call]
    still = [
        name for name, its in model.named_parameters() if its.grad is None or not its.grad.any()
    ]
    assert still == []


def test_padding_and_company_change_no_score(batch: np.ndarray, world: World) -> None:
    torch.manual_seed(2)
    model = RECIPES["self-monitor"].build(world.coder).eval()
    assert isinstance(model, Navigator)

    def walked(rows: np.ndarray) -> Mapping[tuple[int, int], list[float]]:
        walks, scored = Walks(model, world, rows), {}
        for number, (_, active, _, scores) in enumerate(walks.steps()):
            for row, logits in zip(active.tolist(), scores.logits, strict=True):
                scored[row, number] = logits[torch.isfinite(logits)].tolist()
            walks.act(scores.logits.argmax(dim=1) * (number < 4))
        return scored

    with torch.no_grad():
        together = walked(batch)
        for row in batch.tolist():
            for key, logits in walked(np.array([row])).items():
                assert logits == pytest.approx(together[key], abs=1e-5)


# The queue of FAST.


def queued(scores: Mapping[str, Mapping[str, float]], queue: Any) -> list[str]:
    """Let a queue choose among actions whose scores are given by where they are and lead."""
    came, order = Choice(None, "a", 0.0, None), []
    while not came.is_stop:
        order.append(came.target)
        here = scores[came.target].items()
        queue.add([Choice(came.target, to, came.score + score, None) for to, score in here])
        came = queue.pop()
    return [*order, came.target]


class SlowQueue:
    """Looks through all actions that were ever scored."""

    def __init__(self) -> None:
        self.known: list[Choice] = []

    def add(self, choices: list[Choice]) -> None:
        """Add actions."""
        self.known += choices

    def pop(self) -> Choice:
        """Take the best one."""
        visited = {each.origin for each in self.known}
        is_full = len(visited) >= MOST_EXPANDED
        open_ones = [
            each for each in self.known if each.is_stop or not (is_full or each.target in visited)
        ]
        return max(open_ones, key=lambda each: each.score)


@pytest.mark.parametrize("seed", range(40))
def test_the_queue_takes_what_a_search_of_everything_takes(seed: int) -> None:
    draw = random.Random(seed)
    names = ["a", *map(str, range(draw.choice([3, 10, 70])))]
    scores = {
        name: {name: draw.gauss(-3, 1), **{other: draw.randint(-1, 2) for other in others}}
        for name in names
        for others in [draw.sample([each for each in names if each != name], 3)]
    }
    assert queued(scores, Queue()) == queued(scores, SlowQueue())


def test_a_queue_goes_back_for_a_better_start() -> None:
    scores = {
        "a": {"a": -9.0, "b": 1.0, "c": 0.5},
        "b": {"b": -9.0, "a": 5.0},  # already visited, however good
        "c": {"c": 0.0, "a": 0.0},
    }
    assert queued(scores, Queue()) == ["a", "b", "c", "c"]
