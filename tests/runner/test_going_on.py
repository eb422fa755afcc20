"""A run goes on where it ended, with the same identity alone."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from reverie_eval import GroundTruth, ReverieEvalError
from reverie_eval.agents import AgentSource
from reverie_eval.errors import LogError
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.runner import Identity, Limits, RunError, run
from reverie_eval.simulator import Observation, Stop
from tests.support.runs import (
    EPISODES,
    WORLD,
    Home,
    Scripted,
    forget_end,
    scripted,
    stop,
    to_the_end,
)
from tests.support.worlds import ground_truth_of


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    return scripted(tmp_path, monkeypatch)


def with_another_heading() -> GroundTruth:
    truth = ground_truth_of(WORLD)
    return replace(truth, episodes=replace(truth.episodes, heading=truth.episodes.heading + 1))


BOXES = '{"house_hall": {"8": {"visible_pos": [12], "bbox2d": [[1, 2, 3, 4]]}}}'
DEMO = GroundTruth.load(DEMO_BUNDLES / "val_unseen.npz")
# For each field, what is changed, and what the message says of it.
CHANGES: Mapping[str, tuple[Mapping[str, Any], str]] = {
    "task": (
        {"ground_truth": GroundTruth.load(DEMO_BUNDLES / "r2r" / "val_unseen.npz")},
        "task: reverie, now r2r",
    ),
    "split": (
        {"ground_truth": GroundTruth.load(DEMO_BUNDLES / "val_seen.npz")},
        "split: val_unseen, now val_seen",
    ),
    "fingerprint": (
        {"ground_truth": DEMO},
        rf"fingerprint of the ground truth: \w{{12}}, now {DEMO.fingerprint[:12]}",
    ),
    "shown": (
        {"ground_truth": with_another_heading()},
        r"digest of instructions, names and headings: \w{12}, now \w{12}",
    ),
    "episodes": (
        {"ground_truth": ground_truth_of(WORLD).subset(EPISODES[:2])},
        r"episodes: all, now \w{12}",
    ),
    "agent": ({"agent": AgentSource("stop")}, "agent: scripted:Agent, now stop"),
    "agent_version": (
        {"agent": AgentSource("stop")},
        r"version of the agent: 1, now [\w.]+",
    ),
    "agent_digest": (
        {"agent": AgentSource("stop")},
        r"digest of the agent's code: \w{12}, now \w{12}",
    ),
    "options": (
        {"agent": AgentSource("nearest-first", {"viewpoints": 3})},
        "option viewpoints: not given, now 3",
    ),
    "seed": ({"seed": 1}, "seed: 0, now 1"),
    "limits": ({"limits": Limits(steps=7)}, "limit of steps: 200, now 7"),
    "boxes": ({"boxes": "boxes.json"}, r"boxes: solution, now \w{12}"),
    "pictures": ({"pictures": "pictures"}, r"pictures: none, now \w{12}"),
    "reverie_eval": ({}, r"version of reverie-eval: [\w.]+, now 9\.9"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_another_identity_is_refused_by_name(
    name: str, home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("boxes.json").write_text(BOXES)
    Path("pictures").mkdir()
    home.run(stop)
    before = {each.name: each.read_bytes() for each in home.folder.iterdir()}
    if name == "reverie_eval":
        monkeypatch.setattr("reverie_eval.runner._run.__version__", "9.9")
    changes, message = CHANGES[name]
    with pytest.raises(RunError, match=rf"has another run \((.*; )?{message}(;|\))"):
        home.run(stop, **changes)
    assert {each.name: each.read_bytes() for each in home.folder.iterdir()} == before


def test_other_pictures_are_another_identity(home: Home, tmp_path: Path) -> None:
    """But not those of other buildings."""
    for scan in ("house", "elsewhere"):
        (tmp_path / scan / "matterport_skybox_images").mkdir(parents=True)
    home.run(stop, pictures=tmp_path)
    (tmp_path / "elsewhere" / "matterport_skybox_images" / "hall_skybox_small.jpg").touch()
    assert home.run(stop, pictures=tmp_path).attempts == 4
    (tmp_path / "house" / "matterport_skybox_images" / "hall_skybox_small.jpg").touch()
    with pytest.raises(RunError, match="pictures: "):
        home.run(stop, pictures=tmp_path)


def test_every_field_of_an_identity_is_compared() -> None:
    assert set(CHANGES) == set(Identity.__struct_fields__)


def test_another_circumstance_is_noted(home: Home) -> None:
    home.run(stop)
    assert run(home.plan, home.folder, jobs=3).attempts == 4
    assert [each.jobs for each in home.card.circumstances] == [1, 3]


def test_a_run_that_has_not_begun_can_become_another(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after a first command with a wrong option."""
    unready = type("Unready", (Scripted,), {"start": None})
    monkeypatch.setattr(sys.modules["scripted"], "Unready", unready, raising=False)
    with pytest.raises(ReverieEvalError, match="needs start"):
        home.run(stop, agent=AgentSource("scripted:Unready"))
    home.run(stop)
    assert home.card.identity.agent == "scripted:Agent"


