"""The check for agents finds what is wrong, and passes ours."""

import sys
from pathlib import Path

import pytest

from reverie_eval import GroundTruth
from reverie_eval.agents import BUILT_IN_AGENTS, AgentSource
from reverie_eval.runner import Limits, RunPlan, check_agent
from reverie_eval.simulator.conformance import ConformanceError

AGENTS = """
from reverie_eval.simulator import Answer, Go, Stop, Turn

def reader(seen):
    named = [it for it in seen.candidates if it.name in seen.instruction]
    return Answer(named[0].object_id) if named else Stop()

def endless(seen): return Turn(0.0)
def lost(seen): return Go("nowhere")
def failing(seen): return {}["key"]

class Remembering:
    episodes = 0
    def start(self, episode):
        self.episodes += 1
        self.ahead = iter([Turn(self.episodes), Stop()])
    def act(self, seen): return next(self.ahead)

class Batch:
    batch_size = 2
    def start(self, episode): episode.memory = iter([Turn(1.0), Stop()])
    def act_batch(self, episodes, observations): return [next(it.memory) for it in episodes]

class Dependent(Batch):
    def act_batch(self, episodes, observations):
        actions = super().act_batch(episodes, observations)
        return [Turn(len(actions)) if it == Turn(1.0) else it for it in actions]
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "agents.py").write_text(AGENTS)
    return tmp_path / "agents.py"


@pytest.mark.parametrize(
    ("name", "read"),
    [
        pytest.param("stop", [], id="stop"),
        pytest.param("shortest", ["solution"], id="shortest"),
        pytest.param("random", [], id="random"),
        pytest.param("nearest-first", ["geometry"], id="nearest-first"),
        pytest.param("word-match", ["geometry", "instruction", "names"], id="word-match"),
    ],
)
def test_ours_pass_and_read_no_more_than_they_say(
    name: str, read: list[str], demo: GroundTruth
) -> None:
    assert sorted(check_agent(RunPlan(AgentSource(name), demo))) == read


def test_every_agent_is_checked() -> None:
    (mark,) = test_ours_pass_and_read_no_more_than_they_say.pytestmark  # type: ignore[attr-defined]
    assert {each.values[0] for each in mark.args[1]} == set(BUILT_IN_AGENTS) - {
        "chat"
    }  # has a test


def test_a_batch_passes_if_its_episodes_do_not_matter_to_each_other(
    file: Path, demo: GroundTruth
) -> None:
    assert check_agent(RunPlan(AgentSource(f"{file}:Batch"), demo)) == set()
    assert check_agent(RunPlan(AgentSource(f"{file}:reader"), demo)) == {"instruction", "names"}


@pytest.mark.parametrize(
    ("name", "says"),
    [
        pytest.param("endless", "9 steps", id="no end"),
        pytest.param("lost", "ActionError: 'nowhere' is not a neighbour", id="impossible"),
        pytest.param("failing", r"KeyError: 'key' \(agents.py, line 10\)", id="an error"),
        pytest.param("Remembering", "something else the second time", id="remembers"),
        pytest.param("Dependent", "something else the second time", id="depends on its batch"),
    ],
)
def test_what_is_wrong_is_found(name: str, says: str, file: Path, demo: GroundTruth) -> None:
    with pytest.raises(ConformanceError, match=says):
        check_agent(RunPlan(AgentSource(f"{file}:{name}"), demo, limits=Limits(steps=9)))
