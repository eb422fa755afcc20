"""Every registered environment, by Gymnasium's own checker and side by side with a copy."""

import sys
from importlib import import_module
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

from reverie_eval import GroundTruth, evaluate
from reverie_eval.errors import MissingPartError
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle
from reverie_eval.simulator import ActionError
from reverie_eval.simulator.gymnasium import IDS, GymnasiumEnvironment

every_id = pytest.mark.parametrize("name", IDS.values())


def test_without_gymnasium_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, GymnasiumEnvironment.__module__)
    with pytest.raises(MissingPartError, match=r"pip install 'reverie-eval\[gymnasium\]'"):
        import_module(GymnasiumEnvironment.__module__)


def test_every_task_has_an_id() -> None:
    assert list(IDS.values()) == [
        f"reverie_eval/{task}-v1" for task in ("REVERIE", "R2R", "R4R", "RxR", "NDH", "SOON")
    ]
    registered = {name for name in gymnasium.registry if name.startswith("reverie_eval/")}
    assert registered == set(IDS.values())


@every_id
def test_its_own_checker_passes_without_a_warning(name: str) -> None:
    check_env(gymnasium.make(name).unwrapped)


@every_id
def test_two_copies_of_one_seed_are_equal_at_each_step(name: str) -> None:
    one, other = gymnasium.make(name), gymnasium.make(name)
    one.action_space.seed(5)
    seen, _ = one.reset(seed=7)
    assert data_equivalence(seen, other.reset(seed=7)[0])
    kinds, done, seen_before = set(), 0, []
    for _ in range(50):
        assert seen in one.observation_space
        action = one.action_space.sample()
        result = one.step(action)
        assert data_equivalence(result, other.step(action))
        seen, reward, terminated, truncated, info = result
        assert (reward, truncated) == (0.0, False)
        seen_before.append(len(seen["neighbours"]))
        kinds.add(int(action[0]))
        done += info["is_possible"]
        if terminated:
            seen, _ = one.reset()
            assert data_equivalence(seen, other.reset()[0])
    assert len(kinds) == len(one.get_wrapper_attr("actions"))
    assert len(set(seen_before)) > 1
    assert done > 25


@every_id
def test_two_copies_draw_the_same_actions_in_turns(name: str) -> None:
    spaces = [gymnasium.make(name).action_space for _ in range(2)]
    for space in spaces:
        space.seed(3)
    for _ in range(20):
        one, other = (space.sample() for space in spaces)
        assert data_equivalence(one, other)


def inner(name: str, **given: Any) -> GymnasiumEnvironment:
    made = gymnasium.make(name, **given).unwrapped
    assert isinstance(made, GymnasiumEnvironment)
    return made


def test_texts_have_the_letters_of_the_data() -> None:
    made = inner(IDS["rxr"])
    space: Any = made.observation_space
    assert {" ", "ह", "త"} <= space["instruction"].character_set
    for episode in made.environment.episodes:
        seen, _ = made.reset(options={"episode": episode})
        assert seen in made.observation_space


def test_going_leads_to_the_neighbour_of_the_number() -> None:
    made = inner(IDS["reverie"])
    seen, _ = made.reset(seed=0)
    later, *_, info = made.step((made.actions.index("go"), np.int64(1)))
    assert later["viewpoint_id"] == seen["neighbours"][1]["viewpoint_id"]
    assert info == {"is_possible": True}


def test_turning_faces_the_view_of_the_number() -> None:
    made = inner(IDS["reverie"])
    seen, _ = made.reset(seed=0)
    later, *_ = made.step((made.actions.index("turn"), 1))
    assert later["viewpoint_id"] == seen["viewpoint_id"]
    assert later["direction"].tolist() == pytest.approx([np.pi / 6, -np.pi / 6])


@pytest.mark.parametrize(
    ("task", "chosen", "argument", "fields"),
    [
        pytest.param("reverie", "stop", 0, {"predObjId": -1}, id="stop"),
        pytest.param(
            "reverie",
            "answer box",
            np.array([13, 1, 2, 3, 4]),
            {"predBox": [1, 2, 3, 4], "predView": 13},
            id="a box",
        ),
        pytest.param("soon", "point", np.array([np.pi, 0.0]), {}, id="a point"),
    ],
)
def test_how_an_episode_ends(task: str, chosen: str, argument: Any, fields: dict[str, Any]) -> None:
    made = inner(IDS[task])
    made.reset(seed=0)
    _, _, terminated, _, _ = made.step((made.actions.index(chosen), argument))
    assert terminated
    (record,) = made.environment.submission()
    assert {key: it for key, it in record.items() if key.startswith("pred")} == fields
    with pytest.raises(ActionError, match=r"no episode goes on; call reset\(\)"):
        made.step((made.actions.index("stop"), 0))


def test_what_cannot_be_done_changes_nothing() -> None:
    made = inner(IDS["reverie"])
    seen, _ = made.reset(seed=0)
    for chosen, argument in (("go", 99), ("answer", 99), ("answer box", np.zeros(5, np.int64))):
        same, _, terminated, _, info = made.step((made.actions.index(chosen), argument))
        assert (terminated, info) == (False, {"is_possible": False})
        assert data_equivalence(same, seen)


def test_only_the_parts_that_were_asked_for_are_read() -> None:
    made = inner(IDS["reverie"], parts=["instruction", "names"])
    seen, _ = made.reset(seed=0)
    assert seen.keys().isdisjoint({"image"})
    assert {key for it in seen["neighbours"] for key in it} == {"viewpoint_id"}
    assert {key for it in seen["candidates"] for key in it} == {"object_id", "name"}
    assert made.environment.parts_read == {"instruction", "names"}
    assert seen in made.observation_space


def test_a_public_bundle_is_walked_and_its_submission_scored() -> None:
    bundle = Bundle.load(DEMO_BUNDLES / "val_unseen.npz")
    truth = GroundTruth.from_bundle(bundle.public())
    made = inner(IDS["reverie"], ground_truth=truth, boxes=DEMO_BUNDLES / "val_unseen.npz")
    for episode in made.environment.episodes:
        seen, _ = made.reset(options={"episode": episode})
        made.step((made.actions.index("answer" if seen["candidates"] else "stop"), 0))
    whole = GroundTruth.from_bundle(bundle)
    scores = evaluate(made.environment.submission(), split="val_unseen", ground_truth=whole)
    assert scores["path_length"] == 0