def test_a_line_that_was_cut_off_is_left_out(home: Home) -> None:
    home.run(to_the_end)
    whole = home.folder.joinpath("submission.json").read_bytes()
    for name in ("episodes.jsonl", "steps.jsonl"):
        file = home.folder / name
        lines = file.read_bytes().splitlines(keepends=True)
        file.write_bytes(b"".join(lines[:-1]) + lines[-1][:-5])
    forget_end(home.folder)
    assert len(home.attempts) == 3
    home.run(to_the_end)
    assert home.folder.joinpath("submission.json").read_bytes() == whole
    last = [(each.attempt, each.state, each.steps) for each in home.attempts[3:]]
    assert last == [(1, "interrupted", 2), (2, "ended", 3)]


def lose_line(file: Path) -> None:
    file.write_bytes(b"".join(file.read_bytes().splitlines(keepends=True)[1:]))


def rename_episodes(file: Path) -> None:
    file.write_bytes(file.read_bytes().replace(b"7_5_", b"9_9_"))


@pytest.mark.parametrize(
    ("name", "damage", "message"),
    [
        pytest.param("episodes.jsonl", Path.unlink, r"episodes\.jsonl is lost", id="episodes"),
        pytest.param("steps.jsonl", Path.unlink, r"whose steps\.jsonl is lost", id="steps"),
        pytest.param(
            "episodes.jsonl", lose_line, r"has 3 attempts, and run\.json says 4", id="an attempt"
        ),
        pytest.param(
            "steps.jsonl", lose_line, "has 2 steps of attempt 1 at 7_5_0, .* says 3", id="a step"
        ),
        pytest.param(
            "*.jsonl", rename_episodes, "has 4 episodes that the split does not have", id="foreign"
        ),
    ],
)
def test_a_run_of_which_something_is_lost_does_not_go_on(
    name: str, damage: Callable[[Path], object], message: str, home: Home
) -> None:
    home.run(to_the_end)
    for file in home.folder.glob(name):
        damage(file)
    with pytest.raises(RunError, match=message):
        home.run(to_the_end)


def test_a_run_that_was_killed_as_it_began_goes_on(home: Home) -> None:
    home.folder.mkdir()
    (home.folder / "episodes.jsonl").touch()
    assert home.run(stop).ended == 4


def test_a_run_with_nothing_but_failures_can_become_another(home: Home) -> None:
    """What the failed attempts cost stays on record."""

    def fail(seen: Observation, agent: Scripted) -> Any:
        agent.episode.log(money=1.0)
        raise KeyError("x")

    with pytest.raises(RunError, match="KeyError"):
        home.run(fail, seed=1)
    assert home.run(stop, seed=2).money == 1.0
    assert home.card.identity.seed == 2


def test_a_damaged_line_is_named(home: Home) -> None:
    home.run(stop)
    file = home.folder / "episodes.jsonl"
    file.write_bytes(file.read_bytes().replace(b'"attempt":1', b'"attempt":x', 1))
    with pytest.raises(LogError, match=r"episodes\.jsonl, line 1: "):
        home.run(stop)


def test_two_processes_cannot_run_in_one_folder(home: Home) -> None:
    def act(seen: Observation, agent: Scripted) -> Any:
        with pytest.raises(RunError, match="another process is running there"):
            run(home.plan, home.folder)
        return Stop()

    assert home.run(act).ended == 4


def test_a_folder_with_something_else_is_left_alone(home: Home) -> None:
    home.folder.mkdir()
    (home.folder / "thesis.tex").touch()
    with pytest.raises(RunError, match=r"is not empty and has no run\.json"):
        home.run(stop)
    assert [each.name for each in home.folder.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        pytest.param(b'{"schema_version": 2}', "has version 2 of the schema", id="newer"),
        pytest.param(b'{"schema_version": 1}', "is not the card of a run", id="incomplete"),
        pytest.param(b"[]", "is not the card of a run", id="something else"),
    ],
)
def test_a_card_that_cannot_be_read_is_named(content: bytes, message: str, home: Home) -> None:
    home.folder.mkdir()
    (home.folder / "run.json").write_bytes(content)
    with pytest.raises(RunError, match=message):
        home.run(stop)
