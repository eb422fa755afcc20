"""Agents are found by name, as a file, in a module and by entry point, and say what is wrong."""

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest

from reverie_eval import ReverieEvalError
from reverie_eval.agents import AgentSource
from reverie_eval.simulator import Environment, Stop
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.worlds import ground_truth_of

WORLD = World(
    {"house": Scan({"hall": Viewpoint((0.0, 0.0, 1.5), views={5: [12]})}, frozenset())},
    [Item("7_5", "house", ["hall"], 5)],
)
AGENTS = """
from dataclasses import dataclass
from functools import partial
from beside import ANSWER
from numpy import int64
from reverie_eval.simulator import Answer, Stop

@dataclass
class Agent:
    answer: int = ANSWER
    def start(self, episode): pass
    def act(self, seen): return Answer(self.answer)

class Other(Agent):
    version = "of mine"

class NoAgent:
    def act(self, seen): return Stop()

class Failing(Agent):
    def __init__(self): raise KeyError("MY_KEY")

class Unsized(NoAgent):
    def start(self, episode): pass
    def act_batch(self, episodes, observations): return [Stop()] * len(episodes)

class Sized(Unsized):
    batch_size = int64(4)

def blind(): return Stop()

def function(seen, answer=6): return Answer(answer)

NUMBER = 7
PARTIAL = partial(function, answer=5)
METHOD = Agent().act

class Even(Agent):
    @classmethod
    def identity(cls, answer): return {"is_even": answer % 2 == 0}
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "modules", {**sys.modules})
    (tmp_path / "beside.py").write_text("ANSWER = 5")
    agents = tmp_path / "my_agents.py"
    agents.write_text(AGENTS)
    return agents


def answer_of(source: AgentSource) -> object:
    seen = Environment(ground_truth_of(WORLD)).reset("7_5_0")
    agent: Any = source.make()
    return getattr(agent.act(seen), "object_id", None)


@pytest.mark.parametrize(
    ("name", "options", "answer"),
    [
        pytest.param("my_agents.py", {}, 5, id="file"),
        pytest.param("./my_agents.py:Agent", {"answer": 3}, 3, id="class in a file"),
        pytest.param("my_agents.py:function", {}, 6, id="function in a file"),
        pytest.param("my_agents:function", {"answer": 4}, 4, id="function in a module"),
        pytest.param("my_agents:METHOD", {}, 5, id="method in a module"),
        pytest.param("my_agents:Other", {}, 5, id="class in a module"),
        pytest.param("theirs", {"answer": 2}, 2, id="entry point"),
        pytest.param("stop", {}, None, id="ours"),
    ],
)
def test_an_agent_is_found(
    name: str, options: dict[str, int], answer: int | None, file: Path
) -> None:
    metadata = file.parent / "theirs-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[reverie_eval.agents]\ntheirs = my_agents:Agent\n")
    sys.path.insert(0, str(file.parent))
    assert answer_of(AgentSource(name, options)) == answer


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        pytest.param("shortes", {}, "did you mean shortest?", id="misspelt"),
        pytest.param("none.py", {}, "there is no file none.py", id="no file"),
        pytest.param("none:Agent", {}, "No module named 'none'", id="no module"),
        pytest.param("my_agents.py:A", {}, "has no class or function 'A'", id="not in the file"),
        pytest.param("my_agents:NUMBER", {}, "has no class or function", id="a number"),
        pytest.param("my_agents:PARTIAL", {}, "has no class or function", id="a partial function"),
        pytest.param("my_agents:NoAgent", {}, "needs start(episode) and act(", id="no start"),
        pytest.param("my_agents:Agent", {"x": 1}, "its options: answer", id="unknown option"),
        pytest.param("my_agents:function", {"x": 1}, "its options: answer", id="of a function"),
        pytest.param("stop", {"x": 1}, "stop has no option x; its options: none", id="no options"),
        pytest.param("chat", {}, "chat needs model, endpoint, observe", id="several missing"),
        pytest.param(
            "chat",
            {"model": "m", "endpoint": "e", "cache": "c"},
            "chat needs observe; its options: model",
            id="one missing",
        ),
        pytest.param(
            "nearest-first", {"viewpoints": "a"}, "a whole number, at least 1, got 'a'", id="a word"
        ),
        pytest.param(
            "word-match", {"viewpoints": 0}, "a whole number, at least 1, got 0", id="too small"
        ),
        pytest.param(
            "my_agents:Failing",
            {},
            "cannot be made: KeyError: 'MY_KEY' (my_agents.py, line 21)",
            id="failing",
        ),
        pytest.param("my_agents:Unsized", {}, "needs a batch_size: how many", id="no size"),
        pytest.param(
            "broken.py",
            {},
            "cannot be imported: NameError: name 'nothing' is not defined (broken.py, line 1)",
            id="broken",
        ),
        pytest.param("my_agents:blind", {}, "needs a parameter for the observation", id="blind"),
        pytest.param(
            "unread.py",
            {},
            "unread.py cannot be imported: SyntaxError: invalid syntax (unread.py, line 1)",
            id="a syntax error",
        ),
        pytest.param(
            "exiting.py", {}, "cannot be imported: SystemExit: 3 (exiting.py, line 1)", id="exiting"
        ),
        pytest.param("needy.py", {}, "cannot be imported: ModuleNotFoundError", id="needy"),
    ],
)
def test_what_is_not_an_agent_is_named(
    name: str, options: dict[str, Any], message: str, file: Path
) -> None:
    file.with_name("broken.py").write_text("nothing")
    file.with_name("unread.py").write_text("def (")
    file.with_name("exiting.py").write_text("raise SystemExit(3)")
    file.with_name("needy.py").write_text("import not_installed_here")
    with pytest.raises(ReverieEvalError) as caught:
        AgentSource(name, options).make()
    assert message in str(caught.value)
    assert "frozen" not in str(caught.value)


def test_an_error_in_generated_code_is_where_the_agent_called_it(file: Path) -> None:
    (file.parent / "pose.py").write_text(
        "import dataclasses\n@dataclasses.dataclass(frozen=True)\nclass Pose:\n    x: float = 0.0\n"
        "def Agent(seen):\n    Pose().x = 1.0\n"
    )
    source = AgentSource("pose.py")
    agent: Any = source.make()
    with pytest.raises(AttributeError) as caught:
        agent.act(None)
    assert source.describe(caught.value).endswith("(pose.py, line 6)")


def test_a_batch_size_may_be_a_number_of_numpy(file: Path) -> None:
    assert AgentSource("my_agents:Sized").make().batch_size == 4  # type: ignore[union-attr]


def test_a_version_is_given_and_a_digest_is_of_the_file(file: Path) -> None:
    sources = [AgentSource(f"{file}:{name}") for name in ("Agent", "Other", "METHOD")]
    assert [each.version for each in sources] == ["", "of mine", ""]
    (before,) = {each.digest for each in sources}
    file.write_text(f"{AGENTS}\n# changed")
    (after,) = {each.digest for each in sources}
    assert after != before


@pytest.mark.parametrize(
    ("edited", "digests"),
    [
        pytest.param("beside.py", 2, id="imported"),
        pytest.param("parts/nets.py", 2, id="imported in a function of what is imported"),
        pytest.param("parts/__init__.py", 2, id="its package"),
        pytest.param("unrelated.py", 1, id="not imported"),
    ],
)
@pytest.mark.parametrize("name", ["{}/my_agents.py", "{}/my_agents.py:function", "my_agents:Agent"])
def test_a_digest_is_also_of_what_is_imported_beside_the_file(
    name: str, edited: str, digests: int, file: Path
) -> None:
    folder = file.parent
    (folder / "parts").mkdir()
    (folder / "beside.py").write_text("ANSWER = 5\ndef late(): from parts import nets")
    for other in ("parts/__init__.py", "parts/nets.py", "unrelated.py"):
        (folder / other).write_text("import beside, numpy.random\n")
    source = AgentSource(name.format(folder))
    before = source.digest
    with (folder / edited).open("a") as opened:
        opened.write("# changed\n")
    assert len({source.digest, before}) == digests


def test_an_agent_may_have_the_name_of_a_module_of_python(file: Path) -> None:
    (file.parent / "wave.py").write_text(AGENTS)
    assert answer_of(AgentSource("wave.py")) == 5
    sys.modules.pop("wave", None)
    assert hasattr(importlib.import_module("wave"), "Wave_read")


def test_a_class_says_which_options_can_change_an_answer(file: Path) -> None:
    options = {"answer": 4}
    assert AgentSource(f"{file}:Agent", options).identity == options
    assert AgentSource(f"{file}:Even", options).identity == {"is_even": True}


def test_a_title_has_no_folder() -> None:
    names = ["/home/me/agent.py", "/home/me/agent.py:Mine", "module:Mine", "stop"]
    titles = [AgentSource(name).title for name in names]
    assert titles == ["agent.py", "agent.py:Mine", "module:Mine", "stop"]


def test_a_function_keeps_nothing(file: Path) -> None:
    agent: Any = AgentSource("my_agents:function").make()
    agent.start(None)
    assert agent.act(None) != Stop()
